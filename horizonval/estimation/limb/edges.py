"""Whole-pixel edge points: Canny on the image stretched to eight bits.

Canny (1986) wants eight bits (:class:`horizonval.estimation.limb.picture.Picture`). The upper threshold is the largest
of three: a multiple of the measured noise, a share of the image's own strong gradients, and a floor that keeps out slow
ramps such as the terminator (a limb rises within a few pixels, a terminator within hundreds).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import noise_sigma
from horizonval.estimation.limb.ranks import percentile

BLUR_SIGMA_PX = 1.0
"""Before detection: a lens's own blur."""
WIDE_SIGMA_PX = 1.8
"""Before the gradient's direction is read, which noise turns more than it moves an edge. Chosen."""
REACH_PX = 10
"""Of the gradient after that blur: rows further off than this from every edge bear on none."""
SOBEL_NOISE_GAIN = 1.14
"""Standard deviation of one Sobel component per unit white noise, after the Gaussian blur of 1 px."""
NOISE_FACTOR = 6.0
"""Standard deviations of a gradient's component: the size of one in sixty million of noise alone is larger."""
STRONG_SHARE = 0.08
"""Of the image's steepest gradients. Chosen: little, so that a limb beside a bright cloud stays."""
RAMP_FLOOR = 25.0
"""Sobel units (eight times grey levels per pixel): a full black-to-white rise slower than 80 px is not an edge."""
LOW_TO_HIGH = 0.4
"""Where an edge goes on; Canny asks for a half to a third."""


@dataclass(frozen=True)
class Edges:
    """Edge pixels of an image.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        (column, row), whole pixels.
    gradient : ndarray, shape (n, 2)
        Unit gradient of the grey level: points to the brighter side.
    """

    uv: FloatArray
    gradient: FloatArray


def find_edges(image8: NDArray[np.uint8], rim_px: int, strong_share: float = STRONG_SHARE) -> Edges:
    """Return the Canny points of an eight-bit image, those within ``rim_px`` of its outer rim left out.

    Parameters
    ----------
    image8 : ndarray of uint8, shape (H, W)
    rim_px : int
        Edges of a picture's own frame, and points without room for a sub-pixel window, lie there.
    strong_share : float
        Of the image's own strong gradients: the upper threshold is at least that. Little, where a later step decides
        what belongs to the limb.
    """
    smooth = cv2.GaussianBlur(image8, (0, 0), BLUR_SIGMA_PX)
    dx = cv2.Sobel(smooth, cv2.CV_16S, 1, 0)
    dy = cv2.Sobel(smooth, cv2.CV_16S, 0, 1)
    # Squares of whole numbers are whole too: only the root rounds.
    square = cv2.add(cv2.multiply(dx, dx, dtype=cv2.CV_32F), cv2.multiply(dy, dy, dtype=cv2.CV_32F))
    strength = np.sqrt(np.asarray(square, dtype=np.float32))
    noise = noise_sigma(image8) * SOBEL_NOISE_GAIN
    strong = percentile(strength, 99.9)
    high = max(NOISE_FACTOR * noise, strong_share * strong, RAMP_FLOOR)
    mask = cv2.Canny(dx, dy, LOW_TO_HIGH * high, high, L2gradient=True)
    places = cv2.findNonZero(mask)
    columns, rows = np.empty((2, 0), dtype=np.int32) if places is None else places.reshape(-1, 2).T
    height, width = image8.shape
    inside = (columns >= rim_px) & (columns < width - rim_px) & (rows >= rim_px) & (rows < height - rim_px)
    rows, columns = rows[inside], columns[inside]
    # Direction from a wider blur than detection: a 3 x 3 gradient of a noisy edge wanders by tens of degrees.
    first, last = max(int(rows.min(initial=height)) - REACH_PX, 0), int(rows.max(initial=0)) + REACH_PX + 1
    wide = cv2.GaussianBlur(image8[first:last].astype(np.float32), (0, 0), WIDE_SIGMA_PX) if len(rows) else image8
    gx = cv2.Sobel(wide, cv2.CV_32F, 1, 0)[rows - first, columns].astype(np.float64)
    gy = cv2.Sobel(wide, cv2.CV_32F, 0, 1)[rows - first, columns].astype(np.float64)
    length = np.hypot(gx, gy)
    good = length > 0
    rows, columns = rows[good], columns[good]
    gradient = np.column_stack([gx[good], gy[good]]) / length[good, None]
    uv = np.column_stack([columns, rows]).astype(np.float64)
    return Edges(uv=uv, gradient=gradient)
