"""The panel: what it shows, and the light of its pixels.

A pixel of level ``v`` (0 to 255) shines with ::

    L(x, y) = [L_black + (L_white - L_black) (v / 255)^gamma] * stripe(x) * row(y) * backlight(x, y) * cos(angle)^k

``stripe``: each pixel has three upright stripes, red, green and blue, of which the black matrix leaves a part open; in
a camera's band they count by their share of white light. The picture is grey, so all three have the same level. ``row``
is the open part of the pixel's height. Both have mean 1, so that the mean radiance does not depend on the matrix.
``backlight`` falls off towards the rim and to one side, ``cos^k`` is how the panel dims when seen at an angle.

A *smooth* panel shows the same picture without levels and matrix: linear between the pixels' centres.

Figures: a 24 inch office panel of 1920 x 1080. White is 0.8 W m-2 sr-1 in 450 to 750 nm, near 250 cd m-2 of a white LED
behind colour filters. Neglected: the panel's refresh and the pulses of a dimmed backlight, which a global shutter open
for several of them does not see, and light from the room on the glass (the room is dark).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray


@dataclass(frozen=True)
class Panel:
    """A panel's build. Lengths in mm, radiances in W m-2 sr-1 in the camera's band.

    Attributes
    ----------
    contrast : float
        White over black.
    stripe_share : tuple
        What red, green and blue have of white light in the camera's band; their sum is 1.
    stripe_open, row_open : float
        Open part of a stripe's width and of a pixel's height.
    backlight_fall, backlight_slope : float
        Relative loss from the middle to the corners, and from the left to the right edge.
    viewing_power : float
        ``k``; 2.5 leaves 70 % at 30 deg.
    smooth : bool
        See the module text; backlight and viewing angle stay as they are.
    """

    width: int = 1920
    height: int = 1080
    pitch_mm: float = 0.2768
    gamma: float = 2.2
    white_w_m2_sr: float = 0.8
    contrast: float = 1000.0
    stripe_share: tuple[float, float, float] = (0.31, 0.41, 0.28)
    stripe_open: float = 0.75
    row_open: float = 0.85
    backlight_fall: float = 0.15
    backlight_slope: float = 0.05
    viewing_power: float = 2.5
    smooth: bool = False

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the lit area."""
        return self.width * self.pitch_mm, self.height * self.pitch_mm

    def place_mm(self, pixel: FloatArray) -> FloatArray:
        """Return the places on the panel, from its middle, of (column, row), shape (n, 2)."""
        middle = np.array([(self.width - 1) / 2, (self.height - 1) / 2])
        return np.asarray((np.asarray(pixel, dtype=float) - middle) * self.pitch_mm)


def levels(share_of_white: FloatArray, gamma: float) -> NDArray[np.uint8]:
    """Return the eight-bit levels that show shares of white, shape (H, W), of 0 to 1."""
    return np.rint(255.0 * np.clip(share_of_white, 0.0, 1.0) ** (1.0 / gamma)).astype(np.uint8)


def share_shown(level: NDArray[np.uint8], panel: Panel) -> FloatArray:
    """Return the share of white that levels shine with, black included, shape (H, W)."""
    black = 1.0 / panel.contrast
    return np.asarray(black + (1.0 - black) * (level / 255.0) ** panel.gamma)
