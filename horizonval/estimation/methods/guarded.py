"""Methods behind the guard, scored next to the bare ones.

The published altitude-free method has none: behind the guard it takes the same points as ``altitude-free``, and its
answers differ by less than 1e-9 arcsec.
"""

from __future__ import annotations

from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.methods import (
    altitude_free,
    limb_ellipsoid,
    limb_profile,
    limb_sphere,
    linear_heads,
    video_vertical,
)

ALTITUDE_FREE = guarded(altitude_free.ESTIMATOR)
LIMB_SPHERE = guarded(limb_sphere.ESTIMATOR)
LIMB_ELLIPSOID = guarded(limb_ellipsoid.ESTIMATOR)
LIMB_PROFILE = guarded(limb_profile.ESTIMATOR)
VIDEO_VERTICAL = guarded(video_vertical.ESTIMATOR)
LINEAR_HEADS = guarded(linear_heads.ESTIMATOR)
LINEAR_HEADS_PUBLISHED = guarded(linear_heads.PUBLISHED)
