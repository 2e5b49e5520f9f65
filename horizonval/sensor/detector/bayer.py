"""A colour mosaic: each pixel sees one of three bands, and an image of a band is interpolated from its pixels.

The interpolation is the plain bilinear one, a convolution of the band's pixels and of their mask with the same tent::

    image = (mosaic mask) * w / (mask * w),     w = (1 2 1)^T (1 2 1) / 4

which leaves the band's own pixels as they are and takes the mean of the two or four nearest elsewhere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from horizonval.core.arrays import FloatArray

BoolArray = NDArray[np.bool_]

_TENT = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0]) / 4.0


def mask(pattern: str, colour: str, shape: tuple[int, int]) -> BoolArray:
    """Return which pixels of a pattern such as ``RGGB`` see a colour (R, G or B), shape (H, W)."""
    cell = np.array([letter == colour for letter in pattern]).reshape(2, 2)
    return np.tile(cell, (shape[0] // 2 + 1, shape[1] // 2 + 1))[: shape[0], : shape[1]]


def colour_of(band: str) -> str:
    """Return the letter of a band's name."""
    return band[0].upper()


def mosaic(planes: dict[str, FloatArray], pattern: str) -> FloatArray:
    """Return what the pixels see, shape (H, W), from the whole image in each colour (keys R, G, B)."""
    shape = planes["G"].shape
    out = np.zeros(shape)
    for colour, plane in planes.items():
        seen = mask(pattern, colour, (shape[0], shape[1]))
        out[seen] = plane[seen]
    return out


def plane(image: FloatArray, pattern: str, colour: str) -> FloatArray:
    """Return the full image of a colour, shape (H, W), interpolated from a mosaic."""
    seen = mask(pattern, colour, (image.shape[0], image.shape[1])).astype(np.float64)
    weight = convolve(seen, _TENT, mode="constant")
    value = convolve(image * seen, _TENT, mode="constant") / np.maximum(weight, 1e-12)
    return np.where(seen > 0.0, image, value)
