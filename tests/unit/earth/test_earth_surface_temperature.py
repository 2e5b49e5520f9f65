"""Zonal temperatures against published means over the globe."""

import numpy as np
import pytest

from horizonval.earth.surface import surface_temperature as st
from horizonval.earth.surface.land import is_land

LATITUDE = np.arange(-89.5, 90.0)
LAND = is_land(LATITUDE[:, None], np.arange(-179.5, 180.0)[None, :]).mean(axis=1)
AREA = np.cos(np.radians(LATITUDE))
MONTHS = range(1, 13)

# Means of the 20th century over all land [C], January first: NOAA National Centers for Environmental Information,
# monthly global climate reports.
NOAA_LAND = (2.8, 3.2, 5.0, 8.1, 11.1, 13.3, 14.3, 13.8, 12.0, 9.3, 5.9, 3.7)


def test_land_is_as_warm_as_all_land() -> None:
    found = [np.average(st.land_k(LATITUDE, m) - 273.15, weights=AREA * LAND) for m in MONTHS]
    warmer = np.array(found) - NOAA_LAND
    # Land has warmed by 1.3 K since the middle of that century; the rest is what round numbers leave.
    assert 0.8 < warmer.min() <= warmer.max() < 2.3
    assert np.argmax(found) == 6


def test_sea_is_as_warm_as_the_sea() -> None:
    open_sea = np.abs(LATITUDE) < 60
    weights = (AREA * (1 - LAND))[open_sea]
    found = [np.average(st.sea_k(LATITUDE, m)[open_sea] - 273.15, weights=weights) for m in MONTHS]
    # ERA5, 60 S to 60 N, 1991 to 2020: 20.3 C, between 20.0 and 20.6 through the year (Copernicus).
    assert np.mean(found) == pytest.approx(20.3, abs=0.5)
    assert np.ptp(found) < 0.7


def test_seasons() -> None:
    for month in np.linspace(1, 12, 23):
        sea, snow = st.sea_k(LATITUDE, month), st.snow_k(LATITUDE, month)
        assert sea.min() >= 271.35
        assert sea.max() < 304.0
        assert snow.max() <= 273.15
        assert (snow <= st.land_k(LATITUDE, month)).all()
    north, south = LATITUDE > 10, LATITUDE < -10
    assert (st.land_k(LATITUDE, 7.0) > st.land_k(LATITUDE, 1.0))[north].all()
    assert (st.land_k(LATITUDE, 7.0) < st.land_k(LATITUDE, 1.0))[south].all()
    # Land swings more than the sea wherever there is much of it: 20 to 70 deg north.
    belt = (LATITUDE > 20) & (LATITUDE < 70)
    assert (np.ptp([st.land_k(LATITUDE, m)[belt] - st.sea_k(LATITUDE, m)[belt] for m in (1, 7)], axis=0) > 4).all()


def test_a_year_closes() -> None:
    np.testing.assert_allclose(st.land_k(LATITUDE, 0.5), st.land_k(LATITUDE, 12.5), atol=1e-9)


def test_daily_swing() -> None:
    swing = st.land_daily_swing_k(LATITUDE)
    assert swing.min() >= 0.0
    assert 14.0 < swing.max() <= 15.0
    assert swing[[0, -1]].max() < 1.0
