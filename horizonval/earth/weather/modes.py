r"""How the air of one column varies: vertical modes and standard deviations by class of latitude and season.

The deviation of temperature, ln ozone and ln water vapour (q = 0, 1, 2) from the climate is a sum over classes c and
modes k with random numbers a of unit variance::

    d_q(z) = sum_c sqrt(W_c) sigma_cq(z) sum_k e_ckq(z) a_ck,         sum_k e_ckq^2 = 1,    sum_c W_c = 1

so that its standard deviation is ``sqrt(sum_c W_c sigma_cq^2)`` exactly. z is the log-pressure height of the climate,
``7 km ln(p_0 / p)``. The modes (``data/weather_modes.npz``) are singular vectors of the 96 real states' deviations
from the climate, all three quantities together, so that warm layers are dry or rich in ozone as they really are.

The states were chosen to be diverse, and so their spread is that of extremes: sigma is :data:`DAYS` of it. The figure
was set before any horizon was looked at: at 10 and 30 hPa the states of polar winters spread by 14 and 12 K, where days
of a winter at 60 to 80 deg spread by some 11 and 9 K (round numbers of the size that reference atmospheres give; A. E.
Cole and A. J. Kantor, Air Force Reference Atmospheres, 1978).

Beyond 65 km, where half of the states end, deviations fade as :data:`FADING_M` says; nothing is known there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import npz

TABLE = "weather_modes.npz"
CLASSES = ("tropics", "midlatitudes", "polar winter", "polar summer")
MODES = 6
DAYS = 0.8
SCALE_M = 7000.0
FADING_M = 15_000.0
QUIET_NORTH, QUIET_SOUTH = 7.5, 2.0
"""Month at which a hemisphere's stratosphere is quietest; half a year later its waves are strongest: at the end of
January, in the south in late winter (W. J. Randel, J. Atmos. Sci. 45, 1988)."""
_TROPICS_DEG, _POLAR_DEG = (20.0, 32.0), (45.0, 57.0)


@dataclass(frozen=True)
class VerticalModes:
    """``level_m`` (k,): log-pressure height. ``spread`` (c, 3, k): sigma. ``modes`` (c, m, 3, k)."""

    level_m: FloatArray
    spread: FloatArray
    modes: FloatArray

    def at(self, height_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return spread (c, 3, n) and modes (c, m, 3, n) at log-pressure heights (n,), linear between levels."""
        z = np.clip(height_m, self.level_m[0], self.level_m[-1])
        i = np.clip(np.searchsorted(self.level_m, z, side="right") - 1, 0, len(self.level_m) - 2)
        w = (z - self.level_m[i]) / (self.level_m[i + 1] - self.level_m[i])
        fading = np.exp(-np.maximum(height_m - self.level_m[-1], 0.0) / FADING_M)
        spread, modes = (v[..., i] * (1.0 - w) + v[..., i + 1] * w for v in (self.spread, self.modes))
        length = np.sqrt(np.sum(modes**2, axis=1, keepdims=True))
        return spread * fading, modes / np.maximum(length, 1e-9)


@cache
def vertical_modes() -> VerticalModes:
    """Return the shipped modes with the deviations of days."""
    table = npz(TABLE)
    level, spread, modes = (
        np.asarray(table[key], dtype=np.float64) for key in ("log_pressure_altitude_m", "spread", "modes")
    )
    smooth = np.pad(spread, ((0, 0), (0, 0), (1, 1)), mode="edge")
    smooth = 0.25 * smooth[..., :-2] + 0.5 * smooth[..., 1:-1] + 0.25 * smooth[..., 2:]
    return VerticalModes(level, DAYS * smooth, modes)


def winter_share(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return how far a hemisphere is in the season of waves, 0 to 1."""
    north, south = (
        0.5 * (1.0 - math.cos(2.0 * math.pi * (month - quiet) / 12.0)) for quiet in (QUIET_NORTH, QUIET_SOUTH)
    )
    return np.where(np.asarray(latitude_deg, dtype=np.float64) >= 0.0, north, south)


def class_weights(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return W_c of the module text, shape (4, n), for latitudes (n,)."""
    latitude = np.abs(np.asarray(latitude_deg, dtype=np.float64))

    def smooth(low: float, high: float) -> FloatArray:
        x = np.clip((latitude - low) / (high - low), 0.0, 1.0)
        return x * x * (3.0 - 2.0 * x)

    away, polar = smooth(*_TROPICS_DEG), smooth(*_POLAR_DEG)
    winter = winter_share(latitude_deg, month)
    return np.stack([1.0 - away, away * (1.0 - polar), away * polar * winter, away * polar * (1.0 - winter)])


def class_of(latitude_deg: float, month: float) -> int:
    """Return the class that a place and month belong to most."""
    return int(np.argmax(class_weights(np.array([latitude_deg]), month)[:, 0]))
