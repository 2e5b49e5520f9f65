"""A static quadrant sensor: fields that look at the limb in four directions, and roll and pitch from them.

Four quadrants are at azimuths 45, 135, 225 and 315 deg, from forward to the right. Each has three fields, sectors of
rings about the body's z axis, one above the other:

- A, across the limb: ``width`` about the nominal nadir angle of the limb, the Earth in its lower half;
- B, on the Earth: 3 deg wide, half a degree below A;
- S, in space: 3 deg wide, half a degree above A, which measures what the housing sends to all three.

A field's output is its mean radiance, and the reading ``D = (A - S) / (B - S)`` falls when the limb sinks in the
field. The limb is at ``limb + gain (D - zero)``, with one gain and one zero for all quadrants. A quadrant whose limb is
farther from the middle than ``range`` is not used.

*Roll and pitch.* With the limb at nadir angle eta_k in quadrant k, where ``eta0_k`` is expected of a level body::

    eta_k - eta0_k = -pitch cos a_k + roll sin a_k + lift

Least squares over the quadrants in range; three are enough. The lift is what altitude and air have in common. With four
the residual guards the answer. Second-order terms are 0.004 deg at half a degree of tilt.

*Noise.* A thermopile of detectivity 1e8 cm Hz^0.5 / W, an aperture of 1 cm2 with a focal length of 2 cm, half of the
light, 1 Hz: radiance equal to noise is ``f / (D* A tau sqrt(Omega))`` per square root of hertz, Omega the field's solid
angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal

AZIMUTH_RAD = np.radians([45.0, 135.0, 225.0, 315.0])
HALF_AZIMUTH_RAD = math.radians(10.0)
OTHER_RAD, GAP_RAD = math.radians(3.0), math.radians(0.5)
DETECTIVITY_CM, APERTURE_CM2, FOCAL_CM, TRANSMISSION, BANDWIDTH_HZ = 1e8, 1.0, 2.0, 0.5, 1.0
SHIFT_RAD = math.radians(0.5)
"""Distances by which the fields are moved for the calibration."""
LEAST_QUADRANTS = 3
RESIDUAL_RAD = math.radians(0.5)
"""Largest disagreement of the quadrants: air of two hemispheres causes a tenth of a degree of it."""


@dataclass(frozen=True)
class QuadrantFit:
    """An attitude; ``covariance``: shape (3, 3), of its three angles [rad2]."""

    roll_rad: float
    pitch_rad: float
    lift_rad: float
    covariance: FloatArray


@dataclass(frozen=True)
class QuadrantSensor:
    """A static sensor of four quadrants; :meth:`calibrated` gives it gain and zero.

    Attributes
    ----------
    limb_rad, width_rad : float
        Nadir angle of the middle of field A, and its width.
    range_rad : float
        Largest distance of the limb from the middle.
    gain_rad, zero : float
        Slope of the limb's angle over the reading, and the reading at the middle.

    Examples
    --------
    >>> import horizonval as hv, numpy as np
    >>> nadir_angle = np.radians(np.arange(60.0, 84.0, 0.05))
    >>> limb = lambda deg: np.clip((np.radians(deg) - nadir_angle) / 0.01 + 0.5, 0.0, 1.0)
    >>> sensor = hv.QuadrantSensor(limb_rad=np.radians(72.5), width_rad=np.radians(4.0))
    >>> sensor = sensor.calibrated(nadir_angle, limb(72.5), np.radians(72.5))
    >>> tilted = sensor.limb_angles(nadir_angle, np.array([limb(72.5 + x) for x in (-0.1, 0.1, 0.1, -0.1)]))
    >>> fit = sensor.attitude(tilted, np.full(4, np.radians(72.5)))
    >>> print(f"pitch {np.degrees(fit.pitch_rad):.2f}, roll {abs(np.degrees(fit.roll_rad)):.2f} deg")
    pitch 0.14, roll 0.00 deg
    """

    limb_rad: float
    width_rad: float
    range_rad: float = math.inf
    gain_rad: float = 1.0
    zero: float = 0.0

    def fields(self) -> dict[str, tuple[float, float]]:
        """Return the nadir angles between which the fields are."""
        low, high = self.limb_rad - self.width_rad / 2.0, self.limb_rad + self.width_rad / 2.0
        return {
            "A": (low, high),
            "B": (low - GAP_RAD - OTHER_RAD, low - GAP_RAD),
            "S": (high + GAP_RAD, high + GAP_RAD + OTHER_RAD),
        }

    def reading(self, eta_rad: FloatArray, radiance: FloatArray) -> FloatArray:
        """Return D, shape (...), of radiances (..., n) at even nadir angles (n,)."""
        a, b, s = (field_mean(eta_rad, radiance, *ends) for ends in self.fields().values())
        return (a - s) / (b - s)

    def calibrated(
        self, eta_rad: FloatArray, radiance: FloatArray, true_limb_rad: FloatArray | float
    ) -> QuadrantSensor:
        """Return the sensor with gain and zero from level bodies.

        ``radiance``: shape (..., n), at even nadir angles ``eta_rad``; ``true_limb_rad``: shape (...), where the limb
        is. The slope is measured by moving the fields by half a degree either way.
        """

        def moved(by: float) -> FloatArray:
            return replace(self, limb_rad=self.limb_rad + by).reading(eta_rad, radiance)

        # Fields moved outwards see less Earth, as if the limb had sunk.
        slope = float(np.mean(moved(-SHIFT_RAD) - moved(SHIFT_RAD))) / (2.0 * SHIFT_RAD)
        zero = float(np.mean(moved(0.0) - slope * (true_limb_rad - self.limb_rad)))
        return replace(self, gain_rad=1.0 / slope, zero=zero)

    def limb_angles(self, eta_rad: FloatArray, radiance: FloatArray) -> FloatArray:
        """Return the limb's nadir angles, shape (...), NaN out of range, of radiances (..., n) at even nadir angles."""
        x = self.gain_rad * (self.reading(eta_rad, radiance) - self.zero)
        return np.where(np.abs(x) <= self.range_rad, self.limb_rad + x, np.nan)

    def sigma_rad(self, plateau: float) -> float:
        """Return the standard deviation of a limb angle from noise, at a plateau [W m-2 sr-1] and A half filled."""
        a, b, s = (noise_radiance(*ends) for ends in self.fields().values())
        return abs(self.gain_rad) * math.hypot(a, s, 0.5 * b, 0.5 * s) / plateau

    def attitude(self, limb_rad: FloatArray, expected_rad: FloatArray, sigma_rad: float = 0.0) -> QuadrantFit | Refusal:
        """Return roll and pitch from the limb's nadir angles (4,), NaN where a quadrant is not used.

        ``expected_rad``: shape (4,), of a level body; ``sigma_rad``: of one quadrant, for the covariance.
        """
        valid = np.isfinite(limb_rad)
        if valid.sum() < LEAST_QUADRANTS:
            return Refusal(Outcome.SATURATED, f"{int(valid.sum())} of 4 quadrants are in range, three are needed")
        alpha = AZIMUTH_RAD[valid]
        design = np.stack([np.sin(alpha), -np.cos(alpha), np.ones_like(alpha)], axis=1)
        gain = np.linalg.pinv(design)
        excess = (limb_rad - expected_rad)[valid]
        solution = gain @ excess
        residual = float(np.max(np.abs(excess - design @ solution)))
        if residual > RESIDUAL_RAD:
            return Refusal(Outcome.AMBIGUOUS, f"the quadrants disagree by {math.degrees(residual):.2f} deg")
        roll, pitch, lift = (float(x) for x in solution)
        return QuadrantFit(roll, pitch, lift, sigma_rad**2 * gain @ gain.T)


def field_mean(eta_rad: FloatArray, radiance: FloatArray, low_rad: float, high_rad: float) -> FloatArray:
    """Return the mean over solid angle between two nadir angles, with ``radiance sin(eta)`` linear between samples."""
    step = eta_rad[1] - eta_rad[0]
    weighted = radiance * np.sin(eta_rad)
    pieces = 0.5 * step * (weighted[..., 1:] + weighted[..., :-1])
    area = np.concatenate([np.zeros((*weighted.shape[:-1], 1)), np.cumsum(pieces, axis=-1)], axis=-1)

    def up_to(angle: float) -> FloatArray:
        i = min(max(math.floor((angle - eta_rad[0]) / step), 0), len(eta_rad) - 2)
        x = angle - eta_rad[i]
        slope = (weighted[..., i + 1] - weighted[..., i]) / step
        return area[..., i] + x * (weighted[..., i] + 0.5 * x * slope)

    return np.asarray((up_to(high_rad) - up_to(low_rad)) / (math.cos(low_rad) - math.cos(high_rad)))


def noise_radiance(low_rad: float, high_rad: float) -> float:
    """Return the radiance that equals the noise [W m-2 sr-1] of a field between two nadir angles."""
    solid_angle = 2.0 * HALF_AZIMUTH_RAD * (math.cos(low_rad) - math.cos(high_rad))
    per_cm2 = FOCAL_CM * math.sqrt(BANDWIDTH_HZ / solid_angle) / (DETECTIVITY_CM * APERTURE_CM2 * TRANSMISSION)
    return 1e4 * per_cm2
