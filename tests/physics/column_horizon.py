"""The infrared horizon of single columns of air: radiance of a sphere's limb, and where it falls to half or to a level.

Straight rays past a sphere of 6371 km, the same air all along a ray; carbon dioxide 420 ppm, 14.0 to 16.3 um.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import thermal_absorption
from horizonval.geometry.ellipsoid import sphere
from horizonval.spec.camera import CameraSpec
from horizonval.suites.stability import highest_crossing
from horizonval.truth.infrared_radiance import BandMedium, RayPath, limb_radiances, ray_paths

EARTH = sphere(6.371e6)
CAMERA_M = np.array([6.371e6 + 500e3, 0.0, 0.0])
HEIGHT_M = np.concatenate([np.arange(10e3, 24.1e3, 2e3), np.arange(26e3, 62e3, 1.5e3), [66e3, 72e3, 80e3]])
GRID_M = np.linspace(0.0, 1e5, 251)
LEVEL_M = np.concatenate([np.arange(0.0, 14e3, 1e3), np.arange(14e3, 18e3, 250.0), np.arange(18e3, 50e3, 1e3),
                          np.arange(50e3, 1e5 + 1.0, 2e3)])  # fmt: skip
BAND = {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}


@cache
def _paths() -> list[RayPath]:
    return ray_paths(CAMERA_M, EARTH, np.zeros(1), HEIGHT_M, float(GRID_M[-1]))


def limb(state: GasState) -> FloatArray:
    """Return the radiance [W m-2 sr-1], shape (c, heights), of the limbs of columns on :data:`LEVEL_M`."""
    camera = CameraSpec.model_validate({"camera": {"width": 4, "height": 4, "fov_deg": 20.0}, "band": [BAND]})
    points = thermal_absorption.g_points(camera.band[0], where="")
    ln_k = points.ln_absorption(state)
    rows = []
    for c in range(len(state.temperature_k)):
        band = EmittingBand(
            name="co2",
            wavelength_um=points.wavelength_um,
            altitude_m=GRID_M,
            sin_latitude=np.zeros(1),
            level_m=state.altitude_m,
            ln_extinction=ln_k[:, c : c + 1],
            temperature_k=state.temperature_k[c : c + 1],
            source_wavenumber_per_cm=points.wavenumber_per_cm,
            source_weight_per_cm=points.weight_per_cm,
            sun_radiance=np.zeros(len(points.wavelength_um)),
        )
        rows.append(limb_radiances([BandMedium(band)], _paths())[0][0])
    return np.array(rows)


def half_plateau_m(radiance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height of half of the plateau [m] and the plateau, the brightest from 10 to 24 km."""
    plateau = radiance[:, HEIGHT_M <= 24.1e3].max(axis=1)
    return highest_crossing(HEIGHT_M, radiance, 0.5 * plateau), plateau


def level_m(radiance: FloatArray, level: float) -> FloatArray:
    """Return the height [m] at which the limb falls to a radiance [W m-2 sr-1]."""
    return highest_crossing(HEIGHT_M, radiance, level)
