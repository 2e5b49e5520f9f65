r"""Clouds as the Earth has them: where, of which kind, how high and how bright, from a seed and a month.

**Where.** Gradient noise of ten octaves n, looked up where whirls brought the air from (:mod:`.whirls`), plus what
fronts add. u is its rank among its values over the globe, F the fraction of :mod:`.climatology`. A place is cloudy
where u exceeds ``1 - F'`` with ``logit F' = logit F + d``; d makes the global share exact, that of the climatology or
the one that is asked for. Octaves count by the kind of cloud: fronts have all sizes, with amplitudes falling as the
cube root, the tropics most at 300 to 600 km, decks cells of some 40 km (closed ones: the noise's absolute value).

**How high.** With ``s = (u - (1 - F')) / F'``, uniform from 0 to 1 over the clouds of a place, every kind has
``top = base + span s^p`` (:data:`SPAN_M`, :data:`POWER`), mixed by the kinds' shares: deep clouds reach the
tropopause, fronts most of it, decks end at 1.5 km, cumulus at 3.5.

**How bright.** Optical thickness is distributed log-logistically, ``tau = tau_0 (s / (1 - s))^k``, and albedo follows
in the two-stream approximation, ``A = g tau / (1 + g tau)``, ``g = (1 - 0.85) sqrt(3) / 2``, without absorption. tau_0
and k were chosen for the whole globe to have the shares of ISCCP: 0.53 of all clouds thinner than 3.6, 0.38 from there
to 23, 0.09 thicker (W. B. Rossow and R. A. Schiffer, Bull. Am. Meteorol. Soc. 80, 2261 (1999), of all heights). It has
0.54, 0.37 and 0.08. What a cloud does not reflect it hands on to the ground; see
:mod:`horizonval.renderer.kernel.surface`.

The coarse part (origin of the air, fronts, fraction, kinds) is a map of one degree, bilinear between its nodes, so
that only noise is left to do where a place is looked up. The arithmetic is written once, for numpy and Dr.Jit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.climatology import cloud_kinds
from horizonval.earth.clouds.lattice_noise import (
    EARTH_RADIUS_M,
    FALLOFF,
    even_points,
    lattice_noise,
    numpy_split,
    ranked,
)
from horizonval.earth.clouds.whirls import stirred

BASE_M = 500.0
LARGEST_M, OCTAVES = 2_400_000.0, 10
STRETCHED_OCTAVES, STRETCH = 5, 2.0
"""The largest octaves are compressed along the Earth's axis: weather is longer from west to east."""
STIRRED_OCTAVES = 7
"""Smaller ones lie where they are: billows and cells form anew, and are not drawn out to threads."""
CELL_OCTAVES = (5, 6)
"""Of 75 and 37 km, where decks have closed cells."""
PER_DEGREE = 1
MAP_ROWS, MAP_COLUMNS, CHANNELS = 180 * PER_DEGREE + 1, 360 * PER_DEGREE + 1, 8
CALIBRATION_POINTS = 400_000
CALIBRATION_PARTS = 25
"""16 000 points at a time stay in a processor's cache: two thirds of the time of all at once."""
MEAN_POINTS = 20_000
RANK_STEPS = 512
TWO_STREAM = 0.15 * math.sqrt(3.0) / 2.0
LARGEST_LOGIT = 40.0

NOISE_SIGMA, CELL_MEAN, CELL_SIGMA = 0.1909, 0.1534, 0.1136
"""Of one octave, and of its absolute value."""

KINDS = ("deep", "fronts", "deck", "cumulus")
WEIGHTS = {
    "deep": (0.5, 0.7, 1.0, 0.9, 0.65, 0.5, 0.4, 0.32, 0.25, 0.2),
    "fronts": tuple(FALLOFF**k for k in range(10)),
    "deck": (0.8, 0.6, 0.5, 0.35, 0.3, 0.6, 0.8, 0.45, 0.35, 0.25),
    "cumulus": (0.6, 0.5, 0.55, 0.55, 0.5, 0.55, 0.6, 0.5, 0.4, 0.3),
}
SPAN_M = {"deck": 1000.0, "cumulus": 3000.0}
FRONT_SHARE = 0.85
"""Of the way to the tropopause that fronts reach; deep clouds reach all of it."""
POWER = {"deep": 2.2, "fronts": 1.2, "deck": 0.5, "cumulus": 1.5}
THICKNESS = {"deep": 3.2, "fronts": 4.2, "deck": 6.0, "cumulus": 1.7}
SPREAD = {"deep": 0.95, "fronts": 0.8, "deck": 0.55, "cumulus": 0.7}
"""Median optical thickness, and the k of the module text (a logarithmic standard deviation is 1.81 k)."""


@dataclass(frozen=True)
class Arithmetic:
    """What numpy and Dr.Jit spell differently. ``split``, ``real``: as for the lattice noise."""

    module: Any
    where: Callable[[Any, Any, Any], Any]
    split: Callable[[Any], tuple[Any, Any]]
    real: Callable[[Any], Any]
    constant: Callable[[float], Any]


@dataclass(frozen=True, eq=False)
class Coarse:
    """What a seed and a month fix for the whole globe.

    Attributes
    ----------
    values : ndarray, shape (MAP_ROWS * MAP_COLUMNS * CHANNELS,)
        Float32: shift of the place (3), fronts, logit of the fraction, shares of deep clouds, fronts, decks. Rows from
        90 S, columns from 180 W to 180 E, both ends the same.
    lowest, highest : float
        Noise at the ends of ``rank``.
    rank : ndarray, shape (RANK_STEPS + 1,)
    """

    values: Any
    lowest: float
    highest: float
    rank: FloatArray


@dataclass(frozen=True)
class Local:
    """The coarse map at places."""

    shift: tuple[Any, Any, Any]
    lift: Any
    fraction: Any
    shares: dict[str, Any]


def local(channels: list[Any], a: Arithmetic) -> Local:
    """Return the coarse map at places from its channels there."""
    deep, fronts, deck = channels[5:8]
    shares = {"deep": deep, "fronts": fronts, "deck": deck, "cumulus": 1.0 - deep - fronts - deck}
    fraction = 1.0 / (1.0 + a.module.exp(-channels[4]))
    return Local((channels[0], channels[1], channels[2]), channels[3], fraction, shares)


def noise(position: tuple[Any, Any, Any], at: Local, seed: Any, a: Arithmetic) -> Any:
    """Return the noise at unit vectors, of variance one but for what fronts add.

    ``seed``: unsigned 32-bit, of whatever kind is multiplied with arrays of such.
    """
    return octaves(position, at, seed, a, range(OCTAVES)) / sigma(at, a) + at.lift


def octaves(position: tuple[Any, Any, Any], at: Local, seed: Any, a: Arithmetic, which: range) -> Any:
    """Return the sum of some octaves of the noise at unit vectors, each weighted; ``seed`` as of :func:`noise`."""
    stirred_place = [p + d for p, d in zip(position, at.shift, strict=True)]
    total: Any = 0.0
    for octave in which:
        per_cell = EARTH_RADIUS_M / LARGEST_M * 2.0**octave
        stretch = STRETCH if octave < STRETCHED_OCTAVES else 1.0
        place = stirred_place if octave < STIRRED_OCTAVES else position
        one = lattice_noise(
            (place[0] * per_cell, place[1] * per_cell, place[2] * (per_cell * stretch)), octave, seed, a.split, a.real
        ) * (1.0 / NOISE_SIGMA)
        if octave in CELL_OCTAVES:
            cells = (a.module.abs(one) - CELL_MEAN / NOISE_SIGMA) * (NOISE_SIGMA / CELL_SIGMA)
            one = one + at.shares["deck"] * (cells - one)
        total = total + _weight(octave, at) * one
    return total


def sigma(at: Local, a: Arithmetic) -> Any:
    """Return the standard deviation of the weighted octaves together."""
    variance: Any = 0.0
    for octave in range(OCTAVES):
        weight = _weight(octave, at)
        variance = variance + weight * weight
    return a.module.sqrt(variance)


def _weight(octave: int, at: Local) -> Any:
    return sum(WEIGHTS[kind][octave] * at.shares[kind] for kind in KINDS)


def depth(rank: Any, at: Local, a: Arithmetic) -> Any:
    """Return s of the module text, from -1 far from clouds to 1 deep inside."""
    return a.module.maximum((rank - (1.0 - at.fraction)) / at.fraction, -1.0)


def top_m(s: Any, at: Local, ceiling_m: Any, highest_m: Any, a: Arithmetic) -> Any:
    """Return the tops: below BASE_M where there is no cloud, and as far below as the same s inside would be above.

    So the zero of a relief that is bilinear between nodes lies where that of s does. ``ceiling_m``: the tropopause;
    ``highest_m``: no top is higher.
    """
    depth_of = a.module.log(a.module.maximum(a.module.abs(s), 1e-9))
    span = {"deep": ceiling_m - BASE_M, "fronts": FRONT_SHARE * (ceiling_m - BASE_M), **SPAN_M}
    rise: Any = 0.0
    for kind in KINDS:
        rise = rise + at.shares[kind] * span[kind] * a.module.exp(POWER[kind] * depth_of)
    rise = a.module.minimum(rise, highest_m - BASE_M)
    return BASE_M + a.where(s > 0.0, rise, -rise)


def albedo(s: Any, at: Local, a: Arithmetic) -> Any:
    """Return the albedo of clouds, 0 outside."""
    inside = a.module.minimum(a.module.maximum(s, 1e-6), 1.0 - 1e-6)
    spread: Any = sum(SPREAD[kind] * at.shares[kind] for kind in KINDS)
    median: Any = sum(math.log(TWO_STREAM * THICKNESS[kind]) * at.shares[kind] for kind in KINDS)
    scaled = a.module.exp(median + spread * a.module.log(inside / (1.0 - inside)))
    return a.where(s > 0.0, scaled / (1.0 + scaled), 0.0 * s)


@cache
def climatological_cover(month: int) -> float:
    """Return the share of the globe under clouds in a month."""
    p = even_points(MEAN_POINTS)
    latitude, longitude = np.degrees(np.arcsin(p[:, 2])), np.degrees(np.arctan2(p[:, 1], p[:, 0]))
    return float(cloud_kinds(latitude, longitude, month).fraction.mean())


def numpy_arithmetic() -> Arithmetic:
    """Return numpy's spelling."""
    return Arithmetic(np, np.where, numpy_split, lambda h: h.astype(np.float64), float)


def map_place(latitude_deg: Any, longitude_deg: Any) -> tuple[Any, Any]:
    """Return (row, column) of the coarse map as fractions, for longitudes from 180 W to 180 E."""
    return (latitude_deg + 90.0) * PER_DEGREE, (longitude_deg + 180.0) * PER_DEGREE


def at_places(coarse: Coarse, position: FloatArray) -> Local:
    """Return the coarse map at unit vectors, shape (n, 3)."""
    latitude = np.degrees(np.arcsin(np.clip(position[:, 2], -1.0, 1.0)))
    y, x = map_place(latitude, np.degrees(np.arctan2(position[:, 1], position[:, 0])))
    i, j = np.minimum(y.astype(int), MAP_ROWS - 2), np.minimum(x.astype(int), MAP_COLUMNS - 2)
    wy, wx = (y - i)[:, None], (x - j)[:, None]
    cells = coarse.values.reshape(MAP_ROWS, MAP_COLUMNS, CHANNELS)
    low = cells[i, j] + (cells[i, j + 1].astype(np.float64) - cells[i, j]) * wx
    high = cells[i + 1, j] + (cells[i + 1, j + 1].astype(np.float64) - cells[i + 1, j]) * wx
    return local(list((low + (high - low) * wy).T), numpy_arithmetic())


def depth_at(coarse: Coarse, seed: int, position: FloatArray) -> tuple[FloatArray, Local]:
    """Return s and the coarse map at unit vectors, shape (n, 3)."""
    n, at = _noise_at(coarse, seed, position)
    rank = np.interp(n, np.linspace(coarse.lowest, coarse.highest, RANK_STEPS + 1), coarse.rank)
    return depth(rank, at, numpy_arithmetic()), at


def _noise_at(coarse: Coarse, seed: int, position: FloatArray) -> tuple[FloatArray, Local]:
    """Return the noise and the coarse map at unit vectors, shape (n, 3)."""
    at = at_places(coarse, position)
    return noise((position[:, 0], position[:, 1], position[:, 2]), at, seed, numpy_arithmetic()), at


def coarse_map(seed: int, month: int, cover: float | None) -> Coarse:
    """Return the coarse map of a seed in a month; ``cover``: global share, None for that of the climatology."""
    latitude = np.linspace(-90.0, 90.0, MAP_ROWS)
    longitude = np.linspace(-180.0, 180.0, MAP_COLUMNS)
    north, east = np.meshgrid(np.radians(latitude), np.radians(longitude), indexing="ij")
    position = np.stack([np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)], axis=-1)
    origin, lift = stirred(position.reshape(-1, 3), seed)
    lift = lift.reshape(north.shape)
    # fronts move the clouds of a latitude about, and make no more of them
    lift = lift - lift[:, :-1].mean(axis=1)[:, None]
    kinds = cloud_kinds(np.degrees(north), np.degrees(east), month)
    fraction = np.log(kinds.fraction / (1.0 - kinds.fraction))
    values = np.concatenate(
        [
            origin.reshape(position.shape) - position,
            np.stack([lift, fraction, kinds.deep, kinds.fronts, kinds.deck], axis=-1),
        ],
        axis=-1,
    )
    # both ends of a row are one place, and so is all of a pole's
    values[:, -1] = values[:, 0]
    values[[0, -1]] = values[[0, -1], :-1].mean(axis=1)[:, None]
    values = values.astype(np.float32)
    first = Coarse(values.ravel(), 0.0, 0.0, np.zeros(0))
    parts = [
        _noise_at(first, seed, some) for some in np.array_split(even_points(CALIBRATION_POINTS), CALIBRATION_PARTS)
    ]
    n, covered = (np.concatenate(each) for each in zip(*((m, at.fraction) for m, at in parts), strict=True))
    lowest, highest, rank = ranked(n, RANK_STEPS)
    u = np.interp(n, np.linspace(lowest, highest, RANK_STEPS + 1), rank)
    wanted = climatological_cover(month) if cover is None else cover
    values[..., 4] += np.float32(_shift(u, covered, wanted))
    flat = values.ravel()
    flat.setflags(write=False)
    return Coarse(flat, lowest, highest, rank)


def _shift(u: FloatArray, fraction: FloatArray, wanted: float) -> float:
    """Return by what the logit of the fraction is shifted for the wanted share of places to be cloudy."""
    threshold = np.log(np.maximum(1.0 - u, 1e-12) / np.maximum(u, 1e-12)) - np.log(fraction / (1.0 - fraction))
    if wanted >= 1.0:
        return LARGEST_LOGIT
    return float(np.quantile(threshold, wanted))
