"""The bench of the hardware-in-the-loop experiment: a camera that is turned before a panel with a picture of the limb.

Bench axes are those of a camera at rest on a perfect bench: x right, y down (along gravity), z to the panel,
millimetres. The published text says no more than that a camera was in front of a displayed horizon and that an
accelerometer measured its tilt. So one camera's chord measures the turn about its boresight, which is level. With the
tilt ``t`` and the distance ``D``::

    bench from camera   Rz(t) Ry(axis_yaw) Rx(axis_pitch)
    lens                (shift_x, shift_y, -distance) + Rz(t) (eccentric_x, eccentric_y, 0)
    bench from panel    Rz(panel_roll) Ry(panel_yaw) Rx(panel_pitch),      panel's middle (0, 0, D)

The panel shows a rendered frame of the limb; each pixel of the camera sees the radiance where its line of sight meets
the panel. The detector is the shipped one.

*Sizes* of the errors are ours, what a careful student reaches with a ruler, a square and a spirit level; the source
gives none. Sixteen benches have every error at its size, with signs from the columns of a Hadamard matrix (Plackett and
Burman, Biometrika 33, 305, 1946): to first order their mean square is the sum of the squares that the errors cause one
by one, and the mean of ``sign * error`` is what one error does.

*Tilt of one camera*: the chord ``c`` between the lines of sight to the arc's ends is perpendicular to the vertical, and
the boresight ``z`` is level, so that the vertical is ``n = c x z`` and the tilt ``atan2(n_x, n_y)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure as MplFigure
from numpy.typing import NDArray
from scipy.linalg import hadamard
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.limb.arc import find_arc
from horizonval.estimation.methods.video_vertical import chord
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.systems.entries import Table, Values
from horizonval.systems.task_cache import TaskCache, rng_of

SIZES: dict[str, float] = {
    "shift_x_mm": 3.0, "shift_y_mm": 3.0, "eccentric_x_mm": 2.0, "eccentric_y_mm": 2.0, "distance_mm": 5.0,
    "axis_yaw_deg": 1.0, "axis_pitch_deg": 1.0, "centre_x_px": 5.0, "centre_y_px": 5.0, "panel_roll_deg": 0.25,
    "panel_yaw_deg": 1.0, "panel_pitch_deg": 1.0, "accelerometer_roll_deg": 0.3, "accelerometer_zero_mg": 5.0,
}  # fmt: skip
BENCHES = 16
SIGNS = np.asarray(hadamard(BENCHES)[:, 1 : 1 + len(SIZES)], dtype=float)
TILTS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
CAMERA = "vis-cmos-512-60deg"
DISTANCE_MM = 200.0
PANEL_PX, PITCH_MM = (1920, 1080), 0.2768
"""A 24 inch panel, which fills the camera's field at every tilt."""
STEP_MG, NOISE_MG, SAMPLES = 3.9, 4.0, 64
"""Accelerometer of a hobby board: steps of its converter, noise, samples in a mean."""


def shown_scene(camera: hv.Camera) -> hv.Scene:
    """Return the scene on the panel: level at 500 km, boresight level along the pitch axis, the Sun high."""
    return hv.Scene(
        camera=camera,
        name="panel",
        mount_roll_deg=90.0,
        altitude_km=500.0,
        earth={"shape": "sphere"},
        sun={"zenith_deg": 20.0, "azimuth_deg": 270.0},
        render={"subsamples": 1, "nodes": 32},
    )


@lru_cache(maxsize=1)
def _frames() -> tuple[NDArray[np.floating], hv.Frame]:
    """Return the panel's picture, and the frame of the camera whose truth and detector the photographs have."""
    camera = hv.Camera.from_file(CAMERA).changed(detector={"auto_exposure": {"min_s": 1e-6, "max_s": 1e-2}})
    lens = {"width": PANEL_PX[0], "height": PANEL_PX[1], "fx": DISTANCE_MM / PITCH_MM, "fov_deg": None}
    panel = hv.render(shown_scene(camera.changed(camera=lens)), progress=False)
    return panel.radiance["vis"].astype(np.float32), hv.render(shown_scene(camera), progress=False)


def radiance_seen(
    picture: NDArray[np.floating], camera: CameraModel, errors: Mapping[str, float], tilt_rad: float
) -> FloatArray:
    """Return the radiance (H, W) in the pixels of a camera before the panel."""
    degrees = {name: math.radians(value) for name, value in errors.items() if name.endswith("_deg")}
    turn = Rotation.from_euler("Z", tilt_rad)
    camera_turn = turn * Rotation.from_euler("YX", [degrees["axis_yaw_deg"], degrees["axis_pitch_deg"]])
    eccentric = turn.apply([errors["eccentric_x_mm"], errors["eccentric_y_mm"], 0.0])
    eye = np.array([errors["shift_x_mm"], errors["shift_y_mm"], -errors["distance_mm"]]) + eccentric
    panel_turn = Rotation.from_euler("ZYX", [degrees[f"panel_{axis}_deg"] for axis in ("roll", "yaw", "pitch")])
    built = replace(camera, cx=camera.cx + errors["centre_x_px"], cy=camera.cy + errors["centre_y_px"])
    to_panel = (panel_turn.inv() * camera_turn).as_matrix()
    los = unproject(built, pixel_grid(camera)) @ to_panel.T
    start = panel_turn.inv().apply(eye - [0.0, 0.0, DISTANCE_MM])
    on_panel = (start - los * (start[2] / los[..., 2])[..., None])[..., :2] / PITCH_MM
    column, row = np.moveaxis(on_panel + (np.array(PANEL_PX) - 1) / 2, -1, 0).astype(np.float32)
    return np.asarray(cv2.remap(picture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def accelerometer_rad(true_rad: float, errors: Mapping[str, float], rng: np.random.Generator | None) -> float:
    """Return the tilt from a mean of 64 samples of gravity in two axes; without random numbers it is not noisy."""
    angle = true_rad + math.radians(errors["accelerometer_roll_deg"])
    gravity_mg = 1e3 * np.array([math.sin(angle), math.cos(angle)]) + (errors["accelerometer_zero_mg"], 0.0)
    if rng is not None:
        samples = gravity_mg + NOISE_MG * rng.standard_normal((SAMPLES, 2))
        gravity_mg = STEP_MG * np.rint(samples / STEP_MG).mean(axis=0)
    return math.atan2(gravity_mg[0], gravity_mg[1])


def tilt_rad(image: FloatArray, camera: CameraModel, full_scale: float) -> float:
    """Return how far the camera is turned about its boresight, clockwise as it looks; NaN where it sees no arc."""
    arc = find_arc(image, full_scale)
    if isinstance(arc, hv.Refusal):
        return math.nan
    across = chord(arc, camera)
    down = np.array([-across[1], across[0]])
    if down @ (arc.circle.centre - arc.uv.mean(axis=0)) < 0.0:
        down = -down
    return math.atan2(down[0], down[1])


def sweep(item: JsonObject) -> JsonObject:
    """Return estimated and measured tilts [deg] of one bench, by the item's ``errors``, ``noise`` and ``seed``."""
    picture, frame = _frames()
    camera = frame.truth.camera_model
    estimated, measured = [], []
    for tilt_deg in TILTS_DEG:
        tilt = math.radians(tilt_deg)
        radiance = radiance_seen(picture, camera, item["errors"], tilt).astype(np.float32)
        seen = hv.Frame.of(replace(frame, radiance={"vis": radiance}))
        seed = int(rng_of(item["seed"], "bench", str(item["number"]), f"{tilt_deg:g}").integers(2**31))
        image = seen.observe(seed=seed, noise=item["noise"])
        estimated.append(math.degrees(tilt_rad(image.dn.astype(np.float64), camera, image.full_scale)))
        rng = rng_of(seed, "accelerometer") if item["noise"] else None
        measured.append(math.degrees(accelerometer_rad(tilt, item["errors"], rng)))
    return {"estimated": estimated, "measured": measured}


def measure(cache: TaskCache) -> tuple[Values, dict[str, Callable[[], MplFigure]], Sequence[Table]]:
    """Run sixteen benches with all errors, one without any, and sixteen with noise alone."""
    none = dict.fromkeys(SIZES, 0.0)
    items: dict[str, JsonObject] = {"perfect": {"errors": none, "noise": False}}
    for k, signs in enumerate(SIGNS):
        errors = {name: size * float(sign) for (name, size), sign in zip(SIZES.items(), signs, strict=True)}
        items |= {f"bench {k}": {"errors": errors, "noise": True}, f"noise {k}": {"errors": none, "noise": True}}
    swept = cache.each("B: bench", sweep, {k: {**v, "number": k, "seed": cache.seed} for k, v in items.items()})
    off = {name: np.array(one["estimated"]) - np.array(one["measured"]) for name, one in swept.items()}
    whole, noise = (np.array([off[f"{kind} {k}"] for k in range(BENCHES)]) for kind in ("bench", "noise"))
    true = np.array([swept[f"bench {k}"]["estimated"] for k in range(BENCHES)]) - TILTS_DEG
    effects = np.sqrt(np.mean((SIGNS.T @ whole / BENCHES) ** 2, axis=1))
    root_sum = math.sqrt(float(np.sum(effects**2)) + _rms(noise) ** 2)
    values: dict[str, Any] = {
        "rig_rms": [_rms(whole), float(np.sqrt(np.mean(np.var(whole, axis=1))))],
        "rig_noise": _rms(noise),
        "rig": [_rms(off["perfect"]), _rms(true), root_sum],
    }
    lines = []
    for (name, size), effect in sorted(zip(SIZES.items(), effects.tolist(), strict=True), key=lambda one: -one[1]):
        error, _, unit = name.rpartition("_")
        lines.append((error.replace("_", " "), f"{size:g} {unit}", effect, effect / size))
    table = Table(
        "The bench: what its errors do",
        ("error", "size, ours", "its effect, deg rms", "per unit, deg"),
        tuple(lines),
        f"Main effects of the two-level design over tilts of {TILTS_DEG[0]:g} to {TILTS_DEG[-1]:g} deg.",
    )
    return values, {"rig": partial(draw, whole, off["perfect"])}, (table,)


def draw(whole: FloatArray, perfect: FloatArray) -> MplFigure:
    """The camera's view of the panel, and the published error against tilt."""
    figure = MplFigure(figsize=(9.6, 4.0), layout="constrained")
    axes = figure.subplots()
    for k, row in enumerate(whole):
        label = f"sixteen benches, rms {_rms(whole):.2f} deg" if k == 0 else None
        axes.plot(TILTS_DEG, row, ".-", color="#4477aa", lw=0.9, label=label)
    axes.plot(TILTS_DEG, perfect, "ko-", lw=2.0, label=f"perfect bench, rms {_rms(perfect):.3f} deg")
    axes.set(xlabel="tilt [deg]", ylabel="estimate minus accelerometer [deg]")
    axes.legend(fontsize=8)
    return figure


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
