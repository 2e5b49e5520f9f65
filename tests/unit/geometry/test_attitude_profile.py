"""Attitude along an orbit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.geometry import orbit
from horizonval.geometry.attitude_profile import AttitudeProfile, Slew, attitude_against_lvlh, pointing_error
from horizonval.geometry.frames import from_yaw_pitch_roll, rotate

ELEMENTS = orbit.Elements(6.9e6, 0.0, 1.7, 0.4, 0.0, 0.0)
SUN = np.array([0.6, 0.64, 0.48])


def _states(t):
    return orbit.tod_states(ELEMENTS, t)


def _fly(profile, t):
    return attitude_against_lvlh(profile, _states, SUN, np.asarray(t, float))


def test_the_stars_turn_by_the_orbital_rate_about_the_normal():
    _, rates = _fly(AttitudeProfile(reference="inertial"), [0.0])
    # A body fixed among the stars turns against lvlh by the orbital rate about +y; J2 adds 2e-3 of it.
    assert rates[0] == pytest.approx([0.0, ELEMENTS.mean_motion_rad_s, 0.0], abs=3e-6)


def test_the_sun_stays_on_its_axis():
    t = np.linspace(0, 5500, 23)
    angles, _ = _fly(AttitudeProfile(reference="sun", sun_axis=(0.0, 1.0, 1.0)), t)
    lvlh = orbit.lvlh_matrices(*_states(t))
    seen = np.array([rotate(from_yaw_pitch_roll(*a), m @ SUN) for a, m in zip(angles, lvlh, strict=True)])
    assert seen / np.linalg.norm(SUN) == pytest.approx(np.tile([0, 1, 1], (23, 1)) / math.sqrt(2), abs=1e-9)


def test_a_tumble_turns_at_its_rate():
    angles, rates = _fly(AttitudeProfile(tumble_rad_s=(0.0, 0.0, 0.01)), [0.0, 50.0])
    assert rates == pytest.approx(np.tile([0.0, 0.0, 0.01], (2, 1)), abs=1e-12)
    assert angles[1] == pytest.approx([0.5, 0.0, 0.0], abs=1e-12)


def test_a_slew_goes_from_one_attitude_to_the_other_and_rests():
    profile = AttitudeProfile(offset_rad=(0.0, 0.1, 0.0), slew=Slew((0.4, 0.0, -0.3), start_s=10.0, duration_s=60.0))
    angles, rates = _fly(profile, [0.0, 40.0, 100.0])
    assert angles[0] == pytest.approx([0.0, 0.1, 0.0], abs=1e-12)
    assert angles[2] == pytest.approx([0.4, 0.0, -0.3], abs=1e-12)
    assert np.linalg.norm(rates[[0, 2]]) < 1e-12
    # Half way the smooth step is 15/8 times as fast as an even turn, whose angle is about 0.5 rad.
    assert 0.4 * 15 / 8 / 60 < np.linalg.norm(rates[1]) < 0.6 * 15 / 8 / 60


def test_a_pointing_error_has_its_rms_and_its_correlation():
    lags = np.array([0.0, 20.0])
    values = np.array(
        [pointing_error((1e-3, 2e-3, 0.0), 20.0, np.random.default_rng(seed)).at(lags) for seed in range(3000)]
    )
    rms = np.sqrt(np.mean(values**2, axis=(0, 1)))
    # 3000 draws give an rms to 1.3 %, a correlation to 0.02.
    assert rms[:2] == pytest.approx([1e-3, 2e-3], rel=0.05)
    assert rms[2] == 0.0
    correlation = np.mean(values[:, 0] * values[:, 1], axis=0)[:2] / rms[:2] ** 2
    assert correlation == pytest.approx(math.exp(-0.5), abs=0.06)


def test_rates_are_the_derivative_of_the_angles():
    error = pointing_error((1e-3, 1e-3, 1e-3), 10.0, np.random.default_rng(1))
    h = 0.01
    angles, rates = _fly(AttitudeProfile(error=error), [5.0 - h, 5.0, 5.0 + h])
    # Small angles: yaw is about z, pitch about y, roll about x, to 1e-3 of the rate.
    assert rates[1][::-1] == pytest.approx((angles[2] - angles[0]) / (2 * h), abs=1e-6)
