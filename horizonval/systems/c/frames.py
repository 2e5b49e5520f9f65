"""Rendered frames of three Earths: the oracle beside their truth, every image estimator beside the oracle."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods import ideal
from horizonval.estimation.observation import Fit
from horizonval.geometry.rotation import angle_between
from horizonval.plugins import registry
from horizonval.scoring.errors import ARCSEC, score
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of

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
