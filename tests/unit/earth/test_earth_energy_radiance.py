"""Energy radiance on the spectral nodes against plain integrals over wavelength."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.earth.atmosphere.solar_rule import gauss, solar_measure
from horizonval.earth.spectral import sunlight
from horizonval.earth.spectral.bands import response
from horizonval.spec.camera import Band

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
