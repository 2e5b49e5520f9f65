r"""Cloud tops: a seeded random relief over the globe, the same for every frame of a scene.

Gradient noise on a cubic lattice, taken on the unit sphere, summed over octaves from the field's scale down to 3 km,
amplitudes falling as the cube root of the size (the -5/3 law of cloud fields, R. F. Cahalan and J. B. Snider, Remote
Sens. Environ. 28, 95 (1989)). The rank u of the noise among its values over this very globe, uniform from 0 to 1,
makes cover and heights exact: with cover c and ``s = (u - (1 - c)) / c``::

    cloudless where s <= 0,      top = base + (highest - base) s^p,     highest = min(top_m, tropopause)

p sets the mean. Edges thin out to the base. Clouds are opaque, without gaps down to the ground. The highest tops have
the field's albedo, those at the base 0.6 of it, linear in height between: thin clouds are greyer.

The arithmetic of :func:`noise` is written once and runs on numpy and on Dr.Jit arrays alike.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.directions import GOLDEN_ANGLE_RAD
from horizonval.spec.scene import SceneSpec

BASE_M = 500.0
BASE_BRIGHTNESS = 0.6
FINEST_M = 3000.0
EARTH_RADIUS_M = 6.371e6
TROPICAL_TROPOPAUSE_M, POLAR_TROPOPAUSE_M = 17_000.0, 9_000.0
FALLOFF = 0.5 ** (1.0 / 3.0)
RANK_POINTS = 100_000
RANK_STEPS = 512
_LATTICE_OFFSET = 8192.0


@dataclass(frozen=True)
class CloudField:
    """A relief of cloud tops; heights in metres."""

    cover: float
    top_m: float
    mean_top_m: float
    scale_m: float
    seed: int
    albedo: float

    @property
    def exponent(self) -> float:
        """The p of the module text."""
        return (self.top_m - BASE_M) / (self.mean_top_m - BASE_M) - 1.0

    @property
    def mean_albedo(self) -> float:
        """Mean albedo of the clouds."""
        return self.albedo * (BASE_BRIGHTNESS + (1.0 - BASE_BRIGHTNESS) / (self.exponent + 1.0))

    @property
    def octaves(self) -> int:
        """Octaves of noise, from ``scale_m`` down to about 3 km."""
        return max(1, 1 + math.floor(math.log2(self.scale_m / FINEST_M) + 1e-9))


def cloud_field(scene: SceneSpec) -> CloudField | None:
    """Return the clouds of a scene, None without."""
    clouds = scene.clouds
    if clouds is None or clouds.cover == 0.0:
        return None
    seed = clouds.seed
    if seed is None:
        identity = json.dumps(["clouds", scene.scene.draw or scene.scene.name, scene.scene.seed])
        seed = int.from_bytes(hashlib.sha256(identity.encode()).digest()[:4], "little")
    mean_km = clouds.mean_top_km if clouds.mean_top_km is not None else 0.4 * clouds.top_km + 0.3
    return CloudField(clouds.cover, clouds.top_km * 1e3, mean_km * 1e3, clouds.scale_km * 1e3, seed, clouds.albedo)


def tropopause_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return the height of the tropopause: 17 km in the tropics, 9 km at the poles, half way at 40 degrees."""
    middle = 0.5 * (TROPICAL_TROPOPAUSE_M + POLAR_TROPOPAUSE_M)
    half = 0.5 * (TROPICAL_TROPOPAUSE_M - POLAR_TROPOPAUSE_M)
    return middle - half * np.tanh((np.abs(np.asarray(latitude_deg, dtype=np.float64)) - 40.0) / 10.0)


def _hashed(x: Any, y: Any, z: Any, seed: int) -> Any:
    h = (x * 0x8DA6B343) ^ (y * 0xD8163841) ^ (z * 0xCB1AB31F) ^ seed
    h = (h ^ (h >> 16)) * 0x85EBCA6B
    h = (h ^ (h >> 13)) * 0xC2B2AE35
    return h ^ (h >> 16)


def noise(
    position: tuple[Any, Any, Any],
    field: CloudField,
    split: Callable[[Any], tuple[Any, Any]],
    real: Callable[[Any], Any],
) -> Any:
    """Return the noise at unit vectors, in no particular unit.

    Parameters
    ----------
    position : three arrays
    field : CloudField
    split : callable
        Splits an array of positive floats into whole part (unsigned 32-bit) and fraction.
    real : callable
        Turns unsigned 32-bit arrays into floats.
    """
    total: Any = 0.0
    for octave in range(field.octaves):
        per_cell = EARTH_RADIUS_M / field.scale_m * 2.0**octave
        offset = _LATTICE_OFFSET + 0.37 * octave
        cells, parts = zip(*(split(v * per_cell + offset) for v in position), strict=True)
        seed = (field.seed + 0x9E3779B9 * (octave + 1)) & 0xFFFFFFFF
        total = total + FALLOFF**octave * _lattice_noise(cells, parts, seed, real)
    return total


def _lattice_noise(cells: Any, parts: Any, seed: int, real: Callable[[Any], Any]) -> Any:
    fade = [t * t * t * (t * (t * 6.0 - 15.0) + 10.0) for t in parts]

    def corner(i: int, j: int, k: int) -> Any:
        h = _hashed(cells[0] + i, cells[1] + j, cells[2] + k, seed)
        slopes = [real((h >> shift) & 1023) * (1.0 / 511.5) - 1.0 for shift in (0, 10, 20)]
        return slopes[0] * (parts[0] - i) + slopes[1] * (parts[1] - j) + slopes[2] * (parts[2] - k)

    def mixed(a: Any, b: Any, w: Any) -> Any:
        return a + w * (b - a)

    x = [[mixed(corner(0, j, k), corner(1, j, k), fade[0]) for j in (0, 1)] for k in (0, 1)]
    y = [mixed(a, b, fade[1]) for a, b in x]
    return mixed(y[0], y[1], fade[2])


def numpy_noise(position: FloatArray, field: CloudField) -> FloatArray:
    """Return the noise at unit vectors, shape (n, 3)."""

    def split(v: FloatArray) -> tuple[Any, Any]:
        whole = np.floor(v)
        return whole.astype(np.uint32), v - whole

    return noise((position[:, 0], position[:, 1], position[:, 2]), field, split, lambda h: h.astype(np.float64))


@lru_cache(maxsize=8)
def rank_table(field: CloudField) -> tuple[float, float, FloatArray]:
    """Return ``(lowest, highest, rank)``: rank of the noise at RANK_STEPS + 1 even steps from lowest to highest."""
    k = np.arange(RANK_POINTS) + 0.5
    z = 1.0 - 2.0 * k / RANK_POINTS
    phi = GOLDEN_ANGLE_RAD * k
    s = np.sqrt(1.0 - z * z)
    values = np.sort(numpy_noise(np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1), field))
    steps = np.linspace(values[0], values[-1], RANK_STEPS + 1)
    rank = np.interp(steps, values, (np.arange(RANK_POINTS) + 0.5) / RANK_POINTS)
    rank[0], rank[-1] = 0.0, 1.0
    rank.setflags(write=False)
    return float(values[0]), float(values[-1]), rank


def top_m(field: CloudField, position: FloatArray) -> FloatArray:
    """Return the tops at unit normals of the ellipsoid, shape (n, 3); below BASE_M where there is no cloud."""
    lowest, highest, rank = rank_table(field)
    u = np.interp(numpy_noise(position, field), np.linspace(lowest, highest, RANK_STEPS + 1), rank)
    s = (u - (1.0 - field.cover)) / field.cover
    ceiling = np.minimum(field.top_m, tropopause_m(np.degrees(np.arcsin(np.clip(position[:, 2], -1.0, 1.0)))))
    span = ceiling - BASE_M
    return BASE_M + span * np.where(s > 0.0, np.maximum(s, 0.0) ** field.exponent, s)
