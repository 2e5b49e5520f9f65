"""Two airs side by side, and the light that they scatter once, summed straight along rays in double precision.

Which share of the air at a place is the second one is a function of the place's unit vector. Both airs are closed
forms: molecules fall off exponentially, ozone is a Gaussian layer. Points along a ray are even in its length, those on
the way from each of them to the Sun dense where that is lowest; sums are trapezoids. There is a sphere without
refraction. No code is shared with the renderer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Share = Callable[[Array], Array]
"""From unit vectors (..., 3) to the share of the second air."""
RADIUS_M, TOP_M = 6.371e6, 1.0e5


@dataclass(frozen=True)
class ClosedAir:
    """Scattering at the ground [1/m] and its scale height [m]; ozone's largest absorption [1/m], height and width."""

    scattering: float
    scale_m: float
    ozone: float
    layer_m: float
    width_m: float

    def molecules(self, height_m: Array) -> Array:
        return self.scattering * np.exp(-height_m / self.scale_m)

    def absorption(self, height_m: Array) -> Array:
        return self.ozone * np.exp(-(((height_m - self.layer_m) / self.width_m) ** 2))


SOUTH = ClosedAir(1.15e-5, 7800.0, 2.5e-7, 26e3, 6.5e3)
NORTH = ClosedAir(1.35e-5, 6900.0, 4.5e-7, 20e3, 6.5e3)
"""About the tropics and a subarctic winter at 550 nm."""


def coefficients(height_m: Array, share: Array) -> tuple[Array, Array]:
    """Return scattering and extinction; none above the top."""
    inside = height_m <= TOP_M
    scattering = (1.0 - share) * SOUTH.molecules(height_m) + share * NORTH.molecules(height_m)
    absorption = (1.0 - share) * SOUTH.absorption(height_m) + share * NORTH.absorption(height_m)
    return np.where(inside, scattering, 0.0), np.where(inside, scattering + absorption, 0.0)


def scattered_once(
    o: Array, d: Array, sun: Array, share_at: Share, *, own_column: bool, points: int = 1000, sun_points: int = 150
) -> float:
    """Return the radiance per irradiance along one ray that passes the ground.

    ``own_column``: on its way from the Sun light meets the air of the place where it is scattered; else the air of
    every place on the way.
    """
    middle = -o @ d
    miss2 = o @ o - middle**2
    assert miss2 > RADIUS_M**2
    half = np.sqrt((RADIUS_M + TOP_M) ** 2 - miss2)
    t = np.linspace(middle - half, middle + half, points)
    p = o + t[:, None] * d
    r = np.linalg.norm(p, axis=1)
    share = share_at(p / r[:, None])
    scattering, extinction = coefficients(r - RADIUS_M, share)

    forth = p @ sun
    sun_miss2 = r**2 - forth**2
    lit = (forth > 0.0) | (sun_miss2 > RADIUS_M**2)
    way = -forth + np.sqrt(np.maximum((RADIUS_M + TOP_M) ** 2 - sun_miss2, 0.0))
    # dense towards the lowest place of the way, or the beginning of one that only rises
    u = np.linspace(0.0, 1.0, sun_points)
    depth = np.zeros(points)
    for begin, end in ((np.zeros(points), np.clip(-forth, 0.0, way)), (np.clip(-forth, 0.0, way), way)):
        falling = begin == 0.0
        s = np.where((falling & (end < way))[:, None], 1.0 - (1.0 - u) ** 2, u**2)
        s = begin[:, None] + (end - begin)[:, None] * s
        q = p[:, None, :] + s[:, :, None] * sun
        height = np.linalg.norm(q, axis=2)
        q_share = share[:, None] if own_column else share_at(q / height[:, :, None])
        depth += np.trapezoid(coefficients(height - RADIUS_M, q_share)[1], s, axis=1)

    before = np.concatenate([[0.0], np.cumsum(0.5 * (extinction[1:] + extinction[:-1]) * np.diff(t))])
    phase = 3.0 / (16.0 * np.pi) * (1.0 + (d @ sun) ** 2)
    return float(np.trapezoid(scattering * phase * np.where(lit, np.exp(-depth - before), 0.0), t))
