"""Refraction of a satellite's light on its way to a ground station: as it is, and as an observer takes it off.

**As it is.** In spherical layers ``n r sin z`` is constant along a ray (Bouguer). A ray that arrives at the apparent
elevation ``E`` has ``c = n0 r0 cos E`` and turns about the Earth's centre by ::

    phi(E) = int_{r0}^{r} c dr / (r sqrt(n^2 r^2 - c^2))

up to radius r. The apparent elevation is the one whose ``phi`` is the angle at the centre between station and
satellite: exact for a satellite at its finite distance. With the air of a scene, integrated by the trapezoidal rule.

**As it is taken off.** ``z = z' + A tan z' + B tan^3 z'`` (``erfa.refco`` of the observer's pressure and temperature)
leads to the direction of the ray above the air, which passes beside the station by ::

    delta = r0 (n0 sin z' - sin z),     n0 - 1 = A (1 + H / r0), H = 8 km

so that the direction to a satellite at distance d is higher by ``delta / d`` (0.6 arcsec sin z at 800 km).
"""

from __future__ import annotations

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

_SCALE_HEIGHT_M = 8000.0
_STEPS = 12


@dataclass(frozen=True)
class RefractingAir:
    """Refractivity n - 1, linear over height above a sphere, shape (n,) each; vacuum above."""

    altitude_m: FloatArray
    refractivity: FloatArray
    radius_m: float = 6_371_008.8


@dataclass(frozen=True)
class Correction:
    """What an observer knows of the air: A and B [rad] of ``erfa.refco`` and the height of the station [m]."""

    a: float
    b: float
    height_m: float

    @classmethod
    def of(cls, pressure_hpa: float, temperature_c: float, height_m: float, wavelength_um: float) -> Correction:
        """Build from dry air at the station."""
        a, b = erfa.refco(pressure_hpa, temperature_c, 0.0, wavelength_um)
        return cls(float(a), float(b), height_m)


def apparent_elevation(
    air: RefractingAir, height_m: float, elevation_rad: ArrayLike, distance_m: ArrayLike
) -> FloatArray:
    """Return the elevation under which something is seen, shape (...).

    Parameters
    ----------
    air : RefractingAir
    height_m : float
        Of the station, inside the air.
    elevation_rad, distance_m : array_like, shape (...)
        Straight line from the station, ending above the air. Elevation between 10 and 90 deg: near the horizon the
        secant steps that invert the integral could fail.
    """
    elevation, distance = np.broadcast_arrays(np.asarray(elevation_rad, float), np.asarray(distance_m, float))
    r0 = air.radius_m + height_m
    across, up = distance * np.cos(elevation), r0 + distance * np.sin(elevation)
    radius, central_angle = np.hypot(across, up), np.arctan2(across, up)
    above = air.altitude_m[air.altitude_m > height_m]
    r = air.radius_m + np.concatenate([[height_m], above])
    index = 1.0 + np.interp(r - air.radius_m, air.altitude_m, air.refractivity)

    def turned(apparent: FloatArray) -> FloatArray:
        c = (index[0] * r0 * np.cos(apparent))[..., None]
        # What bends: the difference to a straight ray with the same c, which is known in closed form.
        bent = c / (r * np.sqrt((index * r) ** 2 - c**2)) - c / (r * np.sqrt(r**2 - c**2))
        c = c[..., 0]
        return np.trapezoid(bent, r, axis=-1) + np.arccos(c / radius) - np.arccos(np.minimum(c / r0, 1.0))

    # n0 r0 cos E may exceed r0 only below 1.4 deg; the zenith is straight.
    first, second = elevation, elevation + 2.8e-4 / np.tan(np.maximum(elevation, 0.1)) + 1e-9
    y_first, y_second = turned(first) - central_angle, turned(second) - central_angle
    for _ in range(_STEPS):
        slope = y_second - y_first
        moved = np.abs(slope) > 0.0
        step = np.divide(y_second * (second - first), slope, out=np.zeros_like(slope), where=moved)
        first, y_first = second, y_second
        second = second - step
        y_second = turned(second) - central_angle
    return np.asarray(second)


def true_elevation(correction: Correction, apparent_rad: ArrayLike, distance_m: ArrayLike) -> FloatArray:
    """Return the elevation of the straight line to something seen at a distance, shape (...), as an observer would."""
    z_apparent = np.pi / 2 - np.asarray(apparent_rad, float)
    tangent = np.tan(z_apparent)
    z = z_apparent + correction.a * tangent + correction.b * tangent**3
    r0 = 6_371_008.8 + correction.height_m
    index = 1.0 + correction.a * (1.0 + _SCALE_HEIGHT_M / r0)
    beside = r0 * (index * np.sin(z_apparent) - np.sin(z))
    return np.asarray(np.pi / 2 - z + beside / np.asarray(distance_m, float))
