"""Weather: random fields of temperature, ozone, water vapour and surface pressure over the globe, from a seed.

**Horizontal structure.** Every vertical mode has a random coefficient at each place. It is a sum over zonal wave
numbers m = 0 to 7 of Gaussian processes A, B over latitude, turned westward with height z::

    a(z) = sum_m sqrt(w_m) c_m(phi) [A_m(phi) cos(m lambda + t_m z) + B_m(phi) sin(m lambda + t_m z)]

c_m is ``cos(phi)^min(m, 4)``, so that the field has one value at a pole, and the shares w_m are divided by ``sum w_m
c_m^2``: the variance is 1 at every place and height. In the winter stratosphere the zonal mean and waves 1 to 3 have
nearly all of it, since shorter waves do not propagate there (J. G. Charney and P. G. Drazin, J. Geophys. Res. 66, 83
(1961)); in the troposphere waves 4 to 7 have half. Shares are rounded.

A and B have the covariance ``sum_j v_j cos(j pi (s - s') / 2)`` in s = sin(phi), v_j normal in j with a length of 0.35:
25 deg in middle latitudes, while a polar cap moves as one. Phases lag to the west by 0.45 rad in 7 km, 26 deg of
longitude for wave 1: the tilt of waves that carry heat poleward. No longitude is preferred. The pressure at sea level
has a separate field with the shares of the troposphere, and 2 to 10 hPa.

**Vertical structure.** The deviation of temperature, ln ozone and ln water vapour (q = 0, 1, 2) from the climate is a
sum over classes c (latitude and season) and modes k with random numbers a of unit variance::

    d_q(z) = sum_c sqrt(W_c) sigma_cq(z) sum_k e_ckq(z) a_ck,         sum_k e_ckq^2 = 1,    sum_c W_c = 1

so that its standard deviation is exactly ``sqrt(sum_c W_c sigma_cq^2)``. z is the log-pressure height of the climate,
``7 km ln(p_0 / p)``. The modes (``data/weather_modes.npz``) are joint singular vectors of the three quantities'
deviations in the 96 real states, so that warm layers are realistically dry or rich in ozone. These states were selected
to be diverse; sigma is therefore :data:`DAYS` of their spread, which gives the day-to-day variability of polar winters
(A. E. Cole and A. J. Kantor, Air Force Reference Atmospheres, 1978). Beyond 65 km, where half of the states end,
deviations fade (:data:`FADING_M`).

**Sudden stratospheric warmings.** The polar stratosphere warms by some tens of kelvin within days, while the mesosphere
above it cools; the warm air is off the pole at first. With the share of latitude c (0 at 45 deg, 1 from 70 deg on) and
the profile v over log-pressure height::

    dT = W v(z) [c + 0.35 sin(c pi / 2) (cos(phi) / cos(65 deg)) cos(lambda - lambda_0 + tilt z)],
    v(z) = exp(-((z - 33 km) / 9 km)^2 / 2) - 0.5 exp(-((z - 68 km) / 9 km)^2 / 2)

W is the mean over the polar cap at its warmest, near 8 hPa. Shape and rounded values follow the composites of V.
Limpasuvan et al., J. Climate 17, 2584 (2004). In the north six winters of ten have a major warming (A. J. Charlton and
L. M. Polvani, J. Climate 20, 449 (2007)), which lasts some 20 of 120 days: one winter day in ten. In the south it is
one spring in twenty. Random warmings have W uniform from 25 to 55 K.

**Map of columns** (:class:`ColumnMap`): a square lattice on the stereographic projection about the place c below the
camera. A place with the ellipsoid's unit normal n, and axes e, f across c, has the coordinates::

    x = n . e / (1 + n . c),    y = n . f / (1 + n . c),        sqrt(x^2 + y^2) = tan(theta / 2)

with theta the angle from c. The projection is smooth everywhere except opposite of c, at the poles and the date line
too. Values are bilinear in (x, y) between columns, and constant beyond the outermost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import npz
from horizonval.geometry.rotation import perpendicular

WARM_M, COLD_M, DEEP_M = 33e3, 68e3, 9e3
COLD_SHARE, WAVE_SHARE = 0.5, 0.35
TILT_PER_M = 0.45 / 7000.0
"""Phase of the planetary waves per height."""
NORTH_DAYS, SOUTH_DAYS = 0.1, 0.003
DRAWN_K = (25.0, 55.0)


def winter_pole(month: float) -> int:
    """Return 1 from November to April (north), -1 from May to October."""
    return 1 if math.cos(2.0 * math.pi * (month - 1.5) / 12.0) > 0.0 else -1


def chance(month: float) -> float:
    """Return the probability of a warming on a day of a month; 0 outside the inner months of winter."""
    pole = winter_pole(month)
    middle = 1.5 if pole > 0 else 8.5
    inner = abs((month - middle + 6.0) % 12.0 - 6.0) <= 2.0
    return (NORTH_DAYS if pole > 0 else SOUTH_DAYS) if inner else 0.0


def warmer_k(
    amplitude_k: float,
    pole: int,
    origin_rad: float,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    height_m: FloatArray,
) -> FloatArray:
    """Return dT of the module text, shape (c, k), at places (c,) and log-pressure heights (k,).

    ``pole``: 1 north, -1 south. ``origin_rad``: longitude of the warm side at the ground.
    """
    x = np.clip((pole * latitude_deg - 45.0) / 25.0, 0.0, 1.0)
    cap = x * x * (3.0 - 2.0 * x)
    vertical = np.exp(-0.5 * ((height_m - WARM_M) / DEEP_M) ** 2)
    vertical = vertical - COLD_SHARE * np.exp(-0.5 * ((height_m - COLD_M) / DEEP_M) ** 2)
    # none at the pole itself, where longitudes meet
    ring = np.sin(0.5 * math.pi * cap) * np.cos(np.radians(latitude_deg)) / math.cos(math.radians(65.0))
    phase = np.radians(longitude_deg)[:, None] - origin_rad + TILT_PER_M * height_m
    return np.asarray(amplitude_k * vertical * (cap[:, None] + WAVE_SHARE * ring[:, None] * np.cos(phase)))


TABLE = "weather_modes.npz"
CLASSES = ("tropics", "midlatitudes", "polar winter", "polar summer")
MODES = 6
DAYS = 0.8
SCALE_M = 7000.0
FADING_M = 15_000.0
QUIET_NORTH, QUIET_SOUTH = 7.5, 2.0
"""Month at which a hemisphere's stratosphere is quietest; its waves are strongest half a year later (W. J. Randel, J.
Atmos. Sci. 45, 1988)."""
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
    """Return the shipped modes with the daily standard deviations."""
    table = npz(TABLE)
    level, spread, modes = (
        np.asarray(table[key], dtype=np.float64) for key in ("log_pressure_altitude_m", "spread", "modes")
    )
    smooth = np.pad(spread, ((0, 0), (0, 0), (1, 1)), mode="edge")
    smooth = 0.25 * smooth[..., :-2] + 0.5 * smooth[..., 1:-1] + 0.25 * smooth[..., 2:]
    return VerticalModes(level, DAYS * smooth, modes)


def winter_share(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the strength of a hemisphere's wave season, 0 to 1."""
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


WAVES = 8
SHARES_HIGH = {
    "tropics": (0.50, 0.15, 0.10, 0.07, 0.06, 0.05, 0.04, 0.03),
    "midlatitudes": (0.30, 0.33, 0.17, 0.08, 0.05, 0.03, 0.02, 0.02),
    "polar winter": (0.30, 0.33, 0.17, 0.08, 0.05, 0.03, 0.02, 0.02),
    "polar summer": (0.40, 0.20, 0.12, 0.08, 0.06, 0.06, 0.04, 0.04),
}
SHARES_LOW = (0.15, 0.12, 0.13, 0.12, 0.12, 0.13, 0.12, 0.11)
LOW_M, HIGH_M = 10e3, 20e3

LENGTH, ORDERS = 0.35, 8
STEEPEST_EDGE = 4
_SURFACE_DEG, _SURFACE_HPA = (0.0, 15.0, 30.0, 55.0, 90.0), (2.0, 2.5, 5.0, 10.0, 9.0)


@dataclass(frozen=True)
class Deviations:
    """From the climate, at places (c,) and log-pressure heights (k,): arrays (c, k), the pressure's (c,).

    Half the variance is subtracted from logarithms, so that the mean amount of a gas is the climate's.
    """

    temperature_k: FloatArray
    ln_ozone: FloatArray
    ln_water: FloatArray
    sea_level_pa: FloatArray


@dataclass(frozen=True)
class WeatherField:
    """The weather of one day, fixed by the seed.

    ``month``: of the underlying climate. ``warming_k``: of a stratospheric warming in the winter hemisphere; None for a
    random one. ``opposite``: waves and surface pressure with the opposite sign, the warming unchanged. The mean of a
    day and its opposite is the climate, which makes ensembles of such pairs unbiased.
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
            low, high = DRAWN_K
            amplitude = low + (high - low) * size if happens < chance(self.month) else 0.0
        return float(amplitude), winter_pole(self.month), float(origin) * math.tau

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
            kelvin = kelvin + warmer_k(amplitude, pole, origin, latitude, longitude, height)
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
        """Return the sum of one class of modes, of unit variance, shape (c, 3 k).

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
    """Return a separate random stream for each quantity."""
    key = int.from_bytes(what.encode(), "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, key])))


COARSER = 4
"""Thinning of columns each way for slowly varying quantities; the number of columns along a side fits it."""


@dataclass(frozen=True)
class ColumnMap:
    """``axes`` (3, 3): e, f and c as rows. ``half``: largest x and y. ``count``: columns along a side."""

    axes: FloatArray
    half: float
    count: int

    @classmethod
    def around(cls, centre: FloatArray, reach_rad: float, step_rad: float) -> ColumnMap:
        """Return the map of all places within ``reach_rad`` of a unit normal, columns at most ``step_rad`` apart."""
        half = math.tan(0.5 * min(reach_rad, 0.95 * math.pi))
        # a step of the map is widest at its centre: 2 dx
        count = 1 + COARSER * math.ceil(2.0 * half / (COARSER * math.tan(0.5 * step_rad)) - 1e-9)
        c = centre / np.linalg.norm(centre)
        e = perpendicular(c)
        return cls(np.stack([e, np.cross(c, e), c]), half, count)

    @property
    def columns(self) -> int:
        """Number of columns; those of a row of equal y are contiguous."""
        return self.count**2

    def coarser(self) -> tuple[ColumnMap, np.ndarray]:
        """Return the map of every :data:`COARSER` th column each way, and the indices of those columns."""
        side = np.arange(0, self.count, COARSER)
        return ColumnMap(self.axes, self.half, len(side)), (side[:, None] * self.count + side).ravel()

    def plane(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y of unit normals (..., 3)."""
        across, along, up = (normal @ axis for axis in self.axes)
        return across / (1.0 + up), along / (1.0 + up)

    def normals(self) -> FloatArray:
        """Return the unit normals of the columns, shape (columns, 3)."""
        side = np.linspace(-self.half, self.half, self.count)
        y, x = (v.ravel() for v in np.meshgrid(side, side, indexing="ij"))
        squared = x**2 + y**2
        place = np.stack([2.0 * x, 2.0 * y, 1.0 - squared], axis=-1) / (1.0 + squared)[:, None]
        return np.asarray(place @ self.axes)

    def corners(self, x: FloatArray, y: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return the four columns around places, and their weights."""
        (i, u), (j, v) = (self._along(value) for value in (x, y))
        start = j * self.count + i
        return [
            (start, (1.0 - u) * (1.0 - v)),
            (start + 1, u * (1.0 - v)),
            (start + self.count, (1.0 - u) * v),
            (start + self.count + 1, u * v),
        ]

    def _along(self, value: FloatArray) -> tuple[np.ndarray, FloatArray]:
        step = np.clip((value + self.half) * ((self.count - 1) / (2.0 * self.half)), 0.0, self.count - 1.0)
        i = np.minimum(step.astype(np.intp), self.count - 2)
        return i, step - i


def latitude_longitude_deg(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return geodetic latitude and longitude of unit normals (..., 3)."""
    latitude = np.degrees(np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1])))
    return latitude, np.degrees(np.arctan2(normal[..., 1], normal[..., 0]))
