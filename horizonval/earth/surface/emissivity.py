"""Emissivity of land, desert, snow and sea from 7 to 20 um.

**Land and snow** emit equally in all directions. Their spectra are rounded after published measurements. Land is 60 %
green vegetation (0.97 to 0.985) and 40 % dry soil with the quartz band at 8 to 9.5 um (shapes after J. W. Salisbury and
D. M. D'Aria, Remote Sens. Environ. 42, 83 (1992), and the ASTER spectral library, A. M. Baldridge et al., ibid. 113,
711 (2009)). Snow has medium grains: 0.985 to 0.995 (M. Hori et al., ibid. 100, 486 (2006)); real snow falls to 0.96 at
60 deg from the vertical. Desert is quartz sand with two bands of lattice vibrations (reststrahlen) at 8 to 9.5 um,
where bright deserts emit 0.7 to 0.8 (S. W. Seemann et al., J. Appl. Meteor. Climatol. 47, 108 (2008); G. C. Hulley et
al., Geophys. Res. Lett. 42, 7966 (2015)).

**Water** is flat and opaque: it emits what it does not reflect, ``e = 1 - (|r_s|^2 + |r_p|^2) / 2`` with Fresnel's
amplitudes for the complex index N = n + i k of G. M. Hale and M. R. Querry, Appl. Opt. 12, 555 (1973), 25 C,

    r_s = (c - w) / (c + w),   r_p = (N^2 c - w) / (N^2 c + w),   w = sqrt(N^2 - 1 + c^2)

c the cosine of the angle from the vertical: 0.993 at 11 um straight down, 0 towards grazing. Salt changes N by less
than 0.01 (D. Friedman, Appl. Opt. 8, 2073 (1969)); foam emits like water. Waves are neglected: under a wind of 7 m/s
(slopes of Cox and Munk) the emissivity at 8 to 15 um is 0.006 lower at 60 deg, 0.02 to 0.04 higher at 75 deg, 0.1
higher at 80 deg, and 0.5 to 0.65 at the horizon. Reflected sky replaces what a flat sea does not emit, and beyond 80
deg the air hides most of the difference, except in 10 to 12.5 um and 8 to 9 um over a cold, dry place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError

KINDS = ("land", "desert", "snow", "water", "foam")
VEGETATION_SHARE = 0.6
"""Share of vegetation in land; the rest is dry soil."""

_SPECTRA = {
    "vegetation": (
        (7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 14.0, 17.0, 20.0),
        (0.970, 0.975, 0.975, 0.980, 0.980, 0.985, 0.985, 0.980, 0.975),
    ),
    "soil": (
        (7.0, 7.5, 8.0, 8.3, 9.2, 9.6, 10.0, 10.8, 12.0, 12.6, 13.0, 14.0, 17.0, 19.0, 20.0),
        (0.95, 0.96, 0.90, 0.87, 0.88, 0.93, 0.95, 0.965, 0.97, 0.955, 0.97, 0.97, 0.96, 0.95, 0.92),
    ),
    "desert": (
        (7.0, 7.5, 7.9, 8.2, 8.6, 8.8, 9.2, 9.6, 10.0, 10.8, 12.0, 12.6, 13.0, 14.0, 17.0, 19.0, 20.0),
        (0.94, 0.95, 0.83, 0.74, 0.77, 0.75, 0.76, 0.89, 0.93, 0.955, 0.97, 0.95, 0.965, 0.965, 0.955, 0.94, 0.90),
    ),
    "snow": (
        (7.0, 9.0, 10.5, 11.0, 12.5, 14.0, 17.0, 20.0),
        (0.985, 0.990, 0.995, 0.993, 0.985, 0.985, 0.988, 0.988),
    ),
}
_WATER_UM = (
    7.0, 7.5, 8.0, 8.4, 8.8, 9.2, 9.6, 10.0, 10.5, 11.0, 11.5, 12.0, 12.5, 13.0, 13.5, 14.0, 14.5, 15.0, 15.5, 16.0,
    16.5, 17.0, 17.5, 18.0, 18.5, 19.0, 19.5, 20.0,
)  # fmt: skip
_WATER_N = (
    1.317, 1.304, 1.291, 1.281, 1.269, 1.255, 1.239, 1.218, 1.185, 1.153, 1.126, 1.111, 1.123, 1.146, 1.177, 1.210,
    1.241, 1.270, 1.297, 1.325, 1.351, 1.376, 1.401, 1.423, 1.443, 1.461, 1.476, 1.480,
)  # fmt: skip
_WATER_K = (
    0.0320, 0.0326, 0.0343, 0.0361, 0.0385, 0.0415, 0.0454, 0.0508, 0.0662, 0.0968, 0.142, 0.199, 0.259, 0.305, 0.343,
    0.370, 0.388, 0.402, 0.414, 0.422, 0.428, 0.429, 0.429, 0.426, 0.421, 0.414, 0.404, 0.393,
)  # fmt: skip
MIN_UM, MAX_UM = 7.0, 20.0


def emissivity(kind: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the emissivity of a kind of :data:`KINDS`, constant beyond 7 and 20 um; of water and foam at nadir."""
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    if kind in ("water", "foam"):
        return water_emissivity(wavelength, 1.0)
    if kind == "land":
        plants, soil = (np.interp(wavelength, *_SPECTRA[name]) for name in ("vegetation", "soil"))
        return np.asarray(VEGETATION_SHARE * plants + (1.0 - VEGETATION_SHARE) * soil)
    if kind in ("desert", "snow"):
        return np.interp(wavelength, *_SPECTRA[kind])
    raise UserError(f"unknown kind of ground {kind!r}", expected="one of " + ", ".join(KINDS))


def water_index(wavelength_um: ArrayLike) -> np.ndarray:
    """Return the complex index n + i k of water, linear between the wavelengths of the table."""
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    return np.interp(wavelength, _WATER_UM, _WATER_N) + 1j * np.interp(wavelength, _WATER_UM, _WATER_K)


def water_emissivity(wavelength_um: ArrayLike, cosine: ArrayLike) -> FloatArray:
    """Return the emissivity of flat water at cosines of the angle between view and vertical, which broadcast."""
    square = water_index(wavelength_um) ** 2
    c = np.clip(np.asarray(cosine, dtype=np.float64), 0.0, 1.0)
    w = np.sqrt(square - 1.0 + c * c)
    across = np.abs((c - w) / (c + w)) ** 2
    along = np.abs((square * c - w) / (square * c + w)) ** 2
    return np.asarray(1.0 - 0.5 * (across + along))
