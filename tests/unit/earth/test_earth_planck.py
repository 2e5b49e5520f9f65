import numpy as np
import pytest
from scipy.integrate import quad

from horizonval.earth.spectral import planck


def test_wien_and_stefan() -> None:
    wavelength = np.linspace(8.0, 12.0, 40_001)
    peak = wavelength[np.argmax(planck.radiance_per_um(wavelength, 288.15))]
    assert peak == pytest.approx(2897.771955 / 288.15, abs=1e-4)
    assert planck.band_radiance(1e-3, 1e7, 288.15) == pytest.approx(5.670374419e-8 * 288.15**4 / np.pi, rel=1e-9)


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
def test_band_integral_against_quadrature(lo: float, hi: float, kelvin: float) -> None:
    expected = quad(lambda w: float(planck.radiance_per_um(w, kelvin)), lo, hi, epsabs=0, epsrel=1e-12)[0]
    assert planck.band_radiance(lo, hi, kelvin) == pytest.approx(expected, rel=1e-11)


def test_series_meet_where_they_change_over() -> None:
    # The density is steep: x = 2 -+ 1e-9 differs by 1e-9 in F; a gap between the series would show.
    wavelength = 14387.76877 / 300.0 / (2.0 + np.array([-1e-9, 1e-9]))
    below, above = planck.fraction_below(wavelength, 300.0)
    assert abs(below - above) < 1e-9
    # Blackbody tables: F(lambda T = 2898 um K) = 0.2501, F(4107 um K) = 0.5.
    assert planck.fraction_below(2897.77 / 300.0, 300.0) == pytest.approx(0.25005, abs=2e-5)
    assert planck.fraction_below(4107.0 / 300.0, 300.0) == pytest.approx(0.5, abs=2e-4)


def test_cold_and_short_is_zero_not_nan() -> None:
    assert planck.radiance_per_um(0.5, 3.0) == 0.0
    assert planck.fraction_below(0.5, 3.0) == 0.0


def test_shapes_broadcast() -> None:
    assert planck.radiance_per_um(np.ones(3), np.full((2, 1), 300.0)).shape == (2, 3)
    assert planck.band_radiance(8.0, 14.0, np.full((2, 3), 300.0)).shape == (2, 3)
