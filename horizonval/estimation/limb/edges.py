"""Edge points of an image: whole pixels by Canny, and their positions below the pixel.

**Canny** works on the image stretched to eight bits (:class:`horizonval.estimation.limb.picture.Picture`). The upper
threshold is the largest of three: a multiple of the measured noise, a share of the image's strong gradients, and a
floor that excludes slow ramps such as the terminator.

**Sub-pixel position** by the area under the profile. A pixel holds the share of itself that the bright side covers.
Along one column (for an edge closer to horizontal; else along one row), with the levels ``a`` and ``b`` before and
behind the edge, ::

    p = sum_k (I_k - b) / (a - b) - h - 1/2,      k = -h .. h

is the mean position of the edge across that column, measured from the window's centre. It is exact for a straight hard
edge of any slope, and unbiased by any symmetric point spread (partial areas: Trujillo-Pino et al., Image and Vision
Computing 31, 72, 2013; here in its simplest form, with levels measured at both ends of the window). The window is one
pixel wide, so that the noise of neighbouring points is independent; it is centred on the edge once.

Neglected: curvature across one pixel (1/24 px times the curvature, 0.003 px on a disc of 18 px radius) and shading of
the inner side within the window.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import noise_sigma, percentile

BLUR_SIGMA_PX = 1.0
"""Before detection: a lens's own blur."""
WIDE_SIGMA_PX = 1.8
"""Blur before the gradient's direction is read, since noise turns an edge more than it displaces it."""
REACH_PX = 10
"""Range of the gradient after that blur: rows farther from every edge do not matter."""
SOBEL_NOISE_GAIN = 1.14
"""Standard deviation of one Sobel component per unit white noise, after the Gaussian blur of 1 px."""
NOISE_FACTOR = 6.0
"""Standard deviations of a gradient's component: the size of one in sixty million of noise alone is larger."""
STRONG_SHARE = 0.08
"""Threshold relative to the image's steepest gradients: small, so that a limb next to a bright cloud stays."""
RAMP_FLOOR = 25.0
"""Sobel units (eight times grey levels per pixel): a full black-to-white rise slower than 80 px is not an edge."""
LOW_TO_HIGH = 0.4
"""Where an edge goes on; Canny asks for a half to a third."""


@dataclass(frozen=True)
class Edges:
    """Edge pixels of an image.

    ``uv`` (shape (n, 2)): (column, row), whole pixels. ``gradient`` (shape (n, 2)): unit gradient of the grey level:
    points to the brighter side.
    """

    uv: FloatArray
    gradient: FloatArray


def find_edges(image8: NDArray[np.uint8], rim_px: int, strong_share: float = STRONG_SHARE) -> Edges:
    """Return the Canny points of an eight-bit image (H, W), those within ``rim_px`` of its outer rim left out.

    ``strong_share``: the upper threshold is at least that share of the image's own strong gradients.
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


HALF_WINDOW_PX = 5
"""Three pixels of level to either side, and two of edge: a lens of 0.7 px blurs no farther."""


def half_window(shape: tuple[int, ...]) -> int:
    """Return the half length of the profile window [px] that suits an image: 5, less for tiny images."""
    return int(np.clip(min(shape) // 8, 2, HALF_WINDOW_PX))


def refine(image: FloatArray, uv: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return sub-pixel positions (m, 2) of whole-pixel edge points (n, 2), at least ``half_window + 1`` from the rim.

    Points whose profile holds no edge near its middle are left out, and so is the second of two points that became the
    same. ``image``: shape (H, W), linear grey levels (not the eight-bit copy); ``gradient``: shape (n, 2), unit.
    """
    half = half_window(image.shape)
    vertical = np.abs(gradient[:, 1]) >= np.abs(gradient[:, 0])
    fixed = np.where(vertical, uv[:, 0], uv[:, 1]).astype(np.int64)
    along = np.where(vertical, uv[:, 1], uv[:, 0]).astype(np.int64)
    length = np.asarray(image.shape, dtype=np.int64)[1 - vertical.astype(np.int64)]
    # The brighter end of the profile must be the one the gradient points to: else it is another edge's profile.
    sign = np.where(np.where(vertical, gradient[:, 1], gradient[:, 0]) > 0, 1.0, -1.0)
    centre = along.copy()
    position = np.zeros(len(uv))
    good = np.ones(len(uv), dtype=bool)
    for _ in range(2):
        centre = centre + np.rint(position).astype(np.int64)
        good &= (centre >= half) & (centre < length - half)
        profile = _profiles(image, vertical, fixed, np.clip(centre, half, length - 1 - half), half)
        ends = max(1, half - 2)
        before, behind = profile[:, :ends].mean(axis=1), profile[:, -ends:].mean(axis=1)
        step = before - behind
        good &= step * sign < 0
        share = (profile - behind[:, None]).sum(axis=1) / np.where(step == 0, np.inf, step)
        position = np.clip(share - half - 0.5, -half, half)
    good &= np.abs(position) <= 1.0
    refined = centre + position
    out = np.where(vertical[:, None], np.column_stack([fixed, refined]), np.column_stack([refined, fixed]))
    kept = np.flatnonzero(good)
    key = np.column_stack([vertical[kept], fixed[kept], centre[kept]])
    _, first = np.unique(key, axis=0, return_index=True)
    return np.asarray(out[kept[np.sort(first)]])


def _profiles(
    image: FloatArray, vertical: NDArray[np.bool_], fixed: NDArray[np.int64], centre: NDArray[np.int64], half: int
) -> FloatArray:
    moving = centre[:, None] + np.arange(-half, half + 1)
    rows, columns = (
        np.where(vertical[:, None], moving, fixed[:, None]),
        np.where(vertical[:, None], fixed[:, None], moving),
    )
    return np.asarray(image[rows, columns], dtype=np.float64)
