"""Everything that the source of the four linear heads prints, judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.systems.d.rows import TEXT
from horizonval.systems.d.score import StepScore
from horizonval.systems.d.settings import MOMENTS, PUBLISHED, QUANTUM_DEG, TABLES
from horizonval.systems.d.steps import cross_axis
from horizonval.systems.result import Claim, ComparisonRow, Status

SCATTERS = 3.0
"""Standard deviations of whole pixels' rounding that a mean or a standard deviation may be off."""


def claims(
    score: StepScore, hard: dict[str, JsonObject], rows: Sequence[ComparisonRow], departure: float
) -> list[Claim]:
    """Return every printed figure, judged; ``departure`` [deg] is the largest of a reading from the printed one."""
    measured = {row.name: row for row in rows}
    return [
        *(_table(number, axis, hard) for number, settings in TABLES.items() for axis in settings[0].read),
        *(_moments(number, axis, measured) for number, axis in MOMENTS),
        *(_checked(key, measured) for key in ("quantum_multiples", "whole_pixels", "yaw_spread")),
        _across(score, departure),
    ]


def _table(number: int, axis: str, hard: dict[str, JsonObject]) -> Claim:
    """Return the figures of one axis of a table: which step they fall on nothing published decides."""
    figures = [(s.read[axis], hard[s.key]["published"][axis]) for s in TABLES[number]]
    printed = ", ".join("lost" if f is None else f"{f:g}" for f, _ in figures)
    steps = [round(abs(m - f) / QUANTUM_DEG) for f, m in figures if f is not None and m is not None]
    fields: dict[str, Any] = {"number": number, "axis": axis, "n": len(steps), "same": steps.count(0)}
    return TEXT.claim("table", f"{printed} deg", Status.NOT_DETERMINABLE, figure=f"{number}", most=max(steps), **fields)


def _moments(number: int, axis: str, measured: dict[str, ComparisonRow]) -> Claim:
    """Return a table's printed moments; where the truth's own deviation of zero is near enough, they are no test."""
    mean, deviation = MOMENTS[number, axis]
    names = (TEXT.rows[key].name.format(table=number, axis=axis) for key in ("mean", "deviation"))
    ours = [measured[name].measured for name in names]
    n, scatter = len(TABLES[number]), QUANTUM_DEG / 3.0**0.5
    limits = SCATTERS * scatter / n**0.5, SCATTERS * scatter / (2.0 * n) ** 0.5
    status = Status.REPRODUCED if deviation > limits[1] else Status.BOUNDED
    if abs(ours[0] - mean) > limits[0] or abs(ours[1] - deviation) > limits[1]:
        status = Status.CONTRADICTED
    fields: dict[str, Any] = {"number": number, "axis": axis, "mean": ours[0], "deviation": ours[1]}
    printed = f"{mean:g}, {deviation:g} deg"
    return TEXT.claim(
        "moments", printed, status, figure=f"{number}", mean_limit=limits[0], deviation_limit=limits[1], **fields
    )


def _checked(key: str, measured: dict[str, ComparisonRow]) -> Claim:
    """Return a claim that a row with a bar decides."""
    row = measured[TEXT.rows[{"quantum_multiples": "multiples"}.get(key, key)].name]
    status = Status.REPRODUCED if row.holds else Status.CONTRADICTED
    return TEXT.claim(key, PUBLISHED.figures[key].value, status, measured=row.measured)


def _across(score: StepScore, departure: float) -> Claim:
    """Return the figures of an untilted axis that are not zero."""
    across = int(cross_axis().sum())
    right = max(right for _, right in score.rendered.values())
    status = Status.REPRODUCED if right == across else Status.NOT_DETERMINABLE
    printed = f"{across} figures of {QUANTUM_DEG:.4f} deg"
    return TEXT.claim("across", printed, status, right=right, across=across, departure=departure)
