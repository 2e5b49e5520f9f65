"""The tilt of one camera from the chord of its horizon: half of the two-camera method.

The chord ``c`` between the sight lines to the arc's ends is perpendicular to the vertical. A second camera would give a
second such vector; on the bench, where there is one camera, the boresight ``z`` is level instead, so that the vertical
is ``n = c x z`` with the sign that points to the circle's centre, and the tilt is its angle to the columns::

    t = atan2(n_x, n_y)

The arc and its chord are those of :mod:`horizonval.estimation.limb.arc` and
:mod:`horizonval.estimation.methods.video_vertical`.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Refusal
from horizonval.estimation.limb.arc import find_arc
from horizonval.estimation.methods.video_vertical import chord
from horizonval.geometry.camera import CameraModel


def tilt_rad(image: FloatArray, camera: CameraModel, full_scale: float) -> float | None:
    """Return how far the camera is turned about its boresight, clockwise as it looks; None where it sees no arc."""
    arc = find_arc(image, full_scale)
    if isinstance(arc, Refusal):
        return None
    across = chord(arc, camera)
    down = np.array([-across[1], across[0]])
    if down @ (arc.circle.centre - arc.uv.mean(axis=0)) < 0.0:
        down = -down
    return math.atan2(down[0], down[1])
