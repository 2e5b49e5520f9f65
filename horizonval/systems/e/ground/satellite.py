"""How bright a satellite is: sunlight that a diffuse body sends down, and what the air leaves of it.

A convex body that tumbles shows on average a quarter of its surface (Cauchy). Its light is taken to be that of a
diffuse (Lambert) sphere of that cross-section A and albedo rho; at phase angle a and distance d::

    E = E_sun (rho A / d^2) (2 / 3 pi) (sin a + (pi - a) cos a) / pi

Neglected: glints, the shadow of one part on another, earthshine (a few per cent), and where on the satellite the
light comes from: up to some metres beside its centre of mass, 0.8 arcsec for 3 m at 800 km.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel

SUN_MAGNITUDE = -26.74
"""Of the Sun in V at 1 au (Willmer, ApJS 236, 47 (2018): -26.76; -26.74 by tradition)."""


@dataclass(frozen=True)
class Brightness:
    """A satellite's parts: cross-sections [m2] and diffuse albedos, shape (k,) each."""

    cross_section_m2: tuple[float, ...]
    albedo: tuple[float, ...]

    @property
    def reflecting_m2(self) -> float:
        """Cross-section times albedo."""
        return math.fsum(a * rho for a, rho in zip(self.cross_section_m2, self.albedo, strict=True))


def box_cross_section_m2(x_m: float, y_m: float, z_m: float) -> float:
    """Return the mean cross-section of a box (of a plate where one side is 0) over all directions: surface / 4."""
    return (x_m * y_m + y_m * z_m + z_m * x_m) / 2.0


ENVISAT = Brightness((box_cross_section_m2(10.0, 4.6, 4.6), box_cross_section_m2(14.0, 5.0, 0.0)), (0.15, 0.06))
"""Body of 10 x 4.6 x 4.6 m and solar array of 14 x 5 m. The albedos are assumed: foil in folds, and dark cells. They
give the standard magnitude that observers' lists have, about 3.7, which single passes leave by a magnitude and more."""


def sunlight_share(body: Brightness, phase_rad: ArrayLike, distance_m: ArrayLike) -> FloatArray:
    """Return the satellite's irradiance at the observer over the Sun's at the satellite, outside the air.

    ``phase_rad`` is the angle at the satellite between Sun and observer.
    """
    a, d = np.asarray(phase_rad, float), np.asarray(distance_m, float)
    law = (np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi
    return np.asarray(body.reflecting_m2 * 2.0 / (3.0 * np.pi) * law / d**2)


def magnitude(share: ArrayLike) -> FloatArray:
    """Return the magnitude of something as bright as this share of the Sun."""
    return np.asarray(SUN_MAGNITUDE - 2.5 * np.log10(np.asarray(share, float)))


def standard_magnitude(body: Brightness) -> float:
    """Return the magnitude outside the air at 1000 km, half lit (phase 90 deg)."""
    return float(magnitude(sunlight_share(body, math.pi / 2, 1e6)))


def sunlight_through_air(
    model: OpticalModel, band: str, height_m: float, elevation_rad: ArrayLike
) -> tuple[FloatArray, float]:
    """Return a band's sunlight [W m-2] after the air above a station, shape (...), and before it.

    Along straight rays in spherical layers; light scattered back into the beam is neglected.
    """
    sine = np.sin(np.asarray(elevation_rad, float))[..., None]
    z = np.concatenate([[height_m], model.altitude_m[model.altitude_m > height_m]])
    radius = 6_371_008.8
    slant = (radius + z) / np.sqrt((radius + z) ** 2 - (radius + height_m) ** 2 * (1.0 - sine**2))
    after: FloatArray = np.zeros(sine.shape[:-1])
    before = 0.0
    for node in model.nodes:
        if node.band == band:
            extinction = np.interp(z, model.altitude_m, node.extinction_per_m)
            depth = np.trapezoid(extinction * slant, z, axis=-1)
            light = node.weight * node.solar_irradiance
            after, before = after + light * np.exp(-depth), before + light
    return after, before
