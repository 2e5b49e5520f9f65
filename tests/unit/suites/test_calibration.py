"""What an estimator is told of calibration and Sun, and what errors of the calibration change."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, toy_image, truth_at

from horizonval.api.check.limb import sun_outside_deg
from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral.bands import width_um
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import sphere
from horizonval.scoring.horizon_view import sun_in_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.suites.observation import coarse_sun_cam, observation_of
from horizonval.suites.suite import load_suite
from horizonval.truth.frame_truth import truth_of

NEVER = Estimator(name="never", title="", run=lambda observation: None, estimates="geocentric")  # type: ignore[arg-type,return-value]


def seen(make_frame, tables, radiance: float) -> Observation:
    image = observe(make_frame(radiance, tables), CameraSpec.model_validate(tables), noise=False)
    return observation_of(image, NEVER)


def test_a_digital_number_of_a_visible_array_is_a_radiance(make_frame, camera_tables) -> None:
    """Two even scenes: 10 W m-2 sr-1 apart, on the axis, to the rounding of one number in some hundred."""
    dark, bright = (seen(make_frame, camera_tables, radiance) for radiance in (5.0, 15.0))
    row, column = dark.image.shape[0] // 2, dark.image.shape[1] // 2
    steps = bright.image[row, column] - dark.image[row, column]
    assert steps > 100.0
    assert bright.radiance_per_dn is not None
    # Four pixels about the axis have 0.9998 of its light and more.
    assert steps * bright.radiance_per_dn == pytest.approx(10.0, rel=1.5 / steps + 2e-3)
    assert bright.radiance_per_dn == dark.radiance_per_dn
    assert bright.band_width_um == pytest.approx(width_um(CameraSpec.model_validate(camera_tables).band[0]))


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
    """Of a disc in the middle in both directions; a pixel at the limb's distance from the axis is smaller by its
    cosine squared. Points are good to a hundredth of a pixel."""
    pixel_deg = math.degrees(1.0 / FULL.camera_model.fx)
    at_limb_deg = pixel_deg * math.cos(FULL.angular_radius_rad) ** 2
    for point in ([1.0, 0.0], [0.0, 1.0]):
        assert moved_deg(FULL, principal_point_error_px=point) == pytest.approx(at_limb_deg, abs=0.015 * pixel_deg)
    # A limb across the image, its curve unseen: as the camera turned about the limb's direction.
    assert moved_deg(LOW, principal_point_error_px=[0.0, 1.0]) == pytest.approx(pixel_deg, rel=0.1)


def test_a_full_disc_knows_nothing_of_the_focal_length() -> None:
    """By symmetry zero; a percent moves the limb of a low orbit by its share of the field."""
    assert moved_deg(FULL, focal_length_error_percent=1.0) < 2e-3
    assert moved_deg(LOW, focal_length_error_percent=1.0) > 0.05


def test_time_moves_no_method_that_uses_the_image_alone() -> None:
    assert moved_deg(LOW, clock_error_s=10.0, exposure_offset_s=3.0) == 0.0


@pytest.mark.parametrize("zenith_deg", [3.3, 40.4, 95.6])
def test_the_sun_is_told_to_a_degree(zenith_deg):
    truth = truth_at(roll_deg=41.7, sun_zenith_deg=zenith_deg, sun_azimuth_deg=217.3)
    told = coarse_sun_cam(truth)
    assert told is not None
    assert np.linalg.norm(told) == pytest.approx(1.0, abs=1e-12)
    # Half a degree in each of the two angles that are rounded.
    off_deg = math.degrees(np.linalg.norm(np.cross(told, truth.sun_cam)))
    assert 0.0 < off_deg < 0.75


def test_no_sun_is_told_anywhere_behind_the_earth():
    """An orbit's own instants: whether the Sun's centre is well behind the Earth or well clear decides everything."""
    behind = 0
    for case in load_suite("shadow").cases:
        if "_visible_" not in case.name:
            continue
        truth = truth_of(case.scene, case.camera)
        r = np.array(truth.r_itrs)
        from_nadir = math.acos(float(-r @ truth.sun_itrs) / float(np.linalg.norm(r)))
        if from_nadir < truth.angular_radius_rad - math.radians(1.0):
            behind += 1
            assert truth.sun_visible_fraction == 0.0
            assert coarse_sun_cam(truth) is None
            assert not sun_in_frame(truth.camera_model, truth)
            assert sun_outside_deg(truth.camera_model, truth) is None
        elif from_nadir > truth.angular_radius_rad + math.radians(1.0):
            assert truth.sun_visible_fraction == 1.0
            assert coarse_sun_cam(truth) is not None
    assert behind == 12
