"""Nitrogen dioxide in sunlight against published cross sections, columns and slant depths."""

import numpy as np
import pytest
from earth_forms import model_of, solar

from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.gases import nitrogen_dioxide


@pytest.mark.parametrize(
    ("wavelength_um", "cm2"),
    # Burrows et al. 1998 (J. Quant. Spectrosc. Radiat. Transfer 60, 1025) and Vandaele et al. 1998 as read off their
    # figures, means by eye: 6e-19 in the flat maximum, 5e-19 at 440 nm, 1e-19 at 550 nm; a mean through bands of a
    # fifth of the whole is good to 10 %
    [(0.40, 6.0e-19), (0.44, 5.2e-19), (0.50, 2.3e-19), (0.55, 1.0e-19)],
)
def test_cross_section(wavelength_um: float, cm2: float) -> None:
    assert nitrogen_dioxide.cross_section_m2(wavelength_um) == pytest.approx(1e-4 * cm2, rel=0.10)


def test_ends_beyond_red() -> None:
    assert nitrogen_dioxide.cross_section_m2(0.7) == 0.0
    assert nitrogen_dioxide.cross_section_m2(1.5) == 0.0


def test_the_column_is_of_the_stratosphere() -> None:
    air = profile("us_standard")
    z = air.altitude_m
    density = nitrogen_dioxide.number_density_per_m3(z, air.number_density_air)
    above = z >= 12e3
    column_per_cm2 = 1e-4 * np.trapezoid(density[above], z[above])
    # measured 2e15 to 6e15 by day (the text of the module), densest at 20 to 30 km
    assert 2e15 < column_per_cm2 < 6e15
    assert 20e3 <= z[np.argmax(density)] <= 30e3


def absorption_of(lo_um: float, hi_um: float, *, gases: bool) -> tuple[np.ndarray, np.ndarray]:
    air = {"aerosol": "none", "ozone": False, "gases_in_sunlight": gases}
    model = model_of(solar(lo_um, hi_um, nodes=1), atmosphere=air)
    (node,) = model.nodes
    return model.altitude_m, node.extinction_per_m - node.scattering_per_m


def test_blue_bands_lose_to_it_and_red_ones_do_not() -> None:
    z, absorption = absorption_of(0.43, 0.45, gases=True)
    depth = np.trapezoid(absorption, z)
    assert 0.0011 < depth < 0.0033
    # along a ray through the limb at 20 km, by Abel's integral: 40 times as much
    r = 6371e3 + z
    tangent = 6371e3 + 20e3
    slant = 2.0 * np.trapezoid(
        np.interp(np.sqrt(tangent**2 + (x := np.linspace(0.0, 1.1e6, 5001)) ** 2), r, absorption, right=0.0), x
    )
    assert 30.0 * depth < slant < 55.0 * depth
    assert not np.abs(absorption_of(0.43, 0.45, gases=False)[1]).max() > 1e-18
    assert not np.abs(absorption_of(0.70, 0.72, gases=False)[1]).max() > 1e-18
