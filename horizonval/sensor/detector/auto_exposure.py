"""The exposure a camera chooses for itself.

From the expected image: the given percentile of the pixels' electrons, which grow in proportion to the exposure, shall
be the target share of the full well. A dark frame gets the longest exposure; a sunlit one that would saturate even with
the shortest keeps that.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.spec.detector import AutoExposure


def exposure_s(rate_e_per_s: FloatArray, full_well_e: float, rule: AutoExposure) -> float:
    """Return the exposure [s] for expected rates of electrons, dark current included, shape (H, W)."""
    rate = float(np.percentile(rate_e_per_s, rule.percentile))
    if rate * rule.max_s <= rule.target * full_well_e:
        return rule.max_s
    return max(rule.target * full_well_e / rate, rule.min_s)
