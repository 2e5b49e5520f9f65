r"""At which height a fit of an exponential edge places a profile of the limb that is none.

A fit (:mod:`horizonval.estimation.likelihood.fit`) takes the pixels across a limb for ``b + (a + c x + d x^2) E(x)``,
with ``E`` the edge of :mod:`horizonval.estimation.likelihood.edge_profile`. Of a rendered profile, blurred by lens and
pixel, the levels are solved for at every height of a grid, and the height is that which leaves least, by the parabola
through its neighbours. The scale height is that of the fit's prior: where pixels are larger than it only the middle of
the light is seen, the edge's height and the scale height together, and where they are smaller that middle is kept by
what a fit makes of the two.

What is left over says how little the profile is of that shape.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.edge_profile import PIXEL_VARIANCE, edge_profile
from horizonval.estimation.likelihood.light import light_basis
from horizonval.estimation.likelihood.limb_pixels import INSIDE_PX, OUTSIDE_PX, OUTSIDE_SCALES

LOWEST_M, HIGHEST_M = -20e3, 60e3
"""Of an edge: no band's light lies outside of it."""
STEP_M, STEP_PX = 1e3, 0.05
"""Of the grid of heights, whichever is wider; the parabola leaves a hundredth of it."""
BETWEEN_PX = 0.5
"""Of the places at which a profile is read: a lens of 0.7 px leaves nothing that is finer."""
LEVELS = 4
"""Of the light, those of one place: the others are of its change along the limb."""


def edge_height(
    height_m: FloatArray, profiles: FloatArray, pixel_m: float, blur_px: float, scale_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the heights [m] and the root mean square of what is left, of a profile's span, shape (n,) each.

    Parameters
    ----------
    height_m : ndarray, shape (h,)
        Rising.
    profiles : ndarray, shape (n, h)
        Straight between the heights; nothing shines above the last.
    pixel_m : float
        Of height in a pixel at the limb.
    blur_px : float
        Of the lens, standard deviation.
    scale_m : float
        Scale height of the edge.
    """
    blur = float(np.sqrt(blur_px**2 + PIXEL_VARIANCE))
    soft = scale_m / pixel_m
    x = np.arange(-OUTSIDE_PX - OUTSIDE_SCALES * soft, INSIDE_PX, BETWEEN_PX)
    middle = 0.5 * (LOWEST_M + HIGHEST_M)
    seen = _blurred(height_m, profiles, middle - x * pixel_m, blur * pixel_m)
    span = np.ptp(seen, axis=1)
    heights = np.arange(LOWEST_M, HIGHEST_M, max(STEP_M, STEP_PX * pixel_m))
    total = np.einsum("ij,ij->i", seen, seen)
    left = np.empty((len(profiles), len(heights)))
    for k, height in enumerate(heights):
        inside = x + (height - middle) / pixel_m
        edge = edge_profile(inside, blur, np.full(len(x), soft)).level
        basis = light_basis(edge, inside, np.zeros_like(x))[:LEVELS]
        explained = seen @ np.linalg.qr(basis.T)[0]
        left[:, k] = total - np.einsum("ij,ij->i", explained, explained)
    best = np.clip(np.argmin(left, axis=1), 1, len(heights) - 2)
    row = np.arange(len(left))
    before, at, after = left[row, best - 1], left[row, best], left[row, best + 1]
    bent = before - 2.0 * at + after
    share = np.clip(0.5 * (before - after) / np.where(bent > 0.0, bent, np.inf), -0.5, 0.5)
    lowest = np.maximum(at - 0.25 * (before - after) * share, 0.0)
    return heights[best] + (heights[1] - heights[0]) * share, np.sqrt(lowest / len(x)) / np.maximum(span, 1e-300)


def _blurred(height_m: FloatArray, profiles: FloatArray, at_m: FloatArray, sigma_m: float) -> FloatArray:
    """Return profiles (n, h) blurred by a Gaussian, at heights (m,), shape (n, m).

    A profile is a polygon: level below its first height, with the bends ``D_j`` at ``z_j``. A bend blurred is ``D_j``
    times the integral of ``Phi((z - z_j) / s)``.
    """
    places = np.append(height_m, height_m[-1] + STEP_M)
    values = np.concatenate([profiles, np.zeros((len(profiles), 1))], axis=1)
    slopes = np.diff(values, axis=1) / np.diff(places)
    ends = np.zeros((len(profiles), 1))
    bends = np.diff(np.concatenate([ends, slopes, ends], axis=1), axis=1)
    z = (at_m[None, :] - places[:, None]) / sigma_m
    ramp = sigma_m * (z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))
    return np.asarray(profiles[:, :1] + bends @ ramp)
