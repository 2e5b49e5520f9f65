"""Planck's law against published constants and exact series, and brightness temperature as its inverse."""

import math

import numpy as np
import pytest
from earth_forms import black_body_band
from scipy import constants
from scipy.integrate import quad

from horizonval.earth.spectral import planck
from horizonval.earth.spectral.planck import COLDEST_K, HOTTEST_K, black_body_radiance, brightness_temperature_k
from horizonval.spec.camera import Band
from horizonval.spec.load import load_camera


def test_wavelength_and_wavenumber_agree() -> None:
    nu = 667.0
    per_um = planck.radiance_per_um(1e4 / nu, 250.0)
    assert planck.radiance_per_wavenumber(nu, 250.0) == pytest.approx(per_um * 1e4 / nu**2, rel=1e-14)


def test_published_value() -> None:
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


def test_a_narrow_band_is_plancks_law_turned_round() -> None:
    narrow = Band(name="n", kind="thermal", lo_um=11.999, hi_um=12.001)
    per_m = 8.0 / 1e-6
    x = math.log1p(2 * constants.h * constants.c**2 / (12e-6) ** 5 / per_m)
    expected = constants.h * constants.c / (12e-6 * constants.k * x)
    # The curvature of B over 2 nm: below 1e-8 of the radiance, a microkelvin.
    assert brightness_temperature_k(narrow, 8.0 * 0.002) == pytest.approx(expected, abs=2e-5)


def test_a_table_of_responses_weighs_the_radiance() -> None:
    half = Band(name="h", kind="thermal", wavelength_um=[10.0, 10.001, 12.0, 12.001], response=[0, 1, 1, 0])
    hat = Band(name="f", kind="thermal", lo_um=10.0005, hi_um=12.0005)
    assert black_body_radiance(half, 280.0) == pytest.approx(float(black_body_radiance(hat, 280.0)), rel=1e-6)


def test_darkness_is_zero_and_what_is_out_of_range_counts_as_its_end() -> None:
    band = BANDS[0]
    assert brightness_temperature_k(band, [0.0, -1e-3]).tolist() == [0.0, 0.0]
    # Clipped to the last node of the spline, which is exact but for rounding.
    assert brightness_temperature_k(band, 1e-300) == pytest.approx(COLDEST_K, abs=1e-6)
    assert brightness_temperature_k(band, 1e9) == pytest.approx(HOTTEST_K, abs=1e-6)
