"""System D: static infrared horizon sensor of four linear heads (Cui and others 2016), its five tables.

The published pictures show a hard limb: a warm sphere without air, 400 km below. The housing is turned by 90 deg about
the vertical, so that the published azimuths and signs are those of the body (see
:mod:`horizonval.estimation.methods.linear_heads`).
"""

from __future__ import annotations

import math
from functools import partial
from itertools import zip_longest
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure

import horizonval as hv
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.linear_heads import published_angles
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.horizon import horizon_columns
from horizonval.report.plots import COLOURS
from horizonval.systems.entries import Result, Values, system
from horizonval.systems.task_cache import TaskCache

SYSTEM = system("D")
GIVEN = SYSTEM.given
QUANTUM_DEG = GIVEN["element_deg"] / math.sqrt(8.0)
"""Weight of one whole pixel in roll and pitch."""
SPHERE: JsonObject = {"shape": "sphere", "radius_km": GIVEN["radius_km"]}
HARD: JsonObject = {
    "earth": SPHERE,
    "atmosphere": {"profile": "none"},
    "surface": {"kind": "uniform", "temperature_k": 250.0},
}
"""A warm sphere without air; 250 K is what the whole Earth radiates at."""
SOFT: JsonObject = {"earth": SPHERE, "atmosphere": {"profile": "us_standard"}}
"""The uniform limb of carbon dioxide."""
METHODS = {"published": "linear-heads-published", "sub_pixel": "linear-heads"}
AXES = ("roll", "pitch")


def settings(number: str) -> list[JsonObject]:
    """Return the poses of a table's columns, as keywords of a scene."""
    table: dict[str, Any] = {"altitude_km": GIVEN["altitude_km"], "roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}
    table |= GIVEN["table"][number]
    lists = {key: value for key, value in table.items() if isinstance(value, list)}
    return [table | dict(zip(lists, column, strict=True)) for column in zip_longest(*lists.values())]


def name_of(pose: JsonObject) -> str:
    """Return the name of a pose; tables share some."""
    return ", ".join(f"{key} {pose[key]:g}" for key in sorted(pose))


TABLES = {number: settings(number) for number in GIVEN["table"]}
POSES = {name_of(pose): pose for poses in TABLES.values() for pose in poses}
READ = [(number, axis) for number in TABLES for axis in AXES if f"table_{number}_{axis}" in SYSTEM.entry]


def images_of(item: JsonObject) -> list[hv.Image]:
    """Return the noiseless images of the four heads of an item.

    ``planet`` and ``pose``: keywords of the scene; optional ``aim_deg``: nadir angle of the heads, ``rows`` of a head.
    """
    camera = hv.Camera.from_file(GIVEN["camera"]).changed(camera={"height": item.get("rows", 1)})
    data = camera.to_dict()
    if "aim_deg" in item:
        data["head"] = [head | {"mount_pitch_deg": item["aim_deg"]} for head in data["head"]]
    camera = hv.Camera.from_dict(data, GIVEN["camera"])
    scene = hv.Scene(camera=camera, head=camera.heads[0], mount_yaw_deg=90.0, **item["planet"], **item["pose"])
    # The descending node of the published orbit; over a sphere it does not matter.
    scene = scene.changed(latitude_deg=0.0, heading_deg=90.0 + GIVEN["inclination_deg"])
    frames = [hv.render(scene.changed(head=head), progress=False) for head in camera.heads]
    return [frame.observe(noise=False) for frame in frames]


def read(item: JsonObject) -> JsonObject:
    """Return crossings [px], by method and exact, and roll and pitch [deg] of an item of :func:`images_of`."""
    images = images_of(item)
    out: JsonObject = {"exact_px": [_exact_px(image) for image in images]}
    for key, method in METHODS.items():
        fit = hv.estimate(images, method)
        if isinstance(fit, hv.Refusal):
            raise ValueError(f"{method}: {fit.reason}")
        out[key] = {"roll": math.degrees(fit.roll_rad), "pitch": math.degrees(fit.pitch_rad)}
        out[key] |= {"px": fit.points[:, 0].tolist()}
    return out


def _exact_px(image: hv.Image) -> float | None:
    """Return the column at which the exact horizon of the sphere crosses a head's row; None where it does not."""
    truth = image.truth
    geometry = camera_from_spec(truth.camera_spec.camera)
    column = float(horizon_columns(geometry, truth.q_cam_from_itrs, truth.r_itrs, [0.0], truth.ellipsoid)[0, 0])
    return column if math.isfinite(column) else None


def aim(item: JsonObject) -> JsonObject:
    """Return the nadir angle [deg] of half of the infrared limb's plateau, for an item of :func:`images_of`."""
    horizon = images_of(item)[0].truth.infrared_horizon["co2"]
    return {"aim_deg": math.degrees(float(np.mean(horizon["half_plateau_angle_rad"])))}


def altitude_end(item: JsonObject) -> JsonObject:
    """Return the last altitude [km] between the published one and ``end_km`` at which a level sensor sees the limb."""
    seen, unseen = GIVEN["altitude_km"], item["end_km"]
    while abs(unseen - seen) > 2.0:
        middle = 0.5 * (seen + unseen)
        fit = hv.estimate(images_of({"planet": HARD, "pose": {"altitude_km": middle}}), METHODS["sub_pixel"])
        seen, unseen = (seen, middle) if isinstance(fit, hv.Refusal) else (middle, unseen)
    return {"altitude_km": seen}


def picture(item: JsonObject) -> JsonObject:
    """Return the digital numbers of all heads, and the published crossing on their middle row."""
    images = images_of(item)
    fit = hv.estimate(images, METHODS["published"])
    return {"dn": [image.dn.tolist() for image in images], "points": np.asarray(fit.points).tolist()}


def read_all(cache: TaskCache) -> dict[str, JsonObject]:
    """Return the readings of every pose of the tables on the hard limb."""
    return cache.each("D: hard limb", read, {name: {"planet": HARD, "pose": pose} for name, pose in POSES.items()})


def quick(cache: TaskCache) -> Values:
    """Return the values of the tables on the hard limb."""
    hard = read_all(cache)
    readings = {key: [hard[name_of(pose)]["published"][key[1]] for pose in TABLES[key[0]]] for key in READ}
    values: dict[str, Any] = {f"table_{number}_{axis}": of for (number, axis), of in readings.items()}
    steps: dict[str, list[float]] = {"printed": [], "ours": [], "true": []}
    for number, axis in READ:
        true = np.array([pose[f"{axis}_deg"] for pose in TABLES[number]])
        ours = np.array(readings[number, axis])
        if f"errors_{number}_{axis}" in SYSTEM.entry:
            values[f"errors_{number}_{axis}"] = [float((ours - true).mean()), float((ours - true).std(ddof=1))]
        printed = np.array(SYSTEM.entry[f"table_{number}_{axis}"].printed)
        for key, column in (("printed", printed), ("ours", ours), ("true", true)):
            steps[key] += (column / QUANTUM_DEG).tolist()
    printed, ours, true = (np.array(steps[key]) for key in ("printed", "ours", "true"))
    on_step = [int(np.count_nonzero(np.rint(one) == np.rint(printed))) for one in (ours, true)]
    whole, sub, exact = crossings(hard)
    element_rad = math.radians(GIVEN["element_deg"])
    formula = [np.degrees(published_angles(np.array(hard[name]["exact_px"]), element_rad)) for name in POSES]
    tilts = [(pose["pitch_deg"], pose["roll_deg"]) for pose in POSES.values()]
    return values | {
        "multiples": float(np.abs(ours - np.rint(ours)).max() * QUANTUM_DEG),
        "whole_pixels": float((whole - exact).std()),
        "yaw": max(float(np.ptp(readings["4", axis])) for axis in AXES),
        "altitude_spread": max(float(np.ptp(readings["5", axis])) for axis in AXES),
        "on_step": on_step,
        "area": float(np.abs(sub - exact).max()),
        "formula": float(np.abs(np.array(formula) - tilts).max()),
    }


def crossings(readings: dict[str, JsonObject]) -> np.ndarray:
    """Return published, sub-pixel and exact crossings [px] of all heads and poses, shape (3, n)."""
    columns = [(r["published"]["px"], r["sub_pixel"]["px"], r["exact_px"]) for r in readings.values()]
    return np.array(columns).swapaxes(0, 1).reshape(3, -1)


def worst_deg(readings: dict[str, JsonObject]) -> float:
    """Return the worst sub-pixel error of roll and pitch."""
    errors = [r["sub_pixel"][axis] - POSES[name][f"{axis}_deg"] for name, r in readings.items() for axis in AXES]
    return float(np.abs(errors).max())


def reproduce(cache: TaskCache) -> Result:
    """Do the experiment."""
    hard = read_all(cache)
    level = {"planet": SOFT, "pose": {"altitude_km": GIVEN["altitude_km"]}}
    found = cache.each("D: infrared horizon", aim, {"400 km": level})["400 km"]
    at_400 = {name: pose for name, pose in POSES.items() if pose["altitude_km"] == GIVEN["altitude_km"]}
    items = {name: {"planet": SOFT, "pose": pose, **found} for name, pose in at_400.items()}
    soft = cache.each("D: infrared limb", read, items)
    ends = cache.each("D: altitudes", altitude_end, {"lowest": {"end_km": 100.0}, "highest": {"end_km": 1200.0}})
    tilted = {"planet": HARD, "pose": {"altitude_km": 400.0, "pitch_deg": -5.0, "roll_deg": 5.0}, "rows": 160}
    shown = cache.each("D: pictures", picture, {"tilted": tilted})["tilted"]
    values = dict(quick(cache)) | {end: found["altitude_km"] for end, found in ends.items()}
    values["sub_pixel"] = [worst_deg(hard), worst_deg(soft)]
    return Result(
        values,
        {"pictures": partial(draw_pictures, shown), "errors": partial(draw_errors, hard)},
        settings={"camera": GIVEN["camera"], "hard limb": HARD, "infrared limb": SOFT | found},
    )


def draw_pictures(shown: JsonObject) -> MplFigure:
    """Draw the images of the heads with the row of the array and its crossing."""
    figure = MplFigure(figsize=(9.0, 2.8), layout="constrained")
    names = hv.Camera.from_file(GIVEN["camera"]).heads
    for panel, name, dn, (column, row) in zip(
        figure.subplots(1, 4, sharey=True), names, shown["dn"], shown["points"], strict=True
    ):
        panel.imshow(dn, cmap="gray", interpolation="nearest")
        panel.axhline(row, color="white", lw=2.2)
        panel.axhline(row, color=COLOURS[0], lw=1.2, ls="--")
        panel.plot(column, row, "o", ms=8, mfc="none", mec="white", mew=3)
        panel.plot(column, row, "o", ms=8, mfc="none", mec=COLOURS[1], mew=1.6)
        panel.set(title=f"head {name}", xticks=(0, 50, 100, 150), yticks=(0, 50, 100, 150))
        panel.grid(visible=False)
    figure.supxlabel("column [pixels of 0.1°], outwards", fontsize=9)
    return figure


def draw_errors(hard: dict[str, JsonObject]) -> MplFigure:
    """Draw errors of readings, printed and ours, and of single crossings."""
    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    columns: dict[str, list[float]] = {"printed": [], "ours, whole pixels": [], "ours, sub-pixel": []}
    for number, axis in READ:
        printed = SYSTEM.entry[f"table_{number}_{axis}"].printed
        assert isinstance(printed, tuple)
        for pose, figure_deg in zip(TABLES[number], printed, strict=True):
            reading, true = hard[name_of(pose)], pose[f"{axis}_deg"]
            read_deg = (figure_deg, reading["published"][axis], reading["sub_pixel"][axis])
            for errors, one in zip(columns.values(), read_deg, strict=True):
                errors.append(float(one) - true)
    for (label, errors), mark, colour in zip(columns.items(), "so^", (COLOURS[6], *COLOURS[:2]), strict=True):
        left.plot(range(1, len(errors) + 1), errors, mark, ms=4, mfc="none", color=colour, label=label)
    left.set(xlabel="number of the printed figure", ylabel="reading − truth [deg]", ylim=(-0.07, 0.095))
    left.legend(frameon=False, fontsize=8, loc="upper left", ncols=3)
    whole, sub, exact = crossings(hard)
    # The edge of pixel k is at k + 1/2: there the published crossing jumps.
    fraction = exact + 0.5 - np.floor(exact + 0.5)
    right.plot(fraction, whole - exact - np.mean(whole - exact), "o", ms=4, color=COLOURS[0], label="whole pixels")
    right.plot(fraction, sub - exact, "^", ms=4, color=COLOURS[1], label="sub-pixel")
    right.set(xlabel="position of the limb in its pixel", ylabel="crossing − true [pixels]")
    right.set(xlim=(0, 1), ylim=(-0.75, 0.75))
    right.legend(frameon=False, fontsize=8, loc="lower left")
    return figure
