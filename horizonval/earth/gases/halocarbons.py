"""Halocarbons of today's air: CFC-11, CFC-12, HCFC-22 and carbon tetrachloride, the same amounts for any year.

Well mixed to 16 km; above, broken up by sunlight: a scale height of 5 km less than the air's. In the windows they are
what the limb shines with. Of the US standard limb, with them over without:

============= ======== ======== ========
tangent at    10 km    16 km    20 km
============= ======== ======== ========
8-14 um       +10 %    +3 %     +1 %
10.5-12.5 um  +80 %    +40 %    +11 %
14.0-16.3 um  < 0.02 % < 0.02 % < 0.02 %
============= ======== ======== ========

CFC-11, CFC-12 and CCl4 fall by 1 % a year and less, HCFC-22 has stopped rising: within 10 % from 2010 to 2035, too much
before 1980. RRTMG has their cross sections at one temperature, in bands 5, 6 and 8 only.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

SURFACE_VMR = {"cfc11": 219e-12, "cfc12": 490e-12, "hcfc22": 250e-12, "ccl4": 76e-12}
"""Parts of dry air, about 2022 (global network means of NOAA and AGAGE, rounded)."""
MIXED_TO_M, SCALE_HEIGHT_M = 16_000.0, 5000.0


def halocarbons(altitude_m: FloatArray) -> dict[str, FloatArray]:
    """Return the mixing ratios at altitudes, each of their shape."""
    share = np.exp(-np.maximum(np.asarray(altitude_m, dtype=np.float64) - MIXED_TO_M, 0.0) / SCALE_HEIGHT_M)
    return {gas: vmr * share for gas, vmr in SURFACE_VMR.items()}
