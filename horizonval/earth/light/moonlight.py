"""The Moon's irradiance, its colour, and its distribution over the disc.

**Magnitude** (C. W. Allen, *Astrophysical Quantities*, 3rd ed. 1976, section 66; the same law in Krisciunas and
Schaefer, PASP 103, 1033 (1991), eq. 9), for a phase angle a in degrees and distances in au::

    V = +0.21 + 5 lg(r Delta) + 0.026 |a| + 4e-9 a^4

-12.74 for the full Moon at its mean distance, against -26.75 for the Sun at 1 au. Neglected: the opposition surge below
a = 5 deg (up to 0.3 mag brighter), waxing and waning (0.1 mag), libration (a few per cent), polarisation. The law is
fitted to phase angles up to about 150 deg; closer to new Moon the irradiance is negligible.

**Colour.** B - V is 0.92 for the Moon (Allen) and 0.65 for the Sun, so the albedo is proportional to the wavelength to
the power 1.1 in the blue; towards 1 um to the power 0.8 (ratio 1.6 of 1.0 to 0.55 um, as in the ROLO model: Kieffer and
Stone, AJ 129, 2887 (2005)). Constant beyond 1.1 um. Good to some 10 % at 0.4 and 1 um.

**Disc.** Radiance follows Lommel and Seeliger, ``mu0 / (mu0 + mu)`` between terminator and limb: a full Moon as bright
at the edge as in the middle. Its mean over the disc has a closed form (Hapke, *Theory of reflectance*, 2012, section
11.3), which scales the disc to the magnitude. Maria, earthshine and the Moon's thermal emission are neglected.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

V_SUN = -26.75
V_MOON_UNIT = 0.21
"""V of the full Moon at 1 au from Sun and observer."""
V_UM = 0.55
BLUE_SLOPE, RED_SLOPE = 1.1, 0.8
RED_END_UM = 1.1


def magnitude(phase_rad: float, sun_distance_au: float, distance_au: float) -> float:
    """Return the Moon's V; ``sun_distance_au``: from Sun to Moon, ``distance_au``: from Moon to observer."""
    a = abs(math.degrees(phase_rad))
    return V_MOON_UNIT + 5.0 * math.log10(sun_distance_au * distance_au) + 0.026 * a + 4e-9 * a**4


def colour(wavelength_um: ArrayLike) -> FloatArray:
    """Return the albedo relative to that at 0.55 um."""
    wavelength = np.minimum(np.asarray(wavelength_um, float), RED_END_UM) / V_UM
    return wavelength ** np.where(wavelength < 1.0, BLUE_SLOPE, RED_SLOPE)


def irradiance_ratio(
    wavelength_um: ArrayLike, phase_rad: float, sun_moon_au: float, moon_au: float, sun_au: float
) -> FloatArray:
    """Return the Moon's spectral irradiance over the Sun's, across the rays, outside the atmosphere.

    ``phase_rad``: angle at the Moon between Sun and observer. Distances from the Sun to the Moon, from the Moon to the
    observer, and from the Sun to the point of reference.
    """
    return 10.0 ** (0.4 * (V_SUN - magnitude(phase_rad, sun_moon_au, moon_au))) * sun_au**2 * colour(wavelength_um)
