"""System D: static infrared horizon sensor of four linear heads (Cui and others 2016), its five tables and its limits.

The published pictures show a hard limb: a warm ball without air, 400 km below. The same attitudes are then rendered
through the infrared limb of carbon dioxide with the heads turned up to it, the orbit is flown over the ellipsoid and
through the air of every latitude, and the same rows are read with a sub-pixel crossing.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.systems.d import figures as figures
from horizonval.systems.d.frames import (
    AIR,
    CAMERA,
    HARD,
    INCLINATION_DEG,
    OBLATE,
    REAL,
    SOFT,
    altitude_end,
    infrared_aim,
    picture,
    read_heads,
    widest_tilt,
)
from horizonval.systems.d.rows import (
    TEXT,
    StepScore,
    budget,
    cause_rows,
    largest_departure,
    moment_rows,
    range_rows,
    range_table,
    score_steps,
    step_rows,
    sub_pixel_rows,
    tables,
    variant_table,
    worst,
)
from horizonval.systems.d.steps import ALL, MOMENTS, PRINTED, PUBLISHED, QUANTUM_DEG, TABLES, cross_axis
from horizonval.systems.result import Claim, ComparisonRow, Reproduction, Status
from horizonval.systems.task_cache import TaskCache

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


ARGUMENTS_DEG = tuple(30.0 * k for k in range(12))
EPOCHS = {"April": "2016-04-15T12:00:00+00:00", "July": "2016-07-15T12:00:00+00:00"}
"""The air of January is that of July with the hemispheres exchanged."""
NOISY = ("roll 3, pitch 0, yaw 0, 400 km", "roll 2, pitch -2, yaw 0, 400 km")
DRAWS = 60
ORBIT_DRAWS = 8
HARD_ALTITUDES_KM = (200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SOFT_ALTITUDES_KM = (300.0, 400.0, 500.0)


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the experiments and return tables, rows and figures."""
    aim = cache.each("D: the infrared horizon", infrared_aim, {"400 km": {"planet": SOFT}})["400 km"]
    hard = read_tables(cache, "D: hard limb", HARD, {})
    soft = read_tables(cache, "D: infrared limb", SOFT, {"aim_deg": aim["aim_deg"]})
    flat = read_tables(cache, "D: hard limb, flat focal plane", HARD, {"projection": "pinhole"})
    orbit = _fly(cache, aim["aim_deg"])
    ends = _ends(cache, aim["aim_deg"])
    tilted = {"pitch": -5.0, "roll": 5.0, "rows": 160}
    views = {
        f"hard limb, heads at {PUBLISHED.number('nadir_angle'):.2f} deg": {"planet": HARD, **tilted},
        f"infrared limb, heads at {aim['aim_deg']:.2f} deg": {"planet": SOFT, "aim_deg": aim["aim_deg"], **tilted},
    }
    pictures = cache.each("D: pictures", picture, views)
    budget_rows, budget_table = budget(hard, soft, orbit)
    rendered = {"hard limb": hard, "hard limb, flat focal plane": flat, "infrared limb": soft}
    score = score_steps(rendered, cache.rng("linear heads", "phases"))
    departure = largest_departure(hard)
    rows = (
        *step_rows(score),
        TEXT.row("departure", departure),
        *moment_rows(hard),
        *cause_rows(hard),
        *sub_pixel_rows(hard, soft, aim),
        *budget_rows,
        *range_rows(ends),
    )
    return TEXT.reproduction(
        rows=rows,
        tables=(variant_table(score), *tables(hard, soft), budget_table, range_table(ends)),
        figures=(
            TEXT.figure("pictures", partial(figures.draw_pictures, pictures)),
            TEXT.figure("rows", partial(figures.draw_rows, pictures)),
            TEXT.figure("steps", partial(figures.draw_steps, score)),
            TEXT.figure("quantisation", partial(figures.draw_quantisation, hard)),
            TEXT.figure("errors", partial(figures.draw_errors, hard, soft)),
            TEXT.figure("orbit", partial(figures.draw_orbit, orbit)),
            TEXT.figure("range", partial(figures.draw_range, ends, aim)),
        ),
        settings={
            "camera": CAMERA,
            "hard limb": HARD,
            "infrared limb": {**SOFT, "heads' nadir angle [deg]": aim["aim_deg"]},
            "orbit": {
                "inclination_deg": INCLINATION_DEG,
                "descending node": "12:00 local solar time",
                "epochs": EPOCHS,
            },
            "axes": TEXT.phrase("axes"),
        },
        claims=claims(score, hard, rows, departure),
        printed=PRINTED,
        score=score,
        departure=departure,
        two_steps=2 * QUANTUM_DEG,
        worst=worst(hard, "sub_pixel"),
    )


def read_tables(cache: TaskCache, title: str, planet: dict[str, Any], more: JsonObject) -> dict[str, JsonObject]:
    """Return the readings of all settings of the tables, by their keys."""
    items = {
        key: {
            "planet": planet,
            "roll": s.roll_deg,
            "pitch": s.pitch_deg,
            "yaw": s.yaw_deg,
            "altitude_km": s.altitude_km,
            "seed": cache.seed,
            "noise": DRAWS if key in NOISY and "projection" not in more else 0,
            **more,
        }
        for key, s in ALL.items()
    }
    return cache.each(title, read_heads, items)


def _fly(cache: TaskCache, aim_deg: float) -> dict[str, dict[str, JsonObject]]:
    """Return level readings round the orbit: by case, by argument of latitude."""
    items = {}
    for argument in ARGUMENTS_DEG:
        place = {"argument_deg": argument, "seed": cache.seed}
        items["oblate", argument] = {"planet": OBLATE, **place}
        for month, epoch in EPOCHS.items():
            real = {"planet": REAL, "aim_deg": aim_deg, "epoch_utc": epoch, "noise": ORBIT_DRAWS}
            items[f"oblate, air of {month}", argument] = {**real, **place}
    # The air alone, at one place: whether its error and that of the ellipsoid add up.
    check = {"planet": AIR, "aim_deg": aim_deg, "epoch_utc": EPOCHS["July"], "argument_deg": 240.0}
    items["air of July", 240.0] = {**check, "seed": cache.seed}
    named = {f"{case} at {argument:g} deg": item for (case, argument), item in items.items()}
    readings = cache.each("D: round the orbit", read_heads, named)
    cases: dict[str, dict[str, JsonObject]] = {}
    for (case, argument), reading in zip(items, readings.values(), strict=True):
        cases.setdefault(case, {})[f"{argument:g}"] = reading
    return cases


def _ends(cache: TaskCache, aim_deg: float) -> dict[str, dict[str, JsonObject]]:
    """Return the ends of the working range: by kind of limb, by altitude, and of the altitude itself."""
    limbs: dict[str, tuple[JsonObject, tuple[float, ...], float]] = {
        "hard": ({"planet": HARD}, HARD_ALTITUDES_KM, 0.05),
        "infrared": ({"planet": SOFT, "aim_deg": aim_deg}, SOFT_ALTITUDES_KM, 0.2),
    }
    tilts = {
        f"{limb} limb from {altitude:g} km": {**item, "altitude_km": altitude, "step": step}
        for limb, (item, altitudes, step) in limbs.items()
        for altitude in altitudes
    }
    tilt = cache.each("D: range of tilt", widest_tilt, tilts)
    altitudes = {
        f"{end} altitude": {"planet": HARD, "towards_km": towards, "step": 2.0}
        for end, towards in (("lowest", 100.0), ("highest", 1200.0))
    }
    return {"tilt": tilt, "altitude": cache.each("D: range of altitude", altitude_end, altitudes)}
