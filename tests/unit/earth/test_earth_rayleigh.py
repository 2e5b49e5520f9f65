import numpy as np
import pytest

from horizonval.earth import rayleigh
from horizonval.earth.profiles import us76


@pytest.mark.parametrize(
    ("wavelength_um", "cm2"), [(0.45, 1.0274e-26), (0.55, 4.5105e-27), (0.65, 2.2856e-27), (0.85, 7.7235e-28)]
)
def test_cross_section_of_bodhaine(wavelength_um: float, cm2: float) -> None:
    # Computed with another implementation, five figures.
    assert rayleigh.cross_section_m2(wavelength_um, 360.0) * 1e4 == pytest.approx(cm2, rel=2e-5)


def test_published_cross_section_at_532_nm() -> None:
    # Naus and Ubachs, Opt. Lett. 25, 347 (2000), measured in N2, and 1 % more in air: 5.10e-27 and 5.16e-27 cm2.
    assert rayleigh.cross_section_m2(0.532) * 1e4 == pytest.approx(5.16e-27, rel=0.01)


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


def test_phase_function() -> None:
    mu, weight = np.polynomial.legendre.leggauss(8)
    phase = rayleigh.phase_function_per_sr(mu)
    assert 2 * np.pi * weight @ phase == pytest.approx(1, abs=1e-14)
    assert rayleigh.phase_function_per_sr(1.0) == pytest.approx(2 * rayleigh.phase_function_per_sr(0.0))
