"""The ground map, sea ice and the albedo of kinds of ground, against known places and published figures."""

from __future__ import annotations

import numpy as np
import pytest
from earth_forms import is_land

from horizonval.earth import tables
from horizonval.earth.surface import ground_map
from horizonval.earth.surface.ground_map import DRY, spectrum

LATITUDE = np.arange(-89.875, 90.0, 0.25)
LONGITUDE = np.arange(-179.875, 180.0, 0.25)
CELL_KM2 = np.radians(0.25) ** 2 * 6371.0**2 * np.cos(np.radians(LATITUDE))[:, None]


@pytest.mark.parametrize(
    ("latitude", "longitude", "kind"),
    [
        (0.0, -30.0, "sea"),
        (-75.0, 90.0, "ice sheet"),
        (-80.0, -175.0, "ice sheet"),
        (72.0, -40.0, "ice sheet"),
        (-3.0, -65.0, "tropical forest"),
        (23.0, 10.0, "desert"),
        (40.5, 92.0, "desert"),
        (-26.0, 128.0, "shrubland"),
        (72.0, 105.0, "tundra"),
        (41.0, -97.0, "cropland"),
        (47.0, 105.0, "grassland"),
    ],
)
def test_kinds_where_they_are_known(latitude: float, longitude: float, kind: str) -> None:
    for turned in (longitude, longitude + 360.0):
        kinds, weights = ground_map.kinds_around(latitude, turned)
        assert float(np.sum(weights * (kinds == ground_map.KINDS.index(kind)))) > 0.5
        assert weights.sum() == pytest.approx(1.0)


def test_a_strait_and_an_island_finer_than_half_a_degree() -> None:
    """The Strait of Messina is 3 to 10 km wide, Malta 27 km long."""
    assert is_land([38.1, 38.15, 67.0, 67.0], [15.4, 15.9, 180.0, -180.0]).all()
    assert not is_land(38.0, 15.59)
    assert is_land(35.88, 14.45)
    assert not is_land(42.0, 50.5), "the Caspian Sea"


@pytest.mark.parametrize(
    ("latitude", "longitude", "height"),
    [(-78.46, 106.87, 3488), (-90.0, 0.0, 2835), (-75.1, 123.3, 3233), (72.58, -38.46, 3216), (33.0, 88.0, 5000)],
)
def test_heights_of_stations(latitude: float, longitude: float, height: float) -> None:
    """Vostok, Amundsen-Scott, Dome C, Summit, Tibet: 200 m."""
    assert float(ground_map.height_m(latitude, longitude)) == pytest.approx(height, abs=200.0)


# Published extents, million km2, January first: the area where the concentration is above 0.15.
EXTENT_NORTH = (13.91, 14.73, 14.90, 14.21, 12.79, 11.05, 8.48, 6.13, 5.22, 7.14, 9.96, 12.23)
EXTENT_SOUTH = (5.26, 3.21, 4.27, 7.20, 10.64, 13.77, 16.24, 18.00, 18.69, 18.36, 16.14, 10.45)


def _extent(month: float, north: bool) -> float:
    ice = ground_map.frozen(LATITUDE[:, None], LONGITUDE, month) > 0.15
    here = (LATITUDE > 0.0) == north
    sea = ~is_land(LATITUDE[:, None], LONGITUDE)
    return float((CELL_KM2 * (ice & sea))[here].sum()) * 1e-6


@pytest.mark.parametrize("month", [1, 3, 6, 9, 12])
def test_sea_ice_has_the_published_extent(month: int) -> None:
    """2 %, or 0.1 million km2: whether the edges' advance was solved for what it says."""
    assert _extent(month, True) == pytest.approx(EXTENT_NORTH[month - 1], rel=0.02, abs=0.1)
    assert _extent(month, False) == pytest.approx(EXTENT_SOUTH[month - 1], rel=0.02, abs=0.1)


@pytest.mark.parametrize(
    ("latitude", "longitude", "month", "frozen"),
    [
        (90.0, 0.0, 6.0, True),
        (90.0, 0.0, 9.0, True),
        (75.0, 180.0, 3.0, True),
        (72.0, 20.0, 3.0, False),
        (58.0, -30.0, 3.0, False),
        (78.0, 40.0, 9.0, False),
        (-66.0, -40.0, 9.0, True),
        (-60.0, 0.0, 9.0, True),
        (-60.0, 0.0, 2.0, False),
        (-50.0, 100.0, 9.0, False),
        (60.0, -85.0, 2.0, True),
    ],
)
def test_sea_ice_where_it_is_known(latitude: float, longitude: float, month: float, frozen: bool) -> None:
    share = float(ground_map.frozen(latitude, longitude, month))
    assert share > 0.5 if frozen else share == 0.0
    assert float(ground_map.frozen(latitude, longitude + 360.0, month)) == pytest.approx(share, abs=1e-9)


# Snow-free broadband albedo of IGBP classes, white sky, MODIS: F. Gao et al., J. Geophys. Res. 110, D01104 (2005), and
# X. Zhang et al., ibid. 115, D17103 (2010), to 0.02 between studies; firn: Grenfell, Warren and Mullen (1994).
BROADBAND = {
    "boreal forest": 0.10,
    "tropical forest": 0.13,
    "temperate forest": 0.14,
    "woodland": 0.13,
    "savannah": 0.16,
    "grassland": 0.19,
    "cropland": 0.17,
    "shrubland": 0.22,
    "tundra": 0.17,
    "desert": 0.33,
    "wetland": 0.13,
    "ice sheet": 0.82,
}


@pytest.mark.parametrize("kind", BROADBAND)
def test_kinds_are_as_bright_as_published(kind: str) -> None:
    """0.03: what published means of one class differ by."""
    wavelength, irradiance = (np.asarray(v) for v in tables.csv("solar_spectrum.csv")[:2])
    um = wavelength / 1000.0 if wavelength.max() > 100.0 else wavelength
    used = (um > 0.3) & (um < 2.5)
    mixture = ground_map.mixtures()[ground_map.KINDS.index(kind)]
    albedo = sum(mixture[i] * spectrum(name, um[used]) for i, name in enumerate(("vegetation", "soil", "sand", "firn")))
    widths = np.gradient(um[used])
    mean = np.average(albedo, weights=irradiance[used] * widths)
    assert mean == pytest.approx(BROADBAND[kind], abs=0.03)


def test_shares_make_up_the_ground() -> None:
    """Materials and shade are all of it; snow lies on land in winter, on forests less, and sea ice on no land."""
    rng = np.random.default_rng(np.random.SeedSequence(11))
    latitude, longitude = np.degrees(np.arcsin(rng.uniform(-1, 1, 20000))), rng.uniform(-180, 180, 20000)
    for month in (1.0, 7.0):
        cover = ground_map.ground_cover(latitude, longitude, month)
        total = sum(cover.shares.values())
        assert total[~cover.land] == pytest.approx(1.0)
        assert total.max() < 1.0 + 1e-9
        assert total[cover.land].min() > 0.4
        assert set(cover.shares) == {*DRY, "water"}
    winter, summer = (ground_map.ground_cover([62.0, 62.0], [105.0, 30.5], m).shares["snow"] for m in (1.0, 7.0))
    assert (summer == 0.0).all()
    assert (winter > 0.2).all()
    prairie = ground_map.ground_cover(52.0, -106.0, 1.0).shares["snow"]
    taiga = ground_map.ground_cover(60.0, 45.0, 1.0).shares["snow"]
    assert float(prairie) > 0.8 > 0.5 > float(taiga)
