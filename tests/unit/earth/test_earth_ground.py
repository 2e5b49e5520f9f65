"""Temperature and emissivity of the ground against closed forms and published means."""

import math
from typing import Any

import numpy as np
import pytest
from earth_forms import is_land

from horizonval.core.errors import UserError
from horizonval.earth.gases import afgl
from horizonval.earth.surface import surface_temperature
from horizonval.earth.surface import surface_temperature as st
from horizonval.earth.surface.emissivity import emissivity, water_emissivity, water_index
from horizonval.earth.surface.ground_emission import (
    KINDS,
    EmittingPlaces,
    GroundEmission,
    emitting_ground,
    ground_emissivity,
)
from horizonval.earth.surface.ground_emission import ground_k as at_places
from horizonval.earth.surface.ground_map import height_m, mean_height_m
from horizonval.spec.scene import SceneSpec


def scene(**tables: Any) -> SceneSpec:
    platform = {"altitude_km": 500, "epoch_utc": "2026-01-16T12:00:00Z"}
    return SceneSpec.model_validate({"camera": {"file": "c"}, "platform": platform, **tables})


SIN = np.linspace(-1, 1, 41)


def ground_k(ground: GroundEmission, kind: str, sine: Any, hour: Any, land: bool = True, sheet: float = 0.0) -> Any:
    """At sea level."""
    sine, hour = np.broadcast_arrays(np.asarray(sine, dtype=float), np.asarray(hour, dtype=float))
    zero = 0.0 * sine
    return at_places(ground, kind, EmittingPlaces(sine, hour, {}, (zero + land) > 0.0, zero, zero + sheet))


def test_a_uniform_ground_is_as_warm_as_the_lowest_air() -> None:
    ground = emitting_ground(scene(surface={"emissivity": 0.9}), 288.0)
    for kind in KINDS:
        np.testing.assert_array_equal(ground_k(ground, kind, SIN, 1.0), 288.0)
        np.testing.assert_array_equal(ground_emissivity(ground, kind, [8.0, 11.0]), 0.9)
    given = emitting_ground(scene(surface={"temperature_k": 300.0}), 288.0)
    assert float(ground_k(given, "land", 0.3, 0.0)) == 300.0


def test_a_uniform_ground_under_varying_air() -> None:
    ground = emitting_ground(scene(atmosphere={"profile": "by_latitude_month"}), 288.0)
    assert ground.kind == "uniform"
    for sine, climate in ((0.0, "tropical"), (0.71, "midlatitude_winter"), (-0.71, "midlatitude_summer")):
        expected = float(afgl.state(climate, np.zeros(1)).temperature_k[0])
        # The middle of January, half a day off: 1e-4 of 30 K.
        assert float(ground_k(ground, "land", sine, 0.0)) == pytest.approx(expected, abs=0.02)
    fixed = emitting_ground(scene(atmosphere={"profile": "by_latitude_month", "latitude_deg": 10.0}), 288.0)
    assert set(fixed.land_k) == {288.0}


def test_the_earth_has_its_climate() -> None:
    ground = emitting_ground(scene(surface={"kind": "earth"}), 288.0)
    latitude = np.degrees(np.arcsin(SIN))
    for kind, table in (("water", surface_temperature.sea_k), ("snow", surface_temperature.sea_ice_k)):
        for hour in (0.0, 2.0):
            # The table on steps of 0.02 of the sine; near the poles 8 deg of latitude lie in one.
            np.testing.assert_allclose(ground_k(ground, kind, SIN, hour, land=False), table(latitude, 1.02), atol=1.0)
    afternoon, before_dawn = (ground_k(ground, "land", SIN, np.radians(h)) for h in (22.5, -157.5))
    mean = surface_temperature.land_k(latitude, 1.02) + 4.5e-3 * mean_height_m(latitude)
    np.testing.assert_allclose((afternoon + before_dawn) / 2, mean, atol=1.5)
    at_20_north = int(np.argmin(np.abs(latitude - 20)))
    assert (afternoon - before_dawn)[at_20_north] == pytest.approx(26.0, abs=1.0)
    assert afternoon[at_20_north] == pytest.approx(
        ground_k(ground, "land", SIN, np.linspace(-3, 3, 301)[:, None])[:, at_20_north].max(), abs=1e-2
    )


def test_one_temperature_in_place_of_everything() -> None:
    ground = emitting_ground(scene(surface={"kind": "earth", "temperature_k": 280.0}), 288.0)
    assert ground.kind == "earth"
    for kind in KINDS:
        np.testing.assert_array_equal(ground_k(ground, kind, SIN, np.linspace(-3, 3, 41)), 280.0)
    # Its emissivities are still those of land, snow and sea.
    assert len({float(ground_emissivity(ground, kind, 8.6)) for kind in KINDS}) == 4
    assert float(ground_emissivity(ground, "water", 11.0, 0.1)) < 0.6


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


def test_a_year_closes_and_days_swing() -> None:
    np.testing.assert_allclose(st.land_k(LATITUDE, 0.5), st.land_k(LATITUDE, 12.5), atol=1e-9)
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


THERMAL_UM = np.linspace(7.2, 20.0, 400)


def absorbing_reflectance(n: float, k: float, theta: float) -> float:
    """Real-valued Fresnel reflectance of an absorbing medium (Siegel and Howell, Thermal Radiation Heat Transfer)."""
    s = math.sin(theta)
    root = math.sqrt((n * n - k * k - s * s) ** 2 + 4 * n * n * k * k)
    a, b2 = math.sqrt((root + n * n - k * k - s * s) / 2), (root - (n * n - k * k - s * s)) / 2
    c = math.cos(theta)
    across = ((a - c) ** 2 + b2) / ((a + c) ** 2 + b2)
    t = s * math.tan(theta)
    along = across * ((a - t) ** 2 + b2) / ((a + t) ** 2 + b2)
    return (across + along) / 2


@pytest.mark.parametrize("wavelength", [8.0, 10.75, 12.0, 15.2, 19.9])
@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 53.0, 75.0, 89.0])
def test_water_obeys_fresnel(wavelength: float, zenith_deg: float) -> None:
    index = complex(water_index(wavelength))
    expected = 1 - absorbing_reflectance(index.real, index.imag, math.radians(zenith_deg))
    found = float(water_emissivity(wavelength, math.cos(math.radians(zenith_deg))))
    assert found == pytest.approx(expected, abs=1e-12)


def test_water_straight_down() -> None:
    # Emissivity of a calm sea in the splitting channels, 0.992 at 11 um and 0.988 at 12 um (K. Masuda et al., Remote
    # Sens. Environ. 24, 313 (1988)); sea water there, pure water here: 0.002.
    assert float(water_emissivity(11.0, 1.0)) == pytest.approx(0.992, abs=0.002)
    assert float(water_emissivity(12.0, 1.0)) == pytest.approx(0.988, abs=0.002)


def test_kinds_lie_in_their_measured_ranges() -> None:
    window = (THERMAL_UM >= 10.5) & (THERMAL_UM <= 12.5)
    land, snow = emissivity("land", THERMAL_UM), emissivity("snow", THERMAL_UM)
    # Land surfaces over 10.5 to 12.5 um: 0.96 to 0.985, and lower by several hundredths in the quartz band.
    assert 0.96 < land[window].min() <= land[window].max() < 0.985
    assert 0.92 < float(emissivity("land", 8.6)) < float(emissivity("land", 11.0)) - 0.02
    assert 0.984 < snow.min() <= snow.max() < 0.996
    np.testing.assert_array_equal(emissivity("foam", THERMAL_UM), water_emissivity(THERMAL_UM, 1.0))


def test_unknown_kind() -> None:
    with pytest.raises(UserError, match="unknown kind of ground 'ice'; expected one of land, desert, snow, water"):
        emissivity("ice", 11.0)
