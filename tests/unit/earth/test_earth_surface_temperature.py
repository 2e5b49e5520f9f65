"""Zonal temperatures against published means over the globe."""

import numpy as np
import pytest
from earth_forms import is_land

from horizonval.earth.surface import surface_temperature as st
from horizonval.earth.surface.ground_map import height_m

LATITUDE = np.arange(-89.5, 90.0)
LONGITUDE = np.arange(-179.5, 180.0)
# NOAA's land has no ice shelves
SHELF = (LATITUDE[:, None] < -74.0) & (height_m(LATITUDE[:, None], LONGITUDE) < 100.0)
LAND = (is_land(LATITUDE[:, None], LONGITUDE) & ~SHELF).mean(axis=1)
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
    assert 13.0 < swing.max() <= 14.0
    assert swing[[0, -1]].max() < 1.0


# Monthly mean air temperatures [C], January first: READER (Turner et al. 2004), Plateau Station 1965 to 1969.
SOUTH_POLE = (-28.2, -40.9, -54.0, -57.3, -57.9, -58.4, -60.0, -59.7, -59.4, -51.1, -38.3, -27.5)
VOSTOK = (-32.0, -44.3, -57.9, -64.7, -65.6, -65.2, -66.9, -67.6, -66.0, -57.1, -43.3, -32.1)
PLATEAU = (-34.3, -44.3, -57.3, -66.8, -66.9, -69.3, -68.2, -71.3, -65.2, -60.2, -44.7, -32.2)
MCMURDO = (-2.9, -9.5, -18.2, -20.7, -21.7, -23.0, -25.7, -26.1, -24.6, -18.9, -9.7, -3.4)


@pytest.mark.parametrize(
    ("latitude", "height", "station", "worst"),
    [(-90.0, 2835.0, SOUTH_POLE, 3.0), (-78.46, 3488.0, VOSTOK, 3.5), (-77.85, 24.0, MCMURDO, 3.0),
     (-79.25, 3625.0, PLATEAU, 5.0)],
    ids=["Amundsen-Scott", "Vostok", "McMurdo", "Plateau"],
)  # fmt: skip
def test_antarctica_is_as_cold_as_its_stations(latitude, height, station, worst):
    """The first three are among those that the fit was made of; Plateau Station, the coldest, is not."""
    found = []
    for month in MONTHS:
        sea_level, lapse = st.ice_sheet(latitude, month)
        found.append(float(sea_level - lapse * height) - 273.15)
    assert np.abs(np.array(found) - station).max() < worst
    assert np.abs(np.mean(np.array(found) - station)) < 3.0


def test_greenland_is_as_cold_as_its_summit():
    """Monthly means of Summit, 3216 m: K. Steffen and J. Box (2001), 2 K; Nuuk at the coast, -8 C in January."""
    for month, mean in ((1.0, -41.0), (7.0, -11.5), (10.0, -31.0)):
        sea_level, lapse = st.ice_sheet(72.58, month)
        assert float(sea_level - lapse * 3216.0) - 273.15 == pytest.approx(mean, abs=2.0)
    assert float(st.ice_sheet(64.2, 1.0)[0]) - 273.15 == pytest.approx(-8.0, abs=3.0)


def test_sea_ice_is_as_cold_as_published():
    """Rigor, Colony and Martin (2000), Arctic Ocean north of 85 deg: -32 C in winter, 0 in July; 2 K."""
    assert float(st.sea_ice_k(88.0, 2.0)) - 273.15 == pytest.approx(-32.0, abs=2.0)
    assert float(st.sea_ice_k(88.0, 7.0)) - 273.15 == pytest.approx(0.0, abs=1.0)
    assert st.sea_ice_k(LATITUDE, 6.6).max() <= 273.15
    assert (st.sea_ice_k([-60.0, -66.0, -72.0], 9.0) > 248.0).all()
