r"""Noise that a converter cuts off: what dark pixels show where levels end at a floor.

Of a pixel whose level is normal, of mean ``mu`` and standard deviation ``s``, and cut off at ``f``, is expected ::

    E = f + s (phi(z) + z Phi(z)),      dE / dmu = Phi(z),      z = (mu - f) / s

Space at the floor itself shows 0.4 s more than is there, and where the limb begins the light is nothing more. Cameras
without a black level do so: the limb of the shipped infrared one in 8 to 14 um stood 0.4 km lower for it.

``s`` and the background are those of pixels that see nothing but space, by the share of them at the floor and by their
mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from horizonval.core.arrays import FloatArray

LEAST_SHARE, MOST_SHARE = 0.01, 0.99
"""Of dark pixels at the floor: with fewer nothing is lost, with more nothing is known."""
FEWEST = 50
"""Dark pixels: the share is then known to a seventh, and so the noise."""
ROUNDS = 20
HALF_STEP = 0.5
"""Of whole numbers: the floor takes what is below the next one's lower half."""


@dataclass(frozen=True)
class Floor:
    """Lowest level that there is, the standard deviation of the noise, and what space shines above the level."""

    level: float
    sigma: float
    space: float = 0.0

    @property
    def background(self) -> float:
        """Of space, without the floor."""
        return self.level + self.space

    def expected(self, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what pixels of these levels show in the mean, and its derivative by the level."""
        z = (level - self.level) / self.sigma
        above = ndtr(z)
        beside = self.sigma * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        return self.level + beside + (level - self.level) * above, above


def floor_of(dark: FloatArray, lowest: float) -> Floor | None:
    """Return the floor of pixels that see space, None where none cuts their noise off.

    Parameters
    ----------
    dark : ndarray, shape (n,)
    lowest : float
        Of the whole image.
    """
    if len(dark) < FEWEST:
        return None
    share = float(np.mean(dark <= lowest))
    mean = float(np.mean(dark)) - lowest
    if not (LEAST_SHARE < share < MOST_SHARE and mean > 0.0):
        return None
    below, sigma = float(ndtri(share)), mean
    for _ in range(ROUNDS):
        z = HALF_STEP / sigma - below
        sigma = mean / float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + z * ndtr(z))
    if not (np.isfinite(sigma) and sigma > HALF_STEP):
        return None
    return Floor(lowest, sigma, HALF_STEP - below * sigma)
