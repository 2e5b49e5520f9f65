r"""Where the rendered limb of a band is steepest, by blur and the Sun's place: made of the shipped profiles of it.

The profiles (:mod:`horizonval.estimation.likelihood.templates`) are of lines by the Sun's angles at *their own* lowest
points. Lines of one camera side by side across the limb have their lowest points at other places: that of a height
``h`` lies the angle ::

    d = acos((R + h) / r) - acos(R / r)

further from an observer at the distance ``r`` from the Earth's centre than that of the ground's horizon, and the Sun
stands otherwise there. A deep disc seen from afar so has another slope than one seen from near, and the table has the
distance as an axis. Between the places of the profiles logarithms are linear: in twilight light falls by an order of
magnitude in three degrees.

Heights are those of limbs without clouds: the mean of limbs with and without is the profile of neither, and is steep at
two places. What a sensor cannot know is taken from the table's modes: those that are alike along the limb of a low
orbit or more (haze, whether there are clouds at all, ground). A pattern is half of what the height changes by from one
standard deviation of a mode below to one above the mean. Air and single clouds, which vary along the limb, are left to
its relief (:mod:`horizonval.earth.limb_heights`).
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.height.band_heights import SEEN_FROM_M
from horizonval.estimation.likelihood.height.sunlit_profiles import (
    EARTH_RADIUS_M,
    FAINTEST,
    ZENITHS_RAD,
    seen_from,
    without_clouds,
)
from horizonval.estimation.likelihood.templates import LimbTemplates, shipped_templates
from horizonval.estimation.limb.model.steepest_height import steepest_height

ALTITUDES_M = (300e3, 700e3, 2000e3, 36000e3)
"""Of observers: from low orbits to the geostationary one; between them heights are linear in the slant."""
SIGMAS_M = np.geomspace(4e3, 512e3, 15)
"""A narrower blur sees the layers of one haze, which a mean over many has not."""
LEAST_LENGTH_RAD = math.radians(28.0)
"""At the Earth's centre, of modes that are patterns: half of the horizon of an orbit of 800 km measures as much."""
VISIBLE_UM = (0.45, 0.75)
"""Of a camera whose band nobody says."""


class SunlitHeights:
    """Heights of a band's steepest place, and their patterns, on a grid.

    Parameters
    ----------
    table : LimbTemplates
        Of a sunlit band.
    """

    def __init__(self, table: LimbTemplates) -> None:
        sheet = (np.log(SIGMAS_M), ZENITHS_RAD, table.axes[1])
        self._slants = [math.tan(math.asin(EARTH_RADIUS_M / (EARTH_RADIUS_M + up))) for up in ALTITUDES_M[::-1]]
        clear = without_clouds(table)
        mean = np.stack([_heights(table, clear[None], up)[0] for up in ALTITUDES_M[::-1]])
        long = table.modes[:, :, (table.correlation_rad >= LEAST_LENGTH_RAD).all(axis=(0, 2))]
        states = [
            np.maximum(table.mean + s * m, FAINTEST * table.mean) for m in np.moveaxis(long, 2, 0) for s in (1, -1)
        ]
        changed = _heights(table, np.array(states), SEEN_FROM_M)
        patterns = 0.5 * (changed[::2] - changed[1::2])
        outside = {"bounds_error": False, "fill_value": np.nan}
        self._mean = RegularGridInterpolator((self._slants, *sheet), mean, **outside)
        self._patterns = [RegularGridInterpolator(sheet, one, **outside) for one in patterns]

    def height_m(self, rho_rad: float, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return the heights, shape (n,), of points with a blur and the Sun's angles there; NaN where it is night.

        Parameters
        ----------
        rho_rad : float
            Angular radius of the Earth.
        sigma_m : ndarray, shape (n,)
            Wider and narrower blurs than the table's are taken for its last, as are nearer and farther observers.
        zenith, azimuth : ndarray, shape (n,)
        """
        slant = np.full(len(zenith), np.clip(math.tan(rho_rad), self._slants[0], self._slants[-1]))
        return np.asarray(self._mean(np.column_stack([slant, *_sheet(sigma_m, zenith, azimuth)])))

    def patterns_m(self, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return one standard deviation of every pattern, shape (k, n)."""
        at = np.column_stack(_sheet(sigma_m, zenith, azimuth))
        return np.array([pattern(at) for pattern in self._patterns])


def heights_of(band_um: tuple[float, float] | None) -> SunlitHeights:
    """Return the heights of a band; those of the visible one where no table is of it, or nobody says the band."""
    known = VISIBLE_UM if band_um is None else band_um
    return _made(known if shipped_templates("solar", known) is not None else VISIBLE_UM)


@cache
def _made(band_um: tuple[float, float]) -> SunlitHeights:
    table = shipped_templates("solar", band_um)
    assert table is not None
    return _of_table(table)


@cache
def _of_table(table: LimbTemplates) -> SunlitHeights:
    return SunlitHeights(table)


def _sheet(sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> list[FloatArray]:
    low, high = SIGMAS_M[0], SIGMAS_M[-1]
    return [np.log(np.clip(np.nan_to_num(sigma_m, nan=high), low, high)), zenith, azimuth]


def _heights(table: LimbTemplates, states: FloatArray, altitude_m: float) -> FloatArray:
    """Return the steepest heights of states (s, A, B, h), shape (s, sigma, A, B)."""
    seen = seen_from(table, np.log(np.maximum(states, 1e-300)), altitude_m)
    flat = np.exp(seen).reshape(-1, len(table.height_m))
    found = np.array([steepest_height(table.height_m, flat, float(sigma)) for sigma in SIGMAS_M])
    return np.moveaxis(found.reshape(len(SIGMAS_M), *seen.shape[:3]), 1, 0)
