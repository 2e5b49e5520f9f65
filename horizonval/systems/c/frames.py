"""Rendered frames of three Earths: the oracle beside their truth, every image estimator beside the oracle.

The module's reading is also taken from a rendered picture alone, without the pose or the module's formulas. A warm
sphere without air is equally bright up to its edge, and a pixel on the edge has the share of the brightness that the
Earth covers of it. So a column's sum is the number of pixels that the Earth covers in it, and with it the place of the
edge, to a fraction of a pixel (rows likewise, where the limb stands upright). The edge's lines of sight lie on a cone;
its axis ``n`` and half angle ``rho`` are fitted to them, and the reading follows from the boresight ``f`` and the right
axis ``x`` of the picture::

    pitch error = angle(f, n) - rho,     roll error = atan2(x . u, x . l),     l = n x f / |n x f|,     u = l x f
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods import ideal
from horizonval.estimation.methods.ideal import ideal_horizon_sensor
from horizonval.estimation.observation import Fit
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import angle_between, off_axis_angle
from horizonval.plugins import registry
from horizonval.scoring.errors import ARCSEC, score
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of, oracle_pose

FRAMES: dict[str, JsonObject] = {
    "visible, sphere without air": {
        "camera": "vis-cmos-512-60deg",
        "width": 320,
        "earth": {"shape": "sphere"},
        "atmosphere": {"profile": "none"},
    },
    "visible, WGS84 without air": {
        "camera": "vis-cmos-512-60deg",
        "width": 320,
        "earth": {"shape": "wgs84"},
        "atmosphere": {"profile": "none"},
    },
    "infrared, WGS84 with air": {
        "camera": "ir-bolometer-160-57deg",
        "width": 160,
        "earth": {"shape": "wgs84"},
        "atmosphere": {"profile": "us_standard"},
    },
}

ESTIMATORS = (
    "altitude-free",
    "altitude-free-closed-form",
    "altitude-free-published",
    "guarded-altitude-free",
)
"""Methods of one image for the geocentric nadir: those of this package, whatever else is installed."""


def against_oracle(item: JsonObject) -> JsonObject:
    """Render one frame; return the oracle's departure from its truth and each image estimator's error [rad]."""
    from horizonval.renderer.frame import render_frame
    from horizonval.sensor.observe import observe

    camera = load_camera(item["camera"])
    shape = {"width": item["width"], "height": item["width"] * camera.camera.height // camera.camera.width}
    camera = camera.model_copy(update={"camera": camera.camera.model_copy(update=shape)})
    scene = SceneSpec.model_validate(
        {
            "scene": {"name": "ideal-module", "seed": item["seed"]},
            "camera": {"file": item["camera"], "mount_pitch_deg": 65.0},
            "platform": {
                "altitude_km": 500.0,
                "latitude_deg": 40.0,
                "longitude_deg": 20.0,
                "epoch_utc": datetime(2026, 6, 21, 10, tzinfo=UTC),
            },
            "attitude": {"roll_deg": 3.0, "pitch_deg": -2.0, "yaw_deg": 10.0},
            "earth": item["earth"],
            "atmosphere": item["atmosphere"],
        }
    )
    image = observe(render_frame(scene, camera), camera, seed=item["seed"])
    truth = image.truth
    oracle = ideal.ESTIMATOR.run(observation_of(image, ideal.ESTIMATOR))
    assert isinstance(oracle, Fit)
    result: JsonObject = {
        "truth": angle_between(np.array(truth.nadir_geocentric_cam), oracle.nadir_cam),
        "angles": max(abs(oracle.roll_rad - truth.roll_rad), abs(oracle.pitch_rad - truth.pitch_rad)),
        "estimators": {},
        "asked": 0,
    }
    for name in ESTIMATORS:
        estimator = registry.get(name)
        result["asked"] += 1
        fit = registry.run_safely(estimator, observation_of(image, estimator))
        scored = score(truth, estimator, fit)
        if isinstance(fit, Fit) and scored.nadir_error_arcsec is not None:
            result["estimators"][name] = {"error": scored.nadir_error_arcsec * ARCSEC}
    return result


CAMERA = "ir-bolometer-160-57deg"
FULL = 1e-9
"""Share of the brightness by which a pixel may differ from full or dark and still count as such."""
POSES: tuple[tuple[float, float, float], ...] = (
    (0.0, 65.0, 500.0),
    (0.0, -80.0, 500.0),
    (25.0, 55.0, 500.0),
    (65.0, 0.0, 500.0),
    (-60.0, 30.0, 400.0),
    (20.0, -40.0, 2000.0),
)
"""Mounting pitch and roll [deg] and altitude [km]: level and upright pictures, boresights above and below the
horizon."""


def items(seed: int) -> dict[str, JsonObject]:
    """Return the items of :func:`against_picture`, by name."""
    return {
        f"mounted at pitch {pitch:g}, roll {roll:g}, from {altitude:g} km": {
            "pitch": pitch,
            "roll": roll,
            "altitude_km": altitude,
            "seed": seed,
        }
        for pitch, roll, altitude in POSES
    }


def against_picture(item: JsonObject) -> JsonObject:
    """Render one pose of :func:`items`; return both readings [rad], the edge's points and the angle of a pixel."""
    from horizonval.renderer.frame import render_frame

    camera = load_camera(CAMERA)
    scene = SceneSpec.model_validate(
        {
            "scene": {"name": "ideal-module", "seed": item["seed"]},
            "camera": {"file": CAMERA, "mount_pitch_deg": item["pitch"], "mount_roll_deg": item["roll"]},
            "platform": {
                "altitude_km": item["altitude_km"],
                "latitude_deg": 40.0,
                "longitude_deg": 20.0,
                "epoch_utc": datetime(2026, 6, 21, 10, tzinfo=UTC),
            },
            "earth": {"shape": "sphere"},
            "atmosphere": {"profile": "none"},
            "surface": {"kind": "uniform", "temperature_k": 250.0},
        }
    )
    frame = render_frame(scene, camera)
    radiance = np.asarray(next(iter(frame.radiance.values())), dtype=np.float64)
    model = camera_from_spec(camera.camera)
    los = unproject(model, edge_points(radiance / radiance.max()))
    roll, pitch = reading_of_edge(los)
    pose = oracle_pose(frame.truth)
    module = ideal_horizon_sensor(pose.r_itrs, pose.q_cam_from_itrs, pose.radius_m)
    return {
        "roll": roll,
        "pitch": pitch,
        "module_roll": module.roll_error_rad,
        "module_pitch": module.pitch_error_rad,
        "points": len(los),
        "pixel_rad": 1.0 / model.fx,
    }


def edge_points(share: FloatArray) -> FloatArray:
    """Return columns and rows, shape (n, 2), where the edge of a cover ``share``, shape (H, W), crosses the picture.

    One point for every column, or every row, with a covered and a bare end; of the two the more numerous.
    """
    along_columns, along_rows = _crossings(share), _crossings(share.T)[:, ::-1]
    return along_columns if len(along_columns) >= len(along_rows) else along_rows


def _crossings(share: FloatArray) -> FloatArray:
    """Return (column, row) of every column that the edge crosses once."""
    first, last = share[0], share[-1]
    from_top = (first > 1.0 - FULL) & (last < FULL)
    from_below = (first < FULL) & (last > 1.0 - FULL)
    covered = share.sum(axis=0)
    row = np.where(from_top, covered - 0.5, len(share) - 0.5 - covered)
    columns = np.flatnonzero(from_top | from_below)
    return np.stack([columns.astype(float), row[columns]], axis=1)


def reading_of_edge(los_cam: FloatArray) -> tuple[float, float]:
    """Return roll and pitch error [rad] from lines of sight to the horizon, shape (n, 3)."""
    cone = fit_cone(los_cam)
    forward, right = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    rho = float(np.mean(off_axis_angle(los_cam, cone.axis_cam)))
    level = np.cross(cone.axis_cam, forward)
    level /= np.linalg.norm(level)
    up = np.cross(level, forward)
    roll = math.atan2(float(right @ up), float(right @ level))
    return roll, float(off_axis_angle(forward, cone.axis_cam)) - rho
