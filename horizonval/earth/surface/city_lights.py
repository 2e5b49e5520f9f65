"""Cities at night: upward radiance from the number of inhabitants.

Each of the thousand largest agglomerations is a round Gaussian of inhabitants, of standard deviation ``max(7 km, 4.5 km
(inhabitants / 10^6)^0.4)`` (built-up areas of 700 km2 for 3 million and 1600 for 10 million people; 7 km is the
resolution of the table of :data:`PER_DEGREE` cells to a degree). Each inhabitant has L lumens of outdoor lamps, of
which the share F goes above the horizontal and the rest falls on ground of reflectance G. At an angle z from the
vertical an inhabitant sends

    I(z) = L / (2 pi) [2 G (1 - F) cos z + 0.554 F z^4]    lm/sr,    L = 1000 lm, F = G = 0.15

(R. H. Garstang, Publ. Astron. Soc. Pacific 98, 364 (1986)). The radiance is inhabitants per area times ``I / cos z``,
cos z at least :data:`LEAST_COSINE` (which removes the tenth of the flux within 6 deg of the horizontal, as buildings
do). The spectrum is that of sodium lamps and white diodes in equal parts, rounded, 320 lm/W, from 0.4 to 0.8 um. Lamps
switch on from sunset until the Sun is 6 deg down, and burn all night.

This is right to a factor of two or three at best, as lamps per inhabitant differ between countries. Neglected: towns
and roads, fires, gas flares and fishing fleets, and scattering of this light by the air.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth import tables

LUMENS_PER_HEAD = 1000.0
UPWARD_SHARE, GROUND_REFLECTANCE = 0.15, 0.15
LEAST_COSINE = 0.1
ALL_ON_SINE = math.sin(math.radians(6.0))
"""Sine of the Sun's depth below the horizon at which all lamps burn."""
PER_DEGREE = 10
LEAST_SIGMA_KM, SIGMA_KM, SIGMA_POWER = 7.0, 4.5, 0.4
EARTH_RADIUS_KM = 6371.0

_SPECTRUM_UM = (0.40, 0.43, 0.45, 0.47, 0.49, 0.52, 0.55, 0.57, 0.585, 0.60, 0.62, 0.65, 0.70, 0.75, 0.80)
_SPECTRUM = (0.0, 0.10, 0.35, 0.20, 0.18, 0.30, 0.42, 0.75, 0.90, 1.00, 0.70, 0.35, 0.18, 0.08, 0.0)
_EYE_UM = (0.40, 0.43, 0.45, 0.47, 0.49, 0.51, 0.53, 0.555, 0.58, 0.60, 0.62, 0.64, 0.66, 0.68, 0.70, 0.75)
_EYE = (
    0.0004, 0.0116, 0.038, 0.091, 0.208, 0.503, 0.862, 1.0, 0.870, 0.631, 0.381, 0.175, 0.061, 0.017, 0.0041, 0.0001,
)  # fmt: skip
_LUMENS_PER_WATT = 683.0


@cache
def inhabitants_per_m2() -> FloatArray:
    """Return the density of inhabitants, shape (1800, 3600): rows from 90 S, columns eastward from 180 W."""
    latitude = (np.arange(180 * PER_DEGREE) + 0.5) / PER_DEGREE - 90.0
    longitude = (np.arange(360 * PER_DEGREE) + 0.5) / PER_DEGREE - 180.0
    km = math.radians(1.0) * EARTH_RADIUS_KM
    density = np.zeros((len(latitude), len(longitude)))
    for north, east, thousand in tables.csv("cities.csv").T:
        sigma = max(LEAST_SIGMA_KM, SIGMA_KM * (thousand / 1000.0) ** SIGMA_POWER)
        shrink = max(math.cos(math.radians(north)), 0.05)
        high, wide = (math.ceil(4.0 * sigma / km * PER_DEGREE / scale) for scale in (1.0, shrink))
        row, column = int((north + 90.0) * PER_DEGREE), int((east + 180.0) * PER_DEGREE)
        rows = np.arange(max(row - high, 0), min(row + high + 1, len(latitude)))
        columns = np.arange(column - wide, column + wide + 1) % len(longitude)
        across = (longitude[columns] - east + 180.0) % 360.0 - 180.0
        squared = (latitude[rows, None] - north) ** 2 + (shrink * across) ** 2
        blob = np.exp(-0.5 * squared * (km / sigma) ** 2)
        area = (1e3 * km / PER_DEGREE) ** 2 * np.cos(np.radians(latitude[rows, None]))
        density[np.ix_(rows, columns)] += 1e3 * thousand * blob / np.sum(blob * area)
    density.setflags(write=False)
    return density


def burning(mu_sun: ArrayLike) -> FloatArray:
    """Return the share of lamps that burn, at cosines of the Sun's zenith angle."""
    return np.clip(-np.asarray(mu_sun, dtype=np.float64) / ALL_ON_SINE, 0.0, 1.0)


def radiance_per_luminance(wavelength_um: float) -> float:
    """Return the spectral radiance [W m-2 sr-1 um-1] of a luminance of 1 lm m-2 sr-1."""
    return float(np.interp(wavelength_um, _SPECTRUM_UM, _SPECTRUM, left=0.0, right=0.0)) / _lumens()


@cache
def _lumens() -> float:
    """Return the luminous flux of the spectrum as tabulated."""
    um = np.linspace(0.4, 0.8, 4001)
    seen = np.interp(um, _SPECTRUM_UM, _SPECTRUM) * np.interp(um, _EYE_UM, _EYE, right=0.0)
    return _LUMENS_PER_WATT * float(np.sum(seen) * (um[1] - um[0]))
