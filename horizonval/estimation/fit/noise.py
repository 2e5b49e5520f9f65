"""The noise of pixels near a limb: a variance each, and tails that are heavier than a normal distribution's.

Stars, hot pixels and other light that no model has make residuals that noise does not. With Student's distribution of
``nu`` degrees of freedom the likelihood of a residual ``r`` and the weight that it gives a pixel are ::

    -2 ln L = (nu + 1) ln(1 + r^2 / (nu v)) + ln v,        w = (nu + 1) / (nu + r^2 / v) / v

(K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881, 1989). No pixel is left out by a rule,
and no marginal one goes in and out during a fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray

TAIL_FREEDOM = 10.0
"""Degrees of freedom of Student's distribution. Where the noise is normal the estimate has 0.98 of the information of
least squares; a pixel ten sigmas off has a tenth of its weight."""


@dataclass(frozen=True)
class PixelNoise:
    """Noise of n pixels.

    ``variance``: shape (n,), in grey levels squared; ``together``: shape (n,) or 1, number of pixels with one common
    error, which count as one.
    """

    variance: FloatArray
    together: FloatArray | float = 1.0

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Return the inverse variances, shape (n,), that residuals (n,) leave to their pixels."""
        square = residuals**2 / self.variance
        return np.asarray((TAIL_FREEDOM + 1.0) / (TAIL_FREEDOM + square) / (self.variance * self.together))

    def improbability(self, residuals: FloatArray) -> float:
        """Return -2 ln likelihood of residuals (n,), up to a constant that depends on the variances alone."""
        square = residuals**2 / self.variance
        return float(np.sum((TAIL_FREEDOM + 1.0) * np.log1p(square / TAIL_FREEDOM) / self.together))
