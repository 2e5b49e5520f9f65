"""System D: static infrared horizon sensor of four linear heads (Cui and others 2016), its five tables and its limits.

The published pictures show a hard limb: a warm ball without air, 400 km below. The same attitudes are then rendered
through the infrared limb of carbon dioxide with the heads turned up to it, the orbit is flown over the ellipsoid and
through the air of every latitude, and the same rows are read with a sub-pixel crossing.
"""

from __future__ import annotations

from typing import Any

from horizonval.systems.d import figures as figures
from horizonval.systems.d.budget import budget
from horizonval.systems.d.frames import (
    AIR,
    HARD,
    OBLATE,
    REAL,
    SOFT,
    altitude_end,
    infrared_aim,
    picture,
    read_heads,
    widest_tilt,
)
from horizonval.systems.d.published import (
    ALL,
    PRINTED,
    QUANTUM_DEG,
    TWO_QUANTA_DEG,
)
from horizonval.systems.d.rows import (
    cause_rows,
    entry_rows,
    largest_departure,
    moment_rows,
    range_rows,
    range_table,
    sub_pixel_rows,
    tables,
    worst,
)
from horizonval.systems.result import Reproduction
from horizonval.systems.task_cache import Plain, TaskCache

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
    hard = _read(cache, "D: hard limb", HARD, {})
    soft = _read(cache, "D: infrared limb", SOFT, {"aim_deg": aim["aim_deg"]})
    orbit = _fly(cache, aim["aim_deg"])
    ends = _ends(cache, aim["aim_deg"])
    tilted = {"pitch": -5.0, "roll": 5.0, "rows": 160}
    pictures = cache.each(
        "D: pictures",
        picture,
        {
            "hard limb, heads at 70.22 deg": {"planet": HARD, **tilted},
            f"infrared limb, heads at {aim['aim_deg']:.2f} deg": {"planet": SOFT, "aim_deg": aim["aim_deg"], **tilted},
        },
    )
    budget_rows, budget_table = budget(hard, soft, orbit)
    rows = (
        *entry_rows(hard),
        *moment_rows(hard),
        *cause_rows(hard),
        *sub_pixel_rows(hard, soft, aim),
        *budget_rows,
        *range_rows(ends),
    )
    return Reproduction(
        system="D",
        title="Static infrared horizon sensor with four linear heads",
        source="Cui and others, simulation of a static infrared horizon sensor with four linear heads, "
        "Shanghai Institute of Technical Physics, 2016",
        summary=(
            f"{sum(r.limit == TWO_QUANTA_DEG for r in rows)} of {PRINTED} printed readings were read again from "
            f"rendered rows of 160 elements; the largest departure is {largest_departure(rows):.4f} deg, two steps of "
            f"the printed figures being {2 * QUANTUM_DEG:.4f} deg. The steps are whole pixels: the published "
            f"interpolation adds nothing to them. A crossing by area and the exact cone bring the same rows to "
            f"{worst(hard, 'sub_pixel'):.4f} deg at worst. What ellipsoid and air cost in orbit is in the budget."
        ),
        rows=rows,
        tables=(*tables(hard, soft), budget_table, range_table(ends)),
        figures=(
            figures.pictures(pictures),
            figures.rows_and_crossings(pictures),
            figures.quantisation(hard),
            figures.errors(hard, soft),
            figures.round_the_orbit(orbit),
            figures.working_range(ends, aim),
        ),
        settings={
            "camera": "ir-linear-160-four-heads",
            "hard limb": HARD,
            "infrared limb": {**SOFT, "heads' nadir angle [deg]": aim["aim_deg"]},
            "orbit": {"inclination_deg": 97.0, "descending node": "12:00 local solar time", "epochs": EPOCHS},
            "axes": "housing turned by 90 deg: published azimuths count from the right of the track over the tail",
        },
    )


def _read(cache: TaskCache, title: str, planet: dict[str, Any], more: Plain) -> dict[str, Plain]:
    """Return the readings of all settings of the tables, by their keys."""
    items = {
        key: {
            "planet": planet,
            "roll": s.roll,
            "pitch": s.pitch,
            "yaw": s.yaw,
            "altitude_km": s.altitude_km,
            "seed": cache.seed,
            "noise": DRAWS if key in NOISY else 0,
            **more,
        }
        for key, s in ALL.items()
    }
    return cache.each(title, read_heads, items)


def _fly(cache: TaskCache, aim_deg: float) -> dict[str, dict[str, Plain]]:
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
    found = cache.each("D: round the orbit", read_heads, named)
    cases: dict[str, dict[str, Plain]] = {}
    for (case, argument), reading in zip(items, found.values(), strict=True):
        cases.setdefault(case, {})[f"{argument:g}"] = reading
    return cases


def _ends(cache: TaskCache, aim_deg: float) -> dict[str, dict[str, Plain]]:
    """Return the ends of the working range: by kind of limb, by altitude, and of the altitude itself."""
    limbs: dict[str, tuple[Plain, tuple[float, ...], float]] = {
        "hard": ({"planet": HARD}, HARD_ALTITUDES_KM, 0.05),
        "infrared": ({"planet": SOFT, "aim_deg": aim_deg}, SOFT_ALTITUDES_KM, 0.2),
    }
    tilts = {
        f"{limb} limb from {altitude:g} km": {**item, "altitude_km": altitude, "step": step}
        for limb, (item, altitudes, step) in limbs.items()
        for altitude in altitudes
    }
    found = cache.each("D: range of tilt", widest_tilt, tilts)
    altitudes = {
        f"{end} altitude": {"planet": HARD, "towards_km": towards, "step": 2.0}
        for end, towards in (("lowest", 100.0), ("highest", 1200.0))
    }
    return {"tilt": found, "altitude": cache.each("D: range of altitude", altitude_end, altitudes)}
