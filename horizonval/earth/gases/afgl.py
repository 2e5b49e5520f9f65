"""The six AFGL climates with all their gases, their blends, and default gases for incomplete profiles.

Anderson et al. 1986 (AFGL-TR-86-0110) at the report's 50 levels, 0 to 120 km: temperature linear between them, pressure
and mixing ratios linear in their logarithms. All climates share one profile of carbon dioxide, constant up to 80 km and
scaled to the scene's amount, and one of nitric acid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.tables import npz

CO2_PPM = 420.0
"""Default carbon dioxide of the lower atmosphere."""
SEAM_FROM_M, SEAM_TO_M = 14_000.0, 18_000.0
"""Range of the height of 95.58 hPa: 15.9 to 17.0 km in the climates, 14.6 to 17.7 km in 96 real states."""
_FILE = "rrtmg_lw.npz"
_OWN = ("h2o", "o3", "n2o", "ch4")
_TABLE_CO2_PPM = 330.0
_COMPARED_PA = 100.0


@cache
def levels_m() -> FloatArray:
    """Return the altitudes at which thermal absorption is evaluated; shape (148,).

    0.5 km apart up to 30 km, 1 km to 70 km, 2 km to 100 km, and 100 m from 14 to 18 km, where the absorption jumps at
    95.58 hPa (:mod:`horizonval.earth.gases.rrtmg`). The error of the limb's radiance is within 0.07 % in 8 to 14 um and
    0.005 % in 14.0 to 16.3 um, 0.35 % in single bands right below the jump.
    """
    coarse = (np.arange(0.0, 30e3, 500.0), np.arange(30e3, 70e3, 1e3), np.arange(70e3, 100_001.0, 2e3))
    levels = np.unique(np.concatenate([*coarse, np.arange(SEAM_FROM_M, SEAM_TO_M + 1.0, 100.0)]))
    levels.setflags(write=False)
    return levels


def names() -> list[str]:
    """Return the names of the climates."""
    return [str(name) for name in npz(_FILE)["afgl_atmosphere"]]


def state(climate: str, altitude_m: FloatArray, co2_ppm: float = CO2_PPM) -> GasState:
    """Return a climate on altitudes (n,) from 0 to 120 km, arrays of shape (n,); without halocarbons."""
    rows = blended([{climate: 1.0}], altitude_m, co2_ppm)
    gases = {gas: x[0] for gas, x in rows.vmr.items()}
    return GasState(rows.altitude_m, rows.pressure_pa[0], rows.temperature_k[0], gases)


def blended(weights: Sequence[Mapping[str, float]], altitude_m: FloatArray, co2_ppm: float = CO2_PPM) -> GasState:
    """Return blends of climates, arrays of shape (m, n), without halocarbons.

    Temperatures are blended linearly, mixing ratios and the air's density in their logarithms, as in
    :func:`horizonval.earth.atmosphere.climate.blended`; the pressure follows from the ideal gas law.

    ``weights``: climates and their weights, of sum 1; ``altitude_m``: shape (n,), 0 to 120 km; ``co2_ppm``: of the
    lower atmosphere.
    """
    z = np.asarray(altitude_m, dtype=np.float64)
    known = names()
    share = np.zeros((len(weights), len(known)))
    for row, parts in enumerate(weights):
        for name, weight in parts.items():
            share[row, known.index(name)] = weight
    kelvin, ln_pressure, ln_gas = _on(tuple(z))
    temperature = share @ kelvin
    pressure = np.exp(share @ (ln_pressure - np.log(kelvin))) * temperature
    gases = {gas: np.exp(share @ values) for gas, values in ln_gas.items()}
    gases["co2"] *= co2_ppm / _TABLE_CO2_PPM
    return GasState(z, pressure, temperature, gases)


@cache
def _on(altitude_m: tuple[float, ...]) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """Return temperature, ln of pressure and ln of the mixing ratios of all climates, shape (6, n) each."""
    z, own = np.array(altitude_m), np.asarray(npz(_FILE)["afgl_altitude_m"])
    kelvin = np.stack([np.interp(z, own, row) for row in npz(_FILE)["afgl_temperature_k"]])
    ln_pressure = np.stack([np.interp(z, own, np.log(row)) for row in npz(_FILE)["afgl_pressure_pa"]])
    gases = {}
    for gas in (*_OWN, "co2", "hno3"):
        gases[gas] = np.stack([np.interp(z, own, np.log(row)) for row in _rows(gas)])
    return kelvin, ln_pressure, gases


def _rows(gas: str) -> FloatArray:
    """Return the mixing ratio of a gas in all climates at their own levels, shape (6, 50)."""
    if gas in _OWN:
        return np.asarray(npz(_FILE)[f"afgl_{gas}_vmr"])
    same = npz(_FILE)["afgl_co2_330ppm_vmr" if gas == "co2" else "afgl_hno3_vmr"]
    return np.broadcast_to(same, (len(names()), same.size))


def gases_at_pressure(climate: str, pressure_pa: FloatArray, co2_ppm: float = CO2_PPM) -> dict[str, FloatArray]:
    """Return a climate's mixing ratios at pressures of any shape: the default for gases that are not given."""
    row = names().index(climate)
    # Pressure falls with altitude; np.interp wants rising abscissae.
    own, at = -np.log(npz(_FILE)["afgl_pressure_pa"][row]), -np.log(pressure_pa)
    gases = {gas: np.exp(np.interp(at, own, np.log(_rows(gas)[row]))) for gas in (*_OWN, "co2", "hno3")}
    gases["co2"] *= co2_ppm / _TABLE_CO2_PPM
    return gases


def nearest_climate(pressure_pa: FloatArray, temperature_k: FloatArray) -> str:
    """Return the climate of the smallest rms difference in temperature at equal pressure, from the ground to 1 hPa.

    Each level of the column (n,) is weighted by its interval in the logarithm of pressure.
    """
    ln_p = np.log(pressure_pa)
    weight = np.abs(np.gradient(ln_p)) * (pressure_pa >= _COMPARED_PA)
    apart = []
    for p, t in zip(npz(_FILE)["afgl_pressure_pa"], npz(_FILE)["afgl_temperature_k"], strict=True):
        apart.append(weight @ (temperature_k - np.interp(-ln_p, -np.log(p), t)) ** 2)
    return names()[int(np.argmin(apart))]
