"""The Sun as a distractor: a compact blob of saturated pixels.

Its rim is a perfect circle with a flat sky outside, everything a limb is, only far too small and saturated inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST_SHARE_OF_SIDE = 0.3
"""A blob wider than this share of the image's smaller side is not called the Sun."""
SMALLEST_PIXELS = 9
"""Three by three: hot pixels are fewer."""
SMALLEST_SHARE_OF_SATURATED = 0.6
"""The Sun is most of what is saturated; sunlit clouds saturate in many patches."""


@dataclass(frozen=True)
class SunBlob:
    """A saturated blob: centre (column, row) and radius [px]."""

    column: float
    row: float
    radius_px: float


def find_sun(saturated: NDArray[np.bool_]) -> SunBlob | None:
    """Return the largest compact saturated blob, or None.

    Parameters
    ----------
    saturated : ndarray of bool, shape (H, W)
        See :func:`horizonval.estimation.limb.checks.saturated_pixels`.
    """
    height, width = saturated.shape
    pixels = np.count_nonzero(saturated)
    # Nothing, or more than the largest Sun could be most of.
    largest = (LARGEST_SHARE_OF_SIDE * min(height, width)) ** 2
    if pixels < SMALLEST_PIXELS or SMALLEST_SHARE_OF_SATURATED * pixels > largest:
        return None
    mask = saturated.view(np.uint8)
    first_column, first_row, across, down = cv2.boundingRect(mask)
    lit = np.ascontiguousarray(mask[first_row : first_row + down, first_column : first_column + across])
    count, _, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)
    stats[:, :2] += (first_column, first_row)
    best: SunBlob | None = None
    best_area = SMALLEST_PIXELS - 1
    for left, top, wide, high, area in stats[1:count]:
        at_rim = left == 0 or top == 0 or left + wide == width or top + high == height
        compact = area > 0.6 * wide * high and (at_rim or 0.6 < wide / high < 1.7)
        if compact and max(wide, high) < LARGEST_SHARE_OF_SIDE * min(height, width) and area > best_area:
            best_area = int(area)
            best = SunBlob(left + (wide - 1) / 2, top + (high - 1) / 2, max(wide, high) / 2)
    enough = best_area >= SMALLEST_SHARE_OF_SATURATED * pixels
    return best if enough else None
