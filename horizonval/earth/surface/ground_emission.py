"""What the ground and the clouds emit: temperature and emissivity, plain data that survives JSON bit by bit.

The temperature of land follows the Sun through the day: ``T = land_k + diurnal_k cos(H - lag)`` with H the hour angle
of the Sun at the place (0 at noon, positive in the afternoon) and ``lag`` :data:`LAG_RAD`; the sea and snow keep
theirs. A true skin rises faster after sunrise than it falls by night; the cosine has the right swing and phase only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface import emissivity

LAG_RAD = math.radians(22.5)
"""The ground is warmest an hour and a half after noon."""


@dataclass(frozen=True)
class GroundEmission:
    """Temperature and emissivity of everything a ray can end on.

    Attributes
    ----------
    kind : "uniform" or "earth"
    sin_latitude : tuple of float, length k
        Rising in equal steps from -1 to 1, of geodetic latitude. All temperatures below are linear between.
    land_k, snow_k, water_k : tuple of float, length k
        Daily mean temperature of land, of land under snow, of the sea. Equal for a uniform ground.
    diurnal_k : tuple of float, length k
        Amplitude of the daily swing of land.
    emissivity : float
        Of a uniform ground; that of an "earth" is :func:`horizonval.earth.surface.emissivity.emissivity`.
    cloud_emissivity : float
        Of cloud tops, which are as warm as the air there; what they do not emit they let through from below.
    """

    kind: str
    sin_latitude: tuple[float, ...]
    land_k: tuple[float, ...]
    snow_k: tuple[float, ...]
    water_k: tuple[float, ...]
    diurnal_k: tuple[float, ...]
    emissivity: float
    cloud_emissivity: float


def uniform_ground(temperature_k: float, emissivity: float, cloud_emissivity: float = 1.0) -> GroundEmission:
    """Return a ground that is the same everywhere and at all hours."""
    same = (temperature_k, temperature_k)
    return GroundEmission("uniform", (-1.0, 1.0), same, same, same, (0.0, 0.0), emissivity, cloud_emissivity)


def ground_k(ground: GroundEmission, kind: str, sin_latitude: ArrayLike, hour_angle: ArrayLike) -> FloatArray:
    """Return the temperature of a kind of ground.

    Parameters
    ----------
    ground : GroundEmission
    kind : str
        "land", "snow", "water" or "foam"; all the same on a uniform ground.
    sin_latitude : array_like
        Of the geodetic latitude.
    hour_angle : array_like
        Of the Sun at the place [rad]: 0 at noon, positive in the afternoon; broadcasts against the latitude.
    """
    at = np.asarray(sin_latitude, dtype=np.float64)
    means = {"land": ground.land_k, "snow": ground.snow_k, "water": ground.water_k, "foam": ground.water_k}
    mean = np.interp(at, ground.sin_latitude, means[kind])
    swing = np.interp(at, ground.sin_latitude, ground.diurnal_k) if kind == "land" else 0.0
    return np.asarray(mean + swing * np.cos(np.asarray(hour_angle, dtype=np.float64) - LAG_RAD))


def ground_emissivity(
    ground: GroundEmission, kind: str, wavelength_um: ArrayLike, cosine: ArrayLike = 1.0
) -> FloatArray:
    """Return the emissivity of a kind of ground.

    Parameters
    ----------
    ground : GroundEmission
    kind : str
        As for :func:`ground_k`.
    wavelength_um : array_like
    cosine : array_like
        Of the angle between the view and the vertical; broadcasts against the wavelength. Matters to water only.
    """
    wavelength, c = np.broadcast_arrays(np.asarray(wavelength_um, dtype=np.float64), np.asarray(cosine))
    if ground.kind == "uniform":
        return np.full(wavelength.shape, ground.emissivity)
    if kind in ("water", "foam"):
        return emissivity.water_emissivity(wavelength, c)
    return emissivity.emissivity(kind, wavelength)
