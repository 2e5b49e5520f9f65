"""The sky over the ground against closed forms and rays over a round Earth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from earth_forms import model_of, thermal
from scipy.special import expn

from horizonval.earth.atmosphere.emission import EmittingBand

RADIUS_M = 6_371_000.0


def grey(depth: float, kelvin: Any) -> EmittingBand:
    z = np.linspace(0.0, 10e3, 101)
    return EmittingBand(
        name="t",
        wavelength_um=np.array([10.0]),
        altitude_m=z,
        sin_latitude=np.zeros(1),
        level_m=z,
        ln_extinction=np.full((1, 1, 101), np.log(depth / 10e3)),
        temperature_k=np.broadcast_to(kelvin, (1, 101)).astype(float),
        source_wavenumber_per_cm=np.array([1000.0]),
        source_weight_per_cm=np.ones((1, 1)),
        sun_radiance=np.zeros(1),
    )


@pytest.mark.parametrize("depth", [1e-9, 1e-3, 0.3, 2.0, 40.0, 5000.0])
def test_isothermal_slab(depth: float) -> None:
    band = grey(depth, 250.0)
    # The diffuse emissivity of a slab, 1 - 2 E_3; thin ones cancel to 1e-16 absolute.
    expected = band.source(250.0)[0] * (1 - 2 * expn(3, depth))
    assert float(band.sky_irradiance()[0, 0]) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_source_linear_in_depth() -> None:
    band = grey(3.0, np.linspace(300.0, 200.0, 101))
    z, source = band.altitude_m, band.columns()[1][0, 0]
    # The integral of S 2 E_2 by a fine rule; S is smooth and 100 layers follow it.
    tau = np.linspace(0.0, 3.0, 200_001)
    expected = np.trapezoid(np.interp(tau, z * 3e-4, source) * 2 * expn(2, tau), tau)
    assert float(band.sky_irradiance()[0, 0]) == pytest.approx(expected, rel=1e-6)


def spherical_sky(band: EmittingBand) -> Any:
    """Return twice the integral of L(mu) mu dmu over straight rays from the ground, layers of 5 to 50 m."""
    z = np.concatenate([np.arange(0.0, 2e3, 5.0), np.arange(2e3, 100_001.0, 50.0)])
    extinction, source = ([np.interp(z, band.altitude_m, row) for row in c[:, 0]] for c in band.columns())
    k, s = np.array(extinction), np.array(source)
    x, w = np.polynomial.legendre.leggauss(16)
    total = np.zeros(band.count)
    for mu, weight in zip((x + 1) / 2, w / 2, strict=True):
        path = np.sqrt((RADIUS_M * mu) ** 2 + 2 * RADIUS_M * z + z * z) - RADIUS_M * mu
        depth = np.cumsum(0.5 * (k[:, 1:] + k[:, :-1]) * np.diff(path), axis=1)
        passed = np.exp(-np.concatenate([np.zeros((band.count, 1)), depth], axis=1))
        total += 2 * weight * mu * np.sum((passed[:, :-1] - passed[:, 1:]) * 0.5 * (s[:, 1:] + s[:, :-1]), axis=1)
    return total


@pytest.mark.parametrize("climate", ["tropical", "subarctic_winter"])
@pytest.mark.parametrize(("lo", "hi"), [(14.0, 16.3), (8.0, 14.0), (10.5, 12.5)])
def test_round_earth(climate: str, lo: float, hi: float) -> None:
    (band,) = model_of(thermal(lo, hi), atmosphere={"profile": climate}).thermal
    ground = band.source(band.temperature_k[0, 0])
    error = (band.sky_irradiance()[:, 0] - spherical_sky(band)) / ground
    # As the docstring says: what a plane Earth has too much, of the ground's own source.
    assert np.abs(error).max() < 1.5e-3
    assert abs(error @ ground / ground.sum()) < 5e-4


@pytest.mark.parametrize("ground_m", [0.0, 40.0, 1000.0, 2890.0])
def test_a_column_begins_at_its_ground(ground_m: float) -> None:
    band = replace(grey(0.5, 250.0), ground_m=np.array([ground_m]))
    ((column,),) = band.extinction_at(np.arange(0.0, 10001.0, 250.0))
    # 0.5 over 10 km, cut off at the ground: cells of 250 m, those at the ends half as thick
    assert np.trapezoid(column, dx=250.0) == pytest.approx(0.5 * (1.0 - ground_m / 10e3), rel=1e-9)
    assert (column[np.arange(0.0, 10001.0, 250.0) < ground_m - 125.0] == 0.0).all()
    sky = float(band.sky_irradiance()[0, 0])
    assert sky == pytest.approx(band.source(250.0)[0] * (1 - 2 * expn(3, 0.5 * (1.0 - ground_m / 10e3))), rel=1e-3)
