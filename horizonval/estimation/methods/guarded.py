"""The published methods behind the guard, each as a method of its own: scored bare and guarded, side by side."""

from __future__ import annotations

from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.methods import altitude_free, altitude_free_published, linear_heads, video_vertical

ALTITUDE_FREE = guarded(altitude_free.ESTIMATOR)
ALTITUDE_FREE_PUBLISHED = guarded(altitude_free_published.ESTIMATOR)
VIDEO_VERTICAL = guarded(video_vertical.ESTIMATOR)
LINEAR_HEADS = guarded(linear_heads.ESTIMATOR)
LINEAR_HEADS_PUBLISHED = guarded(linear_heads.PUBLISHED)
