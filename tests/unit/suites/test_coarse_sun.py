"""What an estimator is told of the Sun: a coarse sensor's reading, never the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import truth_at

from horizonval.api.check.limb import sun_outside_deg
from horizonval.scoring.horizon_view import sun_in_frame
from horizonval.suites.observation import coarse_sun_cam
from horizonval.suites.suite import load_suite
from horizonval.truth.frame_truth import truth_of


@pytest.mark.parametrize("zenith_deg", [3.3, 40.4, 95.6])
def test_the_sun_is_told_to_a_degree(zenith_deg):
    truth = truth_at(roll_deg=41.7, sun_zenith_deg=zenith_deg, sun_azimuth_deg=217.3)
    told = coarse_sun_cam(truth)
    assert told is not None
    assert np.linalg.norm(told) == pytest.approx(1.0, abs=1e-12)
    # Half a degree in each of the two angles that are rounded.
    off_deg = math.degrees(np.linalg.norm(np.cross(told, truth.sun_cam)))
    assert 0.0 < off_deg < 0.75


def test_no_sun_is_told_in_eclipse():
    assert coarse_sun_cam(truth_at(sun_zenith_deg=150.0, sun_visible_fraction=0.0)) is None


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
