"""Light that rough and dusty lens surfaces scatter out of the image: the wings of the point spread.

The whole lens is one scattering surface, seen in object space. Its bidirectional scatter depends on how far the light
leaves from its specular way, counted in direction cosines (Harvey and Shack's shift-invariant form, with the three
parameters that ray-tracing programs call ABg; J. E. Harvey, *Light-Scattering Characteristics of Optical Surfaces*,
thesis, University of Arizona, 1976)::

    BSDF(x) = b0 (1 + (x / l)^2)^(s / 2)   [1/sr],      x = |beta - beta0|

    TIS = 2 pi integral BSDF x dx = 2 pi b0 l^2 / (s + 2) ((1 + 1 / l^2)^(s / 2 + 1) - 1)

up to x = 1 (s = -2: ``pi b0 l^2 ln(1 + 1 / l^2)``). On the detector of a pinhole camera, a pixel at the offset
``rho = r / f`` from a point on the axis gets the share ::

    K(rho) = BSDF(rho / sqrt(1 + rho^2)) / (1 + rho^2)^2 (pitch / f)^2

of its light, the second factor being the projected solid angle of the pixel; over the whole plane that is TIS. The
point itself keeps 1 - TIS. The same kernel is used over the whole field. From a point at theta off the axis the middle
of the image then gets ``cos^4(theta)`` of what it should (0.56 at 30 deg, 0.78 at 20 deg); no light is lost or made by
it.

Neglected: change of the scatter with the wavelength inside a band (``lambda^-2`` for polish, flat for dust), and light
that is scattered twice (TIS^2).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral.quadrature import composite_gauss
from horizonval.spec.optics import Scatter, scatter_integral

_NEAR_PX = 8


def bsdf(scatter: Scatter, x: FloatArray) -> FloatArray:
    """Return the bidirectional scatter [1/sr] at differences ``x`` of direction cosines, 0 to 1, shape of ``x``."""
    return scatter.level * (1 + (x / scatter.l_rad) ** 2) ** (scatter.s / 2)


def image_share(scatter: Scatter, rho_squared: FloatArray) -> FloatArray:
    """Return the share of a point's light per area of the image in squared focal lengths, from ``(r / f)^2``."""
    grown = 1 + rho_squared
    return bsdf(scatter, np.sqrt(rho_squared / grown)) / grown**2


def share_in_rectangle(scatter: Scatter, half_x: float, half_y: float) -> float:
    """Return the share of a point's light that is scattered into a rectangle around it.

    Exact over the distance, by Gauss' rule over the angle.
    """
    corner = math.atan2(half_y, half_x)
    total = 0.0
    for side, end in ((half_x, corner), (half_y, math.pi / 2 - corner)):
        angle, weight = composite_gauss(np.array([0.0, end]), 96)
        for a, w in zip(angle.ravel(), weight.ravel(), strict=True):
            rho = side / math.cos(a)
            total += w * scatter_integral(scatter.l_rad, scatter.s, rho / math.sqrt(1 + rho * rho)) / (2 * math.pi)
    return 4 * scatter.level * total


@lru_cache(maxsize=2)
def quadrant(scatter: Scatter, rows: int, columns: int, fx: float, fy: float) -> FloatArray:
    """Return the share of a point's light per pixel at offsets (0..rows - 1, 0..columns - 1), read-only.

    Means over the pixel near the point, values at the centre farther out, and scaled (by 1e-4 or so) to hold exactly
    what the formula scatters into the rectangle of all offsets.
    """
    y, x = np.arange(rows)[:, None] / fy, np.arange(columns)[None, :] / fx
    share = image_share(scatter, x * x + y * y) / (fx * fy)
    share[:_NEAR_PX, :_NEAR_PX] = _pixel_means(scatter, min(rows, _NEAR_PX), min(columns, _NEAR_PX), fx, fy)
    half_x, half_y = (columns - 0.5) / fx, (rows - 0.5) / fy
    share *= share_in_rectangle(scatter, half_x, half_y) / quadrant_sum(share)
    share.flags.writeable = False
    return share


def quadrant_sum(values: FloatArray) -> float:
    """Return the sum over all four quadrants of a kernel that is even in both offsets."""
    return float(4 * values.sum() - 2 * values[0].sum() - 2 * values[:, 0].sum() + values[0, 0])


def _pixel_means(scatter: Scatter, rows: int, columns: int, fx: float, fy: float) -> FloatArray:
    point, weight = composite_gauss(np.array([-0.5, 0.0, 0.5]), 6)
    point, weight = point.ravel(), weight.ravel()
    y = (np.arange(rows)[:, None] + point) / fy
    x = (np.arange(columns)[:, None] + point) / fx
    share = image_share(scatter, y[:, :, None, None] ** 2 + x[None, None] ** 2)
    means = np.einsum("iajb,a,b->ij", share, weight, weight) / (fx * fy)
    means[0, 0] = share_in_rectangle(scatter, 0.5 / fx, 0.5 / fy)
    return means
