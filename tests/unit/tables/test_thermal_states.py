"""Days of the ensemble of thermal tables: pairs about the climate, warmings in their own share."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.earth.weather import field
from horizonval.earth.weather.field import WeatherField
from horizonval.tables import thermal as states
from horizonval.tables.modes import LATITUDE_DEG
from horizonval.tables.thermal import ASIDE_DEG, WEATHERS, lengths_of_air

LEVELS_M = np.array([0.0, 5e3, 12e3, 25e3, 35e3, 45e3, 60e3])


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 45.0])
def test_days_of_a_month_have_the_climate_for_their_mean(latitude_deg: float) -> None:
    """October has no warmings: to the rounding, in temperature, at every height."""
    days = [states.air_of_state(latitude_deg, 10.0, k, LEVELS_M).temperature_k[0] for k in range(states.WEATHERS)]
    climate = states.calm_air(latitude_deg, 10.0, LEVELS_M).temperature_k[0]
    np.testing.assert_allclose(np.mean(days, axis=0), climate, atol=1e-9)
    assert np.std(days, axis=0).min() > 0.5  # K


def test_the_opposite_of_a_day_keeps_its_warming_and_turns_the_rest() -> None:
    height = np.array([5e3, 33e3])
    place = np.array([75.0]), np.array([20.0])
    day, other = (WeatherField(3, 1.5, 40.0, opposite).at(*place, height) for opposite in (False, True))
    still = field.warmer_k(*WeatherField(3, 1.5, 40.0).warming(), *place, height)
    np.testing.assert_allclose(0.5 * (day.temperature_k + other.temperature_k), still, atol=1e-9)
    np.testing.assert_allclose(day.sea_level_pa, -other.sea_level_pa)


@pytest.mark.parametrize(("month", "fewest", "most"), [(1.0, 1, 2), (10.0, 0, 0), (7.0, 0, 1)])
def test_warmings_have_their_share_of_the_days(month: float, fewest: int, most: int) -> None:
    """One winter day in ten in the north is one or two of twelve; three of a thousand in the south none or one."""
    warm = sum(states._warming_k(month, k) > 0.0 for k in range(states.WEATHERS))
    assert fewest <= warm <= most


@pytest.mark.parametrize(
    "latitude_deg", [0.0, pytest.param(-70.0, marks=pytest.mark.slow), pytest.param(40.0, marks=pytest.mark.slow)]
)
def test_states_have_cirrus_where_their_cover_has_a_layer(latitude_deg: float) -> None:
    """And over a year's states about as often as its kinds are seen: 36 draws of a third to two thirds, to 0.08."""
    drawn = [(float(month), k) for month in range(1, 13, 2) for k in range(states.COVERS)]
    found = [states.has_cirrus(latitude_deg, *state) for state in drawn]
    assert found == [bool(states.cover_of(latitude_deg, *state).layers) for state in drawn]
    expected = np.mean([states.cirrus_chance(latitude_deg, month) for month, _ in drawn])
    assert abs(np.mean(found) - expected) < 0.2


def test_states_aside_stand_fifteen_degrees_along_the_parallel() -> None:
    """The chord of two places of one latitude; towards the poles a turn of 86 deg is the most."""
    latitude = np.radians([0.0, 40.0, -60.0, 80.0, 90.0])
    turn = states.aside_rad(latitude)
    np.testing.assert_allclose((turn * np.cos(latitude))[:4], np.radians(15.0), rtol=1e-12)
    assert np.degrees(turn.max()) == pytest.approx(86.4, abs=0.1)
    at, aside = (states.air_of_state(40.0, 1.0, 2, LEVELS_M, aside=there).temperature_k for there in (False, True))
    assert np.abs(at - aside).max() > 0.5  # K


MONTHS = 60
MERIDIAN_RAD, PARALLEL_RAD = 0.25, 0.55


def test_lengths_are_found_again() -> None:
    """720 states: a correlation of 0.9 is right to 0.007 and its length to 4 %, one of 0.8 to 3 %; three of these."""
    rng = np.random.default_rng(9)
    latitude = np.radians(LATITUDE_DEG)
    apart = 2.0 * np.sin(0.5 * np.abs(latitude[:, None] - latitude[None]))
    covariance = np.exp(-0.5 * (apart / MERIDIAN_RAD) ** 2)
    draws = rng.multivariate_normal(np.zeros(len(latitude)), covariance, (2, MONTHS, WEATHERS), method="eigh")
    turn = np.minimum(
        np.radians(ASIDE_DEG) / np.maximum(np.cos(latitude), 1e-9), np.radians(ASIDE_DEG / np.cos(np.radians(80.0)))
    )
    chord = 2.0 * np.cos(latitude) * np.sin(0.5 * turn)
    r = np.exp(-0.5 * (chord / PARALLEL_RAD) ** 2)
    at, aside = draws[0], r * draws[0] + np.sqrt(1.0 - r**2) * draws[1]
    same = np.full((MONTHS, 1, len(latitude)), 7.0)
    coefficients = np.moveaxis(np.concatenate([at, same, aside, same], axis=1), 2, 0)[..., None]
    found = lengths_of_air(coefficients)
    assert found.shape == (len(latitude), 1, 2)
    np.testing.assert_allclose(found[:, 0, 0], MERIDIAN_RAD, rtol=0.1)
    np.testing.assert_allclose(found[1:-1, 0, 1], PARALLEL_RAD, rtol=0.12)
    np.testing.assert_array_equal(found[[0, -1], 0, 1], found[[0, -1], 0, 0])
