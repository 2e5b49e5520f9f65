"""Signal, veil and saturation decide the expected outcome; the camera's own settings decide them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic import CMOS, truth_at

from horizonval.core.outcome import Outcome
from horizonval.geometry.camera import camera_from_spec
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.horizon_view import horizon_view
from horizonval.scoring.limb_signal import brightest_reflectance, limb_reflectance, limb_signal
from horizonval.sensor.lens import optics
from horizonval.spec.camera import CameraSpec

LIMB_ROLL_DEG = 68.0


def camera(exposure_s: float = 1.2e-4, **lens):
    return {
        "camera": {"name": "vis", "width": 512, "height": 512, "fov_deg": 60.0},
        "optics": {"f_number": 4.0, "transmission": 0.7, **lens},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75}],
        "detector": CMOS | {"exposure_s": exposure_s},
    }


def expected(exposure_s: float = 1.2e-4, lens=None, **pose):
    return expected_outcome(truth_at(camera(exposure_s, **(lens or {})), roll_deg=LIMB_ROLL_DEG, **pose))


def test_too_short_an_exposure_is_dark_and_too_long_a_one_saturates():
    outcomes = [expected(t).outcome for t in (1e-7, 1.2e-4, 5e-3)]
    assert outcomes == [Outcome.DARK, Outcome.VALID, Outcome.SATURATED]
    # 40 times the exposure that lays a sunlit limb on half of full scale: no doubt about it.
    assert not expected(5e-3).borderline
    assert expected(1.8e-4).borderline


def test_the_veil_of_a_sun_outside_the_image_is_glare():
    # The view is towards azimuth 270, 22 deg below the horizontal, 30 deg to its upper edge: the Sun stands above it.
    sun = {"sun_zenith_deg": 75.0, "sun_azimuth_deg": 270.0}
    clean = expected(**sun)
    assert not clean.sun_in_frame
    assert clean.outcome == Outcome.VALID
    baffle = {"angle_deg": [30.0, 60.0], "pst": [1.0e-2, 1.0e-3]}
    veiled = expected(lens={"stray": baffle}, **sun)
    assert veiled.outcome == Outcome.SUN_GLARE
    assert veiled.veil_fraction > 1
    assert (
        expected(lens={"stray": {**baffle, "cutoff_deg": 100.0, "pst": [1e-9, 1e-9]}}, **sun).outcome == Outcome.VALID
    )


def test_the_sun_in_the_frame_of_a_clean_lens_may_go_either_way_and_of_a_dirty_one_not():
    sun = {"sun_zenith_deg": 100.0, "sun_azimuth_deg": 270.0}
    clean = expected(**sun)
    assert clean.sun_in_frame
    assert clean.outcome == Outcome.SUN_GLARE
    dirty = expected(lens={"scatter": {"tis": 0.95, "l_rad": 0.3, "s": -1.5}}, **sun)
    assert dirty.outcome == Outcome.SUN_GLARE
    assert not dirty.borderline
    assert dirty.veil_fraction > 1


def test_the_etendue_on_the_horizon_is_the_sensors():
    """Against the sensor's whole map, whose pixels' centres lie up to 0.7 px off: the law changes by 0.5 % in that."""
    data = camera(vignetting_deg=[0.0, 40.0], vignetting=[1.0, 0.7])
    truth = truth_at(data, roll_deg=LIMB_ROLL_DEG)
    spec = CameraSpec.model_validate(data)
    geometry = camera_from_spec(spec.camera)
    view = horizon_view(truth, geometry)
    signal = limb_signal(truth, spec, spec.band[0], geometry, view)
    at = np.rint(view.uv[view.in_view]).astype(int).clip(0, 511)
    map_m2_sr = optics.etendue(geometry, 5.5e-6, spec.optics)[at[:, 1], at[:, 0]]
    zenith = np.arccos(view.cos_zenith[view.in_view])
    bright = brightest_reflectance(zenith, view.cos_azimuth[view.in_view], 0.3, air=True)
    ratio = signal.filling[view.in_view] / (map_m2_sr * bright)
    assert np.ptp(ratio) / ratio.mean() < 1e-2


def test_reflectance_table():
    """A Lambert ground without air; a fall by more than ten thousand from day to the end of twilight; bright ahead."""
    z = np.radians([0.0, 60.0, 100.0])
    assert limb_reflectance(z, np.ones(3), 0.5, air=False) == pytest.approx([0.5, 0.25, 0.0], abs=1e-12)
    day, dusk = limb_reflectance(np.radians([30.0, 108.0]), np.zeros(2), 0.3, air=True)
    assert day / dusk > 1e4
    # Rayleigh's phase function is (1 + cos^2) times 3/4: twice as bright along the Sun's rays as across them.
    ahead, side = limb_reflectance(np.full(2, math.radians(70.0)), np.array([1.0, 0.0]), 0.0, air=True)
    assert 1.3 < ahead / side < 2.0


LINE = {
    "camera": {"name": "line", "width": 8, "height": 160, "fov_deg": 0.8},
    "band": [{"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.0}],
}
"""160 pixels of 0.1 deg across the limb, which stands 68 deg off the nadir."""


def line(roll_deg: float, above_deg: float | None = None, **pose):
    """Return what is expected of a linear array; ``above_deg``: of the infrared horizon over the ground's edge."""
    truth = truth_at(LINE, roll_deg=roll_deg, **pose)
    if above_deg is not None:
        hard = [truth.angular_radius_rad] * 36
        curve = {
            "azimuth_deg": [10.0 * i for i in range(36)],
            "geometric_angle_rad": hard,
            "half_plateau_angle_rad": [angle + math.radians(above_deg) for angle in hard],
            "half_plateau_height_m": [40e3] * 36,
        }
        truth = replace(truth, infrared_horizon={"co2": curve})
    return expected_outcome(truth, needs="heads")


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_linear_array_must_be_crossed_with_room_to_both_sides(side):
    """20 px to the end, 7 px, 1 px."""
    certain, close, too_close = (line(LIMB_ROLL_DEG + side * off_deg) for off_deg in (6.0, 7.3, 7.85))
    assert (certain.outcome, certain.borderline) == (Outcome.VALID, False)
    assert (close.outcome, close.borderline) == (Outcome.VALID, True)
    assert (too_close.outcome, too_close.borderline) == (Outcome.SHORT_ARC, False)


def test_what_crosses_a_thermal_linear_array_is_the_infrared_horizon():
    """40 km above the ground are a degree: out of the row where the ground's edge is still 20 px within it."""
    assert line(LIMB_ROLL_DEG - 6.0, 1.0).borderline
    assert line(LIMB_ROLL_DEG - 7.0, 1.0).outcome is not Outcome.VALID
    lower = line(LIMB_ROLL_DEG + 7.85, 1.0)
    assert lower.outcome is Outcome.VALID


def test_the_sun_in_a_thermal_linear_array_may_be_refused():
    east = {"sun_zenith_deg": 109.0, "sun_azimuth_deg": 90.0}
    seen = [line(LIMB_ROLL_DEG, **{**east, "sun_azimuth_deg": azimuth}) for azimuth in (90.0, 270.0)]
    with_sun, without = sorted(seen, key=lambda e: not e.sun_in_frame)
    assert with_sun.sun_in_frame
    assert (with_sun.outcome, with_sun.borderline) == (Outcome.SUN_GLARE, True)
    assert (without.outcome, without.borderline) == (Outcome.VALID, False)
    # An image shows that the Sun is a disc.
    image = {**LINE, "camera": {"name": "image", "width": 160, "height": 160, "fov_deg": 30.0}}
    found = expected_outcome(
        truth_at(image, roll_deg=LIMB_ROLL_DEG, **{**east, "sun_azimuth_deg": 90.0}), needs="heads"
    )
    assert found.outcome is Outcome.VALID


def test_a_camera_of_several_must_show_an_arc():
    """Almost out of the frame of 60 deg a few pixels of limb are left, along the rim."""
    outcomes = {}
    for off_deg in (0.0, 20.0, 32.0):
        truth = truth_at(camera(), roll_deg=LIMB_ROLL_DEG - off_deg)
        found = expected_outcome(truth, needs="heads")
        outcomes[off_deg] = found.outcome
        assert found.horizon_arc_px > 20 or off_deg < 32.0
    assert outcomes == {0.0: Outcome.VALID, 20.0: Outcome.VALID, 32.0: Outcome.SHORT_ARC}


def test_a_strip_needs_a_crossing_only():
    strip = {**camera(), "camera": {"name": "strip", "width": 8, "height": 512, "fov_deg": 0.9}}
    truth = truth_at(strip, roll_deg=LIMB_ROLL_DEG)
    assert expected_outcome(truth).outcome == Outcome.SHORT_ARC
    assert expected_outcome(truth, needs="heads").outcome == Outcome.VALID
