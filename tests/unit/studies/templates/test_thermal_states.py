"""Days of the ensemble of thermal tables: pairs about the climate, warmings in their own share."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.earth.weather import warming
from horizonval.earth.weather.field import WeatherField
from horizonval.studies.templates import thermal_states as states

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
    still = warming.warmer_k(*WeatherField(3, 1.5, 40.0).warming(), *place, height)
    np.testing.assert_allclose(0.5 * (day.temperature_k + other.temperature_k), still, atol=1e-9)
    np.testing.assert_allclose(day.sea_level_pa, -other.sea_level_pa)


@pytest.mark.parametrize(("month", "fewest", "most"), [(1.0, 1, 2), (10.0, 0, 0), (7.0, 0, 1)])
def test_warmings_have_their_share_of_the_days(month: float, fewest: int, most: int) -> None:
    """One winter day in ten in the north is one or two of twelve; three of a thousand in the south none or one."""
    warm = sum(states._warming_k(month, k) > 0.0 for k in range(states.WEATHERS))
    assert fewest <= warm <= most
