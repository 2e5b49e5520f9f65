"""Bands, sunlight, Planck's law and quadrature against integrals, published values and exact series."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from earth_forms import black_body_band
from scipy import constants
from scipy.integrate import quad

from horizonval.earth.atmosphere.solar_rule import gauss, solar_measure
from horizonval.earth.spectral import bands, planck, sunlight
from horizonval.earth.spectral.bands import response
from horizonval.earth.spectral.planck import COLDEST_K, HOTTEST_K, black_body_radiance, brightness_temperature_k
from horizonval.earth.spectral.quadrature import Orthonormal, composite_gauss
from horizonval.spec.camera import Band
from horizonval.spec.load import load_camera


def band(**values: Any) -> Band:
    return Band.model_validate({"name": "b", "kind": "solar", **values})


HAT = band(lo_um=0.4, hi_um=0.9)
TRIANGLE = band(wavelength_um=[0.3, 0.4, 0.5, 0.7, 0.8], response=[0.0, 0.0, 0.4, 0.0, 0.0])


def test_responses_by_hand() -> None:
    np.testing.assert_array_equal(bands.response(HAT, [0.39, 0.4, 0.6, 0.9, 0.91]), [0, 1, 1, 1, 0])
    assert bands.limits_um(HAT) == (0.4, 0.9)
    assert bands.width_um(HAT) == pytest.approx(0.5, rel=1e-13)
    assert bands.reference_wavelength_um(HAT) == pytest.approx(0.65, rel=1e-13)
    np.testing.assert_allclose(bands.response(TRIANGLE, [0.35, 0.45, 0.5, 0.6, 0.75]), [0, 0.5, 1, 0.5, 0])
    assert bands.limits_um(TRIANGLE) == (0.4, 0.7)
    assert bands.width_um(TRIANGLE) == pytest.approx(0.15, rel=1e-13)
    # Centroid of a triangle: mean of its corners.
    assert bands.reference_wavelength_um(TRIANGLE) == pytest.approx((0.4 + 0.5 + 0.7) / 3, rel=1e-13)
    step = band(wavelength_um=[0.5, 0.6], response=[0.5, 0.25])
    np.testing.assert_allclose(bands.response(step, [0.499, 0.5, 0.6, 0.601]), [0, 1, 0.5, 0])
    assert bands.limits_um(step) == (0.5, 0.6)
    wavelength, weight = bands.sampled(HAT, [0.123, 0.5137])
    assert np.sum(weight * (wavelength > 0.5137)) == pytest.approx(0.9 - 0.5137, rel=1e-13)


def test_published_irradiances() -> None:
    # 1361 W m-2 in all, of which a 5772 K black body leaves 0.2 % below 250 nm and beyond 20 um; table bins: 1359.02.
    assert sunlight.band_irradiance(0.25, 20.0) == pytest.approx(1359.0, abs=0.2)
    # ASTM E490 holds 759.6 W m-2 in 400 to 900 nm, NRL2 0.4 to 0.6 % less.
    assert sunlight.band_irradiance(0.4, 0.9) == pytest.approx(759.6 * 0.995, rel=0.002)


def test_inverse_square_and_disc() -> None:
    assert sunlight.irradiance(0.55, 2.0) == pytest.approx(sunlight.irradiance(0.55) / 4)
    # The disc's mean radiance does not change with distance; 2.0e7 W m-2 sr-1 in all (5772 K: sigma T^4 / pi).
    near = sunlight.band_irradiance(0.25, 20.0, 0.98) / sunlight.disc_projected_solid_angle(0.98)
    far = sunlight.band_irradiance(0.25, 20.0, 1.02) / sunlight.disc_projected_solid_angle(1.02)
    assert near == pytest.approx(far)
    assert near == pytest.approx(5.670374e-8 * 5772**4 / np.pi, rel=0.003)
    # 32.0 arc minutes across.
    assert sunlight.disc_projected_solid_angle() == pytest.approx(np.pi * np.radians(32.0 / 60 / 2) ** 2, rel=0.003)


def test_rules_of_flat_measures_are_gauss_legendre() -> None:
    x, w = composite_gauss(np.array([0.0, 0.1, 1.0, 3.0]), 3)
    assert x.shape == w.shape == (3, 3)
    assert np.sum(w * x**5) == pytest.approx(3.0**6 / 6, rel=1e-14)
    x, w = composite_gauss(np.linspace(-1, 1, 40), 8)
    nodes, weights = Orthonormal.of(x.ravel(), w.ravel(), 7).rule(7)
    expected_nodes, expected_weights = np.polynomial.legendre.leggauss(7)
    np.testing.assert_allclose(nodes, expected_nodes, atol=1e-13)
    np.testing.assert_allclose(weights, expected_weights, atol=1e-13)


@pytest.mark.parametrize("n", [1, 2, 5, 64])
def test_jagged_measure_is_integrated_exactly(n: int) -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(0.4, 0.9, 1500)
    w = rng.uniform(0, 1, x.size) * (x > 0.45)
    nodes, weights = Orthonormal.of(x, w, 64).rule(n)
    assert nodes.min() > 0.45
    assert (weights > 0).all()
    for degree in {0, 1, n, 2 * n - 1}:
        assert weights @ nodes**degree == pytest.approx(w @ x**degree, rel=1e-12)


def test_smoothed_keeps_the_integrals_of_a_jagged_function() -> None:
    rng = np.random.default_rng(4)
    x = np.linspace(0.4, 0.9, 1500)
    w, values = rng.uniform(0, 1, x.size), 5 + rng.uniform(-1, 1, x.size)
    polynomials = Orthonormal.of(x, w, 9)
    nodes, weights = polynomials.rule(4)
    stand_in = polynomials.smoothed(polynomials.moments(values), nodes)
    for degree in range(4):
        assert weights @ (stand_in * nodes**degree) == pytest.approx(np.sum(w * values * x**degree), rel=1e-11)


def test_smoothed_is_never_negative() -> None:
    x = np.linspace(0.0, 1.0, 500)
    polynomials = Orthonormal.of(x, np.ones_like(x), 3)
    nodes, _ = polynomials.rule(3)
    values = np.where(x > 0.8, 1.0, 0.0)
    line = np.polynomial.Polynomial.fit(x, values, 2)
    assert line(nodes).min() < 0
    assert polynomials.smoothed(polynomials.moments(values), nodes).min() == 0


VISIBLE = Band.model_validate({"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75})
WIDE = Band.model_validate({"name": "wide", "kind": "solar", "lo_um": 0.40, "hi_um": 1.00})
CURVE = Band.model_validate(
    {
        "name": "curve",
        "kind": "solar",
        "wavelength_um": [0.4, 0.5, 0.6, 0.7, 0.9],
        "response": [0.0, 0.9, 1.0, 0.7, 0.0],
    }
)
SPECTRA = {"white": 0.0, "blue": -4.0}
STEPS = 600_001


def integrals(band: Band, power: float) -> tuple[float, float]:
    """Energy and photon-counted integrals of the Sun's spectrum times wavelength^power, by the trapezoid rule."""
    lo, hi = (band.lo_um, band.hi_um) if band.lo_um and band.hi_um else (band.wavelength_um[0], band.wavelength_um[-1])
    wavelength = np.linspace(lo, hi, STEPS)
    weight = response(band, wavelength)
    light = weight * sunlight.irradiance(wavelength) * wavelength**power
    mean = np.trapezoid(weight * wavelength, wavelength) / np.trapezoid(weight, wavelength)
    return float(np.trapezoid(light, wavelength)), float(np.trapezoid(light * wavelength / mean, wavelength))


@pytest.mark.parametrize("band", [VISIBLE, WIDE, CURVE], ids=lambda band: band.name)
@pytest.mark.parametrize("spectrum", SPECTRA)
@pytest.mark.parametrize("nodes", [1, 2, 3, 4, 6])
def test_energy_is_the_integral_over_wavelength(band: Band, spectrum: str, nodes: int) -> None:
    """White light whatever the nodes; light as blue as air's scattering as well as nodes can tell it."""
    rule = gauss(solar_measure(band, "test"), nodes)
    energy = float(
        np.sum(rule.weight_um * rule.energy_ratio * rule.mean_irradiance * rule.wavelength_um ** SPECTRA[spectrum])
    )
    known, _ = integrals(band, SPECTRA[spectrum])
    # The polynomial of degree n - 1 through a power law leaves this much of it in the widest band.
    allowed = 1e-5 if spectrum == "white" else {1: 0.6, 2: 0.15, 3: 0.03, 4: 3e-3, 6: 3e-5}[nodes]
    assert energy == pytest.approx(known, rel=allowed)


@pytest.mark.parametrize(
    ("band", "spectrum", "percent"), [(VISIBLE, "white", -2.0), (VISIBLE, "blue", -9.7), (WIDE, "blue", -25.7)]
)
def test_what_counts_photons_is_no_energy(band: Band, spectrum: str, percent: float) -> None:
    """The differences that the documentation names; they are of physics, not of the rule."""
    energy, photons = integrals(band, SPECTRA[spectrum])
    rule = gauss(solar_measure(band, "test"), 6)
    light = rule.weight_um * rule.mean_irradiance * rule.wavelength_um ** SPECTRA[spectrum]
    assert float(light.sum()) == pytest.approx(photons, rel=2e-5)
    assert 100.0 * (photons / energy - 1.0) == pytest.approx(percent, abs=0.05)


def test_plancks_law_in_both_units() -> None:
    nu = 667.0
    per_um = planck.radiance_per_um(1e4 / nu, 250.0)
    assert planck.radiance_per_wavenumber(nu, 250.0) == pytest.approx(per_um * 1e4 / nu**2, rel=1e-14)
    # First radiation constant for radiance 1.191042972e8 W um4 m-2 sr-1, second 14387.768775 um K.
    expected = 1.191042972e8 / 10.0**5 / np.expm1(14387.768775 / (10.0 * 300.0))
    assert planck.radiance_per_um(10.0, 300.0) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("lo", "hi", "kelvin"), [(14.0, 16.3, 250.0), (8.0, 14.0, 288.0), (0.4, 0.9, 5778.0), (20.0, 40.0, 300.0)]
)
def test_band_integral_against_the_exact_series(lo: float, hi: float, kelvin: float) -> None:
    found = quad(lambda w: float(planck.radiance_per_um(w, kelvin)), lo, hi, epsabs=0, epsrel=1e-12)[0]
    assert found == pytest.approx(float(black_body_band(lo, hi, kelvin)), rel=1e-11)


def test_cold_and_short_is_zero_not_nan() -> None:
    assert planck.radiance_per_um(0.5, 3.0) == 0.0
    assert planck.radiance_per_um(np.ones(3), np.full((2, 1), 300.0)).shape == (2, 3)


BANDS = load_camera("ir-four-band-320-24deg").band


@pytest.mark.parametrize("band", BANDS, ids=lambda band: band.name)
def test_a_black_body_has_its_own_temperature(band: Band) -> None:
    temperature = np.geomspace(1.01 * COLDEST_K, 0.99 * HOTTEST_K, 1001).reshape(7, 143)
    assert band.lo_um is not None
    assert band.hi_um is not None
    # The band's exact series (Widger and Woodall) is another formula than the quadrature that is inverted.
    radiance = black_body_band(band.lo_um, band.hi_um, temperature)
    found = brightness_temperature_k(band, radiance)
    assert found.shape == temperature.shape
    # The spline's own error, as stated.
    np.testing.assert_allclose(found, temperature, rtol=0, atol=1e-5)


def test_temperatures_of_a_narrow_band_and_of_a_table_of_responses() -> None:
    narrow = Band(name="n", kind="thermal", lo_um=11.999, hi_um=12.001)
    per_m = 8.0 / 1e-6
    x = math.log1p(2 * constants.h * constants.c**2 / (12e-6) ** 5 / per_m)
    expected = constants.h * constants.c / (12e-6 * constants.k * x)
    # The curvature of B over 2 nm: below 1e-8 of the radiance, a microkelvin.
    assert brightness_temperature_k(narrow, 8.0 * 0.002) == pytest.approx(expected, abs=2e-5)
    half = Band(name="h", kind="thermal", wavelength_um=[10.0, 10.001, 12.0, 12.001], response=[0, 1, 1, 0])
    hat = Band(name="f", kind="thermal", lo_um=10.0005, hi_um=12.0005)
    assert black_body_radiance(half, 280.0) == pytest.approx(float(black_body_radiance(hat, 280.0)), rel=1e-6)


def test_darkness_is_zero_and_what_is_out_of_range_counts_as_its_end() -> None:
    band = BANDS[0]
    assert brightness_temperature_k(band, [0.0, -1e-3]).tolist() == [0.0, 0.0]
    # Clipped to the last node of the spline, which is exact but for rounding.
    assert brightness_temperature_k(band, 1e-300) == pytest.approx(COLDEST_K, abs=1e-6)
    assert brightness_temperature_k(band, 1e9) == pytest.approx(HOTTEST_K, abs=1e-6)
