"""Expected outcomes of frames whose geometry can be said in words."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import SOLAR_CAMERA, THERMAL_CAMERA, truth_at

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.geometry.ellipsoid import sphere
from horizonval.scoring.expected import expected_outcome

BALL = sphere(6371008.8)
LIMB_ROLL_DEG = 68.0
"""At 500 km the horizon is 68 deg off the nadir: this roll puts it through the image's centre."""


def test_daylight_limb_is_valid():
    e = expected_outcome(truth_at(roll_deg=LIMB_ROLL_DEG))
    assert e.outcome == Outcome.VALID
    assert e.lit_fraction == 1
    assert not e.sun_in_frame
    # It runs from side to side of a 640 pixel wide image, bent.
    assert 640 < e.horizon_arc_px < 700
    assert e.sun_zenith_deg == pytest.approx(30, abs=1e-9)


@pytest.mark.parametrize(("roll_deg", "what"), [(0.0, "ground"), (150.0, "space")])
def test_no_horizon_in_view(roll_deg, what):
    e = expected_outcome(truth_at(roll_deg=roll_deg))
    assert e.outcome == Outcome.NO_LIMB, what
    assert e.lit_fraction is None
    assert e.horizon_arc_px == 0
    assert e.horizon_fraction_in_view == 0


def test_a_cut_corner_is_a_short_arc():
    # The image is 60 deg wide and 47 deg high; yaw of the mount would turn it. Move the limb out over the top edge.
    rolls = np.arange(40.0, 47.0, 0.25)
    arcs = [(expected_outcome(truth_at(roll_deg=float(r), ellipsoid=BALL))) for r in rolls]
    outcomes = [e.outcome for e in arcs]
    assert outcomes[0] == Outcome.NO_LIMB
    assert outcomes[-1] == Outcome.VALID
    assert Outcome.SHORT_ARC in outcomes
    # Too short in pixels, or too short to say where the nadir is.
    assert all(
        e.usable_arc_px < 0.25 * 480 or e.determined_deg is None or e.determined_deg > 0.2
        for e in arcs
        if e.outcome == Outcome.SHORT_ARC
    )
    # Between the certain refusals and the certain answers lie frames that may go either way.
    grey = [e.borderline for e in arcs]
    assert any(grey)
    assert not grey[0]
    assert not grey[-1]


def test_a_narrow_field_sees_a_straight_line():
    narrow = {**SOLAR_CAMERA, "camera": {"name": "tele", "width": 640, "height": 480, "fov_deg": 1.0}}
    e = expected_outcome(truth_at(narrow, roll_deg=LIMB_ROLL_DEG, ellipsoid=BALL))
    # The limb crosses the whole image, and deviates from a line by half^2 / 2 / tan(rho), here h = 0.5 deg.
    rho = math.asin(6371008.8 / 6871008.8)
    focal = 320 / math.tan(math.radians(0.5))
    assert e.horizon_arc_px == pytest.approx(640, rel=0.01)
    assert e.horizon_sagitta_px == pytest.approx(math.radians(0.5) ** 2 / 2 / math.tan(rho) * focal, rel=0.02)
    # Half a pixel of bend can be seen, but some hundred metres of air bend it as much.
    assert e.outcome == Outcome.SHORT_ARC
    assert not e.borderline
    assert e.determined_deg > 1


def test_a_full_disc_in_view():
    e = expected_outcome(truth_at(THERMAL_CAMERA, altitude_km=35786.0, ellipsoid=BALL))
    assert e.outcome == Outcome.VALID
    assert e.horizon_fraction_in_view == 1
    rho = math.asin(6371008.8 / (6371008.8 + 35786e3))
    focal = 80 / math.tan(math.radians(28.5))
    # A circle about the boresight of a pinhole camera, as a polygon of more than 20000 sides.
    assert e.horizon_arc_px == pytest.approx(2 * math.pi * focal * math.tan(rho), rel=1e-6)


def test_night_is_dark_for_the_eye_and_valid_for_heat():
    night = {"roll_deg": LIMB_ROLL_DEG, "sun_zenith_deg": 150.0, "sun_visible_fraction": 0.0}
    assert expected_outcome(truth_at(SOLAR_CAMERA, **night)).outcome == Outcome.DARK
    e = expected_outcome(truth_at(THERMAL_CAMERA, **night))
    assert e.outcome == Outcome.VALID
    assert e.lit_fraction == 1


def test_terminator_along_the_view():
    """The Sun on the horizon of the point below and 90 deg to the side of the view: half the arc in view is lit."""
    e = expected_outcome(
        truth_at(roll_deg=LIMB_ROLL_DEG, latitude_deg=0.0, sun_zenith_deg=90.0, sun_azimuth_deg=0.0, ellipsoid=BALL)
    )
    assert e.lit_fraction == pytest.approx(0.5, abs=0.01)
    # What is left of the arc may or may not be enough for a sensor.
    assert e.borderline


def test_the_suns_disc_in_the_frame_is_glare():
    # The view is towards azimuth 270, its centre at zenith 112: the Sun at 100 stands 12 deg above it.
    sun = {"roll_deg": LIMB_ROLL_DEG, "sun_zenith_deg": 100.0, "sun_azimuth_deg": 270.0}
    e = expected_outcome(truth_at(**sun, ellipsoid=BALL))
    assert e.sun_in_frame
    assert e.outcome == Outcome.SUN_GLARE
    # The horizon's zenith angle is 180 deg - rho.
    horizon = 180 - math.degrees(math.asin(6371008.8 / 6871008.8))
    assert e.sun_limb_distance_deg == pytest.approx(horizon - 100, abs=1e-9)
    thermal = expected_outcome(truth_at(THERMAL_CAMERA, **sun))
    assert thermal.sun_in_frame
    assert thermal.outcome == Outcome.VALID
    assert not expected_outcome(truth_at(**{**sun, "sun_azimuth_deg": 90.0})).sun_in_frame


def test_a_sun_behind_the_earth_is_not_in_the_frame():
    e = expected_outcome(
        truth_at(roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=116.0, sun_azimuth_deg=270.0, sun_visible_fraction=0.0)
    )
    assert not e.sun_in_frame
    assert e.sun_limb_distance_deg < 0


def test_only_the_edge_of_the_disc_in_the_frame_counts():
    """The Sun's centre 0.2 deg above the top edge (disc radius 0.267 deg) shows; 0.3 deg above it does not."""
    plain = {**SOLAR_CAMERA, "camera": {"name": "plain", "width": 640, "height": 480, "fov_deg": 60.0}}
    half_height = math.degrees(math.atan(math.tan(math.radians(30)) * 480 / 640))
    top = 180 - LIMB_ROLL_DEG - half_height
    for above, seen in ((0.2, True), (0.3, False)):
        truth = truth_at(
            plain, roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=top - above, sun_azimuth_deg=270.0, ellipsoid=BALL
        )
        assert expected_outcome(truth).sun_in_frame is seen


def test_a_method_that_is_given_the_pose_can_always_answer():
    e = expected_outcome(truth_at(roll_deg=150.0), needs="pose")
    assert e.outcome == Outcome.VALID
    assert e.horizon_arc_px == 0


def test_bands_are_told_apart_by_name():
    both = {**SOLAR_CAMERA, "band": [*SOLAR_CAMERA["band"], *THERMAL_CAMERA["band"]]}
    truth = truth_at(both, roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=150.0, sun_visible_fraction=0.0)
    assert expected_outcome(truth).outcome == Outcome.DARK
    assert expected_outcome(truth, "lwir").outcome == Outcome.VALID
    with pytest.raises(UserError, match="no band 'uv'"):
        expected_outcome(truth, "uv")
