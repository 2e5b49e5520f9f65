import numpy as np
import pytest

from horizonval.earth.atmosphere.profiles import us76
from horizonval.earth.gases import rayleigh


@pytest.mark.parametrize(
    ("wavelength_um", "cm2"), [(0.45, 1.0274e-26), (0.55, 4.5105e-27), (0.65, 2.2856e-27), (0.85, 7.7235e-28)]
)
def test_cross_section_of_bodhaine(wavelength_um: float, cm2: float) -> None:
    # Computed with another implementation, five figures.
    assert rayleigh.cross_section_m2(wavelength_um, 360.0) * 1e4 == pytest.approx(cm2, rel=2e-5)


def test_fit_of_bucholtz() -> None:
    # Bucholtz, Appl. Opt. 34, 2765 (1995), eq. 8 and table 3: other index and King factor; the fit is good to 0.1 %.
    um = np.array([0.35, 0.45, 0.55, 0.65, 0.85])
    short = 3.01577e-32 * um ** -(3.55212 + 1.35579 * um + 0.11563 / um)
    long = 4.01061e-32 * um ** -(3.99668 + 1.10298e-3 * um + 2.71393e-2 / um)
    np.testing.assert_allclose(rayleigh.cross_section_m2(um), np.where(um < 0.5, short, long), rtol=2e-3)


def test_king_factor_and_index_at_550_nm() -> None:
    # Bates 1984 gives 1.049 for air at 550 nm; n - 1 of standard air is 2.778e-4 (Edlen).
    assert rayleigh.king_factor(0.55) == pytest.approx(1.049, abs=0.0005)
    assert rayleigh.refractive_index_minus_one(0.55) == pytest.approx(2.778e-4, rel=5e-4)


def test_carbon_dioxide_changes_little() -> None:
    ratio = rayleigh.cross_section_m2(0.55, 420.0) / rayleigh.cross_section_m2(0.55, 360.0)
    assert 1 < ratio < 1.0001


def test_vertical_optical_depth() -> None:
    z = np.arange(0.0, 86_001.0, 50.0)
    depth = np.trapezoid(us76(z).number_density, z) * rayleigh.cross_section_m2(0.55, 360.0)
    # Column of molecules p0 / (m g), with gravity 0.2 % lower at the air's mean height of 7 km.
    column = 101_325.0 / (28.9644e-3 / 6.02214076e23 * 9.80665 * (1 - 2 * 7.0 / 6371))
    assert depth == pytest.approx(column * 4.5105e-31, rel=5e-4)
    assert depth == pytest.approx(0.0971, abs=0.0002)


@pytest.mark.parametrize(
    ("wavelength_um", "factor"),
    # Bucholtz, Appl. Opt. 34, 2765 (1995), table 1, after Bates 1984 as Bodhaine et al. are; their fit in 1999 differs
    # from it by up to 2.5 % in the ultraviolet.
    [(0.30, 3.178e-2), (0.40, 2.955e-2), (0.55, 2.842e-2), (0.70, 2.786e-2)],
)
def test_depolarisation_of_bucholtz(wavelength_um: float, factor: float) -> None:
    assert rayleigh.depolarisation(wavelength_um) == pytest.approx(factor, rel=0.025)


@pytest.mark.parametrize("wavelength_um", [0.3, 0.55, 1.0])
def test_depolarisation_and_king_factor_say_the_same(wavelength_um: float) -> None:
    rho = rayleigh.depolarisation(wavelength_um)
    assert (6 + 3 * rho) / (6 - 7 * rho) == pytest.approx(rayleigh.king_factor(wavelength_um), rel=1e-14)
    # Chandrasekhar's function, 3 / (4 (1 + 2 q)) ((1 + 3 q) + (1 - q) cos^2) / (4 pi), another way to write it.
    q = rho / (2 - rho)
    for cosine in (-1.0, 0.0, 0.6):
        expected = 3 / (16 * np.pi * (1 + 2 * q)) * (1 + 3 * q + (1 - q) * cosine**2)
        found = rayleigh.phase_function_per_sr(cosine, rayleigh.cos2(wavelength_um))
        assert found == pytest.approx(expected, rel=1e-14)


def test_round_molecules_have_three_quarters() -> None:
    # No depolarisation is a King factor of 1.
    assert rayleigh.COS2 == 0.75
    assert 0.7 < rayleigh.cos2(0.3) < rayleigh.cos2(0.55) < rayleigh.cos2(1.0) < 0.75


def test_phase_function() -> None:
    mu, weight = np.polynomial.legendre.leggauss(8)
    phase = rayleigh.phase_function_per_sr(mu)
    assert 2 * np.pi * weight @ phase == pytest.approx(1, abs=1e-14)
    assert 2 * np.pi * weight @ rayleigh.phase_function_per_sr(mu, 0.7) == pytest.approx(1, abs=1e-14)
    assert rayleigh.phase_function_per_sr(1.0) == pytest.approx(2 * rayleigh.phase_function_per_sr(0.0))
