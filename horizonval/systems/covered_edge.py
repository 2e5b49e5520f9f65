"""Edge of an evenly bright body in a noiseless picture, to a fraction of a pixel."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

FULL = 1e-6
"""Largest difference of a covered pixel from 1, and of a bare one from 0."""


def column_edges(share: FloatArray) -> FloatArray:
    """Return the row of the edge in every column, shape (W,), of covered shares of the pixels (H, W).

    A column's sum is the number of pixels that the body covers in it, and with it the mean row of the edge. NaN where
    the column is not covered at one end and bare at the other.
    """
    bare_above = (share[0] < FULL) & (share[-1] > 1.0 - FULL)
    bare_below = (share[0] > 1.0 - FULL) & (share[-1] < FULL)
    covered = share.sum(axis=0)
    rows = np.where(bare_below, covered - 0.5, len(share) - 0.5 - covered)
    return np.where(bare_above | bare_below, rows, np.nan)
