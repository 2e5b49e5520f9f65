"""Oxygen and water vapour in sunlight, against SPCTRAL2's transmission and a direct spectrum at the ground."""

from typing import Any

import numpy as np
import pytest
from earth_forms import model_of, solar

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.gases import sunlight_absorption as gases
from horizonval.earth.optical import node_counts
from horizonval.earth.tables import csv

UM = np.arange(0.4, 1.2, 0.0005)


def hat(lo: float, hi: float) -> FloatArray:
    return ((lo <= UM) & (hi >= UM)).astype(float)


def of_parts(energy: FloatArray, mass: float, water: float) -> float:
    parts = gases.parts(UM, energy)
    return sum(float(p.energy.sum() * np.exp(-p.mixed * mass - p.water * water)) for p in parts) / float(energy.sum())


def leckner(energy: FloatArray, mass: float, water: float) -> float:
    table_um, a_water, a_mixed = csv("gases_in_sunlight.csv")
    t = np.ones_like(UM)
    # Leckner's formulae as Bird and Riordan print them.
    for a, amount, linear, saturation in ((a_mixed, mass, 1.41, 118.3), (a_water, water, 0.2385, 20.07)):
        x = np.where(UM >= 0.57, np.interp(UM, table_um, a), 0.0) * amount
        t = t * np.exp(-linear * x / (1 + saturation * x) ** 0.45)
    return float(energy @ t / energy.sum())


@pytest.mark.parametrize(("lo", "hi"), [(0.7, 0.8), (0.75, 0.95), (0.4, 1.0), (0.6, 0.9)])
def test_parts_keep_the_transmission(lo: float, hi: float) -> None:
    energy = hat(lo, hi)
    parts = gases.parts(UM, energy)
    assert 2 <= len(parts) <= 5
    np.testing.assert_allclose(sum(p.energy for p in parts), energy, atol=1e-12)
    assert of_parts(energy, *gases.REFERENCE) == pytest.approx(leckner(energy, *gases.REFERENCE), abs=3e-3)
    for mass, water in ((1.0, 1.42), (1.5, 2.1), (3.0, 4.5), (5.0, 7.0), (15.0, 2.0), (2.0, 10.0)):
        # 1.3 % as the module says; without any gas it would be 4 to 25 %.
        assert of_parts(energy, mass, water) == pytest.approx(leckner(energy, mass, water), abs=0.013)


def test_against_a_direct_spectrum() -> None:
    """ASTM G173-03's direct spectrum (SMARTS 2.9.2, air mass 1.5, 1.42 cm of water) over its extraterrestrial one.

    The loss of energy to gases, with a line through the logarithm of the clean neighbourhoods (670-680, 705-708,
    747-755, 775-782, 865-880 and 1000-1020 nm) as what would be there without: 7.31 % of 700 to 800 nm, 13.63 % of 750
    to 950 nm.
    """
    for lo, hi, loss in ((0.7, 0.8, 0.0731), (0.75, 0.95, 0.1363)):
        assert 1 - of_parts(hat(lo, hi), 1.5, 1.5 * 1.42) == pytest.approx(loss, abs=0.01)


def test_amounts_of_a_column() -> None:
    air = profile("us_standard").at(np.arange(0.0, 100_001.0, 100.0))
    mass = gases.air_mass_per_m(air.pressure_pa, air.number_density_air)
    water = gases.water_cm_per_m(air.pressure_pa, air.number_density_h2o)
    assert np.trapezoid(mass, air.altitude_m) == pytest.approx(1.0, abs=0.01)
    # 14.2 kg/m2 of the AFGL US standard.
    assert np.trapezoid(water, air.altitude_m) == pytest.approx(1.42, rel=0.02)


def model(lo: float, hi: float, **atmosphere: Any) -> Any:
    return model_of(solar(lo, hi, nodes=3), atmosphere=atmosphere)


def test_nodes_of_a_band() -> None:
    on, off = model(0.7, 0.8), model(0.7, 0.8, gases_in_sunlight=False)
    assert node_counts(off) == {"b": 3}
    assert node_counts(on) == {"b": 7}
    # The same light arrives, and only absorption is added.
    assert sum(n.weight * n.solar_irradiance for n in on.nodes) == pytest.approx(
        sum(n.weight * n.solar_irradiance for n in off.nodes), rel=1e-12
    )
    z = on.altitude_m

    def straight_down(of: Any) -> float:
        light = [n.weight * np.exp(-2 * np.trapezoid(n.extinction_per_m, z)) for n in of.nodes]
        return float(sum(light) / sum(n.weight for n in of.nodes))

    # Down and up once, two air masses and 2.84 cm of water: SPCTRAL2's loss in sunlight, with half a per cent for the
    # weights of the Sun's spectrum and what molecules do over a tenth of a micrometre.
    assert straight_down(on) / straight_down(off) == pytest.approx(leckner(hat(0.7, 0.8), 2.0, 2.84), abs=8e-3)


def test_bands_that_hardly_lose_stay_as_they_are() -> None:
    for lo, hi in ((0.4, 0.55), (0.445, 0.745), (0.6, 0.68)):
        on, off = model(lo, hi), model(lo, hi, gases_in_sunlight=False)
        for a, b in zip(on.nodes, off.nodes, strict=True):
            # nitrogen dioxide alone: a vertical depth of 0.0034 at most
            assert np.trapezoid(a.extinction_per_m - b.extinction_per_m, on.altitude_m) < 0.004
            assert (a.weight, a.wavelength_um) == (b.weight, b.wavelength_um)
