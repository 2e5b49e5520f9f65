"""Weather: hydrostatic balance, variances, spectra, poles, seeds, real states."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from make_weather_modes import made

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere import air, climate
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.tables import npz
from horizonval.earth.weather import field, real_states, zonal_climate
from horizonval.earth.weather.field import WeatherField
from horizonval.earth.weather.hydrostatic import pressure_pa, saturated_share
from horizonval.earth.weather.zonal_climate import with_cold_poles
from horizonval.spec.scene import SceneSpec

Z_M = np.linspace(0.0, 1e5, 201)
LATITUDE = np.array([-90.0, -62.0, -35.0, 0.0, 48.0, 75.0, 90.0])
LONGITUDE = np.array([10.0, -170.0, 60.0, 0.0, 179.0, -30.0, 33.0])


def scene(**tables: Any) -> SceneSpec:
    platform = {"altitude_km": 500, "latitude_deg": 60.0, "epoch_utc": datetime(2026, 1, 20, 12, tzinfo=UTC)}
    return SceneSpec.model_validate({"camera": {"file": "c"}, "platform": platform, **tables})


def test_drawn_columns_are_in_hydrostatic_balance() -> None:
    """Weight of the column above each height, by Simpson's rule over its own density and WGS84's gravity: 0.02 %.

    Gravity by Somigliana's formula and the free-air gradient; the code has List's.
    """
    state = air.weather_columns(WeatherField(11, 1.5), LATITUDE, LONGITUDE, Z_M)
    moist = 28.9644e-3 - state.vmr["h2o"] * (28.9644e-3 - 18.0153e-3)
    density = state.pressure_pa * moist / (8.314462618 * state.temperature_k)
    s2 = np.sin(np.radians(LATITUDE))[:, None] ** 2
    normal = 9.7803253359 * (1.0 + 0.00193185265241 * s2) / np.sqrt(1.0 - 0.00669437999013 * s2)
    up = Z_M / 6378137.0
    free_air = 1.0 - 2.0 * (1.00335281 + 0.00344979 - 2.0 * 0.00335281 * s2) * up + 3.0 * up**2
    force = density * normal * free_air
    # two steps at a time, in the logarithm: what lies between falls exponentially
    low, middle, high = force[:, :-2:2], force[:, 1:-1:2], force[:, 2::2]
    weight = (low + 4.0 * middle + high) / 6.0 * 1000.0
    above = np.cumsum(weight[:, ::-1], axis=1)[:, ::-1]
    expected = state.pressure_pa[:, :-2:2] - state.pressure_pa[:, -1:]
    deep = Z_M[:-2:2] < 80e3
    np.testing.assert_allclose(above[:, deep], expected[:, deep], rtol=4e-4)


def test_pressure_of_an_isothermal_column_is_the_closed_form() -> None:
    z = np.array([0.0, 10e3, 50e3])
    found = pressure_pa(np.array([45.0]), z, np.full((1, 3), 250.0), 0.0, 1e5)[0]
    radius, g = 6_370_000.0, 9.80616
    expected = 1e5 * np.exp(-28.9644e-3 * g / (8.314462618 * 250.0) * z * radius / (radius + z))
    # gravity as linear between levels 40 km apart
    np.testing.assert_allclose(found, expected, rtol=6e-4)


def test_variances_are_those_asked_for() -> None:
    """400 draws: the standard deviation within 12 % (3.4 standard errors), everywhere, poles included."""
    height = np.array([5e3, 25e3, 35e3, 60e3])
    drawn = np.array([WeatherField(s, 1.5, 0.0).at(LATITUDE, LONGITUDE, height).temperature_k for s in range(400)])
    spread, _ = field.vertical_modes().at(height)
    wanted = np.sqrt(np.einsum("cn,ck->nk", field.class_weights(LATITUDE, 1.5), spread[:, 0] ** 2))
    np.testing.assert_allclose(drawn.std(axis=0), wanted, rtol=0.12)
    np.testing.assert_allclose(drawn.mean(axis=0) / wanted, 0.0, atol=0.2)


def test_spectra_are_those_asked_for() -> None:
    """Around a parallel the zonal wave numbers have the shares of the module's text, within 4 standard errors."""
    longitude = np.arange(24) * 15.0
    latitude, height = np.full(24, 60.0), np.array([5e3, 35e3])
    power = np.zeros((13, 2))
    count = 300
    for seed in range(count):
        value = WeatherField(seed, 1.5, 0.0).at(latitude, longitude, height).temperature_k
        spectrum = np.abs(np.fft.rfft(value, axis=0) / 24) ** 2
        power += np.concatenate([spectrum[:1], 2.0 * spectrum[1:]])
    edge = field.edges(np.array([60.0]))[:, 0] ** 2
    for k, (name, z) in enumerate((("polar winter", 5e3), ("polar winter", 35e3))):
        share = field.shares(name, np.array([z]))[:, 0] * edge
        found = power[:8, k] / power[:, k].sum()
        assert power[8:, k].sum() < 1e-6 * power[:, k].sum()
        error = share / share.sum() * math.sqrt(2.0 / count) + 0.003
        assert np.all(np.abs(found - share / share.sum()) < 4.0 * error)


def test_waves_tilt_westward_with_height() -> None:
    """The crest of wave 1 at 45 km lies west of that at 25 km; turns by 0.45 rad in 7 km in every single mode."""
    one = np.ones((1, 3, 2))
    coefficients = np.zeros((1, field.WAVES, 2, 2 * field.ORDERS - 1))
    coefficients[0, 1, 0, 0] = 1.0
    longitude, height = np.arange(0.0, 360.0, 1.0), np.array([25e3, 32e3])
    share = np.ones((field.WAVES, 2))
    wave = WeatherField._waves(coefficients, share, one, np.full(360, 60.0), longitude, height)[:, :2]
    crest = longitude[np.argmax(wave, axis=0)]
    assert (crest[1] - crest[0] + 180.0) % 360.0 - 180.0 == pytest.approx(-math.degrees(0.45), abs=1.0)


@pytest.mark.parametrize("pole", [-90.0, 90.0])
def test_a_pole_has_one_column(pole: float) -> None:
    weather = WeatherField(4, 1.5, 40.0)
    state = air.weather_columns(weather, np.full(5, pole), np.array([-180.0, -20.0, 0.0, 77.0, 180.0]), Z_M)
    np.testing.assert_allclose(state.temperature_k, state.temperature_k[:1].repeat(5, axis=0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(state.vmr["o3"], state.vmr["o3"][:1].repeat(5, axis=0), rtol=1e-12)


def test_the_same_seed_draws_the_same_air() -> None:
    atmosphere = {"profile": "weather"}
    one, again = (air_of(scene(atmosphere=atmosphere)).state for _ in range(2))
    assert one.temperature_k.tobytes() == again.temperature_k.tobytes()
    named = air_of(scene(atmosphere=atmosphere, scene={"name": "other"})).state
    assert np.abs(named.temperature_k - one.temperature_k).max() > 1.0
    shared = [
        air_of(scene(atmosphere=atmosphere, scene={"name": name, "draw": "common"})).state.temperature_k
        for name in ("a", "b")
    ]
    np.testing.assert_array_equal(*shared)
    seeded = [
        air_of(scene(atmosphere=atmosphere | {"seed": 7}, scene={"name": name})).state.temperature_k
        for name in ("a", "b")
    ]
    np.testing.assert_array_equal(*seeded)


def test_the_antarctic_winter_is_cold() -> None:
    """Lower stratosphere over the Antarctic in July: below 200 K, where the blend of AFGL climates has 215."""
    state = air.weather_columns(WeatherField(1, 7.0), np.array([-85.0]), np.zeros(1), Z_M, calm=True)
    kelvin = np.interp([20e3], Z_M, state.temperature_k[0])[0]
    assert 175.0 < kelvin < 195.0
    arctic = air.weather_columns(WeatherField(1, 1.0), np.array([85.0]), np.zeros(1), Z_M, calm=True)
    assert np.interp(20e3, Z_M, arctic.temperature_k[0]) > kelvin + 8.0
    assert zonal_climate.sea_level_pa(-65.0) < zonal_climate.sea_level_pa(-30.0) - 2000.0


def _of_weather(latitude_deg: float, month: float, blend: GasState) -> FloatArray:
    return zonal_climate.temperature_k(np.array([latitude_deg]), month, blend.altitude_m, blend.temperature_k)[0]


def _of_latitude_and_month(latitude_deg: float, month: float, blend: GasState) -> FloatArray:
    return with_cold_poles(blend, np.array([latitude_deg]), month).temperature_k[0]


@pytest.mark.parametrize("low_air", [_of_weather, _of_latitude_and_month])
def test_low_polar_air_is_as_cold_as_real_states(low_air: Callable[[float, float, GasState], FloatArray]) -> None:
    """500 to 700 hPa poleward of 68 deg, where the subarctic climates are 10 to 18 K too warm; means over five or more
    days, each of which has 6 K of weather: 3 standard errors."""
    apart: dict[str, list[float]] = {}
    for name in real_states.names():
        s = real_states.real_state(name)
        if abs(s.latitude_deg) < 68.0:
            continue
        month = climate.month_of(datetime(s.date.year, s.date.month, s.date.day, tzinfo=UTC))
        winter = (4.0 <= month <= 10.5) == (s.latitude_deg < 0.0)
        if s.latitude_deg > 0.0 and not winter:
            continue
        z = s.altitude_m[(s.altitude_m > s.surface_m + 200.0) & (s.pressure_pa > 5e4) & (s.pressure_pa < 7e4)]
        own = low_air(s.latitude_deg, month, afgl.blended([climate.climate_weights(s.latitude_deg, month)], z))
        key = f"{'south' if s.latitude_deg < 0.0 else 'north'} {'winter' if winter else 'summer'}"
        apart.setdefault(key, []).append(float(np.mean(own - np.interp(z, s.altitude_m, s.temperature_k))))
    assert sorted(apart) == ["north winter", "south summer", "south winter"]
    for key, found in apart.items():
        assert len(found) >= 5
        assert abs(np.mean(found)) < 3.0 * 6.0 / math.sqrt(len(found)), (key, np.mean(found))


@pytest.mark.parametrize(("latitude", "month"), [(-90.0, 9.0), (-70.0, 1.0), (80.0, 1.0), (-62.0, 7.0)])
def test_cold_poles_leave_the_air_s_density_and_what_is_above(latitude: float, month: float) -> None:
    blend = afgl.blended([climate.climate_weights(latitude, month)], Z_M)
    cold = with_cold_poles(blend, np.array([latitude]), month)
    density = cold.pressure_pa / cold.temperature_k
    np.testing.assert_allclose(density, blend.pressure_pa / blend.temperature_k, rtol=1e-12)
    above = Z_M >= 12e3
    np.testing.assert_array_equal(cold.temperature_k[:, above], blend.temperature_k[:, above])
    np.testing.assert_array_equal(cold.vmr["h2o"][:, above], blend.vmr["h2o"][:, above])
    humidity = [state.vmr["h2o"] / saturated_share(state.pressure_pa, state.temperature_k) for state in (cold, blend)]
    np.testing.assert_allclose(*humidity, rtol=1e-12)
    if abs(latitude) > 68.0:
        assert (cold.temperature_k[:, Z_M < 8e3] < blend.temperature_k[:, Z_M < 8e3]).all()


def test_only_poles_are_cold() -> None:
    """South of 55 deg all year, and north of it by the winter's share: none in July."""
    latitude = np.array([-54.0, 0.0, 54.0, 90.0])
    blend = afgl.blended([climate.climate_weights(float(row), 7.0) for row in latitude], Z_M)
    np.testing.assert_array_equal(with_cold_poles(blend, latitude, 7.0).temperature_k, blend.temperature_k)


def test_a_warming_warms_the_winter_pole_and_cools_above() -> None:
    height = np.array([33e3, 68e3])
    quiet, warm = (WeatherField(9, 1.5, k).at(np.array([85.0, -85.0, 10.0]), np.zeros(3), height) for k in (0.0, 40.0))
    change = warm.temperature_k - quiet.temperature_k
    assert change[0, 0] == pytest.approx(40.0, abs=6.0)
    assert change[0, 1] < -10.0
    assert np.abs(change[1:]).max() < 1e-9


def test_warmings_come_as_often_as_they_are_said_to() -> None:
    """2000 northern winter days: one in ten, within 4 standard errors; none in summer or where switched off."""
    drawn = [WeatherField(s, 1.5).warming()[0] for s in range(2000)]
    share = np.mean(np.array(drawn) > 0.0)
    assert share == pytest.approx(field.NORTH_DAYS, abs=4.0 * math.sqrt(0.09 / 2000))
    assert all(25.0 <= k <= 55.0 for k in drawn if k)
    assert field.chance(6.0) == 0.0
    assert all(WeatherField(s, 1.5, 0.0).warming()[0] == 0.0 for s in range(20))


def test_air_is_not_wetter_than_saturated() -> None:
    """And ice at the ice point has 611 Pa, at -40 C 12.8 Pa (Murphy and Koop 2005, table C1)."""
    assert float(saturated_share(np.array(1e5), np.array(273.149))) * 1e5 == pytest.approx(611.1, abs=0.5)
    assert float(saturated_share(np.array(1e5), np.array(233.15))) * 1e5 == pytest.approx(12.84, abs=0.05)
    state = air.weather_columns(WeatherField(2, 1.5), LATITUDE, LONGITUDE, Z_M)
    low = Z_M <= air.SATURATED_TO_M
    limit = saturated_share(state.pressure_pa, state.temperature_k)[:, low]
    assert np.all(state.vmr["h2o"][:, low] <= limit * (1 + 1e-12))
    assert state.vmr["h2o"][3, 0] > 5e-3


def test_real_states_are_columns_of_a_scene() -> None:
    state = air_of(scene(atmosphere={"profile": "weather:ec2008-12"})).state
    source = real_states.real_state("ec2008-12")
    np.testing.assert_allclose(
        np.interp(source.altitude_m[5:60], state.altitude_m, state.temperature_k), source.temperature_k[5:60], atol=1.0
    )
    assert state.pressure_pa[0] == pytest.approx(101325.0, rel=1e-3)
    assert len(real_states.names()) == 96
    for name in real_states.names()[::7]:
        other = air.real_profile(name)
        assert np.all(np.diff(other.pressure_pa) < 0.0)
        assert np.all(other.number_density_h2o > 0.0)
        assert np.all(other.number_density_o3 > 0.0)


def test_an_unknown_state_is_refused_in_one_line() -> None:
    with pytest.raises(UserError, match="unknown state 'ec2008-99'") as caught:
        air_of(scene(atmosphere={"profile": "weather:ec2008-99"}))
    assert "atmosphere.profile" in str(caught.value)
    with pytest.raises(ValueError, match='warming_k applies to profile = "weather" only'):
        scene(atmosphere={"warming_k": 10.0})


def test_the_modes_are_made_of_the_states() -> None:
    """The shipped table is what its maker makes; signs of singular vectors are fixed, their last digits are not."""
    again, shipped = made(), npz(field.TABLE)
    np.testing.assert_allclose(again["spread"], shipped["spread"], rtol=0, atol=2e-4)
    product = np.einsum("cmqk,cmqk->cm", again["modes"], shipped["modes"])
    length = np.einsum("cmqk,cmqk->cm", shipped["modes"], shipped["modes"])
    np.testing.assert_allclose(product, length, rtol=1e-3)
    np.testing.assert_allclose((np.asarray(shipped["modes"])[..., 0, :] ** 2).sum(axis=1), 1.0, atol=1e-3)
