"""System C: the ideal horizon-sensor module of a space simulator, held against the exact horizon.

The module that ships is compared with two other ways to the same reading (:mod:`horizonval.systems.c.poses`), then the
oracle of image estimators with the truth of rendered frames, and every image estimator with the oracle.
"""

from __future__ import annotations

from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.scoring.errors import ARCSEC
from horizonval.systems.c.figures import draw_readings
from horizonval.systems.c.frames import FRAMES, against_oracle
from horizonval.systems.c.poses import RADIUS_M, departures, known_poses
from horizonval.systems.published import published
from horizonval.systems.result import ComparisonRow, Reproduction
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.text import page_text

TEXT = page_text("C")
EXACT = published("C").figures["exact"].value
LIMIT_RAD = 1e-9
POSES = 1000
BRUTE = 100
"""Of the poses, those that are minimised as well."""


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the comparisons and return rows, table and figure."""
    seed = cache.seed
    random = cache.each("C: random poses", departures, {"poses": {"seed": seed, "count": POSES, "brute": BRUTE}})
    known = cache.each("C: known poses", known_poses, {"poses": {"seed": seed, "count": POSES}})["poses"]
    frames = cache.each("C: frames", against_oracle, {k: {**v, "seed": seed} for k, v in FRAMES.items()})
    rows = (*_pose_rows(random["poses"], known), *_frame_rows(frames))
    angles = (
        (frame, estimator, answer["error"] / ARCSEC)
        for frame, result in frames.items()
        for estimator, answer in result["estimators"].items()
    )
    return TEXT.reproduction(
        rows=rows,
        tables=[TEXT.table("estimators", angles)],
        figures=[TEXT.figure("readings", draw_readings)],
        settings={"radius_m": RADIUS_M, "poses": POSES, "minimised": BRUTE, "altitude_km": [100, 100_000]},
        worst=max(row.measured for row in rows if row.unit == "rad"),
    )


def _pose_rows(random: JsonObject, known: JsonObject) -> list[ComparisonRow]:
    def row(key: str, value: float, limit: float = LIMIT_RAD, **fields: Any) -> ComparisonRow:
        counts: dict[str, Any] = {"poses": POSES, "minimised": BRUTE, "signs": 2 * POSES}
        return TEXT.row(key, value, EXACT, limit=limit, **counts, **fields)

    quantities = ("roll error", "pitch error", "direction to H")
    return [
        *(
            row(yardstick, value, quantity=quantity)
            for yardstick in ("documented", "exact")
            for quantity, value in zip(quantities, random[yardstick], strict=True)
        ),
        row("minimised", random["brute"]),
        row("tangent", random["tangent"]),
        *(row(key, known[key]) for key in ("level", "pitch", "roll")),
        *(row(key, known[key], limit=0.0) for key in ("wrong", "statuses")),
        row("near_axis", known["near_axis"]),
    ]


def _frame_rows(frames: dict[str, JsonObject]) -> list[ComparisonRow]:
    asked = sum(result["asked"] for result in frames.values())
    answered = sum(len(result["estimators"]) for result in frames.values())
    rows = [TEXT.row("answered", answered, limit=1.0, at_least=True, asked=asked)]
    for frame, result in frames.items():
        rows.append(TEXT.row("truth", max(result["truth"], result["angles"]), EXACT, limit=LIMIT_RAD, frame=frame))
        for estimator, answer in result["estimators"].items():
            fields: dict[str, Any] = {"frame": frame, "estimator": estimator, "error": answer["error"] / ARCSEC}
            rows.append(TEXT.row("estimator", answer["apart"], limit=LIMIT_RAD, **fields))
    return rows
