"""Is this an image at all? Checks that need no search for edges.

An estimator must answer anything with a typed refusal, so whatever later steps assume is asked for here: two
dimensions, a few pixels, finite numbers, and some pixels between darkness and saturation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal

SMALLEST_SIDE_PX = 8
"""A profile across an edge has five pixels at least, and one to either side to be moved by."""
SATURATED_SHARE = 0.9
"""Above this share of saturated pixels nothing is left to see a limb in."""
COMMON_FULL_SCALES = (1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0)
"""Full scales of float, 8, 10, 12, 14 and 16 bit images: a constant image at one of these is saturated, not dark."""
DARK_LEVEL = 0.2
"""Of full scale: an image without an edge whose brightest pixels stay below it shows nothing lit."""
DARK_SHARE = 0.01
"""A constant image below this share of full scale is called dark."""


def check_image(image: FloatArray, full_scale: float | None = None) -> Refusal | None:
    """Return why the image cannot hold a limb, or None if it may.

    Parameters
    ----------
    image : ndarray
        Grey levels, hopefully of shape (H, W).
    full_scale : float, optional
        Digital number at which the converter saturates.
    """
    if not isinstance(image, np.ndarray) or image.dtype.kind not in "buif":
        return Refusal(Outcome.BAD_INPUT, "the image is not an array of numbers")
    if image.ndim != 2:
        return Refusal(Outcome.BAD_INPUT, f"the image has {image.ndim} dimensions; a grey image has 2")
    if min(image.shape) < SMALLEST_SIDE_PX:
        rows, columns = image.shape
        return Refusal(
            Outcome.BAD_INPUT, f"the image is {columns} x {rows} pixels; {SMALLEST_SIDE_PX} a side are needed"
        )
    low, high = float(image.min()), float(image.max())
    # Either of them is not finite if any pixel is not.
    if not (np.isfinite(low) and np.isfinite(high)):
        bad = int(image.size - np.isfinite(image).sum())
        return Refusal(Outcome.BAD_INPUT, f"{bad} pixels are not finite")
    if high == low:
        return _flat(high, full_scale)
    if full_scale is not None:
        share = np.count_nonzero(image >= full_scale) / image.size
        if share > SATURATED_SHARE:
            return Refusal(Outcome.SATURATED, f"{share:.0%} of the pixels are saturated")
    return None


def saturated_pixels(image: FloatArray, full_scale: float | None = None) -> NDArray[np.bool_]:
    """Return where the image is saturated.

    Without a known full scale, the image's largest value counts as saturation where it forms a plateau: at least nine
    pixels share it exactly, which noise does not do.
    """
    top = float(image.max()) if full_scale is None else full_scale
    at_top = image >= top
    if full_scale is None and np.count_nonzero(at_top) < 9:
        return np.zeros(image.shape, dtype=bool)
    return np.asarray(at_top)


def _flat(level: float, full_scale: float | None) -> Refusal:
    scales = COMMON_FULL_SCALES if full_scale is None else (full_scale,)
    if level in scales or (full_scale is not None and level >= full_scale):
        return Refusal(Outcome.SATURATED, f"every pixel is saturated at {level:g}")
    if level <= DARK_SHARE * (full_scale if full_scale is not None else COMMON_FULL_SCALES[0]):
        return Refusal(Outcome.DARK, f"every pixel is {level:g}: nothing is lit")
    return Refusal(Outcome.NO_LIMB, f"every pixel is {level:g}: there is no contrast")
