"""What a search for the limb gives back where it does not refuse (:mod:`horizonval.core.outcome`)."""

from __future__ import annotations

from dataclasses import dataclass

from horizonval.core.arrays import FloatArray

FEWEST_POINTS = 8
"""Of three unknowns, and something to see their scatter by."""


@dataclass(frozen=True)
class LimbPoints:
    """Points of the Earth's limb in one image.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        (column, row) [px].
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight in camera axes.
    scale : int
        Pixels of the image per pixel of the size at which the limb is an edge: 1 of a sharp limb, more of one that is
        many pixels deep.
    """

    uv: FloatArray
    los_cam: FloatArray
    scale: int = 1
