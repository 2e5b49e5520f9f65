"""The horizon as the published arc methods see it: the longest edge, and a circle through it.

**Circle** (Taubin's algebraic fit). A circle is ``a (x^2 + y^2) + b x + c y + d = 0``. The fit minimises the sum of
squares of the left side over the sum of squares of its gradient, which is the distance of the points to first order
(Taubin, IEEE Trans. PAMI 13, 1115, 1991). On centred points with ``z = x^2 + y^2`` the minimum is the smallest singular
vector of three columns, ``((z - mean z) / (2 sqrt(mean z)), x, y)``; a straight line is the circle ``a = 0``. A horizon
in an image is a conic, not a circle: see :mod:`horizonval.geometry.horizon`.

**Horizon.** Canny edges form chains of touching pixels. The chain with the most pixels is taken for the horizon, a
circle is fitted to it, and pixels far from the circle are left out, twice. Nothing is checked: a terminator, a cloud's
edge or the rim of a dazzled patch is an arc too (:mod:`horizonval.estimation.limb.finder` does check).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.edges import canny
from horizonval.estimation.limb.picture import DARK_LEVEL, MEDIAN_TO_SIGMA, TRIM_SIGMAS, Picture, check_image


@dataclass(frozen=True)
class Circle:
    """A circle in an image: ``centre`` (column, row) and ``radius_px``."""

    centre: FloatArray
    radius_px: float

    def distance_px(self, uv: FloatArray) -> FloatArray:
        """Return the distance of points, shape (n, 2), from the circle, positive outside."""
        return np.hypot(*(uv - self.centre).T) - self.radius_px

    def nearest(self, uv: FloatArray) -> FloatArray:
        """Return the points of the circle nearest to given ones, shape (n, 2)."""
        outwards = uv - self.centre
        return self.centre + self.radius_px * outwards / np.hypot(*outwards.T)[:, None]

    def along(self, uv: FloatArray) -> FloatArray:
        """Return the angle [rad] of points about the centre, from the middle of them all."""
        outwards = uv - self.centre
        middle = outwards.mean(axis=0)
        across = middle[0] * outwards[:, 1] - middle[1] * outwards[:, 0]
        return np.arctan2(across, outwards @ middle)


def fit_circle(uv: FloatArray) -> Circle | None:
    """Return the circle through points (n, 2), None if they are collinear; raises ``ValueError`` for n < 3."""
    if len(uv) < 3:
        raise ValueError(f"a circle needs three points, not {len(uv)}")
    middle = uv.mean(axis=0)
    scale = float(np.abs(uv - middle).max())
    if scale == 0.0:
        return None
    xy = (uv - middle) / scale
    z = (xy**2).sum(axis=1)
    mean = float(z.mean())
    columns = np.column_stack([(z - mean) / (2.0 * np.sqrt(mean)), xy])
    _, _, rows = np.linalg.svd(columns, full_matrices=False)
    a = rows[2, 0] / (2.0 * np.sqrt(mean))
    # Less curvature of points of unit spread has no centre that float64 could tell.
    if abs(a) < 1e-9:
        return None
    centre = -rows[2, 1:] / (2.0 * a)
    radius = float(np.sqrt(centre @ centre + mean))
    return Circle(centre * scale + middle, radius * scale)


STRONG_SHARE = 0.08
"""Threshold relative to the image's steepest gradients: small, so that a limb next to a bright cloud stays."""
FEWEST_PIXELS = 24
"""A shorter arc of 100 px radius bends by less than the 0.7 px that whole pixels are off."""


@dataclass(frozen=True)
class Arc:
    """The pixels of an arc, shape (n, 2), from one end to the other, and the circle through them."""

    uv: FloatArray
    circle: Circle


def find_arc(image: FloatArray, full_scale: float | None = None) -> Arc | Refusal:
    """Return the longest edge of an image (H, W) as an arc of whole pixels, or why there is none."""
    if (refusal := check_image(image, full_scale)) is not None:
        return refusal
    picture = Picture(image, full_scale)
    uv = longest_chain(canny(picture.single, picture.credible_noise, STRONG_SHARE)[0])
    if len(uv) < FEWEST_PIXELS:
        if full_scale is not None and float(np.percentile(picture.grey, 99.9)) < DARK_LEVEL * full_scale:
            return Refusal(Outcome.DARK, f"no edge of {FEWEST_PIXELS} pixels in a dark image")
        return Refusal(Outcome.NO_LIMB, f"the longest edge has {len(uv)} pixels; {FEWEST_PIXELS} are needed")
    for _ in range(2):
        circle = fit_circle(uv)
        if circle is None:
            return Refusal(Outcome.SHORT_ARC, "the longest edge is straight: it has no circle")
        off = np.abs(circle.distance_px(uv))
        # Whole pixels lie up to 0.7 px from any curve.
        kept = off <= max(TRIM_SIGMAS * MEDIAN_TO_SIGMA * float(np.median(off)), 1.5)
        uv = uv[kept]
        if len(uv) < FEWEST_PIXELS:
            return Refusal(Outcome.NO_LIMB, "the longest edge is no arc of a circle")
    circle = fit_circle(uv)
    if circle is None:
        return Refusal(Outcome.SHORT_ARC, "the longest edge is straight: it has no circle")
    return Arc(uv[np.argsort(circle.along(uv), kind="stable")], circle)


def longest_chain(mask: NDArray[np.uint8]) -> FloatArray:
    """Return the pixels (m, 2) of the largest group of touching ones (by side or corner) in a mask (H, W)."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if len(stats) < 2:
        return np.empty((0, 2))
    return np.argwhere(labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]))[:, ::-1].astype(np.float64)
