from datetime import UTC, datetime
from typing import Any

import earth_forms
import numpy as np
import pytest

from horizonval.earth.atmosphere import climate
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.atmosphere.climate import blended, climate_weights, month_of
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, profile
from horizonval.earth.gases import afgl
from horizonval.earth.optical import optical_model
from horizonval.spec.scene import SceneSpec

DOBSON_PER_M2 = 2.6867e20
CLIMATES = ("tropical", "midlatitude_summer", "midlatitude_winter", "subarctic_summer", "subarctic_winter")


def ozone_du(state: AtmosphereProfile) -> float:
    fine = state.at(np.arange(0.0, 100_001.0, 100.0))
    return float(np.trapezoid(fine.number_density_o3, fine.altitude_m) / DOBSON_PER_M2)


@pytest.mark.parametrize(
    ("latitude", "month", "name", "dobson"),
    # Columns of the AFGL climates, Dobson units.
    [
        (0.0, 3.0, "tropical", 282),
        (-15.0, 9.0, "tropical", 282),
        (45.0, 7.0, "midlatitude_summer", 334),
        (45.0, 1.0, "midlatitude_winter", 378),
        (-45.0, 1.0, "midlatitude_summer", 334),
        (60.0, 7.0, "subarctic_summer", 348),
        (90.0, 1.0, "subarctic_winter", 376),
        (-75.0, 7.0, "subarctic_winter", 376),
    ],
)
def test_climates_at_their_own_place_and_season(latitude: float, month: float, name: str, dobson: float) -> None:
    assert climate_weights(latitude, month) == {name: pytest.approx(1.0)}
    state, own = blended(climate_weights(latitude, month)), profile(name)
    for key in ("temperature_k", "pressure_pa", "number_density_air", "number_density_o3", "number_density_h2o"):
        np.testing.assert_allclose(getattr(state, key), getattr(own, key), rtol=1e-6)
    assert ozone_du(state) == pytest.approx(dobson, abs=1.5)


def test_weights_are_weights_and_smooth() -> None:
    for month in np.linspace(0.5, 12.5, 25):
        before: dict[str, float] = {}
        for latitude in np.arange(-90.0, 90.01, 0.5):
            weights = climate_weights(float(latitude), float(month))
            assert sum(weights.values()) == pytest.approx(1.0)
            assert min(weights.values()) > 0
            if before:
                # Smoothsteps of 30 and 15 deg: slopes of at most 1.5 / 15 deg.
                assert max(abs(weights.get(c, 0) - before.get(c, 0)) for c in CLIMATES) <= 0.5 * 1.5 / 15 + 1e-12
            before = weights


def test_the_south_has_the_same_seasons_half_a_year_later() -> None:
    for latitude in (20.0, 38.0, 52.0, 80.0):
        for month in (1.0, 3.5, 6.0, 9.0, 12.2):
            south, north = climate_weights(-latitude, month), climate_weights(latitude, month + 6)
            assert south == {name: pytest.approx(weight, abs=1e-12) for name, weight in north.items()}


def test_a_blend_lies_between_its_climates() -> None:
    weights = climate_weights(38.0, 4.0)
    state, parts = blended(weights), [profile(name) for name in weights]
    assert len(parts) == 3
    for key in ("temperature_k", "number_density_air", "number_density_o3"):
        values = np.array([getattr(p, key) for p in parts])
        assert (getattr(state, key) >= values.min(axis=0) * (1 - 1e-12)).all()
        assert (getattr(state, key) <= values.max(axis=0) * (1 + 1e-12)).all()
    assert state.pressure_pa[0] == pytest.approx(1015e2, rel=0.01)
    np.testing.assert_allclose(state.pressure_pa, state.number_density_air * 1.380649e-23 * state.temperature_k)


def test_month_of_an_epoch() -> None:
    assert month_of(datetime(2026, 7, 16, 12, tzinfo=UTC)) == pytest.approx(7.0)
    assert month_of(datetime(2026, 1, 1, tzinfo=UTC)) == pytest.approx(0.5)
    year_end = climate_weights(50.0, month_of(datetime(2026, 12, 31, 23, 59, tzinfo=UTC)))
    new_year = climate_weights(50.0, month_of(datetime(2027, 1, 1, tzinfo=UTC)))
    assert year_end == {name: pytest.approx(weight, abs=1e-3) for name, weight in new_year.items()}


def scene(**tables: Any) -> SceneSpec:
    platform = {"altitude_km": 500, "latitude_deg": -45.0, "epoch_utc": "2026-01-16T12:00:00Z"}
    return earth_forms.scene(platform=platform, **tables)


def test_the_platform_decides_or_the_keys_do() -> None:
    atmosphere = {"profile": climate.BY_LATITUDE_MONTH}
    assert air_of(scene(atmosphere=atmosphere)).climates == {"midlatitude_summer": pytest.approx(1.0)}
    winter = scene(atmosphere={**atmosphere, "month": 7})
    assert air_of(winter).climates == {"midlatitude_winter": pytest.approx(1.0)}
    north = scene(atmosphere={**atmosphere, "latitude_deg": 60.0})
    assert air_of(north).climates == {"subarctic_winter": pytest.approx(1.0)}


def test_a_column_of_any_place_can_be_asked_for() -> None:
    atmosphere = {"profile": climate.BY_LATITUDE_MONTH}
    here = scene(atmosphere=atmosphere)
    there = air_of(here, place_deg=(-60.0, 120.0)).state
    moved = air_of(scene(atmosphere=atmosphere | {"latitude_deg": -60.0})).state
    np.testing.assert_array_equal(there.temperature_k, moved.temperature_k)
    assert np.abs(there.temperature_k - air_of(here).state.temperature_k).max() > 5.0
    fixed = scene(atmosphere=atmosphere | {"latitude_deg": 10.0})
    np.testing.assert_array_equal(
        air_of(fixed, place_deg=(-60.0, 120.0)).state.temperature_k, air_of(fixed).state.temperature_k
    )


def test_thermal_states_are_blended() -> None:
    camera = earth_forms.camera(earth_forms.thermal(14.0, 16.3))

    def column(**atmosphere: Any) -> EmittingBand:
        (emitting,) = optical_model(scene(atmosphere={"aerosol": "none", **atmosphere}), camera).thermal
        return emitting

    here = {"profile": climate.BY_LATITUDE_MONTH, "latitude_deg": 45.0}
    own, winter = column(profile="midlatitude_summer"), column(profile="midlatitude_winter")
    placed, middle = column(**here, month=7), column(**here, month=4)
    np.testing.assert_allclose(placed.ln_extinction, own.ln_extinction, atol=1e-9)
    np.testing.assert_allclose(placed.temperature_k, own.temperature_k, atol=1e-9)
    np.testing.assert_allclose(middle.temperature_k, (own.temperature_k + winter.temperature_k) / 2, atol=1e-9)
    # Absorption is that of the blended state: away from the mean of the two, and not far.
    off = np.abs(middle.ln_extinction - (own.ln_extinction + winter.ln_extinction) / 2)
    assert 1e-3 < np.median(off) < 0.1
    assert set(afgl.names()) >= set(CLIMATES)


def test_profile_and_table_of_temperature_belong_together() -> None:
    # Thermal bands emit with the temperatures of the report's own levels, solar bands see those of every kilometre:
    # levels at 27.5, 32.5 km and so on lie between.
    z = np.arange(0.0, 100_001.0, 100.0)
    for name in CLIMATES:
        difference = afgl.state(name, z).temperature_k - profile(name).at(z).temperature_k
        assert np.abs(difference).max() <= 1.001
        assert np.abs(difference[z <= 50e3]).max() < 0.61
