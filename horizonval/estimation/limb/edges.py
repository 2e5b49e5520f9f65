"""Edge pixels of an image by Canny (IEEE Trans. PAMI 8, 679, 1986): the published methods take them for the limb."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.picture import FEWEST_POINTS, ROSE_SIGMAS, LimbPoints, percentile, picture_of
from horizonval.geometry.camera import CameraModel, unproject

LIMB_SHARE = 0.4
"""Threshold relative to the steepest gradients where all edges count as limb: discs of 50 to 200 px are shaded."""

Gradient = NDArray[np.float32]


def canny(grey: Gradient, noise: float, strong_share: float = 0.0) -> tuple[NDArray[np.uint8], Gradient, Gradient]:
    """Return the edge pixels of an image (H, W) and its gradients along rows and columns, over their noise.

    ``noise``: standard deviation of a pixel. The threshold is that of visibility (Rose), or a share of the image's
    strong gradients where that is larger. The two outermost pixels are no edges: the blur reflects the image there.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    # Standard deviation of a Sobel component of white noise after this blur: 1.14.
    unit = 1.0 / (1.14 * noise)
    dx = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=unit), dtype=np.float32)
    dy = np.asarray(cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=unit), dtype=np.float32)
    high = max(ROSE_SIGMAS, strong_share * percentile(cv2.magnitude(dx, dy), 99.9) if strong_share else 0.0)
    # Whole numbers of 16 bits with eight steps to a standard deviation reach up to 4 000 of them.
    across, down = (np.clip(8.0 * d, -32767.0, 32767.0).astype(np.int16) for d in (dx, dy))
    mask = np.asarray(cv2.Canny(across, down, 4.0 * high, 8.0 * high, L2gradient=True), dtype=np.uint8)
    mask[:2] = mask[-2:] = mask[:, :2] = mask[:, -2:] = 0
    return mask, dx, dy


def find_canny_pixels(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return every Canny pixel, unrefined and untested, with the threshold :data:`LIMB_SHARE`.

    Arguments as for :func:`horizonval.estimation.limb.finder.find_limb`.
    """
    picture = picture_of(image, camera, full_scale)
    if isinstance(picture, Refusal):
        return picture
    mask, _, _ = canny(picture.single, picture.credible_noise, LIMB_SHARE)
    uv = np.argwhere(mask)[:, ::-1].astype(np.float64)
    if camera.image_circle_rad is not None:
        # Leave out the lens's own edge: a perfect cone with nothing outside, everything a limb is.
        outwards = uv - (camera.cx, camera.cy)
        uv = uv[np.isfinite(unproject(camera, uv + outwards / np.maximum(np.hypot(*outwards.T), 1e-9)[:, None]))[:, 0]]
    los = unproject(camera, uv)
    good = np.isfinite(los).all(axis=1)
    if good.sum() < FEWEST_POINTS:
        return Refusal(Outcome.NO_LIMB, f"{int(good.sum())} edge points; {FEWEST_POINTS} are needed")
    return LimbPoints(uv[good], los[good])
