"""What an estimator is told of the Sun: a coarse sensor's reading, never the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import truth_at

from horizonval.suites.observation import coarse_sun_cam


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
