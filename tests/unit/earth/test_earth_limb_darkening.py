"""Limb darkening against tables that have no part in it."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.earth.light import limb_darkening

WAVELENGTHS = [0.3, 0.35, 0.372, 0.38, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0, 1.1, 2.0]


@pytest.mark.parametrize("wavelength_um", WAVELENGTHS)
def test_the_middle_of_the_disc_is_one_and_the_edge_is_darker(wavelength_um: float) -> None:
    a = limb_darkening.coefficients(wavelength_um)
    values = limb_darkening.profile(a, np.linspace(0.05, 1.0, 50))
    assert values[-1] == pytest.approx(1.0, abs=2e-5)
    assert np.all(np.diff(values) > 0.0)


@pytest.mark.parametrize(
    ("wavelength_um", "u", "v"), [(0.45, 0.99, -0.17), (0.50, 0.97, -0.22), (0.60, 0.88, -0.23), (0.80, 0.73, -0.22),
                                  (1.00, 0.64, -0.20)]
)  # fmt: skip
def test_the_disc_is_as_dark_as_allens(wavelength_um: float, u: float, v: float) -> None:
    """C. W. Allen, *Astrophysical Quantities*, section 81: ``1 - u - v + u mu + v mu^2``; 2 % of the centre."""
    a = limb_darkening.coefficients(wavelength_um)
    mu = np.linspace(0.2, 1.0, 30)
    assert np.abs(limb_darkening.profile(a, mu) - (1 - u - v + u * mu + v * mu**2)).max() < 0.02
    assert limb_darkening.mean(a) == pytest.approx(1.0 - u / 3.0 - v / 2.0, rel=0.01)


@pytest.mark.parametrize("wavelength_um", [0.45, 0.55, 0.7, 0.9])
def test_the_power_law_of_hestroffer_and_magnan(wavelength_um: float) -> None:
    """A&A 333, 338 (1998): ``I = mu^alpha``, ``alpha = -0.023 + 0.292 / lambda``; 1.5 % of the centre.

    From mu = 0.5 inwards, three quarters of the disc: one exponent is too dark towards the edge, by 4 % at mu = 0.2.
    """
    mu = np.linspace(0.5, 1.0, 30)
    power = mu ** (-0.023 + 0.292 / wavelength_um)
    assert np.abs(limb_darkening.profile(limb_darkening.coefficients(wavelength_um), mu) - power).max() < 0.015


def test_mean_is_the_integral() -> None:
    a = limb_darkening.coefficients(0.5)
    r = (np.arange(20000) + 0.5) / 20000
    mean = np.mean(limb_darkening.profile(a, np.sqrt(1.0 - r**2)) * r) * 2.0
    assert limb_darkening.mean(a) == pytest.approx(mean, rel=1e-6)
