import numpy as np
import pytest

from horizonval.earth.atmosphere import profiles

# U.S. Standard Atmosphere 1976, table 4 values at the bases of its layers: geopotential km, K, Pa, kg m-3.
STANDARD = [
    (0.0, 288.15, 101325.0, 1.2250),
    (11.0, 216.65, 22632.1, 0.363918),
    (20.0, 216.65, 5474.89, 0.0880349),
    (32.0, 228.65, 868.019, 0.0132250),
    (47.0, 270.65, 110.906, 0.00142753),
    (51.0, 270.65, 66.9389, 0.000861606),
    (71.0, 214.65, 3.95642, 0.0000642110),
]


def geometric_m(geopotential_km: float) -> float:
    h = geopotential_km * 1e3
    return 6_356_766.0 * h / (6_356_766.0 - h)


@pytest.mark.parametrize(("h_km", "temperature", "pressure", "density"), STANDARD)
def test_us76_at_the_bases_of_its_layers(h_km: float, temperature: float, pressure: float, density: float) -> None:
    state = profiles.us76(geometric_m(h_km))
    # Published with six figures.
    assert state.temperature_k == pytest.approx(temperature, abs=0.001)
    assert state.pressure_pa == pytest.approx(pressure, rel=3e-6)
    assert state.density == pytest.approx(density, rel=5e-5 if h_km == 0 else 3e-6)


def test_us76_number_density_at_sea_level() -> None:
    # Table 8 of the standard: 2.5470e25 per m3.
    assert profiles.us76(0.0).number_density == pytest.approx(2.5470e25, rel=2e-5)


@pytest.mark.parametrize("altitude", [-1.0, 86_001.0, np.nan])
def test_us76_ends_at_86_km(altitude: float) -> None:
    with pytest.raises(ValueError, match="altitude must lie between 0 and 86000"):
        profiles.us76(altitude)


def test_table_of_us76_meets_the_closed_form_between_levels_too() -> None:
    z = np.arange(0.0, 87e3, 1e3)
    table, closed = profiles.profile("us76").at(z), profiles.us76(z)
    # Independent code made the table; six decimals of p are left at 86 km.
    np.testing.assert_allclose(table.pressure_pa, closed.pressure_pa, rtol=2e-5)
    np.testing.assert_allclose(table.temperature_k, closed.temperature_k, rtol=1e-6)
    np.testing.assert_allclose(table.number_density_air, closed.number_density, rtol=2e-5)
    z = np.arange(0.0, 85e3, 50.0)
    ratio = profiles.profile("us76").at(z).number_density_air / profiles.us76(z).number_density - 1
    assert np.abs(ratio[z < 10e3]).max() < 6e-4
    # The gradient of temperature breaks at 47.35 km, between two levels.
    assert np.abs(ratio).max() < 2.5e-3


@pytest.mark.parametrize("name", profiles.names())
def test_every_profile_is_a_gas_and_nearly_hydrostatic(name: str) -> None:
    p = profiles.profile(name)
    boltzmann = 1.380649e-23
    np.testing.assert_allclose(p.number_density_air, p.pressure_pa / (boltzmann * p.temperature_k), rtol=1e-3)
    low = p.altitude_m <= 80e3
    gravity = 9.80665 * (6371e3 / (6371e3 + p.altitude_m[low])) ** 2
    weight = np.trapezoid(p.number_density_air[low] * 28.9644e-3 / 6.02214076e23 * gravity, p.altitude_m[low])
    # Trapezoids of 1 km add 0.2 %; AFGL levels are hydrostatic to 2 or 3 % only.
    assert weight == pytest.approx(p.pressure_pa[0], rel=0.02)


def test_levels_are_kept_and_gases_follow_the_air() -> None:
    p = profiles.profile("tropical")
    same = p.at(p.altitude_m)
    np.testing.assert_allclose(same.number_density_o3, p.number_density_o3, rtol=1e-12)
    middle = p.at([500.0])
    assert middle.temperature_k[0] == pytest.approx((p.temperature_k[0] + p.temperature_k[1]) / 2)
    assert middle.pressure_pa[0] == pytest.approx(np.sqrt(p.pressure_pa[0] * p.pressure_pa[1]))
    ratio = p.number_density_h2o / p.number_density_air
    assert middle.number_density_h2o[0] / middle.number_density_air[0] == pytest.approx(np.sqrt(ratio[0] * ratio[1]))


def test_outside_the_table() -> None:
    with pytest.raises(ValueError, match="between 0 and 120000 m"):
        profiles.profile("us76").at([120_001.0])
