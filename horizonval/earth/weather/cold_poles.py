"""The troposphere over the poles, for air that is a blend of climates by latitude and month.

The coldest of the six AFGL climates is that of 60 N in January: over the Antarctic, and over the Arctic in winter, its
troposphere is 10 to 13 K too warm. There the temperature below :data:`FULL_TO_M` is that of
:mod:`horizonval.earth.weather.zonal_climate`, by the share that it has down to the ground; over the next 4 km the one
passes into the other. Densities of the air stay what they are, and with them light and all that is above; the pressure
follows from the ideal gas law, and columns are hydrostatic to 6 % where the climates' own are to 3 %. The relative
humidity stays, too: colder air is drier.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather.humidity import saturated_share
from horizonval.earth.weather.zonal_climate import polar_share, table_temperature_k

FULL_TO_M, NONE_FROM_M = 8e3, 12e3
"""The tropopause over both poles lies between: windows see what is below, bands of carbon dioxide what is above."""


def with_cold_poles(state: GasState, latitude_deg: FloatArray, month: float) -> GasState:
    """Return columns with the troposphere of the poles.

    Parameters
    ----------
    state : GasState
        Blends of climates, arrays of shape (m, n).
    latitude_deg : ndarray, shape (m,)
    month : float
        As :func:`horizonval.earth.atmosphere.climate.month_of` counts.
    """
    z, warm = state.altitude_m, state.temperature_k
    height = np.clip((NONE_FROM_M - z) / (NONE_FROM_M - FULL_TO_M), 0.0, 1.0)
    share = polar_share(latitude_deg, month)[:, None] * height
    kelvin = warm + share * (table_temperature_k(latitude_deg, month, z) - warm)
    pressure = state.pressure_pa * (kelvin / warm)
    drier = saturated_share(pressure, kelvin) / saturated_share(state.pressure_pa, warm)
    return replace(
        state, pressure_pa=pressure, temperature_k=kelvin, vmr={**state.vmr, "h2o": state.vmr["h2o"] * drier}
    )
