"""Sensors against closed forms: known tilts, linear and step profiles, brighter heads."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.studies.stability.sensors import attitude_error, edge_excess, field_excess, field_output, interpolate

QUARTERS = np.radians([0.0, 90.0, 180.0, 270.0])
WIDTH = math.radians(2.0)


@pytest.mark.parametrize(("roll", "pitch"), [(1e-4, 0.0), (0.0, 1e-4), (2e-4, -3e-4)])
@pytest.mark.parametrize("first", [0.0, 30.0, 45.0])
def test_a_tilted_body_is_an_error_of_attitude_with_the_opposite_sign(roll, pitch, first):
    # A cone of 61 deg about the tilted nadir, cut by the vertical planes of the heads in body axes.
    radius, azimuth = math.radians(61.0), QUARTERS + math.radians(first)
    nadir = nadir_of_roll_pitch(roll, pitch)

    def horizon(alpha):
        def miss(eta):
            ray = [math.sin(eta) * math.cos(alpha), math.sin(eta) * math.sin(alpha), math.cos(eta)]
            return float(nadir @ ray) - math.cos(radius)

        return brentq(miss, 0.5, 1.6, xtol=1e-14)

    excess = np.array([horizon(alpha) for alpha in azimuth]) - radius
    found_pitch, found_roll = attitude_error(excess, azimuth)
    # Second order in the tilt: 3e-4 squared.
    assert found_pitch == pytest.approx(pitch, abs=2e-7)
    assert found_roll == pytest.approx(roll, abs=2e-7)


def test_one_head_enters_by_half_and_all_alike_not_at_all():
    for head, sign in ((0, -1), (2, 1)):
        pitch, roll = attitude_error(1e-3 * np.eye(4)[head], QUARTERS)
        assert float(pitch) == pytest.approx(sign * 5e-4, rel=1e-12)
        assert abs(float(roll)) < 1e-18
    for head, sign in ((1, 1), (3, -1)):
        pitch, roll = attitude_error(1e-3 * np.eye(4)[head], QUARTERS)
        assert float(roll) == pytest.approx(sign * 5e-4, rel=1e-12)
        assert abs(float(pitch)) < 1e-18
    assert np.max(np.abs(attitude_error(np.full((5, 4), 1e-3), QUARTERS))) < 1e-17


def test_an_edge_is_turned_into_an_angle_by_its_own_head():
    height = np.array([0.0, 20e3, 40e3, 60e3])
    offset = np.stack([height / 3.5e6, height / 3.6e6])
    excess = edge_excess(np.array([42e3, 42e3]), 40e3, height, offset)
    np.testing.assert_allclose(excess, [2e3 / 3.5e6, 2e3 / 3.6e6], rtol=1e-12)


def test_interpolation_keeps_rows_apart():
    values = np.array([[0.0, 1.0], [10.0, 30.0]])
    np.testing.assert_allclose(interpolate([0.5, 0.25], [0.0, 1.0], values), [0.5, 15.0])


def test_a_field_on_a_linear_profile():
    offset = np.linspace(-0.1, 0.1, 41)
    mean, slope = field_output(0.013, WIDTH, offset, 5.0 - 20.0 * offset)
    assert float(mean) == pytest.approx(5.0 - 20.0 * 0.013, rel=1e-12)
    assert float(slope) == pytest.approx(-20.0, rel=1e-12)


STEP = np.array([-0.05, -0.03, -0.01, -1e-9, 1e-9, 0.01, 0.03])
DISC = np.where(STEP < 0, 6.0, 0.0)


def test_a_field_on_a_step():
    for centre in (-0.01, 0.0, 0.008):
        mean, slope = field_output(centre, WIDTH, STEP, DISC)
        assert float(mean) == pytest.approx(6.0 * (WIDTH / 2 - centre) / WIDTH, rel=1e-6)
        assert float(slope) == pytest.approx(-6.0 / WIDTH, rel=1e-6)


def test_a_field_above_the_profile_is_dark_and_one_below_it_is_refused():
    mean, slope = field_output(0.1, WIDTH, STEP, DISC)
    assert (float(mean), float(slope)) == (0.0, 0.0)
    with pytest.raises(ValueError, match="below the profile"):
        field_output(-0.04, WIDTH, STEP, DISC)


@pytest.mark.parametrize("fraction", [0.1, 0.3, -0.2])
def test_a_brighter_head_passes_for_a_higher_horizon(fraction):
    radiance = DISC * np.array([[1.0 + fraction], [1.0], [1.0], [1.0]])
    output, slope = field_output(np.zeros(4), WIDTH, np.broadcast_to(STEP, (4, 7)), radiance)
    excess = field_excess(output, float(output[1]), float(slope[1]))
    np.testing.assert_allclose(excess, [fraction * WIDTH / 2, 0.0, 0.0, 0.0], rtol=1e-6, atol=1e-12)
    pitch, roll = attitude_error(excess, QUARTERS)
    # A difference of 30 % between opposite heads costs a field of 2 deg 0.15 deg.
    assert math.degrees(float(pitch)) == pytest.approx(-0.5 * fraction, rel=1e-6)
    assert abs(float(roll)) < 1e-15


def test_a_field_finds_a_horizon_that_moves():
    moved = field_output(0.0, WIDTH, STEP + 0.002, DISC)[0]
    mean, slope = field_output(0.0, WIDTH, STEP, DISC)
    assert float(field_excess(moved, float(mean), float(slope))) == pytest.approx(0.002, rel=1e-6)
