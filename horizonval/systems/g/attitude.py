r"""Pitch and roll from where the limb stands in four quadrants, with their covariance, or a refusal.

A limb that stands at nadir angle eta_k in quadrant k, where ``eta0_k`` is expected of a level body at a known place::

    eta_k - eta0_k = -pitch cos a_k + roll sin a_k + lift

Least squares over the quadrants that are within the range the sensor was calibrated for; three are enough. The lift is
what altitude and air have in common all round. With four there is one condition to spare: its residual is the guard.
Second-order terms are 0.004 deg at half a degree of tilt.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal

LEAST_QUADRANTS = 3
RESIDUAL_RAD = math.radians(0.5)
"""Oblateness is expected and taken off; air of two hemispheres spends a tenth of a degree of it."""


@dataclass(frozen=True)
class QuadrantFit:
    """An attitude.

    Attributes
    ----------
    roll_rad, pitch_rad, lift_rad : float
    covariance : ndarray, shape (3, 3)
        Of the three, in this order [rad2].
    """

    roll_rad: float
    pitch_rad: float
    lift_rad: float
    covariance: FloatArray


def attitude_of_quadrants(
    limb_rad: FloatArray, expected_rad: FloatArray, azimuth_rad: FloatArray, sigma_rad: float
) -> QuadrantFit | Refusal:
    """Return roll and pitch.

    Parameters
    ----------
    limb_rad : ndarray, shape (4,)
        Nadir angles of the limb in the body; nan where a quadrant is out of its range.
    expected_rad, azimuth_rad : ndarray, shape (4,)
        Of a level body; of the quadrants, from forward to the right.
    sigma_rad : float
        Standard deviation of one quadrant.
    """
    valid = np.isfinite(limb_rad)
    if valid.sum() < LEAST_QUADRANTS:
        return Refusal(Outcome.SATURATED, f"{int(valid.sum())} of 4 quadrants are in range, three are needed")
    alpha = azimuth_rad[valid]
    design = np.stack([np.sin(alpha), -np.cos(alpha), np.ones_like(alpha)], axis=1)
    gain = np.linalg.pinv(design)
    excess = (limb_rad - expected_rad)[valid]
    solution = gain @ excess
    residual = float(np.max(np.abs(excess - design @ solution)))
    if residual > RESIDUAL_RAD:
        return Refusal(Outcome.AMBIGUOUS, f"the quadrants disagree by {math.degrees(residual):.2f} deg")
    roll, pitch, lift = (float(x) for x in solution)
    return QuadrantFit(roll, pitch, lift, sigma_rad**2 * gain @ gain.T)
