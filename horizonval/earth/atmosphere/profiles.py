"""Named atmospheric profiles, and the US Standard Atmosphere 1976 in closed form.

Six AFGL climates (Anderson et al. 1986, AFGL-TR-86-0110) and the US Standard Atmosphere 1976 with the gases of the
AFGL US standard, tabulated by 1 km to 120 km. Between levels the temperature is linear in altitude, and so are the
logarithms of the pressure and of the mixing ratios; the density of air is p / (k T).

The closed form (NOAA-S/T 76-1562) works in geopotential altitude ``H = r0 z / (r0 + z)`` and layers of constant
temperature gradient L (eqs. 18, 23, 33a, 33b, 42)::

    T_M = T_b + L (H - H_b)
    p = p_b (T_b / T_M)^(g0 M0 / (R* L))            L != 0
    p = p_b exp(-g0 M0 (H - H_b) / (R* T_b))        L = 0
    rho = p M0 / (R* T_M)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.tables import npz

GASES = ("o3", "h2o", "co2", "n2o", "ch4", "hno3")
_TABLE = "atmosphere_profiles.npz"
_LENDER = "us_standard"
"""Climate that lends its trace gases to profiles which are not AFGL climates."""


@dataclass(frozen=True)
class AtmosphereProfile:
    """State of the atmosphere over altitude, arrays of shape (n,).

    ``number_density_*``: molecules per m3; CO2 is 420 ppm below 80 km. The AFGL climates are hydrostatic to 2 to 3 %
    only.
    """

    name: str
    altitude_m: FloatArray
    pressure_pa: FloatArray
    temperature_k: FloatArray
    number_density_air: FloatArray
    number_density_o3: FloatArray
    number_density_h2o: FloatArray
    number_density_co2: FloatArray
    number_density_n2o: FloatArray
    number_density_ch4: FloatArray
    number_density_hno3: FloatArray

    @classmethod
    def of(
        cls,
        name: str,
        altitude_m: FloatArray,
        pressure_pa: FloatArray,
        temperature_k: FloatArray,
        number_density_air: FloatArray,
        gases: Mapping[str, FloatArray],
    ) -> AtmosphereProfile:
        """Return a profile from the densities of all :data:`GASES` by name."""
        densities = {f"number_density_{gas}": density for gas, density in gases.items()}
        return cls(name, altitude_m, pressure_pa, temperature_k, number_density_air, **densities)

    def gas_densities(self) -> dict[str, FloatArray]:
        """Return the number density of every gas of :data:`GASES`."""
        return {gas: getattr(self, f"number_density_{gas}") for gas in GASES}

    def at(self, altitude_m: ArrayLike) -> AtmosphereProfile:
        """Return the profile on other altitudes; raises ``ValueError`` outside the tabulated range.

        Against the closed form of US76 the density is within 2.4e-3 between levels and 1e-5 at them.
        """
        z = np.asarray(altitude_m, dtype=np.float64)
        if z.size and (z.min() < self.altitude_m[0] or z.max() > self.altitude_m[-1]):
            raise ValueError(
                f"altitude must lie between {self.altitude_m[0]:g} and {self.altitude_m[-1]:g} m, "
                f"got {z.min():g} to {z.max():g} m"
            )

        def ln_linear(values: FloatArray) -> FloatArray:
            return np.exp(np.interp(z, self.altitude_m, np.log(values)))

        def share(density: FloatArray) -> FloatArray:
            return ln_linear(density / self.number_density_air)

        temperature = np.interp(z, self.altitude_m, self.temperature_k)
        air = ln_linear(self.number_density_air * self.temperature_k) / temperature
        return AtmosphereProfile.of(
            name=self.name,
            altitude_m=z,
            pressure_pa=ln_linear(self.pressure_pa),
            temperature_k=temperature,
            number_density_air=air,
            gases={gas: air * share(density) for gas, density in self.gas_densities().items()},
        )

    def gas_state(self) -> GasState:
        """Return the air as thermal bands need it, without halocarbons."""
        vmr = {gas: density / self.number_density_air for gas, density in self.gas_densities().items()}
        return GasState(self.altitude_m, self.pressure_pa, self.temperature_k, vmr)


def names() -> list[str]:
    """Return the names of the shipped profiles."""
    return [str(name) for name in npz(_TABLE)["atmosphere"]]


def profile(name: str, *, where: str = "") -> AtmosphereProfile:
    """Return a shipped profile on its own levels, 0 to 120 km by 1 km.

    ``where``: file and key of the name, for the error message. Raises ``UserError``: unknown name, with similar ones.
    """
    known = names()
    if name not in known:
        raise UserError(
            f"unknown atmosphere profile {name!r}",
            where=where,
            expected="one of " + ", ".join(nearest(name, known)),
        )
    table = npz(_TABLE)
    i = known.index(name)

    def row(key: str) -> FloatArray:
        return np.asarray(table[key][i], dtype=np.float64)

    pressure, air = row("pressure_pa"), row("number_density_air_per_m3")
    lent = afgl.gases_at_pressure(name if name in afgl.names() else _LENDER, pressure)
    gases = {gas: row(f"number_density_{gas}_per_m3") for gas in ("o3", "h2o", "co2")}
    gases |= {gas: air * lent[gas] for gas in ("n2o", "ch4", "hno3")}
    return AtmosphereProfile.of(
        name=name,
        altitude_m=np.asarray(table["altitude_m"], dtype=np.float64),
        pressure_pa=pressure,
        temperature_k=row("temperature_k"),
        number_density_air=air,
        gases=gases,
    )


@dataclass(frozen=True)
class Us76:
    """State by :func:`us76`; arrays with the shape of the altitude. Density in kg m-3, number density in m-3."""

    pressure_pa: FloatArray
    temperature_k: FloatArray
    density: FloatArray
    number_density: FloatArray


_G0 = 9.80665
_M0 = 28.9644e-3
_GAS_CONSTANT_1976 = 8.31432
_AVOGADRO_1976 = 6.022169e23
_R0 = 6_356_766.0
_BASE_M = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3])
_LAPSE = np.array([-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3])
_TOP_M = 86e3


def geopotential_m(altitude_m: ArrayLike) -> FloatArray:
    """Return the geopotential altitude of a geometric one (US76, eq. 18, r0 = 6356.766 km)."""
    z = np.asarray(altitude_m, dtype=np.float64)
    return _R0 * z / (_R0 + z)


def _bases() -> tuple[FloatArray, FloatArray]:
    temperature = np.full(7, 288.15)
    pressure = np.full(7, 101_325.0)
    for b in range(6):
        step = _BASE_M[b + 1] - _BASE_M[b]
        temperature[b + 1] = temperature[b] + _LAPSE[b] * step
        if _LAPSE[b]:
            power = _G0 * _M0 / (_GAS_CONSTANT_1976 * _LAPSE[b])
            pressure[b + 1] = pressure[b] * (temperature[b] / temperature[b + 1]) ** power
        else:
            pressure[b + 1] = pressure[b] * np.exp(-_G0 * _M0 * step / (_GAS_CONSTANT_1976 * temperature[b]))
    return temperature, pressure


_BASE_T, _BASE_P = _bases()


def us76(altitude_m: ArrayLike) -> Us76:
    """Return the US Standard Atmosphere 1976 at geometric altitudes between 0 and 86 km, else ``ValueError``.

    The molecular weight is that at the ground. The standard lets it fall above 80 km, by 0.04 % at 86 km.
    """
    z = np.asarray(altitude_m, dtype=np.float64)
    if z.size and not (z.min() >= 0 and z.max() <= _TOP_M):
        raise ValueError(f"altitude must lie between 0 and {_TOP_M:g} m, got {z.min():g} to {z.max():g} m")
    h = geopotential_m(z)
    b = np.clip(np.searchsorted(_BASE_M, h, side="right") - 1, 0, 6)
    lapse, dh, t_b = _LAPSE[b], h - _BASE_M[b], _BASE_T[b]
    temperature = t_b + lapse * dh
    column = _G0 * _M0 / _GAS_CONSTANT_1976
    with np.errstate(divide="ignore", invalid="ignore"):
        gradient = (t_b / temperature) ** (column / lapse)
    pressure = _BASE_P[b] * np.where(lapse == 0, np.exp(-column * dh / t_b), gradient)
    density = pressure * _M0 / (_GAS_CONSTANT_1976 * temperature)
    return Us76(
        pressure_pa=pressure,
        temperature_k=temperature,
        density=density,
        number_density=density * _AVOGADRO_1976 / _M0,
    )
