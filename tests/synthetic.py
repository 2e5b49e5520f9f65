"""Truths, toy detector images and whole run folders made without renderer, sensor or estimators."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry import frames
from horizonval.geometry.camera import camera_from_spec, pixel_grid, project, unproject
from horizonval.geometry.ellipsoid import (
    WGS84,
    Ellipsoid,
    geocentric_nadir,
    geodetic_nadir,
    itrs_from_geodetic,
    tangent_point,
)
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import Row, make_row, write_results
from horizonval.scoring.summary import summarise
from horizonval.spec.camera import CameraSpec
from horizonval.store.folder import write_json
from horizonval.store.store import Store

SOLAR_CAMERA: dict[str, Any] = {
    "camera": {"name": "vis-640x480", "width": 640, "height": 480, "fov_deg": 60.0, "distortion": [-0.1, 0.02]},
    "band": [{"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7}],
}
THERMAL_CAMERA: dict[str, Any] = {
    "camera": {"name": "lwir-160x120", "width": 160, "height": 120, "fov_deg": 57.0},
    "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
}
TALL_CAMERA: dict[str, Any] = {
    "camera": {"name": "strip-64x512", "width": 64, "height": 512, "fov_deg": 8.0},
    "band": [{"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.0}],
}
CMOS: dict[str, Any] = {
    "kind": "cmos",
    "pixel_pitch_um": 5.5,
    "exposure_s": 2e-4,
    "quantum_efficiency": 0.6,
    "full_well_e": 13500.0,
    "read_noise_e": 13.0,
    "bits": 10,
}
SUN_RADIUS_RAD = math.radians(959.63 / 3600)


def truth_at(
    camera: dict[str, Any] | None = None,
    *,
    name: str = "made",
    latitude_deg: float = 40.0,
    altitude_km: float = 500.0,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
    mount_roll_deg: float = 0.0,
    sun_zenith_deg: float = 30.0,
    sun_azimuth_deg: float = 180.0,
    sun_visible_fraction: float = 1.0,
    ellipsoid: Ellipsoid = WGS84,
) -> FrameTruth:
    """Build a self-consistent truth at longitude 20 deg, heading north. A roll turns the boresight off the nadir."""
    spec = CameraSpec.model_validate(camera or SOLAR_CAMERA)
    r = itrs_from_geodetic(math.radians(latitude_deg), math.radians(20.0), altitude_km * 1e3, ellipsoid)
    angles = [math.radians(a) for a in (yaw_deg, pitch_deg, roll_deg)]
    q_body_from_lvlh = frames.body_from_lvlh(*angles)
    q_cam_from_body = frames.cam_from_body(0.0, 0.0, math.radians(mount_roll_deg))
    q_cam = frames.compose(q_cam_from_body, q_body_from_lvlh, frames.lvlh_from_itrs(r, 0.0))
    north, east = frames.north_east(r)
    up = -geodetic_nadir(r, ellipsoid)
    zenith, azimuth = math.radians(sun_zenith_deg), math.radians(sun_azimuth_deg)
    level = math.cos(azimuth) * north + math.sin(azimuth) * east
    level -= (level @ up) * up
    sun = math.cos(zenith) * up + math.sin(zenith) * level / np.linalg.norm(level)
    return FrameTruth(
        scene={
            "scene": {"name": name, "seed": 0},
            "camera": {"file": spec.camera.name},
            "platform": {"latitude_deg": latitude_deg, "altitude_km": altitude_km},
        },
        camera=spec.model_dump(mode="json"),
        scene_id="0" * 64,
        epoch_utc="2026-03-20T12:00:00+00:00",
        ellipsoid_a_m=ellipsoid.a_m,
        ellipsoid_b_m=ellipsoid.b_m,
        r_itrs=_floats(r),
        altitude_m=altitude_km * 1e3,
        q_cam_from_itrs=_floats(q_cam),
        q_cam_from_body=_floats(q_cam_from_body),
        q_body_from_lvlh=_floats(q_body_from_lvlh),
        yaw_rad=angles[0],
        pitch_rad=angles[1],
        roll_rad=angles[2],
        sun_itrs=_floats(sun),
        sun_cam=_floats(frames.rotate(q_cam, sun)),
        sun_angular_radius_rad=SUN_RADIUS_RAD,
        sun_visible_fraction=sun_visible_fraction,
        nadir_geocentric_cam=_floats(frames.rotate(q_cam, geocentric_nadir(r))),
        nadir_geodetic_cam=_floats(frames.rotate(q_cam, geodetic_nadir(r, ellipsoid))),
        angular_radius_rad=math.asin((ellipsoid.a_m**2 * ellipsoid.b_m) ** (1 / 3) / float(np.linalg.norm(r))),
    )


def fit_of(
    truth: FrameTruth,
    *,
    error_rad: tuple[float, float] = (0.0, 0.0),
    sigma_rad: float = 1e-4,
    geodetic: bool = False,
    **changes: Any,
) -> Fit:
    """A claim that is off by a rotation of ``error_rad`` about two axes across the true nadir."""
    nadir = np.array(truth.nadir_geodetic_cam if geodetic else truth.nadir_geocentric_cam)
    axis = np.cross(nadir, [1.0, 0.0, 0.0] if abs(nadir[0]) < 0.9 else [0.0, 1.0, 0.0])
    axis /= np.linalg.norm(axis)
    claimed = Rotation.from_rotvec(error_rad[0] * axis + error_rad[1] * np.cross(nadir, axis)).apply(nadir)
    body = frames.rotate(frames.inverse(truth.q_cam_from_body), claimed)
    roll, pitch = frames.roll_pitch_of_nadir(body)
    values: dict[str, Any] = {
        "nadir_cam": claimed,
        "covariance_nadir_cam": sigma_rad**2 * (np.eye(3) - np.outer(claimed, claimed)),
        "roll_rad": float(roll),
        "pitch_rad": float(pitch),
    }
    return Fit(**(values | changes))


def estimator(name: str = "made-up", **changes: Any) -> Estimator:
    """An estimator that nobody runs."""
    return Estimator(name=name, title=name, run=lambda _: Refusal(Outcome.NO_LIMB, "never run"), **changes)


def toy_image(truth: FrameTruth, full_scale: int = 1023) -> DetectorImage:
    """Ground, an exponential limb of 8 km scale height, dark current, and the Sun's disc if it is in the frame."""
    spec = truth.camera_spec
    camera = camera_from_spec(spec.camera)
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    d_cam = unproject(camera, pixel_grid(camera))
    d_itrs = frames.rotate(frames.inverse(truth.q_cam_from_itrs), d_cam)
    r = np.array(truth.r_itrs)
    s, height = tangent_point(r, d_itrs, ellipsoid, ray=True)
    glow = 0.5 * np.exp(-np.maximum(height, 0.0) / 8e3)
    if spec.band[0].kind == "solar":
        foot = r + s[..., None] * d_itrs
        cos_zenith = (foot @ np.array(truth.sun_itrs)) / np.linalg.norm(foot, axis=-1)
        glow = glow * np.clip(cos_zenith + 0.1, 0.0, 1.0)
        if truth.sun_visible_fraction > 0:
            sun_angle = np.arccos(np.clip(d_cam @ np.array(truth.sun_cam), -1, 1))
            glow = np.where(sun_angle < SUN_RADIUS_RAD, 50.0, glow + 5e-3 / (sun_angle + 0.01) ** 0.5)
    noise = np.random.default_rng(3).normal(0, 0.01, glow.shape)
    dn = np.clip(np.rint((0.05 + glow + noise) * full_scale), 0, full_scale).astype(np.uint16)
    return DetectorImage(dn=dn, band=spec.band[0].name, truth=truth, full_scale=full_scale)


@dataclass(frozen=True)
class Case:
    """One made-up case: its truth and what each made-up estimator said."""

    truth: FrameTruth
    results: dict[str, Fit | Refusal] = field(default_factory=dict)


def synthetic_cases() -> list[Case]:
    """Eight frames of three cameras: valid, soft-limb bias, refusals right and wrong, a false claim, no estimator."""
    edge = 66.0
    views: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
        ("day-arc", SOLAR_CAMERA, {"roll_deg": edge}),
        ("day-tilted", SOLAR_CAMERA, {"roll_deg": edge - 8, "yaw_deg": 35.0, "pitch_deg": 8.0}),
        ("sun-in-frame", SOLAR_CAMERA, {"roll_deg": edge, "sun_zenith_deg": 100.0, "sun_azimuth_deg": 270.0}),
        ("night", SOLAR_CAMERA, {"roll_deg": edge, "sun_zenith_deg": 140.0, "sun_visible_fraction": 0.0}),
        ("away", SOLAR_CAMERA, {"roll_deg": 150.0}),
        ("lwir-arc", THERMAL_CAMERA, {"roll_deg": edge}),
        ("lwir-high", THERMAL_CAMERA, {"altitude_km": 35786.0, "roll_deg": 5.0}),
        ("strip", TALL_CAMERA, {"roll_deg": edge}),
    ]
    truths = {
        name: truth_at(camera, name=name, sun_visible_fraction=pose.pop("sun_visible_fraction", 1.0), **pose)
        for name, camera, pose in views
    }
    generator = np.random.default_rng(11)
    cases = []
    for name, truth in truths.items():
        results: dict[str, Fit | Refusal] = {}
        expected = expected_outcome(truth)
        if name != "strip":
            error = generator.normal(0, 5e-4, 2)
            results["ideal"] = fit_of(truth, sigma_rad=0.0, angular_radius_rad=truth.angular_radius_rad)
            points = limb_points(truth, generator)
            if expected.outcome == Outcome.VALID:
                results["altitude-free"] = fit_of(
                    truth,
                    error_rad=(float(error[0]), float(error[1])),
                    sigma_rad=2e-4,
                    angular_radius_rad=truth.angular_radius_rad + 3e-4,
                    altitude_m=truth.altitude_m + 2.5e3,
                    points=points,
                )
            else:
                results["altitude-free"] = Refusal(expected.outcome, f"made up to fail: {expected.outcome}", points[:9])
            if name == "sun-in-frame":
                results["altitude-free"] = fit_of(
                    truth, error_rad=(0.02, 0.0), angular_radius_rad=truth.angular_radius_rad - 0.01, points=points
                )
            if name == "lwir-high":
                results["altitude-free"] = Refusal(Outcome.NOT_CONVERGED, "41 iterations, <still> moving & shaking")
        cases.append(Case(truth, results))
    return cases


def limb_points(truth: FrameTruth, generator: np.random.Generator, n: int = 300) -> NDArray[np.float64]:
    """Points near the horizon of a sphere, 0.3 px of noise, inside the image."""
    camera = truth.camera_model
    nadir = np.array(truth.nadir_geocentric_cam)
    first = np.cross(nadir, [0.3, 0.5, -0.7])
    first /= np.linalg.norm(first)
    angle = np.linspace(0, math.tau, 40 * n, endpoint=False)[:, None]
    ring = np.cos(angle) * first + np.sin(angle) * np.cross(nadir, first)
    uv, _ = project(camera, math.cos(truth.angular_radius_rad) * nadir + math.sin(truth.angular_radius_rad) * ring)
    uv = uv + generator.normal(0, 0.3, uv.shape)
    inside = (np.abs(uv - [camera.cx, camera.cy]) <= [camera.width / 2, camera.height / 2]).all(axis=-1)
    uv = uv[inside]
    return uv[:: max(1, len(uv) // n)]


def result_row(**columns: Any) -> Row:
    """A row of a claim that is right, but for the columns given."""
    defaults = {"case": "a", "camera": "cam", "band": "vis", "estimator": "est"}
    defaults |= {"expected": "valid", "status": "valid"}
    return Row(**(defaults | columns))


def write_run(run_dir: Path, cases: list[Case] | None = None) -> Path:
    """Write a run folder as the campaign does."""
    cases = synthetic_cases() if cases is None else cases
    store = Store(run_dir / "archive")
    (run_dir / "cases").mkdir(parents=True)
    rows = []
    for case in cases:
        truth, name = case.truth, case.truth.scene["scene"]["name"]
        image = toy_image(truth)
        shape = image.dn.shape
        maps = {key: np.zeros(shape, np.float32) for key in ("distance", "tangent_height", "solar_zenith", "hit")}
        frame_address = store.add_frame(RadianceFrame({image.band: image.dn.astype(np.float32)}, maps, truth))
        image_address = store.add_image(image)
        own, details = [], {}
        for method, result in case.results.items():
            needs = "pose" if method == "ideal" else "image"
            own.append(
                make_row(
                    case=name,
                    camera=truth.camera["camera"]["name"],
                    band=image.band,
                    estimator=method,
                    truth=truth,
                    expected=expected_outcome(truth, image.band, needs=needs),
                    score=score(truth, estimator(method), result),
                    frame_address=frame_address,
                    image_address=image_address,
                )
            )
            fit = None
            if isinstance(result, Fit):
                fit = {"nadir_cam": result.nadir_cam.tolist(), "angular_radius_rad": result.angular_radius_rad}
            details[method] = {"points": result.points.tolist(), "fit": fit}
        rows += own
        document = {
            "case": name,
            "truth_frame": frame_address,
            "image": image_address,
            "rows": [row.to_dict() for row in own],
            "details": details,
        }
        write_json(run_dir / "cases" / f"{name}.json", document)
    run = {
        "suite": "made-up",
        "title": "Made-up frames for the report's own tests",
        "version": "0.1.0",
        "estimators": ["altitude-free", "ideal"],
        "command": ["horizonval", "run", "made-up.toml", "--out", "."],
        "given_pose": ["ideal"],
        "cases": [case.truth.scene["scene"]["name"] for case in cases],
    }
    write_json(run_dir / "run.json", run)
    write_json(run_dir / "summary.json", summarise(rows, ["ideal"]))
    write_results(rows, run_dir / "results.parquet")
    return run_dir


def _floats(v: Any) -> Any:
    return tuple(float(c) for c in v)
