"""A static quadrant sensor: balance by symmetry, slopes against the profile, exact answers of the linear sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.sensor.quadrant import AZIMUTH_RAD, QuadrantFit, QuadrantSensor, field_mean
from horizonval.systems.g import experiment
from horizonval.systems.g.experiment import ETA_RAD, OFFSET_DEG
from horizonval.systems.weather_viewpoints import WeatherPlace

PLACE = WeatherPlace(25.0, 10.0, 60.0, 3, 0, 0)
SENSOR = QuadrantSensor(math.radians(72.0), math.radians(4.0))
SOFT = 5.0 / (1.0 + np.exp((OFFSET_DEG - 1.0) / 0.15))
"""A limb that falls about one degree above the ground's horizon."""


def _over_a_sphere(monkeypatch: pytest.MonkeyPatch, pitch_deg: float, roll_deg: float) -> FloatArray:
    monkeypatch.setattr(experiment, "WGS84", sphere(WGS84.a_m))
    return experiment.sectors(PLACE, 350.0, np.tile(SOFT, (4, 1)), (pitch_deg, roll_deg))


def test_quadrants_balance_over_a_sphere_and_a_tilt_is_read_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    level = _over_a_sphere(monkeypatch, 0.0, 0.0)
    assert np.ptp(SENSOR.reading(ETA_RAD, level)) < 1e-9
    sensor = SENSOR.calibrated(ETA_RAD, level, SENSOR.limb_rad)
    assert sensor.limb_angles(ETA_RAD, level) == pytest.approx(sensor.limb_rad, abs=1e-9)
    tilted = sensor.limb_angles(ETA_RAD, _over_a_sphere(monkeypatch, 0.4, -0.2))
    fit = sensor.attitude(tilted, np.full(4, sensor.limb_rad))
    assert isinstance(fit, QuadrantFit)
    assert np.degrees([fit.pitch_rad, fit.roll_rad]) == pytest.approx([0.4, -0.2], abs=0.02)


def test_the_slope_of_a_field_is_the_difference_of_radiance_at_its_ends() -> None:
    radiance = 5.0 / (1.0 + np.exp((np.degrees(ETA_RAD) - 72.3) / 0.4))
    low, high, h = math.radians(70.0), math.radians(74.0), 1e-5

    def of(by: float) -> float:
        weight = math.cos(low + by) - math.cos(high + by)
        return float(field_mean(ETA_RAD, radiance, low + by, high + by)) * weight

    by_difference = (of(h) - of(-h)) / (2.0 * h)
    ends = [np.interp(end, ETA_RAD, radiance * np.sin(ETA_RAD)) for end in (low, high)]
    assert by_difference == pytest.approx(ends[1] - ends[0], rel=1e-6)
    assert field_mean(ETA_RAD, np.full(len(ETA_RAD), 3.0), low, high) == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize("lost", [None, 0, 3])
def test_four_and_three_quadrants_give_the_attitude_and_its_covariance(lost: int | None) -> None:
    pitch, roll, lift, sigma = 0.004, -0.007, 0.01, 1e-4
    limb = 1.25 - pitch * np.cos(AZIMUTH_RAD) + roll * np.sin(AZIMUTH_RAD) + lift
    rng = np.random.default_rng(2)
    if lost is not None:
        limb[lost] = np.nan
    fit = SENSOR.attitude(limb, np.full(4, 1.25), sigma)
    assert isinstance(fit, QuadrantFit)
    assert (fit.pitch_rad, fit.roll_rad, fit.lift_rad) == pytest.approx((pitch, roll, lift), abs=1e-12)
    drawn = []
    for _ in range(1500):
        noisy = SENSOR.attitude(limb + sigma * rng.standard_normal(4), np.full(4, 1.25), sigma)
        assert isinstance(noisy, QuadrantFit)
        drawn.append((noisy.roll_rad, noisy.pitch_rad, noisy.lift_rad))
    assert np.diag(np.cov(np.array(drawn).T)) == pytest.approx(np.diag(fit.covariance), rel=0.15)


def test_first_order_signs_are_those_of_the_exact_nadir() -> None:
    roll, pitch, rho = 1e-4, 2e-4, 1.25
    nadir = nadir_of_roll_pitch(roll, pitch)
    for azimuth in AZIMUTH_RAD:
        eta = np.linspace(rho - 1e-3, rho + 1e-3, 2001)
        d = np.stack([np.sin(eta) * np.cos(azimuth), np.sin(eta) * np.sin(azimuth), np.cos(eta)], axis=-1)
        at = np.interp(-math.cos(rho), -(d @ nadir), eta)
        assert at - rho == pytest.approx(-pitch * math.cos(azimuth) + roll * math.sin(azimuth), abs=1e-7)


def test_refusals_are_typed() -> None:
    two = SENSOR.attitude(np.array([1.0, np.nan, np.nan, 1.0]), np.ones(4))
    assert isinstance(two, Refusal)
    assert two.status is Outcome.SATURATED
    odd = SENSOR.attitude(np.array([1.1, 1.0, 1.1, 1.0]), np.ones(4))
    assert isinstance(odd, Refusal)
    assert odd.status is Outcome.AMBIGUOUS
