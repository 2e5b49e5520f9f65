"""The horizon as the published arc methods see it: the longest edge of the image, and the circle through it.

Canny edges fall into chains of touching pixels. The chain with the most pixels is taken for the horizon, a circle is
fitted to it, and what lies far from the circle is left out, twice. Nothing is checked: a terminator, a cloud's edge or
the rim of a dazzled patch is an arc too. :mod:`horizonval.estimation.limb.finder` is the search that asks.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.checks import DARK_LEVEL, check_image
from horizonval.estimation.limb.edges import find_edges
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.limb.ranks import MEDIAN_TO_SIGMA, TRIM_SIGMAS
from horizonval.estimation.limb.shape.circle import Circle, fit_circle

RIM_PX = 2
"""The blur before Canny reflects the image at its border: edges in the last pixels are bent."""
FEWEST_PIXELS = 24
"""A shorter arc of 100 px radius bends by less than the 0.7 px that whole pixels are off."""
SMALLEST_TRIM_PX = 1.5
"""Whole pixels lie up to 0.7 px from any curve."""


@dataclass(frozen=True)
class Arc:
    """The pixels of an arc, shape (n, 2), from one end to the other, and the circle through them."""

    uv: FloatArray
    circle: Circle


def find_arc(image: FloatArray, full_scale: float | None = None) -> Arc | Refusal:
    """Return the image's longest edge as an arc of whole pixels, or why there is none.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    full_scale : float, optional
        Digital number at which the converter saturates.
    """
    if (refusal := check_image(image, full_scale)) is not None:
        return refusal
    grey = np.asarray(image, dtype=np.float64)
    edges = find_edges(Picture(grey, full_scale).eight_bit, RIM_PX)
    uv = longest_chain(edges.uv, (grey.shape[0], grey.shape[1]))
    if len(uv) < FEWEST_PIXELS:
        if full_scale is not None and float(np.percentile(grey, 99.9)) < DARK_LEVEL * full_scale:
            return Refusal(Outcome.DARK, f"no edge of {FEWEST_PIXELS} pixels in a dark image")
        return Refusal(Outcome.NO_LIMB, f"the longest edge has {len(uv)} pixels; {FEWEST_PIXELS} are needed")
    for _ in range(2):
        circle = fit_circle(uv)
        if circle is None:
            return Refusal(Outcome.SHORT_ARC, "the longest edge is straight: it has no circle")
        off = np.abs(circle.distance_px(uv))
        kept = off <= max(TRIM_SIGMAS * MEDIAN_TO_SIGMA * float(np.median(off)), SMALLEST_TRIM_PX)
        uv = uv[kept]
        if len(uv) < FEWEST_PIXELS:
            return Refusal(Outcome.NO_LIMB, "the longest edge is no arc of a circle")
    circle = fit_circle(uv)
    if circle is None:
        return Refusal(Outcome.SHORT_ARC, "the longest edge is straight: it has no circle")
    return Arc(uv[np.argsort(circle.along(uv), kind="stable")], circle)


def longest_chain(uv: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Return the largest group of touching pixels (by side or corner) among whole-pixel points, shape (m, 2)."""
    if not len(uv):
        return uv
    columns, rows = uv.astype(int).T
    mask = np.zeros(shape, dtype=np.uint8)
    mask[rows, columns] = 1
    _, labels = cv2.connectedComponents(mask, connectivity=8)
    chain = labels[rows, columns]
    return uv[chain == np.bincount(chain).argmax()]
