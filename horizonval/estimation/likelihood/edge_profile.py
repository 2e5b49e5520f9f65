r"""How bright a pixel at a distance across the limb is: a step or a soft limb, seen through a lens by a square pixel.

Inside the limb the sky is 1; outside it falls as ``exp(-height / H)``, at once where the scale height is zero. The lens
blurs it by a Gaussian, the pixel by its own square. A square has the second moment 1/12 px^2 in every direction, so
that both together are, to third order, one Gaussian of variance ``s^2 = s_lens^2 + 1/12``. With ``x`` the distance
inside the limb and ``c`` the scale height, both in pixels, and ``g = exp(x / c + s^2 / (2 c^2)) Phi(-x / s - s / c)``::

    E = Phi(x / s) + g          E' = g / c           (hard limb: E = Phi(x / s), E' = phi(x / s) / s)
    dE/ds = s E''               E'' = (g / c - phi(x / s) / s) / c
    dE/dc = s phi(x / s) / c^2 - g (x c + s^2) / c^3

**Neglected.** The square's fourth cumulant, -1/120 px^4 along its sides, changes ``E`` by at most 7e-4 of the step for
a lens of 0.7 px and by 1 % for one of 0.25 px; the change is odd in ``x``, so that it widens the edge and does not move
it. A limb bent with the radius ``b`` px is moved by ``s^2 / (2 b)``; :mod:`.pixels` takes that into account.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, ndtr

from horizonval.core.arrays import FloatArray

PIXEL_VARIANCE = 1.0 / 12.0
"""Of a square of one pixel, along any direction [px^2]."""
SMALLEST_SCALE = 0.05
"""Of a soft limb, in widths of the blur: below it the limb is hard to a thousandth of the step, and the terms of a soft
one cancel."""


@dataclass(frozen=True)
class EdgeProfile:
    """Of n pixels, shape (n,) each.

    Attributes
    ----------
    level : ndarray
        From 0 in space to 1 on the Earth.
    slope : ndarray
        By the distance inside the limb [1/px].
    by_blur, by_scale : ndarray
        By the blur and by the scale height [1/px].
    """

    level: FloatArray
    slope: FloatArray
    by_blur: FloatArray
    by_scale: FloatArray


def edge_profile(x: FloatArray, blur: float, scale: FloatArray | None = None) -> EdgeProfile:
    """Return the levels of pixels across the limb.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Distance of the pixels' centres inside the limb [px].
    blur : float
        Standard deviation of lens and pixel together [px].
    scale : ndarray, shape (n,), optional
        Scale height of the soft limb as it is seen [px]; None for a hard one.
    """
    z = x / blur
    bell = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
    step = ndtr(z)
    if scale is None:
        return EdgeProfile(step, bell / blur, -z * bell / blur, np.zeros_like(x))
    c = np.maximum(scale, SMALLEST_SCALE * blur)
    y = z + blur / c
    # exp(x/c + s^2/(2c^2)) Phi(-y) = phi(z) Phi(-y) / phi(y); inside, where y is large, by the scaled function.
    inside = y > 0.0
    with np.errstate(over="ignore"):
        outer = np.exp(np.minimum(z * blur / c + 0.5 * (blur / c) ** 2, 0.0)) * ndtr(-y)
    g = np.where(inside, bell * np.sqrt(0.5 * np.pi) * erfcx(np.maximum(y, 0.0) / np.sqrt(2.0)), outer)
    return EdgeProfile(
        level=step + g,
        slope=g / c,
        by_blur=(blur * g / c - bell) / c,
        by_scale=blur * bell / c**2 - g * (x * c + blur * blur) / c**3,
    )
