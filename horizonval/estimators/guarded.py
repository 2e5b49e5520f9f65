"""The published methods behind the guard, each as a method of its own: scored bare and guarded, side by side."""

from __future__ import annotations

from horizonval.estimators import altitude_free, altitude_free_published, linear_heads, video_vertical
from horizonval.estimators.guard import guarded

ALTITUDE_FREE = guarded(altitude_free.ESTIMATOR)
ALTITUDE_FREE_PUBLISHED = guarded(altitude_free_published.ESTIMATOR)
VIDEO_VERTICAL = guarded(video_vertical.ESTIMATOR)
LINEAR_HEADS = guarded(linear_heads.ESTIMATOR)
LINEAR_HEADS_PUBLISHED = guarded(linear_heads.PUBLISHED)
