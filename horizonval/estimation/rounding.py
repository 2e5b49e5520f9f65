"""The least noise of digital numbers: a converter that rounds to whole steps leaves ``1 / sqrt(12)`` of one.

Where the noise before it is small beside a step, nearly all pixels of an even field get one number. What they scatter
by is then next to nothing, and the few that got another number seem to be far outliers.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

OF_WHOLE_STEPS = 1.0 / 12.0


def rounding_variance(values: FloatArray) -> float:
    """Return the variance of rounding in values of finite numbers: that of whole steps where all are whole, else 0."""
    return OF_WHOLE_STEPS if np.array_equal(values, np.rint(values)) else 0.0
