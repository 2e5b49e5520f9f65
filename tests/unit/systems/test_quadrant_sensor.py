"""A static quadrant sensor: balance by symmetry, slopes against the profile, exact answers of the linear sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from horizonval.systems.g.design import AZIMUTH_RAD, ETA_RAD, QuadrantLayout, field_mean
from horizonval.systems.g.errors import QuadrantFit, attitude_of_quadrants
from numpy.typing import NDArray

from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.systems.g import design
from horizonval.systems.weather_viewpoints import WeatherPlace

PLACE = WeatherPlace(25.0, 10.0, 60.0, 3, 0, 0)
LAYOUT = QuadrantLayout(math.radians(72.0), math.radians(4.0))
SOFT = 5.0 / (1.0 + np.exp((np.array(design.OFFSET_DEG) - 1.0) / 0.15))
"""A limb that falls about one degree above the ground's horizon."""


def _over_a_sphere(monkeypatch: pytest.MonkeyPatch, pitch: float, roll: float) -> NDArray[np.float64]:
    monkeypatch.setattr(design, "WGS84", sphere(WGS84.a_m))
    return design.sectors(PLACE, 350.0, np.tile(SOFT, (4, 1)), pitch, roll)


def test_quadrants_balance_over_a_sphere_when_the_body_is_level(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = LAYOUT.reading(_over_a_sphere(monkeypatch, 0.0, 0.0), "normalised")
    assert np.ptp(seen) < 1e-9
    limb = LAYOUT.limb_rad - 0.05 * (seen - seen.mean())
    fit = attitude_of_quadrants(limb, np.full(4, LAYOUT.limb_rad), AZIMUTH_RAD, 1e-4)
    assert isinstance(fit, QuadrantFit)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_tilt_moves_quadrants_the_way_the_answer_says(monkeypatch: pytest.MonkeyPatch) -> None:
    pitch, roll = math.radians(0.4), math.radians(-0.2)
    seen = _over_a_sphere(monkeypatch, pitch, roll)
    # the slope, by moving the fields over what the level body sees
    level = _over_a_sphere(monkeypatch, 0.0, 0.0)
    h = math.radians(0.05)
    slope = (
        QuadrantLayout(LAYOUT.limb_rad - h, LAYOUT.width_rad).reading(level, "plain")
        - QuadrantLayout(LAYOUT.limb_rad + h, LAYOUT.width_rad).reading(level, "plain")
    ) / (2.0 * h)
    moved = (LAYOUT.reading(seen, "plain") - LAYOUT.reading(level, "plain")) / slope
    fit = attitude_of_quadrants(moved, np.zeros(4), AZIMUTH_RAD, 1e-4)
    assert isinstance(fit, QuadrantFit)
    assert (fit.pitch_rad, fit.roll_rad) == pytest.approx((pitch, roll), abs=math.radians(0.02))


def test_the_slope_of_a_field_is_the_difference_of_radiance_at_its_ends() -> None:
    radiance = 5.0 / (1.0 + np.exp((np.degrees(ETA_RAD) - 72.3) / 0.4))
    low, high, h = math.radians(70.0), math.radians(74.0), 1e-5

    def of(by: float) -> float:
        weight = math.cos(low + by) - math.cos(high + by)
        return float(field_mean(radiance, low + by, high + by)) * weight

    by_difference = (of(h) - of(-h)) / (2.0 * h)
    ends = [np.interp(end, ETA_RAD, radiance * np.sin(ETA_RAD)) for end in (low, high)]
    assert by_difference == pytest.approx(ends[1] - ends[0], rel=1e-6)
    assert field_mean(np.full(len(ETA_RAD), 3.0), low, high) == pytest.approx(3.0, rel=1e-6)


@pytest.mark.parametrize("lost", [None, 0, 3])
def test_four_and_three_quadrants_give_the_attitude_and_its_covariance(lost: int | None) -> None:
    pitch, roll, lift, sigma = 0.004, -0.007, 0.01, 1e-4
    limb = 1.25 - pitch * np.cos(AZIMUTH_RAD) + roll * np.sin(AZIMUTH_RAD) + lift
    rng = np.random.default_rng(2)
    if lost is not None:
        limb[lost] = np.nan
    fit = attitude_of_quadrants(limb, np.full(4, 1.25), AZIMUTH_RAD, sigma)
    assert isinstance(fit, QuadrantFit)
    assert (fit.pitch_rad, fit.roll_rad, fit.lift_rad) == pytest.approx((pitch, roll, lift), abs=1e-12)
    drawn = []
    for _ in range(1500):
        noisy = attitude_of_quadrants(limb + sigma * rng.standard_normal(4), np.full(4, 1.25), AZIMUTH_RAD, sigma)
        assert isinstance(noisy, QuadrantFit)
        drawn.append((noisy.roll_rad, noisy.pitch_rad, noisy.lift_rad))
    scatter = np.cov(np.array(drawn).T)
    assert np.diag(scatter) == pytest.approx(np.diag(fit.covariance), rel=0.15)


def test_first_order_signs_are_those_of_the_exact_nadir() -> None:
    roll, pitch, rho = 1e-4, 2e-4, 1.25
    nadir = nadir_of_roll_pitch(roll, pitch)
    for azimuth in AZIMUTH_RAD:
        eta = np.linspace(rho - 1e-3, rho + 1e-3, 2001)
        d = np.stack([np.sin(eta) * np.cos(azimuth), np.sin(eta) * np.sin(azimuth), np.cos(eta)], axis=-1)
        at = np.interp(-math.cos(rho), -(d @ nadir), eta)
        assert at - rho == pytest.approx(-pitch * math.cos(azimuth) + roll * math.sin(azimuth), abs=1e-7)


def test_refusals_are_typed() -> None:
    two = attitude_of_quadrants(np.array([1.0, np.nan, np.nan, 1.0]), np.ones(4), AZIMUTH_RAD, 1e-4)
    assert isinstance(two, Refusal)
    assert two.status is Outcome.SATURATED
    odd = attitude_of_quadrants(np.array([1.1, 1.0, 1.1, 1.0]), np.ones(4), AZIMUTH_RAD, 1e-4)
    assert isinstance(odd, Refusal)
    assert odd.status is Outcome.AMBIGUOUS
