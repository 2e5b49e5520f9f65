"""Absorption for profiles without a table: each climate predicted from the other five, against its own table."""

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.absorption_interpolation import ln_absorption
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, profile
from horizonval.earth.spectral import thermal_absorption as ta
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.spec.sensor.camera import Band

RADIUS_M = 6_371_000.0
Z = ta.levels_m()


def points(lo: float, hi: float) -> ta.GPoints:
    return ta.g_points(Band(name="t", kind="thermal", lo_um=lo, hi_um=hi))


def state(climate: str) -> AtmosphereProfile:
    """A climate with the temperatures of its table."""
    p = profile(climate).at(Z)
    kelvin = ta.temperature_k(climate, Z)
    scale = p.pressure_pa / (1.380649e-23 * kelvin) / p.number_density_air
    return AtmosphereProfile(
        "file", Z, p.pressure_pa, kelvin, *(
            density * scale
            for density in (p.number_density_air, p.number_density_o3, p.number_density_h2o, p.number_density_co2)
        )
    )  # fmt: skip


def limb(g: ta.GPoints, ln_k: FloatArray, kelvin: FloatArray, height_m: float) -> float:
    """Radiance of a ray with a tangent height (below zero it meets a black ground), midpoints of 3000 pieces."""
    b = RADIUS_M + height_m
    end = np.sqrt((RADIUS_M + 100e3) ** 2 - b**2)
    s = np.linspace(end, np.sqrt(RADIUS_M**2 - b**2) if height_m < 0 else -end, 3001)
    middle = (s[1:] + s[:-1]) / 2
    z = np.clip(np.sqrt(middle**2 + b**2) - RADIUS_M, 0.0, 100e3)
    k = np.exp(np.stack([np.interp(z, Z, row) for row in ln_k]))
    depth = np.concatenate([np.zeros((len(k), 1)), np.cumsum(k * abs(s[1] - s[0]), axis=1)], axis=1)
    passed = np.exp(-depth)

    def source(t: FloatArray) -> FloatArray:
        return g.weight_per_cm @ radiance_per_wavenumber(g.wavenumber_per_cm[:, None], t)

    total = float(np.sum(source(np.interp(z, Z, kelvin)) * -np.diff(passed, axis=1)))
    return total + (float(source(kelvin[:1])[:, 0] @ passed[:, -1]) if height_m < 0 else 0.0)


@pytest.mark.parametrize("climate", ta.climates())
def test_a_climate_gets_its_own(climate: str) -> None:
    g = points(14.0, 16.3)
    own = g.ln_absorption({climate: 1.0}, 400.0)
    found = ln_absorption(g, state(climate), 400.0)
    # Float32 rounding of the tables' pressures and, above 70 km, the profiles' other levels.
    low = Z <= 70e3
    assert np.abs(found - own)[:, low].max() < 0.02


@pytest.mark.parametrize("climate", ["tropical", "midlatitude_winter", "subarctic_winter", "subarctic_summer"])
@pytest.mark.parametrize(
    ("lo", "hi", "stated"),
    [
        (14.0, 16.3, {-10: 0.004, 6: 0.004, 12: 0.004, 20: 0.004, 30: 0.004, 40: 0.02, 50: 0.02, 60: 0.02}),
        (8.0, 14.0, {-10: 0.05, 6: 0.07, 12: 0.05, 20: 0.05, 30: 0.05, 40: 0.075, 50: 0.07, 60: 0.06}),
    ],
)
def test_predicted_from_the_other_five(climate: str, lo: float, hi: float, stated: dict[int, float]) -> None:
    g = points(lo, hi)
    others = [name for name in ta.climates() if name != climate]
    kelvin = ta.temperature_k(climate, Z)
    own, found = g.ln_absorption({climate: 1.0}), ln_absorption(g, state(climate), 420.0, others)
    # The module's table of what is left.
    for height, bound in stated.items():
        ratio = limb(g, found, kelvin, 1e3 * height) / limb(g, own, kelvin, 1e3 * height)
        assert abs(ratio - 1) < bound, height


def test_far_outside_it_stays() -> None:
    g, base = points(14.0, 16.3), state("subarctic_winter")

    def colder(by: float) -> FloatArray:
        kelvin = base.temperature_k - by
        return ln_absorption(g, AtmosphereProfile("file", Z, base.pressure_pa, kelvin, *(
            n * base.temperature_k / kelvin
            for n in (base.number_density_air, base.number_density_o3, base.number_density_h2o, base.number_density_co2)
        )), 420.0) - np.log(base.temperature_k / kelvin)  # fmt: skip

    # From 20 to 60 K below the coldest climate the line no longer counts, only the nearness of the six: a few per cent.
    assert np.abs(colder(60.0) - colder(40.0))[:, Z < 60e3].max() < 0.1
    assert np.isfinite(colder(90.0)).all()
