r"""Where the fields of a static quadrant sensor lie, and what thermopiles in them make of a limb.

Layout and sizes are ours: nobody's drawings were at hand. Four quadrants stand at azimuths 45, 135, 225 and 315 deg,
from forward to the right. Each has three fields, sectors of rings about the body's z axis, one above the other:

- A, across the limb: from ``limb - w / 2`` to ``limb + w / 2`` (nadir angles), the Earth in its lower half;
- B, on the Earth: 3 deg wide, half a degree below A;
- S, in space: 3 deg wide, half a degree above A; what the housing sends to a detector is in all three, and S takes it
  off.

A field's output is its mean radiance. Two ways of processing are looked at::

    plain: D = A - S,        normalised: D = (A - S) / (B - S)

D falls when the limb sinks in the field. The limb stands at ``limb + K (D - D_0)``, with one gain K and one zero D_0
for all quadrants and for good.

*Noise.* A thermopile of detectivity 1e8 cm Hz^0.5 / W, an aperture of 1 cm2 with a focal length of 2 cm, half of the
light, 1 Hz: radiance equal to noise is ``f / (D* A tau sqrt(Omega))`` per square root of hertz, Omega the field's solid
angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray

Processing = Literal["normalised", "plain"]
AZIMUTH_RAD = np.radians([45.0, 135.0, 225.0, 315.0])
HALF_AZIMUTH_RAD = math.radians(10.0)
OTHER_RAD, GAP_RAD = math.radians(3.0), math.radians(0.5)
DETECTIVITY_CM, APERTURE_CM2, FOCAL_CM, TRANSMISSION, BANDWIDTH_HZ = 1e8, 1.0, 2.0, 0.5, 1.0
ETA_RAD = np.radians(np.arange(60.0, 84.001, 0.05))
"""Nadir angles in the body at which sectors are looked at."""


@dataclass(frozen=True)
class QuadrantLayout:
    """The fields of one design: ``limb_rad`` is the nadir angle of A's middle, ``width_rad`` A's width."""

    limb_rad: float
    width_rad: float

    def fields(self) -> dict[str, tuple[float, float]]:
        """Return the nadir angles between which the fields lie."""
        low, high = self.limb_rad - self.width_rad / 2.0, self.limb_rad + self.width_rad / 2.0
        return {
            "A": (low, high),
            "B": (low - GAP_RAD - OTHER_RAD, low - GAP_RAD),
            "S": (high + GAP_RAD, high + GAP_RAD + OTHER_RAD),
        }

    def outputs(self, radiance: FloatArray) -> dict[str, FloatArray]:
        """Return the fields' mean radiances, shape (...), of sectors (..., n) at :data:`ETA_RAD`."""
        return {name: field_mean(radiance, *ends) for name, ends in self.fields().items()}

    def reading(self, radiance: FloatArray, processing: Processing) -> FloatArray:
        """Return D of the module text, shape (...), of sectors (..., n)."""
        out = self.outputs(radiance)
        seen = out["A"] - out["S"]
        return seen / (out["B"] - out["S"]) if processing == "normalised" else seen

    def reading_noise(self, plateau: float, processing: Processing) -> float:
        """Return the standard deviation of D at a plateau [W m-2 sr-1], with A half filled."""
        noise = {name: noise_radiance(*ends) for name, ends in self.fields().items()}
        plain = math.hypot(noise["A"], noise["S"])
        if processing == "plain":
            return plain
        return math.hypot(plain, 0.5 * math.hypot(noise["B"], noise["S"])) / plateau


def field_mean(radiance: FloatArray, low_rad: float, high_rad: float) -> FloatArray:
    """Return the mean over solid angle, shape (...), between two nadir angles; ``radiance sin(eta)`` is linear between
    the angles of :data:`ETA_RAD`.
    """
    step = ETA_RAD[1] - ETA_RAD[0]
    weighted = radiance * np.sin(ETA_RAD)
    pieces = 0.5 * step * (weighted[..., 1:] + weighted[..., :-1])
    area = np.concatenate([np.zeros((*weighted.shape[:-1], 1)), np.cumsum(pieces, axis=-1)], axis=-1)

    def up_to(angle: float) -> FloatArray:
        i = min(max(math.floor((angle - ETA_RAD[0]) / step), 0), len(ETA_RAD) - 2)
        x = angle - ETA_RAD[i]
        slope = (weighted[..., i + 1] - weighted[..., i]) / step
        return area[..., i] + x * (weighted[..., i] + 0.5 * x * slope)

    return np.asarray((up_to(high_rad) - up_to(low_rad)) / (math.cos(low_rad) - math.cos(high_rad)))


def noise_radiance(low_rad: float, high_rad: float) -> float:
    """Return the radiance that equals the noise [W m-2 sr-1] of a field between two nadir angles."""
    solid_angle = 2.0 * HALF_AZIMUTH_RAD * (math.cos(low_rad) - math.cos(high_rad))
    per_cm2 = FOCAL_CM * math.sqrt(BANDWIDTH_HZ / solid_angle) / (DETECTIVITY_CM * APERTURE_CM2 * TRANSMISSION)
    return 1e4 * per_cm2
