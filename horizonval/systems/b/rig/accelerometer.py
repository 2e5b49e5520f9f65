"""The bench's reference: a two-axis accelerometer on the stage.

It measures gravity across the stage's axis, ``(sin t, cos t)`` g at the tilt ``t``, with an error of its zero, noise
and the steps of its converter, and is mounted with a turn against the image's rows::

    reading = atan2(mean a_x, mean a_y),     a = step * round((g(t + roll) + zero + noise) / step)

Its figures are those of the ten-bit parts on hobby boards: steps of 3.9 mg, noise of one step, a zero that a
calibration in two positions brings to some milligrams. The noise is larger than half a step and so smooths the steps
away in a mean.

Neglected: cross-axis sensitivity (1 %: at 20 deg, 0.2 deg times the level axis's error, below 0.01 deg) and an error of
scale, which both axes share and which drops out of their ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

STEP_MG = 3.9
NOISE_MG = 4.0
SAMPLES = 64


@dataclass(frozen=True)
class Accelerometer:
    """What one accelerometer does to gravity.

    Attributes
    ----------
    roll_rad : float
        Its turn against the camera's rows.
    zero_mg : float
        Error of the zero of the x-axis; that of y is a second-order matter near the level.
    """

    roll_rad: float = 0.0
    zero_mg: float = 0.0

    def tilt_rad(self, true_rad: float, rng: np.random.Generator | None) -> float:
        """Return the tilt that a mean of 64 samples gives; without random numbers no noise and no steps."""
        angle = true_rad + self.roll_rad
        gravity_mg = 1e3 * np.array([math.sin(angle), math.cos(angle)]) + np.array([self.zero_mg, 0.0])
        if rng is not None:
            samples = gravity_mg + NOISE_MG * rng.standard_normal((SAMPLES, 2))
            gravity_mg = STEP_MG * np.rint(samples / STEP_MG).mean(axis=0)
        return math.atan2(gravity_mg[0], gravity_mg[1])
