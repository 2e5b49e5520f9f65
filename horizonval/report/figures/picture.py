"""Detector images as small pictures inside the page.

Grey levels run from the 1st to the 99.5th percentile of the pixels that are not saturated, so that neither the Sun's
blob nor a hot pixel decides them, and over no less than 4 % of full scale, so that the noise of a dark frame stays
dark. A gamma of 1.6 shows the fading limb.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.frame import DetectorImage

GAMMA = 1.6
PERCENTILES = (1.0, 99.5)
SMALLEST_RANGE = 0.04
LOSSLESS_BUDGET_PX = 12_000_000
"""Pixels of a whole report up to which they are stored losslessly and in full size: about 8 MB."""
REDUCED_SIDE_PX = 384
REDUCED_QUALITY = 82


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture as ``data:`` URI, and the digital numbers drawn black and white."""

    uri: str
    black_dn: float
    white_dn: float


def picture_of(image: DetectorImage, *, reduced: bool = False) -> EmbeddedPicture:
    """Return the picture of a detector image; ``reduced``: smaller and lossy, for runs of many frames."""
    grey, black, white = tone_mapped(image)
    if reduced:
        scale = REDUCED_SIDE_PX / max(grey.shape)
        if scale < 1:
            size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
            grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        kind, suffix, options = "jpeg", ".jpg", [cv2.IMWRITE_JPEG_QUALITY, REDUCED_QUALITY]
    else:
        kind, suffix, options = "png", ".png", [cv2.IMWRITE_PNG_COMPRESSION, 9]
    done, data = cv2.imencode(suffix, grey, options)
    if not done:
        raise RuntimeError(f"OpenCV cannot write {kind}")
    return EmbeddedPicture(f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}", black, white)


def tone_mapped(image: DetectorImage) -> tuple[NDArray[np.uint8], float, float]:
    """Return 8-bit grey levels, shape (H, W), and the digital numbers that became black and white."""
    dn = image.dn.astype(np.float64)
    usable = dn[dn < image.full_scale]
    low, high = np.percentile(usable, PERCENTILES) if usable.size else (0.0, float(image.full_scale))
    high = max(high, low + SMALLEST_RANGE * image.full_scale)
    level = np.clip((dn - low) / (high - low), 0.0, 1.0) ** (1 / GAMMA)
    return np.rint(255 * level).astype(np.uint8), float(low), float(high)
