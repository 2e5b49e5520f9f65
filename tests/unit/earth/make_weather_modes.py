"""Makes ``horizonval/earth/data/weather_modes.npz``: how the air of one column varies, from 96 real states.

For each class of latitude and season the deviations of the states from the climate, in temperature, ln ozone and ln
water vapour, less their mean, each divided by its standard deviation; then the singular vectors of all three together.
Six of them are kept and scaled so that at every level the squares add up to 1: what was left out is spread over them.

Run it as ``python tests/unit/earth/make_weather_modes.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import horizonval.earth
from horizonval.earth.atmosphere import climate
from horizonval.earth.tables import npz
from horizonval.earth.weather import real_states, zonal_climate
from horizonval.earth.weather.field import CLASSES, MODES, class_weights

STEP_M, TOP_M, SCALE_M = 2500.0, 65e3, 7000.0
WATER_TOP_M, OZONE_FLOOR_M = 15e3, 8e3


def deviations() -> tuple[np.ndarray, np.ndarray]:
    """Return classes (96,) and deviations from the climate (96, 3, levels): K, ln ozone, ln water vapour."""
    level = np.arange(0.0, TOP_M + 1.0, STEP_M)
    out = np.zeros((96, 3, len(level)))
    classes = []
    for n, name in enumerate(real_states.names()):
        s = real_states.real_state(name)
        month = climate.month_of(np.datetime64(s.date).astype("datetime64[s]").item())
        classes.append(int(np.argmax(class_weights([s.latitude_deg], month)[:, 0])))
        own = s.altitude_m >= s.surface_m - 1.0
        z, height = s.altitude_m[own], SCALE_M * np.log(101325.0 / s.pressure_pa[own])
        blend = climate.blended(climate.climate_weights(s.latitude_deg, month)).at(np.minimum(z, 119e3))
        usual = zonal_climate.temperature_k(
            np.array([s.latitude_deg]), month, np.minimum(z, 100e3), blend.temperature_k[None]
        )[0]
        by_pressure = climate.blended(climate.climate_weights(s.latitude_deg, month))

        def share(values: Any, at: np.ndarray = s.pressure_pa[own], of: Any = by_pressure) -> np.ndarray:
            return np.interp(-np.log(at), -np.log(of.pressure_pa), np.log(values / of.number_density_air))

        parts = (
            s.temperature_k[own] - usual,
            np.log(np.maximum(s.ozone_share[own], 1e-12)) - share(by_pressure.number_density_o3),
            np.log(s.water_share[own]) - share(by_pressure.number_density_h2o),
        )
        for k, values in enumerate(parts):
            out[n, k] = np.interp(level, height, values)
    out[:, 1, level < OZONE_FLOOR_M] = 0.0
    out[:, 2, level > WATER_TOP_M] = 0.0
    return np.array(classes), out


def made() -> dict[str, np.ndarray]:
    """Return the arrays of the table."""
    classes, all_parts = deviations()
    level = np.arange(0.0, TOP_M + 1.0, STEP_M)
    spread = np.zeros((len(CLASSES), 3, len(level)))
    modes = np.zeros((len(CLASSES), MODES, 3, len(level)))
    for c in range(len(CLASSES)):
        mine = all_parts[classes == c]
        mine = mine - mine.mean(axis=0)
        spread[c] = mine.std(axis=0)
        unit = (mine / np.maximum(spread[c], 1e-9)).reshape(len(mine), -1)
        _, strength, right = np.linalg.svd(unit, full_matrices=False)
        kept = (strength[:MODES, None] * right[:MODES] / np.sqrt(len(mine))).reshape(MODES, 3, -1)
        kept = kept * np.where(kept.sum(axis=(1, 2)) < 0.0, -1.0, 1.0)[:, None, None]
        modes[c] = kept / np.maximum(np.sqrt((kept**2).sum(axis=0)), 1e-9)
    return {
        "class_name": np.array(CLASSES),
        "count": np.bincount(classes, minlength=len(CLASSES)),
        "log_pressure_altitude_m": level,
        "spread": np.round(spread, 4).astype(np.float32),
        "modes": np.round(modes, 4).astype(np.float32),
    }


if __name__ == "__main__":
    np.savez_compressed(Path(horizonval.earth.__file__).parent / "data" / "weather_modes.npz", **made())
    npz.cache_clear()
