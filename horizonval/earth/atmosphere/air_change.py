"""Air that is a little different: warmer, denser, dustier, or raised over the ground.

Derivatives of frames are made of such air. What each change means:

- warmer: every temperature T becomes T + e at its height. The pressure at the ground stays, that above follows from
  hydrostatic balance, so that with the ideal gas's law the density changes by::

      d ln n(z) = -ln(1 + e / T) + int_0^z (M g / R) (1 / T - 1 / (T + e)) dz'

  The profiles themselves are hydrostatic to a few per cent only, so the change alone is balanced. Mixing ratios stay.
  Ozone's cross section for sunlight follows the temperature; in thermal bands absorption per molecule stays as it was;
- denser: all gases by the same factor, temperature as it was;
- dustier: all particles by the same factor;
- raised: what was at height z is at z + e; below e the air is as it was at the ground; light is bent as it was.
  The ground stays, its temperature too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.aerosol import Aerosol
from horizonval.earth.atmosphere.profiles import AtmosphereProfile

GRAVITY_M_S2, MOLAR_MASS_KG, GAS_CONSTANT = 9.80665, 28.9644e-3, 8.314462618
EARTH_RADIUS_M = 6_356_766.0


@dataclass(frozen=True)
class AirChange:
    """How air differs from that of a scene.

    Attributes
    ----------
    warmer_k : float
        Added to every temperature, pressure in hydrostatic balance.
    denser : float
        Relative, of all gases.
    dustier : float
        Relative, of all particles.
    raised_m : float
        The whole air over the ground.
    """

    warmer_k: float = 0.0
    denser: float = 0.0
    dustier: float = 0.0
    raised_m: float = 0.0

    def ln_density(self, altitude_m: FloatArray, temperature_k: FloatArray) -> FloatArray:
        """Return the change of the logarithm of every gas's density.

        Parameters
        ----------
        altitude_m : ndarray, shape (n,)
            Rising from the ground.
        temperature_k : ndarray, shape (..., n)
            Before the change.
        """
        gas = np.full_like(temperature_k, np.log1p(self.denser))
        if not self.warmer_k:
            return gas
        gravity = GRAVITY_M_S2 * (EARTH_RADIUS_M / (EARTH_RADIUS_M + altitude_m)) ** 2
        lighter = self.warmer_k / (temperature_k * (temperature_k + self.warmer_k))
        swollen = cumulative_trapezoid(MOLAR_MASS_KG / GAS_CONSTANT * gravity * lighter, altitude_m, initial=0.0)
        return np.asarray(gas + swollen - np.log1p(self.warmer_k / temperature_k))

    def state(self, state: AtmosphereProfile) -> AtmosphereProfile:
        """Return warmer and denser gases; what is raised is for the caller to read from lower heights."""
        if not (self.warmer_k or self.denser):
            return state
        factor = np.exp(self.ln_density(state.altitude_m, state.temperature_k))
        temperature = state.temperature_k + self.warmer_k
        return replace(
            state,
            pressure_pa=state.pressure_pa * factor * temperature / state.temperature_k,
            temperature_k=temperature,
            number_density_air=state.number_density_air * factor,
            number_density_o3=state.number_density_o3 * factor,
            number_density_h2o=state.number_density_h2o * factor,
            number_density_co2=state.number_density_co2 * factor,
            number_density_n2o=state.number_density_n2o * factor,
            number_density_ch4=state.number_density_ch4 * factor,
            number_density_hno3=state.number_density_hno3 * factor,
        )

    def particles(self, particles: Aerosol) -> Aerosol:
        """Return more particles."""
        return replace(particles, extinction_550_per_m=particles.extinction_550_per_m * (1.0 + self.dustier))


AS_IT_IS = AirChange()
