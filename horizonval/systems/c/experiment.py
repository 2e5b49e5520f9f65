"""System C: the ideal horizon-sensor module of a space simulator, held against the exact horizon.

The module that ships is compared with two other ways to the same reading (:mod:`horizonval.systems.c.poses`), and with
what rendered pictures say without any pose (:mod:`horizonval.systems.c.picture`). What image estimators make of other
frames stands beside: their errors are theirs, no test of the module.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.scoring.errors import ARCSEC
from horizonval.systems.c.figures import draw_readings
from horizonval.systems.c.frames import FRAMES, against_oracle
from horizonval.systems.c.picture import against_picture, items
from horizonval.systems.c.poses import RADIUS_M, departures, known_poses
from horizonval.systems.published import published
from horizonval.systems.result import Cell, Claim, ComparisonRow, Reproduction, Status
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.text import page_text

TEXT = page_text("C")
EXACT = published("C").figures["exact"].value
LIMIT_RAD = 1e-9
LIMIT_PX = 0.01
"""Of an edge that is read off a rendered picture; set before any was."""
POSES = 1000
BRUTE = 100
"""Of the poses, those that are minimised as well."""


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the comparisons and return rows, table and figure."""
    seed = cache.seed
    random, known = _measured_poses(cache)
    pictures = cache.each("C: pictures", against_picture, items(seed))
    frames = cache.each("C: frames", against_oracle, {k: {**v, "seed": seed} for k, v in FRAMES.items()})
    rows = (*_pose_rows(random, known), *_picture_rows(pictures), *_frame_rows(frames))
    angles = (
        (frame, estimator, answer["error"] / ARCSEC)
        for frame, result in frames.items()
        for estimator, answer in result["estimators"].items()
    )
    return TEXT.reproduction(
        rows=rows,
        tables=[TEXT.table("pictures", _picture_lines(pictures)), TEXT.table("estimators", angles)],
        claims=_claims(random, known, pictures),
        figures=[TEXT.figure("readings", draw_readings)],
        settings={"radius_m": RADIUS_M, "poses": POSES, "minimised": BRUTE, "altitude_km": [100, 100_000]},
        worst=max(row.measured for row in rows if row.unit == "rad"),
        seen=max(_apart_px(one) for one in pictures.values()),
    )


def measured_pose_rows(cache: TaskCache) -> list[ComparisonRow]:
    """Return the rows that need no picture."""
    return _pose_rows(*_measured_poses(cache))


def _measured_poses(cache: TaskCache) -> tuple[JsonObject, JsonObject]:
    """Return what the module makes of random poses and of those that are known."""
    seed = cache.seed
    random = cache.each("C: random poses", departures, {"poses": {"seed": seed, "count": POSES, "brute": BRUTE}})
    known = cache.each("C: known poses", known_poses, {"poses": {"seed": seed, "count": POSES}})
    return random["poses"], known["poses"]


def _pose_rows(random: JsonObject, known: JsonObject) -> list[ComparisonRow]:
    def row(key: str, value: float, limit: float = LIMIT_RAD, **fields: Any) -> ComparisonRow:
        counts: dict[str, Any] = {"poses": POSES, "minimised": BRUTE, "signs": 2 * POSES}
        return TEXT.row(key, value, EXACT, limit=limit, **counts, **fields)

    quantities = ("roll error", "pitch error", "direction to H")
    return [
        TEXT.row("literal", random["literal"]),
        row("elevation", random["elevation"]),
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
    return [
        TEXT.row("answered", answered, asked=asked),
        *(
            TEXT.row("truth", max(result["truth"], result["angles"]), EXACT, limit=LIMIT_RAD, frame=frame)
            for frame, result in frames.items()
        ),
    ]


def _apart_px(one: JsonObject) -> float:
    """Return the larger departure of the module's two errors from the picture's [px]."""
    roll = abs(math.remainder(one["module_roll"] - one["roll"], math.tau))
    return max(roll, abs(one["module_pitch"] - one["pitch"])) / float(one["pixel_rad"])


def _picture_rows(pictures: dict[str, JsonObject]) -> list[ComparisonRow]:
    return [
        TEXT.row(
            "picture",
            _apart_px(one),
            EXACT,
            limit=LIMIT_PX,
            pose=pose,
            points=one["points"],
            pixel_deg=math.degrees(one["pixel_rad"]),
        )
        for pose, one in pictures.items()
    ]


def _picture_lines(pictures: dict[str, JsonObject]) -> Iterator[tuple[Cell, ...]]:
    for pose, one in pictures.items():
        angles = (math.degrees(one[key]) for key in ("roll", "module_roll", "pitch", "module_pitch"))
        yield pose, *(f"{angle:.5f}" for angle in angles)


def _claims(random: JsonObject, known: JsonObject, pictures: dict[str, JsonObject]) -> list[Claim]:
    """Return the documentation's three steps, judged."""
    seen = max(_apart_px(one) for one in pictures.values())
    measured: dict[str, tuple[bool, dict[str, Any]]] = {
        "point": (random["exact"][2] <= LIMIT_RAD, {"rad": random["exact"][2]}),
        "roll": (known["roll"] <= LIMIT_RAD and seen <= LIMIT_PX, {"rad": known["roll"], "px": seen}),
        "pitch": (known["pitch"] <= LIMIT_RAD and seen <= LIMIT_PX, {"rad": known["pitch"], "px": seen}),
    }
    out = []
    for key, (holds, fields) in measured.items():
        good = Status.BOUNDED if key == "pitch" else Status.REPRODUCED
        status = good if holds else Status.CONTRADICTED
        out.append(TEXT.claim(key, str(EXACT), status, figure="exact", **fields))
    out.append(TEXT.claim("sign", str(EXACT), Status.CONTRADICTED, figure="exact", literal=random["literal"]))
    return out
