"""The tables of the two-station localisation: published beside ours, and what the published noise may mean."""

from __future__ import annotations

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.systems.e import noise as noise
from horizonval.systems.e.case import (
    METHODS,
    NOISE_ARCSEC,
    NOISE_ROUNDING_DEG,
    PUBLISHED_NOISE,
    PUBLISHED_ROUNDING,
    QUANTITIES,
    ROUNDING_DEG,
    Figures,
)
from horizonval.systems.e.localisation.pipeline import ALPHA
from horizonval.systems.e.trials import ALPHAS
from horizonval.systems.result import Cell, Table
from horizonval.systems.text import page_text

Rows = dict[str, dict[str, FloatArray]]
"""Draws of every row, by the row's name: see :func:`horizonval.systems.e.trials.gathered`."""


TEXT = page_text("E")


def mean(rows: Rows, row: str, method: str) -> FloatArray:
    """Return a row's three errors of a method, means over its draws, shape (3,)."""
    return rows[row]["rms"][:, METHODS.index(method)].mean(axis=0)


def as_published(rows: Rows, row: str, stage: int) -> FloatArray:
    """Return a row's three errors of the published order, means over its draws, shape (3,); stage 1 has the filter."""
    return rows[row]["published"][:, stage].mean(axis=0)


def half_width(rows: Rows, row: str, method: str) -> FloatArray:
    """Return half the 95 % confidence interval of :func:`mean`, shape (3,)."""
    draws = rows[row]["rms"][:, METHODS.index(method)]
    return stats.t.ppf(0.975, len(draws) - 1) * draws.std(axis=0, ddof=1) / np.sqrt(len(draws))


def cases() -> list[tuple[str, str, dict[str, Figures]]]:
    """Return key, description and published columns of the six published rows."""
    rounding = [
        (f"rounded {q:g}", f"rounded to {q:g} deg", {k: v[i] for k, v in PUBLISHED_ROUNDING.items()})
        for i, q in enumerate(ROUNDING_DEG)
    ]
    return rounding + [
        (f"noisy {n:g}", f"noise {n:g} arcsec", {k: v[i] for k, v in PUBLISHED_NOISE.items()})
        for i, n in enumerate(NOISE_ARCSEC)
    ]


def rounding_table(rows: Rows) -> Table:
    """Return the rounding table, published and ours."""
    lines: list[tuple[Cell, ...]] = []
    for i, q in enumerate(ROUNDING_DEG):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            shifted = mean(rows, f"shifted {q:g}", "proposed")[j]
            half = half_width(rows, f"shifted {q:g}", "proposed")[j]
            ours = [round(float(mean(rows, f"rounded {q:g}", m)[j]), 3) for m in METHODS]
            printed = [PUBLISHED_ROUNDING[k][i][j] for k in ("plain", "proposed")]
            published = [round(float(as_published(rows, f"rounded {q:g}", stage)[j]), 3) for stage in (0, 1)]
            lines.append(
                (f"{q:g} deg", f"{quantity} [{unit}]", *printed, *published, *ours, f"{shifted:.3g} ± {half:.1g}")
            )
    return TEXT.table("rounding", lines)


def noise_table(rows: Rows, nearest: noise.NoiseReading, draws: int) -> Table:
    """Return the noise table, published and ours, under one reading of its noise."""
    lines: list[tuple[Cell, ...]] = []
    for i, n in enumerate(NOISE_ARCSEC):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            ours = [
                f"{mean(rows, f'noisy {n:g}', m)[j]:.3g} ± {half_width(rows, f'noisy {n:g}', m)[j]:.1g}"
                for m in METHODS
            ]
            printed = [PUBLISHED_NOISE[k][i][j] for k in ("plain", "proposed")]
            published = [f"{as_published(rows, f'noisy {n:g}', stage)[j]:.3g}" for stage in (0, 1)]
            lines.append((f"{n:g} arcsec", f"{quantity} [{unit}]", *printed, *published, *ours))
    return TEXT.table("noise", lines, rounding_deg=NOISE_ROUNDING_DEG, reading=nearest.description, draws=draws)


def streak_table(rows: Rows, draws: int) -> Table:
    """Return both published tables again, from angles measured in rendered frames."""
    lines: list[tuple[Cell, ...]] = []
    for key, case, printed in cases():
        for j, (quantity, unit) in enumerate(QUANTITIES):
            row = f"streaks {key}"
            ours = [float(f"{mean(rows, row, m)[j]:.3g}") for m in METHODS]
            published = [float(f"{as_published(rows, row, stage)[j]:.3g}") for stage in (0, 1)]
            lines.append((case, f"{quantity} [{unit}]", printed["plain"][j], printed["proposed"][j], *published, *ours))
    return TEXT.table("streaks", lines, draws=draws)


def factor_table(rows: Rows) -> Table:
    """Return how many of the 18 printed proposed figures are matched or beaten with every forgetting factor."""
    keys = [(key, np.array(printed["proposed"])) for key, _, printed in cases()]
    lines: list[tuple[Cell, ...]] = []
    for i, alpha in enumerate(ALPHAS):
        counts = [sum(int((rows[k]["alphas"][:, i, s].mean(axis=0) <= p).sum()) for k, p in keys) for s in (0, 1)]
        lines.append((f"{alpha:g}", *counts))
    counts = [sum(int((mean(rows, k, m) <= p).sum()) for k, p in keys) for m in ("filtered", "proposed")]
    lines.insert(1, (f"{ALPHA:g}", *counts))
    counts = [sum(int((as_published(rows, k, s) <= p).sum()) for k, p in keys) for s in (0, 1)]
    lines.append((TEXT.phrase("as_published"), counts[1], None))
    return TEXT.table("factors", lines)


def meaning_table(columns: dict[noise.NoiseReading, FloatArray]) -> Table:
    """Return the plain column under every reading of the noise, the nearest first."""
    ordered = sorted(columns.items(), key=lambda pair: noise.distance(pair[1]))
    lines: list[tuple[Cell, ...]] = [
        (reading.description, round(100.0 * noise.distance(c), 1), *(round(float(v), 2) for v in c.ravel()))
        for reading, c in ordered
    ]
    printed = ", ".join(f"{v:g}" for row in PUBLISHED_NOISE["plain"] for v in row)
    return TEXT.table("readings", lines, published=printed)
