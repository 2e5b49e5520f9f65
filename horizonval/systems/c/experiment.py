"""System C: the ideal horizon-sensor module of a space simulator, held against the exact horizon.

The module that ships is compared with two other ways to the same reading (:mod:`horizonval.systems.c.poses`), and with
what rendered pictures say without any pose (:mod:`horizonval.systems.c.frames`). Errors of image estimators
on other frames are reported too; they do not test the module.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.ideal import ideal_horizon_sensor
from horizonval.scoring.errors import ARCSEC
from horizonval.systems.c.frames import FRAMES, against_oracle, against_picture, items
from horizonval.systems.c.poses import RADIUS_M, departures, exact_reading, known_poses, pose_above_horizon
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Cell, Claim, ComparisonRow, Reproduction, Status
from horizonval.systems.task_cache import TaskCache

ALTITUDES = {"400 km": (400e3, "#0072b2", "-"), "3000 km": (3e6, "#d55e00", "--"), "36 000 km": (3.6e7, "#000000", ":")}
ROUNDING = 1e-17
"""Departures of exactly zero are drawn here."""


def draw_readings() -> MplFigure:
    """Pitch error against the boresight's elevation, roll error against roll, and both minus the exact ones."""
    figure = MplFigure(figsize=(9.0, 5.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", height_ratios=(3, 2))
    for label, (altitude, colour, style) in ALTITUDES.items():
        r = np.array([0.6, -0.64, 0.48]) * (RADIUS_M + altitude)
        rho = math.asin(RADIUS_M / (RADIUS_M + altitude))
        elevation = np.radians(np.arange(math.ceil(-math.degrees(rho)) + 0.5, 180 - math.degrees(rho), 1.0))
        roll = np.radians(np.arange(-179.0, 180.0, 2.0))
        for k, (x, attitudes) in enumerate(
            (
                (elevation, [pose_above_horizon(r, RADIUS_M, float(e), 0.2, 1.0) for e in elevation]),
                (roll, [pose_above_horizon(r, RADIUS_M, 0.05, float(a), 1.0) for a in roll]),
            )
        ):
            ours, theirs = _both(r, attitudes, k)
            axes[0, k].plot(np.degrees(x), np.degrees(ours), style, color=colour, label=label)
            axes[1, k].semilogy(np.degrees(x), np.maximum(np.abs(ours - theirs), ROUNDING), ".", color=colour, ms=3)
    for k, what in enumerate(("pitch error", "roll error")):
        axes[0, k].axhline(0, color="#000000", lw=0.6)
        axes[0, k].axvline(0, color="#000000", lw=0.6)
        axes[0, k].set_ylabel(f"{what} [deg]")
        axes[1, k].axhline(1e-9, color="#000000", lw=0.9, ls="-.")
        axes[1, k].set(ylabel="from exact [rad]", ylim=(ROUNDING / 2, 1e-8))
    axes[1, 0].set_xlabel("boresight above the horizon [deg]")
    axes[1, 1].set_xlabel("roll, right axis up [deg]")
    axes[0, 0].legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def _both(
    r: FloatArray,
    attitudes: list[FloatArray],
    axis: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the module's readings and the exact ones [rad]: pitch for axis 0, roll for axis 1."""
    ours, theirs = [], []
    for q in attitudes:
        reading = ideal_horizon_sensor(r, q, RADIUS_M)
        roll, pitch, _ = exact_reading(r, q, RADIUS_M)
        ours.append((reading.pitch_error_rad, reading.roll_error_rad)[axis])
        theirs.append((pitch, roll)[axis])
    return np.array(ours), np.array(theirs)


TEXT = page_text("C")
EXACT = published("C").figures["exact"].value
LIMIT_RAD = 1e-9
LIMIT_PX = 0.01
"""Largest error of an edge read off a rendered picture; set before any was rendered."""
POSES = 1000
BRUTE = 100
"""Number of poses that are minimised as well."""


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
