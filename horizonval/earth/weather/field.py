r"""Weather: fields of temperature, ozone, water vapour and surface pressure over the globe, drawn from a seed.

Every vertical mode of :mod:`horizonval.earth.weather.modes` has a random number at each place. It is a sum over zonal
wave numbers m = 0 to 7 of Gaussian processes A, B over latitude, turned westward with height z::

    a(z) = sum_m sqrt(w_m) c_m(phi) [A_m(phi) cos(m lambda + t_m z) + B_m(phi) sin(m lambda + t_m z)]

c_m is ``cos(phi)^min(m, 4)``, so that the field has one value at a pole, and the shares w_m are divided by
``sum w_m c_m^2``: the variance is 1 at every place and height, whatever the shares. In the stratosphere of winter the
zonal mean and waves 1 to 3 have nearly all of it, since shorter waves do not get there (J. G. Charney and P. G. Drazin,
J. Geophys. Res. 66, 83 (1961)); in the troposphere waves 4 to 7 have half. Shares are round numbers.

A and B have the covariance ``sum_j v_j cos(j pi (s - s') / 2)`` in s = sin(phi), v_j normal in j with a length of 0.35:
25 deg in middle latitudes, while a polar cap moves as one. Phases fall back to the west by 0.45 rad in 7 km, 26 deg of
longitude for wave 1: the tilt of waves that carry heat poleward. Waves are drawn without a preferred longitude.

The pressure at sea level has a field of its own with the shares of the troposphere, and 2 to 10 hPa.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.weather import warming
from horizonval.earth.weather.modes import CLASSES, MODES, class_weights, vertical_modes

WAVES = 8
SHARES_HIGH = {
    "tropics": (0.50, 0.15, 0.10, 0.07, 0.06, 0.05, 0.04, 0.03),
    "midlatitudes": (0.30, 0.33, 0.17, 0.08, 0.05, 0.03, 0.02, 0.02),
    "polar winter": (0.30, 0.33, 0.17, 0.08, 0.05, 0.03, 0.02, 0.02),
    "polar summer": (0.40, 0.20, 0.12, 0.08, 0.06, 0.06, 0.04, 0.04),
}
SHARES_LOW = (0.15, 0.12, 0.13, 0.12, 0.12, 0.13, 0.12, 0.11)
LOW_M, HIGH_M = 10e3, 20e3
TILT_PER_M = 0.45 / 7000.0
LENGTH, ORDERS = 0.35, 8
STEEPEST_EDGE = 4
_SURFACE_DEG, _SURFACE_HPA = (0.0, 15.0, 30.0, 55.0, 90.0), (2.0, 2.5, 5.0, 10.0, 9.0)


@dataclass(frozen=True)
class Deviations:
    """From the climate, at places (c,) and log-pressure heights (k,): arrays (c, k), the pressure's (c,).

    Logarithms have half their variance taken off, so that the mean amount of a gas is the climate's.
    """

    temperature_k: FloatArray
    ln_ozone: FloatArray
    ln_water: FloatArray
    sea_level_pa: FloatArray


@dataclass(frozen=True)
class WeatherField:
    """The weather of one day: what is drawn follows from the seed alone.

    ``month``: of the climate that it is the weather of. ``warming_k``: of a warming in the winter hemisphere; None
    draws whether there is one. ``opposite``: waves and surface pressure with the other sign, the warming as it is. A
    day and its opposite have the climate for their mean, so that an ensemble of such pairs has it however few they are.
    """

    seed: int
    month: float
    warming_k: float | None = None
    opposite: bool = False

    def warming(self) -> tuple[float, int, float]:
        """Return amplitude [K], pole and longitude of the warm side [rad] of the warming; 0 K without one."""
        happens, size, origin = _random(self.seed, "warming").random(3)
        amplitude = self.warming_k
        if amplitude is None:
            low, high = warming.DRAWN_K
            amplitude = low + (high - low) * size if happens < warming.chance(self.month) else 0.0
        return float(amplitude), warming.winter_pole(self.month), float(origin) * math.tau

    @property
    def _sign(self) -> float:
        return -1.0 if self.opposite else 1.0

    def at(self, latitude_deg: ArrayLike, longitude_deg: ArrayLike, height_m: ArrayLike) -> Deviations:
        """Return the deviations at places and log-pressure heights."""
        latitude, longitude, height = (np.asarray(v, dtype=np.float64) for v in (latitude_deg, longitude_deg, height_m))
        spread, modes = vertical_modes().at(height)
        weights = class_weights(latitude, self.month)
        total = np.zeros((len(latitude), 3 * len(height)))
        coefficients = _coefficients(self.seed)
        for c, name in enumerate(CLASSES):
            if not weights[c].any():
                continue
            part = self._waves(coefficients[c], shares(name, height), modes[c], latitude, longitude, height)
            total += self._sign * np.sqrt(weights[c])[:, None] * spread[c].ravel() * part
        kelvin, ozone, water = np.moveaxis(total.reshape(len(latitude), 3, len(height)), 1, 0)
        half = 0.5 * np.einsum("cn,cqk->qnk", weights, spread[:, 1:] ** 2)
        ozone, water = ozone - half[0], water - half[1]
        amplitude, pole, origin = self.warming()
        if amplitude:
            kelvin = kelvin + warming.warmer_k(amplitude, pole, origin, latitude, longitude, height)
        return Deviations(kelvin, ozone, water, self._sea_level_pa(latitude, longitude))

    @staticmethod
    def _waves(
        coefficients: FloatArray,
        share: FloatArray,
        modes: FloatArray,
        latitude_deg: FloatArray,
        longitude_deg: FloatArray,
        height_m: FloatArray,
    ) -> FloatArray:
        """Return what one class of modes adds up to, of unit variance, shape (c, 3 k).

        ``coefficients`` (modes, waves, 2, orders); ``share`` (waves, k); ``modes`` (modes, 3, k).
        """
        along = _latitude_functions(latitude_deg)
        edge = edges(latitude_deg)
        norm = 1.0 / np.sqrt(edge.T**2 @ share)
        numbers, shapes = [], []
        for m in range(WAVES):
            cosine, sine = (coefficients[:, m, part] @ along for part in (0, 1))
            turn = np.radians(m * longitude_deg)
            # cos(a + b) and sin(a + b), with what belongs to the place and to the height apart
            numbers.append((cosine * np.cos(turn) + sine * np.sin(turn)) * edge[m])
            numbers.append((sine * np.cos(turn) - cosine * np.sin(turn)) * edge[m])
            tilt = (TILT_PER_M if m else 0.0) * height_m
            shapes += [modes * (np.sqrt(share[m]) * lean) for lean in (np.cos(tilt), np.sin(tilt))]
        total = np.concatenate(numbers).T @ np.concatenate(shapes).reshape(-1, 3 * len(height_m))
        return total * np.tile(norm, 3)

    def _sea_level_pa(self, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        """Return the deviation of the pressure at sea level [Pa], shape (c,)."""
        coefficients = _random(self.seed, "surface").standard_normal((1, WAVES, 2, 2 * ORDERS - 1))
        share, one = np.array(SHARES_LOW)[:, None], np.ones((1, 3, 1))
        unit = self._waves(coefficients, share, one, latitude_deg, longitude_deg, np.zeros(1))[:, 0]
        return self._sign * 100.0 * np.interp(np.abs(latitude_deg), _SURFACE_DEG, _SURFACE_HPA) * unit


def shares(class_name: str, height_m: FloatArray) -> FloatArray:
    """Return w_m of the module text, shape (waves, k), at log-pressure heights."""
    x = np.clip((height_m - LOW_M) / (HIGH_M - LOW_M), 0.0, 1.0)
    high = x * x * (3.0 - 2.0 * x)
    return np.outer(SHARES_LOW, 1.0 - high) + np.outer(SHARES_HIGH[class_name], high)


def edges(latitude_deg: FloatArray) -> FloatArray:
    """Return c_m of the module text, shape (waves, n)."""
    power = np.minimum(np.arange(WAVES), STEEPEST_EDGE)[:, None]
    return np.asarray(np.maximum(np.cos(np.radians(latitude_deg)), 0.0) ** power)


def _latitude_functions(latitude_deg: FloatArray) -> FloatArray:
    """Return functions of latitude whose squares add up to 1, shape (2 orders - 1, n)."""
    order = np.arange(ORDERS)
    weight = np.exp(-0.5 * (0.5 * math.pi * order * LENGTH) ** 2)
    root = np.sqrt(weight / weight.sum())[:, None]
    angle = 0.5 * math.pi * order[:, None] * np.sin(np.radians(latitude_deg))
    return np.concatenate([root * np.cos(angle), (root * np.sin(angle))[1:]])


@lru_cache(maxsize=8)
def _coefficients(seed: int) -> FloatArray:
    values = _random(seed, "modes").standard_normal((len(CLASSES), MODES, WAVES, 2, 2 * ORDERS - 1))
    values.setflags(write=False)
    return values


def _random(seed: int, what: str) -> np.random.Generator:
    """Return a stream of its own for each thing that is drawn."""
    key = int.from_bytes(what.encode(), "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, key])))
