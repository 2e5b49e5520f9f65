"""Clouds as the Earth has them: position, kind, height and brightness from a seed and a month.

**Position.** Gradient noise of ten octaves n, evaluated where vortices have brought the air from, plus the contribution
of fronts. u is its rank among its values over the globe, F the fraction of :mod:`.climatology`. A place is cloudy where
u exceeds ``1 - F'`` with ``logit F' = logit F + d``; d makes the global share exactly that of the climatology or the
requested one. The weights of the octaves depend on the kind of cloud: fronts have all sizes, with amplitudes falling as
the cube root, the tropics mostly 300 to 600 km, decks closed cells of some 40 km (the noise's absolute value).

**Height.** With ``s = (u - (1 - F')) / F'``, uniform from 0 to 1 over the clouds of a place, every kind has ``top =
base + span s^p`` (:data:`SPAN_M`, :data:`POWER`), mixed by the kinds' shares: deep clouds reach the tropopause, fronts
most of it, decks end at 1.5 km, cumulus at 3.5.

**Brightness.** Optical thickness has a log-logistic distribution, ``tau = tau_0 (s / (1 - s))^k``, and albedo follows
in the two-stream approximation without absorption, ``A = g tau / (1 + g tau)``, ``g = (1 - 0.85) sqrt(3) / 2``. tau_0
and k give the whole globe the shares of ISCCP within 0.01: 0.53 of all clouds thinner than 3.6, 0.38 from there to 23,
0.09 thicker (W. B. Rossow and R. A. Schiffer, Bull. Am. Meteorol. Soc. 80, 2261 (1999)). Light that a cloud does not
reflect reaches the ground (:mod:`horizonval.renderer.kernel.surface`).

The coarse part (origin of the air, fronts, fraction, kinds) is a map of one degree, bilinear between its nodes, so that
only noise remains to be evaluated per place. Such maps are cached on disk by a digest of everything they depend on. The
arithmetic is written once, for numpy and Dr.Jit. The noise lattice is hashed, not stored.

**Vortices** wind bands up to fronts. Each turns the sphere about an axis c by an angle that decreases with the distance
r from it::

    alpha(r) = alpha_0 exp(-(r / R)^2)

A rotation preserves areas, and so does a chain of them: a random field evaluated at the rotated places keeps its
distribution and gets filaments, hooks and spirals, as in two-dimensional flow. Cyclones in the storm tracks rotate
counterclockwise in the north; weaker vortices of either sense are everywhere. Through each cyclone runs a front: a
ridge of cloud, wound up to a comma, with a clear slot behind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.cache import array_of, cached_arrays, keep_arrays, keep_newest, making
from horizonval.core.code import FRAME_ROOMS, code_digest
from horizonval.core.digests import content_digest
from horizonval.core.environment import cache_folder
from horizonval.earth.clouds.climatology import cloud_kinds
from horizonval.geometry.rotation import GOLDEN_ANGLE_RAD

EARTH_RADIUS_M = 6.371e6
FALLOFF = 0.5 ** (1.0 / 3.0)
"""Ratio of amplitudes of successive octaves: the -5/3 law of cloud fields (R. F. Cahalan and J. B. Snider, Remote Sens.
Environ. 28, 95 (1989))."""
_LATTICE_OFFSET = 8192.0
_FACTORS = (0x8DA6B343, 0xD8163841, 0xCB1AB31F)


def lattice_noise(
    position: tuple[Any, Any, Any],
    octave: int,
    seed: Any,
    split: Callable[[Any], tuple[Any, Any]],
    real: Callable[[Any], Any],
) -> Any:
    """Return one octave of noise at positions in lattice cells (three arrays above -8192), in arbitrary units.

    ``octave``: each has a separate lattice; ``split``: divides positive floats into whole part (unsigned 32-bit) and
    fraction; ``real``: converts unsigned 32-bit arrays to floats.
    """
    offset = _LATTICE_OFFSET + 0.37 * octave
    cells, parts = zip(*(split(v + offset) for v in position), strict=True)
    seed = (seed + (0x9E3779B9 * (octave + 1) & 0xFFFFFFFF)) & 0xFFFFFFFF
    fade = [t * t * t * (t * (t * 6.0 - 15.0) + 10.0) for t in parts]
    away = [(t, t - 1.0) for t in parts]
    # What the eight corners of a cell have in common is hashed once.
    x_key, y_key, z_key = ((c * factor, c * factor + factor) for c, factor in zip(cells, _FACTORS, strict=True))
    xy_key = [[x ^ y for y in y_key] for x in x_key]
    z_key = tuple(z ^ seed for z in z_key)

    def corner(i: int, j: int, k: int) -> Any:
        h = _stirred(xy_key[i][j] ^ z_key[k])
        slopes = [real((h >> shift) & 1023) * (1.0 / 511.5) - 1.0 for shift in (0, 10, 20)]
        return slopes[0] * away[0][i] + slopes[1] * away[1][j] + slopes[2] * away[2][k]

    def mixed(a: Any, b: Any, w: Any) -> Any:
        return a + w * (b - a)

    x = [[mixed(corner(0, j, k), corner(1, j, k), fade[0]) for j in (0, 1)] for k in (0, 1)]
    y = [mixed(a, b, fade[1]) for a, b in x]
    return mixed(y[0], y[1], fade[2])


def _stirred(h: Any) -> Any:
    h = (h ^ (h >> 16)) * 0x85EBCA6B
    h = (h ^ (h >> 13)) * 0xC2B2AE35
    return h ^ (h >> 16)


def numpy_split(v: FloatArray) -> tuple[Any, Any]:
    """Return whole part and fraction of positive floats."""
    whole = np.floor(v)
    return whole.astype(np.uint32), v - whole


def even_points(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the globe, shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    phi = GOLDEN_ANGLE_RAD * k
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def ranked(noise: FloatArray, steps: int) -> tuple[float, float, FloatArray]:
    """Return ``(lowest, highest, rank)`` of values over the globe: their rank at even steps from lowest to highest."""
    values = np.sort(noise)
    places = np.linspace(values[0], values[-1], steps + 1)
    rank = np.interp(places, values, (np.arange(len(values)) + 0.5) / len(values))
    rank[0], rank[-1] = 0.0, 1.0
    rank.setflags(write=False)
    return float(values[0]), float(values[-1]), rank


CYCLONES = 11
"""Number in each hemisphere."""
CYCLONE_RADIUS_KM, CYCLONE_TURN_RAD = (450.0, 950.0), (1.0, 3.3)
CYCLONE_LATITUDE_DEG, CYCLONE_SPREAD_DEG = 51.0, 7.0
LESSER, LESSER_RADIUS_KM, LESSER_TURN_RAD = 120, (250.0, 1100.0), 0.8
FRONT_LENGTH_KM, FRONT_WIDTH_KM, FRONT_HEIGHT, SLOT_DEPTH = 1500.0, 170.0, 1.5, 1.1
"""Half length and half width (standard deviations), and heights in standard deviations of the noise."""
EARTH_RADIUS_KM = 6371.0
REACH = 3.0
"""Radii beyond which a vortex has no effect."""


@dataclass(frozen=True)
class Whirl:
    """A vortex: its axis, and the R and alpha_0 of the module text; positive turns are counterclockwise."""

    axis: FloatArray
    radius_rad: float
    turn_rad: float
    front: bool


def whirls(seed: int) -> list[Whirl]:
    """Return the vortices of a seed, cyclones last."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x57484952]))
    found = []
    for _ in range(LESSER):
        z, longitude = rng.uniform(-1.0, 1.0), rng.uniform(-math.pi, math.pi)
        radius = rng.uniform(*LESSER_RADIUS_KM) / EARTH_RADIUS_KM
        found.append(Whirl(_unit(math.asin(z), longitude), radius, rng.normal() * LESSER_TURN_RAD, False))
    for sense in (1.0, -1.0):
        first = rng.uniform(-math.pi, math.pi)
        for k in range(CYCLONES):
            latitude = math.radians(CYCLONE_LATITUDE_DEG + CYCLONE_SPREAD_DEG * float(np.clip(rng.normal(), -2.0, 2.0)))
            longitude = first + 2.0 * math.pi * (k + rng.uniform(-0.35, 0.35)) / CYCLONES
            radius = rng.uniform(*CYCLONE_RADIUS_KM) / EARTH_RADIUS_KM
            turn = sense * rng.uniform(*CYCLONE_TURN_RAD)
            found.append(Whirl(_unit(sense * latitude, longitude), radius, turn, True))
    return found


def stirred(position: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the origin (n, 3) of the air at unit vectors (n, 3), and the contribution (n,) of fronts to the noise.

    The contribution is in standard deviations of the noise.
    """
    origin, lift = np.array(position), np.zeros(len(position))
    for whirl in reversed(whirls(seed)):
        near = np.flatnonzero(origin @ whirl.axis > math.cos(REACH * whirl.radius_rad))
        turned = _turned(origin[near], whirl)
        if whirl.front:
            lift[near] += _front(turned, whirl)
        origin[near] = turned
    return origin, lift


def _turned(p: FloatArray, whirl: Whirl) -> FloatArray:
    """Return places turned back about the axis (Rodrigues' formula)."""
    along = p @ whirl.axis
    distance = np.arccos(np.clip(along, -1.0, 1.0))
    # nothing jumps where the whirl ends
    fade = np.exp(-((distance / whirl.radius_rad) ** 2)) - math.exp(-(REACH**2))
    angle = -whirl.turn_rad * np.maximum(fade, 0.0)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return p * cosine + np.cross(whirl.axis, p) * sine + whirl.axis * (along[:, None] * (1.0 - cosine))


def _front(p: FloatArray, whirl: Whirl) -> FloatArray:
    """Return the ridge of a cyclone's front before it was wound up, and the slot to its west."""
    east = np.cross([0.0, 0.0, 1.0], whirl.axis)
    east /= np.linalg.norm(east)
    north = np.cross(whirl.axis, east)
    # from the centre towards the equator and back west, as cold fronts trail
    poleward = math.copysign(1.0, float(whirl.axis[2]))
    x, y = p @ east * EARTH_RADIUS_KM, poleward * (p @ north) * EARTH_RADIUS_KM
    along, across = 0.8 * y + 0.6 * x, 0.8 * x - 0.6 * y
    end = 1.0 - np.clip(np.hypot(x, y) / (REACH * whirl.radius_rad * EARTH_RADIUS_KM), 0.0, 1.0) ** 4
    length = np.exp(-0.5 * (along / FRONT_LENGTH_KM) ** 2) * end

    def ridge(middle_km: float, width_km: float) -> FloatArray:
        return np.exp(-0.5 * ((across - middle_km) / width_km) ** 2)

    slot = ridge(-2.2 * FRONT_WIDTH_KM, 1.2 * FRONT_WIDTH_KM)
    return length * (FRONT_HEIGHT * ridge(0.0, FRONT_WIDTH_KM) - SLOT_DEPTH * slot)


def _unit(latitude_rad: float, longitude_rad: float) -> FloatArray:
    c = math.cos(latitude_rad)
    return np.array([c * math.cos(longitude_rad), c * math.sin(longitude_rad), math.sin(latitude_rad)])


BASE_M = 500.0
LARGEST_M, OCTAVES = 2_400_000.0, 10
STRETCHED_OCTAVES, STRETCH = 5, 2.0
"""Octaves compressed along the Earth's axis: large weather systems are longer from west to east."""
STIRRED_OCTAVES = 7
"""Octaves that vortices move; smaller billows and cells form anew and are not drawn out to threads."""
CELL_OCTAVES = (5, 6)
"""Octaves of 75 and 37 km, where decks have closed cells."""
PER_DEGREE = 1
MAP_ROWS, MAP_COLUMNS, CHANNELS = 180 * PER_DEGREE + 1, 360 * PER_DEGREE + 1, 8
CALIBRATION_POINTS = 400_000
CALIBRATION_PARTS = 25
"""16 000 points at a time fit into a processor's cache."""
MEAN_POINTS = 20_000
RANK_STEPS = 512
TWO_STREAM = 0.15 * math.sqrt(3.0) / 2.0
LARGEST_LOGIT = 40.0

NOISE_SIGMA, CELL_MEAN, CELL_SIGMA = 0.1909, 0.1534, 0.1136
"""Standard deviation of one octave; mean and standard deviation of its absolute value."""

KINDS = ("deep", "fronts", "deck", "cumulus")
WEIGHTS = {
    "deep": (0.5, 0.7, 1.0, 0.9, 0.65, 0.5, 0.4, 0.32, 0.25, 0.2),
    "fronts": tuple(FALLOFF**k for k in range(10)),
    "deck": (0.8, 0.6, 0.5, 0.35, 0.3, 0.6, 0.8, 0.45, 0.35, 0.25),
    "cumulus": (0.6, 0.5, 0.55, 0.55, 0.5, 0.55, 0.6, 0.5, 0.4, 0.3),
}
SPAN_M = {"deck": 1000.0, "cumulus": 3000.0}
FRONT_SHARE = 0.85
"""Part of the height of the tropopause that fronts reach."""
POWER = {"deep": 2.2, "fronts": 1.2, "deck": 0.5, "cumulus": 1.5}
THICKNESS = {"deep": 3.2, "fronts": 4.2, "deck": 6.0, "cumulus": 1.7}
SPREAD = {"deep": 0.95, "fronts": 0.8, "deck": 0.55, "cumulus": 0.7}
"""Median optical thickness, and the k of the module text (a logarithmic standard deviation is 1.81 k)."""


@dataclass(frozen=True)
class Arithmetic:
    """Operations that numpy and Dr.Jit spell differently; ``split`` and ``real`` as in :func:`lattice_noise`."""

    module: Any
    where: Callable[[Any, Any, Any], Any]
    split: Callable[[Any], tuple[Any, Any]]
    real: Callable[[Any], Any]
    constant: Callable[[float], Any]


@dataclass(frozen=True, eq=False)
class Coarse:
    """The global part of the pattern, from seed and month.

    ``values``: shape (MAP_ROWS * MAP_COLUMNS * CHANNELS,), float32: shift of the place (3), fronts, logit of the
    fraction, shares of deep clouds, fronts, decks; rows from 90 S, columns from 180 W to 180 E, both ends equal.
    ``lowest``, ``highest``: noise at the ends of ``rank``, of shape (RANK_STEPS + 1,).
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
    """Return the noise at unit vectors, of variance one plus the contribution of fronts.

    ``seed``: unsigned 32-bit, of a type that can be multiplied with arrays of such.
    """
    return octaves(position, at, seed, a, range(OCTAVES)) / sigma(at, a) + at.lift


def octaves(position: tuple[Any, Any, Any], at: Local, seed: Any, a: Arithmetic, which: range) -> Any:
    """Return the weighted sum of some octaves of the noise at unit vectors; ``seed`` as of :func:`noise`."""
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
    """Return the standard deviation of the weighted sum of all octaves."""
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
    """Return cloud tops. Without cloud they are below BASE_M, by as much as the same s inside would be above.

    The zero of a relief that is bilinear between nodes is therefore that of s. ``ceiling_m``: the tropopause;
    ``highest_m``: upper bound of all tops.
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
    """Return numpy's operations."""
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
    # fronts redistribute the clouds of a latitude without adding any
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
    """Return the shift of the fraction's logit for which the wanted share of places is cloudy."""
    threshold = np.log(np.maximum(1.0 - u, 1e-12) / np.maximum(u, 1e-12)) - np.log(fraction / (1.0 - fraction))
    if wanted >= 1.0:
        return LARGEST_LOGIT
    return float(np.quantile(threshold, wanted))


KEPT = 64


@lru_cache(maxsize=4)
def kept_coarse_map(seed: int, month: int, cover: float | None) -> Coarse:
    """Return :func:`coarse_map`, cached in memory and on disk."""
    method = code_digest(rooms=FRAME_ROOMS)
    path = cache_folder() / "clouds" / f"{content_digest(method, seed, month, cover)[:32]}.npz"
    with making(path):
        found = cached_arrays(path, _coarse)
        if found is None:
            found = coarse_map(seed, month, cover)
            ends = np.array([found.lowest, found.highest])
            keep_arrays(path, {"values": found.values, "ends": ends, "rank": found.rank})
            keep_newest(path.parent, KEPT)
    return found


def _coarse(arrays: Mapping[str, np.ndarray]) -> Coarse:
    values = array_of(arrays, "values", (MAP_ROWS * MAP_COLUMNS * CHANNELS,), np.float32)
    lowest, highest = array_of(arrays, "ends", (2,))
    rank = array_of(arrays, "rank", (RANK_STEPS + 1,))
    for array in (values, rank):
        array.setflags(write=False)
    return Coarse(values, float(lowest), float(highest), rank)
