"""One image on its way through a search: what several steps ask of it is worked out once.

A detector gives whole numbers. Where an image holds nothing else, up to sixteen bits of them, its percentiles come from
counts and its stretch from a table, which are the same numbers sooner.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.checks import saturated_pixels
from horizonval.estimation.limb.ranks import MEDIAN_TO_SIGMA, level_counts, median, percentile, percentile_of_counts

IMMERKAER: FloatArray = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
"""The operator that measures noise: of a level and its first derivatives it makes nothing."""
STRETCH_PERCENTILES = (0.5, 99.9)
"""Of the levels: dead and hot pixels are fewer than what lies beyond. Chosen."""
SMALLEST_RANGE_SHARE, SMALLEST_RANGE_SIGMAS = 0.02, 12.0
"""Between these percentiles, of the whole range and of the noise: less is space alone, with six of its standard
deviations to either side."""


class Picture:
    """A grey image, and what is asked of it more than once.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Finite, not constant: see :func:`horizonval.estimation.limb.checks.check_image`.
    full_scale : float, optional
        Digital number at which the converter saturates.
    saturated : ndarray of bool, shape (H, W), optional
        Where the image is saturated, if that is known better than from its levels.
    """

    def __init__(
        self, image: FloatArray, full_scale: float | None = None, saturated: NDArray[np.bool_] | None = None
    ) -> None:
        self.grey = np.asarray(image, dtype=np.float64)
        self.full_scale = full_scale
        self.saturated = saturated_pixels(self.grey, full_scale) if saturated is None else saturated

    @cached_property
    def darkest(self) -> float:
        return float(self.grey.min())

    @cached_property
    def brightest(self) -> float:
        return float(self.grey.max())

    @cached_property
    def single(self) -> NDArray[np.float32]:
        """The image in the precision that OpenCV filters in, shape (H, W)."""
        return self.grey.astype(np.float32)

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """Mean of every pixel and its eight neighbours, shape (H, W)."""
        return np.asarray(cv2.blur(self.single, (3, 3)), dtype=np.float32)

    @cached_property
    def noise_sigma(self) -> float:
        """Standard deviation of the pixel noise."""
        return noise_sigma(self.single, None if self.levels is None else int(self.brightest))

    @cached_property
    def levels(self) -> NDArray[np.uint16] | None:
        """The image as whole numbers, shape (H, W), if it holds no others; None if it does."""
        if self.darkest < 0.0 or self.brightest > np.iinfo(np.uint16).max:
            return None
        levels = self.grey.astype(np.uint16)
        return levels if np.array_equal(levels, self.grey) else None

    @cached_property
    def unclipped(self) -> FloatArray:
        """The image with NaN where it is saturated, and beside that, shape (H, W).

        A pixel beside saturated ones is below full scale by its noise, or holds charge of theirs: 5 x 5 pixels round
        each saturated one are left out.
        """
        if not self.saturated.any():
            return self.grey
        near = cv2.dilate(self.saturated.astype(np.uint8), np.ones((5, 5), np.uint8))
        return np.where(near > 0, np.nan, self.grey)

    @cached_property
    def eight_bit(self) -> NDArray[np.uint8]:
        """The image stretched to 0..255 between its darkest and its brightest unsaturated pixels, shape (H, W).

        Of the unsaturated ones, so that the Sun's saturated blob does not press the Earth into the lowest grey levels.
        """
        low, high = self._usable_range()
        top = self.brightest
        # A small bright Earth lies above the percentile: then noise alone would fill the stretch.
        if high - low < SMALLEST_RANGE_SHARE * (top - low) or high - low < SMALLEST_RANGE_SIGMAS * self.noise_sigma:
            high = top
        if high <= low:
            low = self.darkest
        if self.levels is None:
            return _stretched(self.grey, low, high)
        return np.take(_stretched(np.arange(top + 1.0), low, high), self.levels)

    def _usable_range(self) -> tuple[float, float]:
        """Return the percentiles of the unsaturated pixels; the darkest level twice where there are none."""
        usable = ~self.saturated
        if not usable.any():
            return self.darkest, self.darkest
        if self.levels is not None:
            counts = level_counts(self.levels[usable], int(self.brightest))
            low, high = (percentile_of_counts(counts, q) for q in STRETCH_PERCENTILES)
        else:
            values = self.grey[usable]
            low, high = (percentile(values, q) for q in STRETCH_PERCENTILES)
        return low, high


def noise_sigma(image: NDArray[np.floating | np.uint8], largest_level: int | None = None) -> float:
    """Return the standard deviation of the pixel noise, blind to edges and smooth shading.

    By Immerkaer's operator (Computer Vision and Image Understanding 64, 300, 1996), with the median in place of the
    mean so that edges do not count.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    largest_level : int, optional
        Of an image of whole numbers from 0 on, which is sooner counted than ranked; of eight bits it is known.
    """
    gain = float(np.linalg.norm(IMMERKAER)) / MEDIAN_TO_SIGMA
    if image.dtype == np.uint8:
        response, largest_level = cv2.filter2D(image, cv2.CV_16S, IMMERKAER), 255
    else:
        response = cv2.filter2D(np.asarray(image, dtype=np.float32), cv2.CV_32F, IMMERKAER)
    size = np.abs(response[1:-1, 1:-1])
    if largest_level is None:
        return median(size) / gain
    whole = size.view(np.uint16) if size.dtype == np.int16 else size
    return percentile_of_counts(level_counts(whole, 8 * largest_level), 50.0) / gain


def _stretched(grey: FloatArray, low: float, high: float) -> NDArray[np.uint8]:
    return np.clip((grey - low) * (255.0 / (high - low)) + 0.5, 0, 255).astype(np.uint8)
