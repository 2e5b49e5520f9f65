"""Every threshold that scoring uses, in one place, each with its reason.

Changing one changes what "available", "false valid" and "expected" mean, hence the accepted baselines: treat a change
as a change of the product, not as tuning.
"""

from __future__ import annotations

import math

NADIR_ERROR_LIMIT_RAD = math.radians(0.5)
"""A claimed nadir further off than this is false whatever uncertainty it claims.

Small-satellite Earth sensors are specified to 0.25 deg (NASA state of the art of small spacecraft, guidance chapter);
twice that is of no use to anyone who asked for a horizon sensor.
"""

SIGMA_LIMIT = 5.0
"""A claimed nadir whose Mahalanobis distance from the truth exceeds this many sigma is false, too.

For two Gaussian degrees of freedom chance alone does that in exp(-25/2), 4 frames of a million.
"""

SIGMA_TEST_FLOOR_RAD = math.radians(0.1)
"""Below this error the sigma test is not applied.

Limb methods state the noise of their points, arcseconds at best, while the soft edge of the atmosphere shifts all of
them together by 0.03 to 0.1 deg. That known bias is measured by the error and by the normalised error squared; calling
every such frame a false claim would drown the claims that are dangerous. 0.1 deg is the coarse end of what Earth
horizon sensors are required to deliver (0.03 to 0.1 deg).
"""

ROLL_DEFINED_MIN_COS_PITCH = math.sin(math.radians(1.0))
"""Within 1 deg of pitch = +-90 deg roll is not determined by the nadir, and its error is left empty."""

LIT_MAX_SOLAR_ZENITH_DEG = 90.0
"""A tangent point is lit, for solar bands, where the Sun stands above its geometric horizon.

Beyond that the limb fades through twilight (its lowest sunlit layer is at 6 km at 92.5 deg, at 35 km at 96 deg).
An estimator that still finds it is welcome, but it is not expected to.
"""

MIN_ARC_FRACTION_OF_IMAGE = 0.25
"""Shortest arc in view (and shortest lit arc) that should give an attitude, as a share of the image's shorter side.

A limb search leaves out the image's rim and needs an unbroken stretch, so what it can use is shorter than what is in
view; frames close to the limit may fairly go either way, and a suite should hold few of them.
"""

MIN_ARC_SAGITTA_PX = 0.5
"""An arc in view must also deviate from a straight line by this much.

Without measurable curvature the Earth's angular radius, and with it the nadir's distance from the arc, is anyone's
guess for a method without altitude. Half a pixel stands well above the accuracy of single limb points (0.1 to 0.3
pixel) and thereby far above that of the hundreds of points that share it.
"""
