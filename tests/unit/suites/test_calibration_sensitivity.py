"""By how much answers move with a wrong calibration, where geometry says it: even limbs of an exact planet."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, toy_image, truth_at

from horizonval.core.arrays import FloatArray
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Fit
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import sphere
from horizonval.suites.observation import observation_of

BALL = sphere(6371008.8)
LOW = truth_at(THERMAL_CAMERA, altitude_km=500.0, roll_deg=67.0, ellipsoid=BALL)
FULL = truth_at(THERMAL_CAMERA, altitude_km=35786.0, ellipsoid=BALL)
"""The whole disc in the middle of the image."""


def nadir_body(truth: FrameTruth, **calibration: Any) -> FloatArray:
    image = toy_image(replace(truth, scene={**truth.scene, "calibration": calibration}))
    fit = altitude_free.ESTIMATOR.run(observation_of(image, altitude_free.ESTIMATOR))
    assert isinstance(fit, Fit), fit
    roll, pitch = fit.roll_rad, fit.pitch_rad
    return np.array([-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)])


def moved_deg(truth: FrameTruth, **calibration: Any) -> float:
    right, wrong = nadir_body(truth), nadir_body(truth, **calibration)
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(right, wrong))), float(right @ wrong)))


@pytest.mark.parametrize("truth", [LOW, FULL], ids=["low", "full"])
def test_a_degree_of_mounting_is_a_degree(truth: FrameTruth) -> None:
    assert moved_deg(truth, mounting_error_deg=[1.0, 0.0, 0.0]) == pytest.approx(1.0, rel=1e-3)


def test_a_pixel_of_the_principal_point_is_a_pixel_s_angle() -> None:
    """Of a disc in the middle in both directions; 160 px of 57 deg have 0.389 deg on the axis."""
    pixel_deg = math.degrees(1.0 / FULL.camera_model.fx)
    for point in ([1.0, 0.0], [0.0, 1.0]):
        assert moved_deg(FULL, principal_point_error_px=point) == pytest.approx(pixel_deg, rel=0.03)
    # A limb across the image, its curve unseen: as the camera turned about the limb's direction.
    assert moved_deg(LOW, principal_point_error_px=[0.0, 1.0]) == pytest.approx(pixel_deg, rel=0.1)


def test_a_full_disc_knows_nothing_of_the_focal_length() -> None:
    """By symmetry zero; a percent moves the limb of a low orbit by its share of the field."""
    assert moved_deg(FULL, focal_length_error_percent=1.0) < 2e-3
    assert moved_deg(LOW, focal_length_error_percent=1.0) > 0.05


def test_time_moves_no_method_that_uses_the_image_alone() -> None:
    assert moved_deg(LOW, clock_error_s=10.0, exposure_offset_s=3.0) == 0.0
