r"""At which height a blurred profile of the limb is steepest.

A profile is a polygon over the height ``z``, level below its first height, with the bends ``D_j`` at ``z_j``; above the
last its light fades over a kilometre. Blurred by a Gaussian of ``s`` it falls at ``x`` by ::

    -P_s'(x) = - sum_j D_j Phi((x - z_j) / s)

with ``Phi`` the normal distribution, and the place where that is largest is what a search for the steepest place of an
edge finds. Between the places of a search's grid it is that of a parabola.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray

TYPICAL_M = 20e3
"""Where the search has its middle: sunlit limbs are steepest from the ground to some 40 km."""
SEARCH_SIGMAS = 5.0
"""As far as the guard looks for the steepest place: six pixels, of 1.25 pixels of blur."""
LEAST_REACH_M = 35e3
"""From the typical height, however narrow the blur: 55 km, above which no band shines."""
STEPS = 5.0
"""Of the search's grid in a blur: the parabola between them leaves a thousandth of the blur."""
FADE_M = 1e3
"""Over which the light of the last height fades: one step of the shipped tables."""


def steepest_height(height_m: FloatArray, profiles: FloatArray, sigma_m: float) -> FloatArray:
    """Return the heights [m], shape (n,); NaN where a profile has no steepest place within reach.

    Parameters
    ----------
    height_m : ndarray, shape (h,)
        Rising.
    profiles : ndarray, shape (n, h)
    sigma_m : float
        Of the blur.
    """
    slopes = np.diff(profiles, axis=1) / np.diff(height_m)
    ends = np.zeros((len(profiles), 1))
    slopes = np.concatenate([ends, slopes, -profiles[:, -1:] / FADE_M, ends], axis=1)
    places = np.append(height_m, height_m[-1] + FADE_M)
    reach = max(SEARCH_SIGMAS * sigma_m, LEAST_REACH_M)
    step = sigma_m / STEPS
    x = np.arange(TYPICAL_M - reach, TYPICAL_M + reach, step)
    fall = -np.diff(slopes, axis=1) @ ndtr((x[None, :] - places[:, None]) / sigma_m)
    best = np.argmax(fall, axis=1)
    inside = (best > 0) & (best < len(x) - 1)
    best = np.clip(best, 1, len(x) - 2)
    row = np.arange(len(fall))
    before, middle, after = fall[row, best - 1], fall[row, best], fall[row, best + 1]
    bent = before - 2.0 * middle + after
    found = x[best] + 0.5 * step * (before - after) / np.where(bent < 0.0, bent, -1.0)
    return np.where(inside & (middle > 0.0) & (bent < 0.0), found, np.nan)
