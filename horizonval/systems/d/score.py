"""Rows and table that can fail: how many printed figures our readings share, and what chance would share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.d.rows import TEXT
from horizonval.systems.d.settings import PRINTED, QUANTUM_DEG
from horizonval.systems.d.steps import (
    COLUMNS,
    PHASES,
    TRUE_DEG,
    BestPhases,
    HeadVariant,
    alike_phases,
    best_phases,
    chance,
    count,
    cross_axis,
    lost_elsewhere,
    odd_columns,
    rendered_steps,
    same_step,
    variants,
)
from horizonval.systems.result import ComparisonRow, Table

PLAIN = HeadVariant(perspective=False)
FLAT = HeadVariant(perspective=True)


@dataclass(frozen=True)
class StepScore:
    """Figures on the printed step.

    ``rendered``: by the name of the frames, with those of the untilted axis; ``truth``: of the rounded truth;
    ``chance``: counts of evenly spread phases, for pixels of equal angle; ``best``: phases of the heads chosen for it,
    by projection; ``variants``: counts of all phases by variant.
    """

    rendered: dict[str, tuple[int, int]]
    truth: int
    chance: np.ndarray
    best: dict[HeadVariant, BestPhases]
    variants: dict[HeadVariant, list[int]]

    def by_chance(self, reached: int) -> float:
        """Return the share of phases that do as well."""
        return float((self.chance >= reached).mean())


def score_steps(readings: dict[str, dict[str, JsonObject]], rng: np.random.Generator) -> StepScore:
    """Count; ``readings`` are those of all settings, by the name of the frames."""
    crossings = variants()
    across = cross_axis()

    def both(steps: FloatArray) -> tuple[int, int]:
        return count(steps), int((same_step(steps) & across).sum())

    return StepScore(
        rendered={name: both(rendered_steps(one)) for name, one in readings.items()},
        truth=count(TRUE_DEG / QUANTUM_DEG),
        chance=chance(crossings[PLAIN], rng),
        best={one: best_phases(crossings[one]) for one in (PLAIN, FLAT)},
        variants={one: alike_phases(x) for one, x in crossings.items()},
    )


def step_rows(score: StepScore) -> list[ComparisonRow]:
    """Return what is on the printed step, against what needs no sensor and against chance."""
    across = int(cross_axis().sum())
    distinct = len({(s.roll_deg, s.pitch_deg, s.altitude_km) for s in COLUMNS})
    rows = [
        TEXT.row(
            "same_step",
            reached,
            PRINTED,
            limit=score.truth,
            at_least=True,
            frames=name,
            printed=PRINTED,
            truth=score.truth,
            chance=score.by_chance(reached),
        )
        for name, (reached, _) in score.rendered.items()
    ]
    rows.append(TEXT.row("truth_step", score.truth, PRINTED, printed=PRINTED, distinct=distinct))
    mean, top = float(score.chance.mean()), int(score.chance.max())
    rows.append(TEXT.row("chance_step", mean, PRINTED, printed=PRINTED, top=top, truth=score.by_chance(score.truth)))
    for one, best in score.best.items():
        projection = TEXT.phrase("flat" if one.perspective else "equal_angle")
        fields: dict[str, Any] = {"ways": best.ways, "tried": PHASES**4, "right": best.across, "across": across}
        rows.append(TEXT.row("best_step", best.count, PRINTED, printed=PRINTED, projection=projection, **fields))
    for name, (_, right) in score.rendered.items():
        rows.append(TEXT.row("across", right, across, across=across, frames=name))
    moved = lost_elsewhere()
    rows.append(
        TEXT.row("odd", len(odd_columns()), columns=len(COLUMNS), odd="; ".join(odd_columns()), lost="; ".join(moved))
    )
    return rows


def variant_table(score: StepScore) -> Table:
    """Return the counts of every variant: pixels centred on the axis as here, and over all phases."""
    lines = []
    for one, counts in score.variants.items():
        projection = TEXT.phrase("flat" if one.perspective else "equal_angle")
        ends = f"{min(counts)} to {max(counts)}"
        lines.append((projection, f"{one.row_px:g}", f"{one.limb_km:g}", counts[PHASES // 2], ends))
    return TEXT.table("variants", lines, phases=PHASES, printed=PRINTED)
