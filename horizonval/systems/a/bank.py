"""The bank of frames of the altitude-free sensor: bare spheres, and every method's errors on each of them.

A sphere without air under an overhead Sun: all of the limb in view is lit, and the limb is an edge. The camera is the
shipped ``vis-cmos-1024-60deg`` at another field and another number of pixels; it looks to the nadir at zero attitude.

``compare`` runs Newton's method, the closed form and the orthogonal plane on the same noisy points.

``check`` compares the rendered limb with the exact horizon and with a stock Mitsuba sphere. The sphere glows evenly, so
a pixel is its coverage, and the edge of a column (or row) is the sum of its coverages. The analytic edge is the
projected horizon's mean over the pixel's width, by quadrature. The stock sphere shares with this package only the focal
length and the nadir: ``mitsuba.sphere`` before ``mitsuba.perspective``, sampled.
"""

from __future__ import annotations

import base64
import math
from itertools import product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Refusal
from horizonval.estimation.limb.cone import SLOW_PX, slow_error
from horizonval.estimation.limb.edges import find_canny_pixels
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.picture import LimbPoints
from horizonval.estimation.methods import altitude_free, altitude_free_closed_form, altitude_free_published
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import CameraModel, camera_from_spec, project
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.geometry.horizon import fit_cone, horizon_columns, horizon_rows
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.systems.published import published
from horizonval.systems.task_cache import rng_of

CAMERA = "vis-cmos-1024-60deg"
ALTITUDES_KM = (400.0, 800.0, 3000.0, 6000.0)
FIELDS_DEG = (40.0, 60.0, 80.0)
PIXELS = (50, 100, 200, 400, 1024)
ANGLES_DEG = (-30.0, -10.0, 10.0, 30.0)
"""Roll and pitch of the grid: a step of 20 deg, which keeps the bank within some 400 seconds of one core."""
SHORTEST_SHARE = 0.2
"""Smallest limb in view relative to the image's width."""
JITTER_DEG = 1.0
"""Attitudes are drawn within this of the grid's, inside it, so that no pixel grid is symmetric about the nadir."""
SET_UPS = [settings for settings, _ in published("A").tables["set_ups"].columns()]
ARCSEC = math.degrees(1.0) * 3600.0


def camera_of(item: JsonObject) -> CameraSpec:
    """Return the shipped camera with the item's ``pixels`` and ``fov_deg``; one wavelength, for there is no air."""
    spec = load_camera(CAMERA).model_dump(mode="json", exclude_none=True)
    spec["camera"] = {"name": CAMERA, "width": item["pixels"], "height": item["pixels"], "fov_deg": item["fov_deg"]}
    spec["band"][0]["nodes"] = 1
    return CameraSpec.model_validate(spec)


def scene_of(item: JsonObject) -> SceneSpec:
    """Return the item's scene. Albedo 0.1 lays the limb on half of the shipped exposure's full scale."""
    return SceneSpec.model_validate(
        {
            "scene": {"name": "altitude-free"},
            "camera": {"file": CAMERA},
            "platform": {"altitude_km": item["altitude_km"]},
            "attitude": {"roll_deg": item["roll_deg"], "pitch_deg": item["pitch_deg"], "yaw_deg": 0.0},
            "earth": {"shape": "sphere"},
            "atmosphere": {"profile": "none"},
            "surface": {"albedo": 0.1},
            "sun": {"zenith_deg": 0.0},
            "moon": {"enabled": False},
            "night": {"airglow": False, "sky_background": False, "moonlight": False},
            "render": {"subsamples": 2, "nodes": 8, "orders": "single"},
        }
    )


def radius_of(altitude_km: float) -> float:
    """Return the Earth's angular radius [rad] from an altitude above the sphere."""
    return math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + altitude_km * 1e3))


def limb_length_px(item: JsonObject) -> float:
    """Return how much of the limb is in view [px]."""
    camera = camera_from_spec(camera_of(item).camera)
    nadir = nadir_of_roll_pitch(math.radians(item["roll_deg"]), math.radians(item["pitch_deg"]))
    rho = radius_of(item["altitude_km"])
    angle = np.linspace(0.0, 2.0 * np.pi, 7201)
    basis = tangent_basis(nadir)
    around = np.cos(angle)[:, None] * basis[:, 0] + np.sin(angle)[:, None] * basis[:, 1]
    uv, in_front = project(camera, np.cos(rho) * nadir + np.sin(rho) * around)
    with np.errstate(invalid="ignore"):
        inside = in_front & (np.abs(uv - (item["pixels"] - 1) / 2.0) <= item["pixels"] / 2.0).all(axis=1)
        length = np.hypot(*np.diff(uv, axis=0).T)
    return float(length[inside[1:] & inside[:-1]].sum())


def grid(
    seed: int, pixels: tuple[int, ...] = PIXELS, angles_deg: tuple[float, ...] = ANGLES_DEG
) -> dict[str, JsonObject]:
    """Return the items of the full grid, by name, with a fifth of the width of horizon in view.

    An attitude is the same for all numbers of pixels, fields and altitudes.
    """
    items = {}
    for roll, pitch in product(angles_deg, angles_deg):
        off = rng_of(seed, "altitude-free", f"{roll:g} {pitch:g}").uniform(0.0, JITTER_DEG, 2)
        attitude = [round(a - math.copysign(d, a), 6) for a, d in zip((roll, pitch), off.tolist(), strict=True)]
        for altitude, fov in product(ALTITUDES_KM, FIELDS_DEG):
            item = {"altitude_km": altitude, "fov_deg": fov, "roll_deg": attitude[0], "pitch_deg": attitude[1]}
            if limb_length_px(item | {"pixels": 400}) < SHORTEST_SHARE * 400:
                continue
            for n in pixels:
                noisy = n == max(pixels) and fov == 60.0
                name = f"{altitude:g} km, {fov:g} deg, {n} px, roll {roll:g}, pitch {pitch:g}"
                items[name] = item | {"pixels": n, "noise_seed": seed if noisy else None}
    return items


def set_ups(seed: int) -> dict[str, JsonObject]:
    """Return the published set-ups by name; their frames and iterates are kept."""
    items = {}
    for set_up in SET_UPS:
        item: JsonObject = {key: set_up[key] for key in ("altitude_km", "fov_deg", "roll_deg", "pitch_deg")}
        item |= {"pixels": int(set_up["pixels"]), "noise_seed": seed, "picture": True}
        items[f"{item['altitude_km']:g} km, {item['fov_deg']:g} deg, {item['pixels']} px"] = item
    return items


def measure(item: JsonObject) -> JsonObject:
    """Render an item's frame and return every method's errors on it."""
    camera, scene = camera_of(item), scene_of(item)
    frame = render_frame(scene, camera)
    image = frame.radiance["vis"].astype(np.float64)
    result: JsonObject = {"clean": _errors(item, frame, image, camera_from_spec(camera.camera), None)}
    if item["noise_seed"] is not None:
        seen = observe(frame, camera, seed=item["noise_seed"])
        geometry = camera_from_spec(camera.camera)
        result["noisy"] = _errors(item, frame, seen.dn.astype(np.float64), geometry, float(seen.full_scale))
    if item.get("picture"):
        result["picture"] = _png(image)
    return result


def _errors(
    item: JsonObject, frame: RadianceFrame, image: FloatArray, camera: CameraModel, full_scale: float | None
) -> JsonObject:
    observation = Observation(image=image, camera=camera, full_scale=full_scale)
    nadir = np.array(frame.truth.nadir_geocentric_cam)
    whole = find_canny_pixels(image, camera, full_scale)
    limb = find_limb(image, camera, full_scale)
    fits = {
        "whole, newton": (whole, altitude_free_published.fit_pixels),
        "whole, closed": (whole, altitude_free_closed_form.fit_points),
        "limb, newton": (limb, altitude_free.fit_points),
        "limb, closed": (limb, altitude_free_closed_form.fit_points),
    }
    result = {
        name: _error(item, points, fit, observation, nadir, 0.0 if points is whole else SLOW_PX)
        for name, (points, fit) in fits.items()
    }
    if isinstance(whole, LimbPoints):
        result["three-point start"] = {"updates": _three_point_updates(whole.los_cam)}
        if item.get("picture"):
            result["pixels"] = whole.uv.tolist()
            result["iterates"] = _iterates(whole.los_cam)
    return result


def _error(
    item: JsonObject,
    points: LimbPoints | Refusal,
    fit_points: Any,
    observation: Observation,
    nadir: Any,
    slow_px: float,
) -> JsonObject:
    if isinstance(points, Refusal):
        return {"refused": points.reason}
    fit: Fit | Refusal = fit_points(points.los_cam, points.uv, observation)
    if isinstance(fit, Refusal):
        return {"refused": fit.reason}
    off = fit.nadir_cam - nadir
    assert fit.altitude_m is not None
    position = off_axis_angle(points.los_cam, nadir) - radius_of(item["altitude_km"])
    roll = fit.roll_rad - math.radians(item["roll_deg"])
    return {
        "roll_deg": math.degrees(math.atan2(math.sin(roll), math.cos(roll))),
        "pitch_deg": math.degrees(fit.pitch_rad) - item["pitch_deg"],
        "altitude_km": fit.altitude_m / 1e3 - item["altitude_km"],
        "nadir_arcsec": float(off_axis_angle(fit.nadir_cam, nadir)) * ARCSEC,
        "nees": float(off @ np.linalg.pinv(_covariance(points, fit, observation, slow_px), rcond=1e-9) @ off),
        "points": len(points.uv),
        "point_rms_arcsec": float(np.sqrt(np.mean(position**2))) * ARCSEC,
        "updates": [float(u) for u in np.abs(np.diff(fit.steps, axis=0)).max(axis=1)] if len(fit.steps) else [],
    }


def _covariance(points: LimbPoints, fit: Fit, observation: Observation, slow_px: float) -> FloatArray:
    """Return the claim on a smooth sphere without air: noise and slow errors, without oblateness and relief."""
    basis = tangent_basis(fit.nadir_cam)
    slow = slow_error(points.los_cam, fit.nadir_cam, 1.0 / observation.camera.fx, slow_px)[:2, :2]
    return np.asarray(fit.covariance_nadir_cam + basis @ slow @ basis.T)


def _three_point_updates(los_cam: FloatArray) -> list[float]:
    turn, start = altitude_free.start_from(los_cam)
    steps = altitude_free.newton(turn.apply(los_cam), start, altitude_free_published.step_by_pseudo_inverse)
    return [float(u) for u in np.abs(np.diff(steps, axis=0)).max(axis=1)]


def _iterates(los_cam: FloatArray) -> JsonObject:
    """Return the iterates (phi, theta, rho) [rad] from both starts and the summed error of the equations at each."""
    pseudo_inverse = altitude_free_published.step_by_pseudo_inverse
    published = altitude_free.newton(los_cam, altitude_free_published.START, pseudo_inverse)
    turn, start = altitude_free.start_from(los_cam)
    turned = turn.apply(los_cam)
    runs = {"zero": (los_cam, published), "three": (turned, altitude_free.newton(turned, start, pseudo_inverse))}
    return {
        name: {
            "steps": steps.tolist(),
            "summed": [float(np.abs(los @ nadir_of_roll_pitch(*x[:2]) - np.cos(x[2])).sum()) for x in steps],
        }
        for name, (los, steps) in runs.items()
    }


def _png(image: FloatArray) -> str:
    grey = cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)
    return base64.b64encode(cv2.imencode(".png", grey)[1].tobytes()).decode("ascii")


PIXEL_RAD = float(2 * np.tan(np.radians(30.0)) / 1024)
"""Central pixel of 1024 over 60 deg, the unit of the stated noise."""
RADII_DEG = (31.0, 42.8, 62.7, 70.2, 80.0, 88.0)
ARCS_DEG = (20.0, 40.0, 90.0, 360.0)
NOISES_PX = (0.02, 0.1, 0.3)
DRAWS = 200
POINTS = 400


def conditions(seed: int) -> dict[str, JsonObject]:
    """Return the items by name: every radius and arc at a tenth of a pixel, every noise on 40 deg at 3000 km."""
    cells = [(rho, arc, 0.1) for rho in RADII_DEG for arc in ARCS_DEG]
    cells += [(42.8, 40.0, noise) for noise in NOISES_PX if noise != 0.1]
    return {
        f"rho {rho:g} deg, arc {arc:g} deg, noise {noise:g} px": {
            "rho_deg": rho,
            "arc_deg": arc,
            "noise_px": noise,
            "seed": seed,
        }
        for rho, arc, noise in cells
    }


def compare(item: JsonObject) -> JsonObject:
    """Return errors of the nadir [arcsec] of one condition, over 200 draws of 400 points evenly along the arc.

    ``_rms``; ``_bias``: mean along the arc's bisector, and the closed form's predicted bias; Newton's steps and
    failures; largest angle between Newton's nadir and the orthogonal plane's.
    """
    rng = rng_of(item["seed"], "altitude-free solvers", *(f"{item[k]:g}" for k in ("rho_deg", "arc_deg", "noise_px")))
    rho, sigma = np.radians(item["rho_deg"]), item["noise_px"] * PIXEL_RAD
    nadir = np.array([np.sin(rho), 0.0, np.cos(rho)])
    # towards the optical axis: the camera looks at the middle of the arc
    bisector, side = np.array([-np.cos(rho), 0.0, np.sin(rho)]), np.array([0.0, 1.0, 0.0])
    angle = np.radians(item["arc_deg"]) * (np.arange(POINTS) + 0.5 - POINTS / 2) / POINTS
    t = np.cos(angle)[:, None] * bisector + np.sin(angle)[:, None] * side
    errors: dict[str, list[float]] = {"newton": [], "closed": []}
    biases: dict[str, list[float]] = {"newton": [], "closed": []}
    steps, failed, apart = [], 0, [0.0]
    for _ in range(DRAWS):
        off = rho + rng.normal(0.0, sigma, POINTS)[:, None]
        los = np.cos(off) * nadir + np.sin(off) * t
        nadirs: dict[str, FloatArray] = {}
        try:
            nadirs["newton"], _, iterates = altitude_free.solve(los)
            steps.append(len(iterates) - 1)
            apart.append(float(off_axis_angle(fit_cone(los).axis_cam, nadirs["newton"])))
        except np.linalg.LinAlgError:
            failed += 1
        nadirs["closed"] = altitude_free_closed_form.solve(los)[0]
        for name, direction in nadirs.items():
            errors[name].append(float(off_axis_angle(direction, nadir)))
            biases[name].append(float(direction @ bisector))
    exact = np.cos(rho) * nadir + np.sin(rho) * t
    predicted = altitude_free_closed_form.attenuation(exact, nadir, float(rho), float(sigma)) * np.cos(rho)

    def rms(name: str) -> float:
        return float(np.sqrt(np.mean(np.square(errors[name])))) * ARCSEC

    return {
        **{k: item[k] for k in ("rho_deg", "arc_deg", "noise_px")},
        "newton_rms": rms("newton"),
        "newton_bias": float(np.mean(biases["newton"])) * ARCSEC,
        "closed_rms": rms("closed"),
        "closed_bias": float(np.mean(biases["closed"])) * ARCSEC,
        "predicted_closed_bias": float(predicted @ bisector) * ARCSEC,
        "newton_steps": float(np.mean(steps)) if steps else 0.0,
        "newton_failed": failed / DRAWS,
        "plane_difference": max(apart) * ARCSEC,
    }


SAMPLES = 256
"""Stratified, per pixel of the stock sphere: an edge pixel's coverage to 0.02 or so."""
GAUSS, WEIGHT = (v / 2 for v in np.polynomial.legendre.leggauss(6))


def check(item: JsonObject) -> JsonObject:
    """Return the rms and largest departure [px] of the rendered edges from both authorities, and how many edges."""
    geometry = camera_of(item).camera.model_dump(mode="json", exclude_none=True)
    glow = {"name": "glow", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
    camera = CameraSpec.model_validate({"camera": geometry, "band": [glow]})
    tables = scene_of(item).model_dump(mode="json", exclude_none=True)
    scene = SceneSpec.model_validate(tables | {"surface": {"temperature_k": 288.0}})
    frame = render_frame(scene, camera)
    radiance = frame.radiance["glow"].astype(np.float64)
    coverage = radiance / radiance.max()
    intrinsics = camera_from_spec(camera.camera)
    ellipsoid = frame.truth.ellipsoid
    pose = (intrinsics, frame.truth.q_cam_from_itrs, frame.truth.r_itrs)
    rho = radius_of(item["altitude_km"])
    stock = _stock_sphere(np.array(frame.truth.nadir_geocentric_cam), rho, item["pixels"], item["fov_deg"])
    against_curve, against_stock = [], []
    at = (np.arange(item["pixels"])[:, None] + GAUSS).ravel()
    for find, ours, other in ((horizon_rows, coverage, stock), (horizon_columns, coverage.T, stock.T)):
        crossings = find(*pose, at, ellipsoid).reshape(item["pixels"], len(GAUSS), -1)
        used, rows = _crossed_once(ours, crossings)
        against_curve.append((_edge(ours) - rows @ WEIGHT)[used])
        against_stock.append((_edge(ours) - _edge(other))[used])
    curve, sphere = np.concatenate(against_curve), np.concatenate(against_stock)
    return {
        "edges": len(curve),
        "curve_rms_px": float(np.sqrt(np.mean(curve**2))),
        "curve_max_px": float(np.abs(curve).max()),
        "stock_mean_px": float(sphere.mean()),
        "stock_rms_px": float(np.sqrt(np.mean(sphere**2))),
        "stock_max_px": float(np.abs(sphere).max()),
    }


def _edge(coverage: FloatArray) -> FloatArray:
    """Return the row of every column's edge from what is covered of it."""
    filled = coverage.sum(axis=0)
    return np.asarray(np.where(coverage[0] > 0.5, filled, len(coverage) - filled) - 0.5)


def _crossed_once(coverage: FloatArray, crossings: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which columns the horizon crosses once, away from the ends, and where: (n,) and (n, quadrature points)."""
    once = np.all(np.isfinite(crossings).sum(axis=2) == 1, axis=1)
    rows = np.where(once[:, None], np.nan_to_num(crossings).sum(axis=2), -1.0)
    once &= (rows.min(axis=1) > 0.5) & (rows.max(axis=1) < len(coverage) - 1.5)
    # a sliver at either end is a second crossing between the quadrature points
    once &= np.isin(coverage[0], (0.0, 1.0)) & np.isin(coverage[-1], (0.0, 1.0))
    return once, rows


def _stock_sphere(nadir_cam: FloatArray, rho: float, pixels: int, fov_deg: float) -> FloatArray:
    """Return the coverage of a unit sphere that Mitsuba's own plug-ins see at that place."""
    import mitsuba as mi

    # Mitsuba's camera looks along z with x to the left and y up: ours turned by half a turn about z.
    centre = (nadir_cam / np.sin(rho) * (-1.0, -1.0, 1.0)).tolist()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "perspective",
                "fov": fov_deg,
                "film": {
                    "type": "hdrfilm",
                    "width": pixels,
                    "height": pixels,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
                "sampler": {"type": "stratified", "sample_count": SAMPLES},
            },
            "earth": {
                "type": "sphere",
                "center": centre,
                "radius": 1.0,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    image = np.array(mi.render(scene, spp=SAMPLES, seed=mi.UInt32(0))).astype(np.float64)
    return image.reshape(pixels, pixels)
