"""System A: the altitude-free image horizon sensor of Raeisy and Ghofrani (2021), on its own set-ups.

Spheres without air under an overhead Sun, rendered at the five published set-ups. Methods that know the altitude and
one with a second camera take the same whole pixels by Canny. With lines of sight ``u``, nadir ``n``, the Earth's
angular radius ``rho``:

- *known altitude*: ``min sum (u . n - cos rho)^2`` over unit vectors n, rho from a right or a wrong altitude;
- *two sensors*: the chord of each camera's arc is perpendicular to the nadir, so that the nadir is the cross product of
  the chords of two cameras, the second turned by 90 deg about the nadir.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure as MplFigure
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.limb.edges import find_canny_pixels
from horizonval.estimation.limb.picture import LimbPoints
from horizonval.estimation.methods import altitude_free, altitude_free_closed_form, altitude_free_published
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.systems.covered_edge import column_edges
from horizonval.systems.entries import Result, Table, Values, system
from horizonval.systems.task_cache import TaskCache

CAMERA = "vis-cmos-1024-60deg"
ALTITUDE_OFF = 0.01
STEPS = 4
"""Steps in which the source says its method converges."""
FIELDS = ("altitude_km", "fov_deg", "pixels")
SAMPLES = 256
"""Stratified, per pixel of the stock sphere: an edge pixel's coverage to 0.02 or so."""
METHODS = ("as published", "known altitude", "altitude known to 1 %", "two sensors")


def set_ups() -> dict[str, JsonObject]:
    """Return the published set-ups by name."""
    given = system("A").given
    items = [dict(zip(FIELDS, values, strict=True)) for values in zip(*(given[key] for key in FIELDS), strict=True)]
    return {
        f"{one['altitude_km']:g} km, {one['fov_deg']:g} deg, {one['pixels']} px": {**one, **given["attitude"]}
        for one in items
    }


def scene_of(item: JsonObject, *, yaw_deg: float = 0.0, glow: bool = False) -> hv.Scene:
    """Return an item's scene; ``glow``: an evenly bright Earth instead of a sunlit one."""
    size = {"width": item["pixels"], "height": item["pixels"], "fov_deg": item["fov_deg"]}
    camera = hv.Camera.from_file(CAMERA).changed(camera=size).to_dict()
    camera["band"][0]["nodes"] = 1
    if glow:
        camera = {
            "camera": camera["camera"],
            "band": [{"name": "vis", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}],
        }
    return hv.Scene(
        camera=camera,
        altitude_km=item["altitude_km"],
        roll_deg=item["roll_deg"],
        pitch_deg=item["pitch_deg"],
        yaw_deg=yaw_deg,
        earth={"shape": "sphere"},
        atmosphere={"profile": "none"},
        # Albedo 0.1 gives the limb half of the shipped exposure's full scale.
        surface={"kind": "uniform", "temperature_k": 288.0} if glow else {"albedo": 0.1},
        sun={"zenith_deg": 0.0},
        moon={"enabled": False},
        night={"airglow": False, "sky_background": False, "moonlight": False},
        render={"subsamples": 2, "nodes": 8, "orders": "single"},
    )


def measure(item: JsonObject) -> JsonObject:
    """Render a set-up; return every method's errors, the iterates of Newton's method, and the picture."""
    scene = scene_of(item)
    frame = hv.render(scene, progress=False)
    camera, image = frame.truth.camera_model, frame.radiance["vis"].astype(np.float64)
    nadir = np.array(frame.truth.nadir_geocentric_cam)
    fit = hv.estimate(frame, "altitude-free-published")
    points = find_canny_pixels(image, camera, None)
    if not isinstance(points, LimbPoints) or not isinstance(fit, hv.Fit):
        return {"answered": False}
    second = hv.render(scene_of(item, yaw_deg=90.0), progress=False)
    others = find_canny_pixels(second.radiance["vis"].astype(np.float64), camera, None)
    assert isinstance(others, LimbPoints)
    turn = Rotation.from_quat(frame.truth.q_cam_from_itrs) * Rotation.from_quat(second.truth.q_cam_from_itrs).inv()
    radii = [radius_of(item["altitude_km"] * (1.0 + off)) for off in (0.0, ALTITUDE_OFF)]
    found = [
        fit.nadir_cam,
        *(known_altitude(points.los_cam, rho) for rho in radii),
        two_sensors(points.los_cam, turn.apply(others.los_cam)),
    ]
    grey = np.rint(image * (255.0 / image.max())).astype(np.uint8)
    return {
        "answered": True,
        "errors": [
            math.degrees(fit.roll_rad) - item["roll_deg"],
            math.degrees(fit.pitch_rad) - item["pitch_deg"],
            hv.score(fit, frame).altitude_error_km,
        ],
        "nadir_arcsec": [math.degrees(float(off_axis_angle(one, nadir))) * 3600.0 for one in found],
        "iterates": iterates(points.los_cam),
        "picture": base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode("ascii"),
        "pixels": points.uv.tolist(),
    }


def iterates(los_cam: FloatArray) -> JsonObject:
    """Return the iterates (phi, theta, rho) [rad] from both starts, and the summed error of the equations at each."""
    step = altitude_free_published.step_by_pseudo_inverse
    turn, start = altitude_free.start_from(los_cam)
    runs = {"zero": (los_cam, altitude_free_published.START), "three": (turn.apply(los_cam), start)}
    out = {}
    for name, (los, first) in runs.items():
        steps = altitude_free.newton(los, first, step)
        summed = [float(np.abs(los @ nadir_of_roll_pitch(*x[:2]) - np.cos(x[2])).sum()) for x in steps]
        out[name] = {"steps": steps.tolist(), "summed": summed}
    return out


def after_four_steps(run: JsonObject) -> float:
    """Return the largest distance [rad] of the unknowns from their final values after four steps."""
    steps = np.array(run["steps"])
    return float(np.abs(steps[min(STEPS, len(steps) - 1)] - steps[-1]).max())


def radius_of(altitude_km: float) -> float:
    """Return the Earth's angular radius [rad] from an altitude above the sphere."""
    return math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + altitude_km * 1e3))


def known_altitude(los: FloatArray, rho_rad: float) -> FloatArray:
    """Return the nadir at a known angular radius, by Gauss-Newton on the unit sphere from the closed form."""
    nadir = altitude_free_closed_form.solve(los)[0]
    for _ in range(12):
        basis = tangent_basis(nadir)
        nadir = nadir + basis @ np.linalg.lstsq(los @ basis, math.cos(rho_rad) - los @ nadir, rcond=None)[0]
        nadir /= np.linalg.norm(nadir)
    return np.asarray(nadir)


def two_sensors(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the nadir from the chords of two arcs."""
    nadir = np.cross(_chord(first), _chord(second))
    nadir /= np.linalg.norm(nadir)
    return np.asarray(nadir if float(np.mean(first @ nadir)) > 0.0 else -nadir)


def _chord(los: FloatArray) -> FloatArray:
    """Return the difference of the lines of sight to the two pixels of an arc that are farthest apart."""
    one = los[np.argmax(np.linalg.norm(los - los.mean(axis=0), axis=1))]
    return np.asarray(los[np.argmax(np.linalg.norm(los - one, axis=1))] - one)


def cross_check(item: JsonObject) -> JsonObject:
    """Return how far [px] rendered edges are from a stock Mitsuba sphere's, by column and by row."""
    frame = hv.render(scene_of(item, glow=True), progress=False)
    share = frame.radiance["vis"].astype(np.float64)
    share /= share.max()
    stock = stock_sphere(np.array(frame.truth.nadir_geocentric_cam), radius_of(item["altitude_km"]), item)
    off = [column_edges(ours) - column_edges(other) for ours, other in ((share, stock), (share.T, stock.T))]
    edges = np.concatenate(off)
    return {"off": edges[np.isfinite(edges)].tolist()}


def stock_sphere(nadir_cam: FloatArray, rho_rad: float, item: JsonObject) -> FloatArray:
    """Return the coverage of a unit sphere before a camera, rendered by Mitsuba's own plug-ins."""
    import mitsuba as mi

    # Mitsuba's camera looks along z with x to the left and y up: ours turned by half a turn about z.
    centre = (nadir_cam / math.sin(rho_rad) * (-1.0, -1.0, 1.0)).tolist()
    film: dict[str, Any] = {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "luminance"}
    film |= {"width": item["pixels"], "height": item["pixels"], "component_format": "float32"}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "perspective",
                "fov": item["fov_deg"],
                "film": film,
                "sampler": {"type": "stratified", "sample_count": SAMPLES},
            },
            "earth": {"type": "sphere", "center": centre, "radius": 1.0, "emitter": glow},
        }
    )
    image = np.array(mi.render(scene, spp=SAMPLES, seed=mi.UInt32(0))).astype(np.float64)
    return image.reshape(item["pixels"], item["pixels"])


def quick(cache: TaskCache) -> Values:
    """Return the figures of the set-ups."""
    return _values(cache.each("A: set-ups", measure, set_ups()))


def reproduce(cache: TaskCache) -> Result:
    """Repeat the experiments of the paper."""
    shown = cache.each("A: set-ups", measure, set_ups())
    checks = cache.each("A: image generator", cross_check, set_ups())
    off = np.concatenate([one["off"] for one in checks.values()])
    rivals = Table(
        "Errors of the method as published, and nadir errors of others on the same whole pixels",
        ("set-up", "roll [deg]", "pitch [deg]", "altitude [km]", *(f"{name} [arcsec]" for name in METHODS)),
        tuple((name, *one["errors"], *one["nadir_arcsec"]) for name, one in shown.items() if one["answered"]),
        "Noise-free frames. Two sensors: the second camera is turned by 90 deg about the nadir.",
    )
    return Result(
        values={**_values(shown), "cross_check": float(np.sqrt(np.mean(off**2)))},
        figures={
            "set-ups": partial(draw_set_ups, shown),
            "convergence": partial(draw_convergence, next(iter(shown.values()))),
        },
        tables=(rivals,),
        settings={"frames": 2 * len(shown)},
    )


def _values(shown: Mapping[str, JsonObject]) -> Values:
    found = [one for one in shown.values() if one["answered"]]
    arcsec = np.array([one["nadir_arcsec"] for one in found])
    ratio = np.exp(np.mean(np.log(arcsec[:, :1] / arcsec), axis=0))
    rms = np.sqrt(np.mean(arcsec**2, axis=0))
    by_pixels = {name: one["nadir_arcsec"][0] for name, one in shown.items() if name.startswith("6000")}
    falls = [by_pixels[f"6000 km, {fov} deg, 50 px"] / by_pixels[f"6000 km, {fov} deg, 400 px"] for fov in (40, 80)]
    return {
        "set_ups": float(len(found)),
        "nadir": arcsec[:, 0].tolist(),
        "four_steps": [max(after_four_steps(one["iterates"][run]) for one in found) for run in ("three", "zero")],
        "pixels": falls,
        "no_altitude": ratio[1:].tolist(),
        "no_altitude_rms": (rms[0] / rms[1:]).tolist(),
    }


UNKNOWNS = (("roll", "#0072b2", "o"), ("pitch", "#d55e00", "s"), ("angular radius", "#009e73", "^"))
STARTS = {"zero": "start: roll = pitch = 0, rho = 45 deg", "three": "start: the cone through three pixels"}


def draw_set_ups(shown: Mapping[str, JsonObject]) -> MplFigure:
    """The rendered set-ups with the pixels that Canny marks."""
    figure = MplFigure(figsize=(10.5, 6.6), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    for axes, (name, one) in zip(panels, shown.items(), strict=False):
        data = np.frombuffer(base64.b64decode(one["picture"]), np.uint8)
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
        axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        points = np.array(one["pixels"])
        axes.plot(points[:, 0], points[:, 1], "s", color="#ff7f0e", ms=5.0 if len(image) < 100 else 1.0, mew=0)
        axes.set_title(f"{name}: {len(points)} edge pixels", fontsize=9)
        axes.set(xlabel="column [px]", ylabel="row [px]")
    for axes in panels[len(shown) :]:
        axes.axis("off")
    return figure


def draw_convergence(one: JsonObject) -> MplFigure:
    """Summed error of the equations, and each unknown's distance from its final value, against the step."""
    figure = MplFigure(figsize=(10.5, 4.2), layout="constrained")
    left, *panels = figure.subplots(1, 3)
    for axes, (name, title) in zip(panels, STARTS.items(), strict=True):
        run = one["iterates"][name]
        left.semilogy(run["summed"], "o-" if name == "zero" else "s--", color="#333333", ms=4, label=title)
        steps = np.array(run["steps"])
        off = np.maximum(np.abs(steps[:-1] - steps[-1]), 1e-16)
        for k, (unknown, colour, marker) in enumerate(UNKNOWNS):
            axes.semilogy(off[:, k], marker=marker, color=colour, ms=5, label=unknown)
        axes.axhline(1e-6, color="#888888", lw=0.9, ls=":")
        axes.axvline(STEPS, color="#888888", lw=0.9, ls=":")
        axes.set(xlabel="step", ylabel="distance from the solution [rad]", ylim=(1e-17, 30))
        axes.set_title(title, fontsize=9)
        axes.legend(fontsize=8, loc="lower left")
    left.set(xlabel="step", ylabel="sum of |F| over all pixels")
    left.legend(fontsize=8, loc="center right")
    for axes in (left, *panels):
        axes.set_xticks(range(8))
        axes.grid(alpha=0.3)
    return figure
