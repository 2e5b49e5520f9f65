"""Colour pictures of radiance: three bands, white where sunlight would be white, dark and bright parts together.

Each band is divided by the sunlight in it, so that a white, level ground under the Sun's zenith is (1, 1, 1). The
brightest of the three is then compressed, and the colour kept::

    shown = asinh(k v / v_white) / asinh(k)

``v_white`` is the 99.5th percentile of the pixels that light falls into, and k = 12: three decades fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STRETCH = 12.0
WHITE_PERCENTILE = 99.5
DARKEST = 1e-12


@dataclass(frozen=True)
class ToneMapped:
    """An 8-bit sRGB picture, shape (H, W, 3), and the reflectance that became white."""

    rgb: NDArray[np.uint8]
    white: float


def tone_mapped(reflectance: NDArray[np.float64]) -> ToneMapped:
    """Return the picture of red, green and blue radiances over those of a white ground, shape (H, W, 3)."""
    brightest = reflectance.max(axis=-1)
    lit = brightest[brightest > DARKEST]
    white = float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0
    level = np.arcsinh(STRETCH * brightest / white) / np.arcsinh(STRETCH)
    colour = reflectance / np.maximum(brightest, DARKEST)[..., None]
    linear = np.clip(level[..., None] * colour, 0.0, 1.0)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return ToneMapped(np.rint(255.0 * srgb).astype(np.uint8), white)
