"""Edge pixels of an image by Canny: the search of the published methods, right where the limb is the only edge.

The image is stretched to eight bits (:class:`horizonval.estimation.limb.picture.Picture`). The upper threshold is the
largest of three: a multiple of the measured noise, a share of the image's strong gradients, and a floor that excludes
slow ramps such as the terminator.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.picture import FEWEST_POINTS, LimbPoints, noise_sigma, percentile, picture_of
from horizonval.geometry.camera import CameraModel, unproject

BLUR_SIGMA_PX = 1.0
"""Before detection: a lens's own blur."""
SOBEL_NOISE_GAIN = 1.14
"""Standard deviation of one Sobel component per unit white noise, after the Gaussian blur of 1 px."""
NOISE_FACTOR = 6.0
"""Standard deviations of a gradient's component: the size of one in sixty million of noise alone is larger."""
STRONG_SHARE, LIMB_SHARE = 0.08, 0.4
"""Threshold relative to the image's steepest gradients: small, so that a limb next to a bright cloud stays; and where
all edges count as limb, since discs of 50 to 200 px have steep shading."""
RAMP_FLOOR = 25.0
"""Sobel units (eight times grey levels per pixel): a full black-to-white rise slower than 80 px is not an edge."""
LOW_TO_HIGH = 0.4
"""Where an edge goes on; Canny asks for a half to a third."""


def find_edges(image8: NDArray[np.uint8], rim_px: int, strong_share: float = STRONG_SHARE) -> FloatArray:
    """Return the Canny pixels (n, 2) of an eight-bit image (H, W), those within ``rim_px`` of its outer rim left out.

    ``strong_share``: the upper threshold is at least that share of the image's own strong gradients.
    """
    smooth = cv2.GaussianBlur(image8, (0, 0), BLUR_SIGMA_PX)
    dx = cv2.Sobel(smooth, cv2.CV_16S, 1, 0)
    dy = cv2.Sobel(smooth, cv2.CV_16S, 0, 1)
    # Squares of whole numbers are whole too: only the root rounds.
    square = cv2.add(cv2.multiply(dx, dx, dtype=cv2.CV_32F), cv2.multiply(dy, dy, dtype=cv2.CV_32F))
    strong = percentile(np.sqrt(np.asarray(square, dtype=np.float32)), 99.9)
    high = max(NOISE_FACTOR * noise_sigma(image8) * SOBEL_NOISE_GAIN, strong_share * strong, RAMP_FLOOR)
    mask = cv2.Canny(dx, dy, LOW_TO_HIGH * high, high, L2gradient=True)
    mask[:rim_px] = mask[-rim_px:] = mask[:, :rim_px] = mask[:, -rim_px:] = 0
    places = cv2.findNonZero(mask)
    return np.empty((0, 2)) if places is None else places.reshape(-1, 2).astype(np.float64)


def find_canny_pixels(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return every Canny pixel, unrefined and untested, with the threshold :data:`LIMB_SHARE`.

    Arguments as for :func:`horizonval.estimation.limb.finder.find_limb`.
    """
    picture = picture_of(image, camera, full_scale)
    if isinstance(picture, Refusal):
        return picture
    uv = find_edges(picture.eight_bit, 1, LIMB_SHARE)
    if camera.image_circle_rad is not None:
        # Leave out the lens's own edge: a perfect cone with nothing outside, everything a limb is.
        outwards = uv - (camera.cx, camera.cy)
        uv = uv[np.isfinite(unproject(camera, uv + outwards / np.maximum(np.hypot(*outwards.T), 1e-9)[:, None]))[:, 0]]
    los = unproject(camera, uv)
    good = np.isfinite(los).all(axis=1)
    if good.sum() < FEWEST_POINTS:
        return Refusal(Outcome.NO_LIMB, f"{int(good.sum())} edge points; {FEWEST_POINTS} are needed")
    return LimbPoints(uv[good], los[good])
