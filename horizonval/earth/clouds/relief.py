"""Cloud tops: a random relief over the globe from a seed, the same for every frame of a scene.

Gradient noise on a cubic lattice, evaluated on the unit sphere and summed over octaves from the field's scale down to 3
km, amplitudes falling as the cube root of the size (the -5/3 law of cloud fields, R. F. Cahalan and J. B. Snider,
Remote Sens. Environ. 28, 95 (1989)). The rank u of the noise among its values over the globe, uniform from 0 to 1,
makes cover and heights exact: with cover c and ``s = (u - (1 - c)) / c``::

    cloudless where s <= 0,      top = base + (highest - base) s^p,     highest = min(top_m, tropopause)

p follows from the mean height. Clouds are opaque down to the ground. The highest tops have the field's albedo, those at
the base 0.6 of it, linear in height between: thin clouds are greyer. The arithmetic of :func:`noise` is written once,
for numpy and Dr.Jit.
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
from horizonval.earth.clouds import earth_pattern
from horizonval.earth.clouds.earth_pattern import (
    BASE_M,
    EARTH_RADIUS_M,
    FALLOFF,
    Coarse,
    even_points,
    kept_coarse_map,
    lattice_noise,
    numpy_split,
    ranked,
)
from horizonval.spec.scene import SceneSpec

BASE_BRIGHTNESS = 0.6
FINEST_M = 3000.0
TROPICAL_TROPOPAUSE_M, POLAR_TROPOPAUSE_M = 17_000.0, 9_000.0
RANK_POINTS = 100_000
RANK_STEPS = 512


@dataclass(frozen=True)
class CloudField:
    """A relief of cloud tops; heights in metres.

    ``cover``: share of the globe, None for the climatology's; ``top_m``: highest tops; ``mean_top_m``, ``scale_m``: of
    the uniform pattern; ``albedo``: of the brightest clouds; ``pattern``: ``"earth"`` or ``"uniform"``; ``month``: of
    the pattern of the Earth, 1 for January.
    """

    cover: float | None
    top_m: float
    mean_top_m: float
    scale_m: float
    seed: int
    albedo: float
    pattern: str = "uniform"
    month: int = 0

    @property
    def share(self) -> float:
        """Covered share of the globe."""
        return earth_pattern.climatological_cover(self.month) if self.cover is None else self.cover

    def coarse(self) -> Coarse:
        """Return the coarse part of the pattern of the Earth."""
        return kept_coarse_map(self.seed, self.month, self.cover)

    @property
    def exponent(self) -> float:
        """The p of the module text."""
        return (self.top_m - BASE_M) / (self.mean_top_m - BASE_M) - 1.0

    @property
    def octaves(self) -> int:
        """Octaves of noise, from ``scale_m`` down to about 3 km."""
        return max(1, 1 + math.floor(math.log2(self.scale_m / FINEST_M) + 1e-9))


def seed_of(scene: SceneSpec, *what: str | int) -> int:
    """Return a seed for something random in a scene, from what it is and the scene's draw (or name) and seed."""
    identity = json.dumps([*what, scene.scene.draw or scene.scene.name, scene.scene.seed])
    return int.from_bytes(hashlib.sha256(identity.encode()).digest()[:4], "little")


def cloud_field(scene: SceneSpec) -> CloudField | None:
    """Return the clouds of a scene, None without."""
    clouds = scene.clouds
    if clouds is None or clouds.cover == 0.0:
        return None
    seed = clouds.seed
    if seed is None:
        seed = seed_of(scene, "clouds")
    mean_km = clouds.mean_top_km if clouds.mean_top_km is not None else 0.4 * clouds.highest_top_km + 0.3
    cover = None if clouds.cover == "climate" else clouds.cover
    earth = clouds.like_the_earth
    month = scene.platform.epoch_utc.month if earth else 0
    scale_m, top_m = clouds.scale_km * 1e3, clouds.highest_top_km * 1e3
    pattern = "earth" if earth else "uniform"
    return CloudField(cover, top_m, mean_km * 1e3, scale_m, seed, clouds.albedo, pattern, month)


def tropopause_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return the height of the tropopause: 17 km in the tropics, 9 km at the poles, half way at 40 degrees."""
    middle = 0.5 * (TROPICAL_TROPOPAUSE_M + POLAR_TROPOPAUSE_M)
    half = 0.5 * (TROPICAL_TROPOPAUSE_M - POLAR_TROPOPAUSE_M)
    return middle - half * np.tanh((np.abs(np.asarray(latitude_deg, dtype=np.float64)) - 40.0) / 10.0)


def noise(
    position: tuple[Any, Any, Any],
    field: CloudField,
    split: Callable[[Any], tuple[Any, Any]],
    real: Callable[[Any], Any],
) -> Any:
    """Return the noise at unit vectors (three arrays), in arbitrary units; see :func:`lattice_noise`."""
    total: Any = 0.0
    for octave in range(field.octaves):
        per_cell = EARTH_RADIUS_M / field.scale_m * 2.0**octave
        x, y, z = (v * per_cell for v in position)
        total = total + FALLOFF**octave * lattice_noise((x, y, z), octave, field.seed, split, real)
    return total


def numpy_noise(position: FloatArray, field: CloudField) -> FloatArray:
    """Return the noise at unit vectors, shape (n, 3)."""
    place = position[:, 0], position[:, 1], position[:, 2]
    return noise(place, field, numpy_split, lambda h: h.astype(np.float64))


@lru_cache(maxsize=8)
def rank_table(field: CloudField) -> tuple[float, float, FloatArray]:
    """Return ``(lowest, highest, rank)``: rank of the noise at RANK_STEPS + 1 even steps from lowest to highest."""
    return ranked(numpy_noise(even_points(RANK_POINTS), field), RANK_STEPS)


def top_m(field: CloudField, position: FloatArray) -> FloatArray:
    """Return the tops at unit normals of the ellipsoid, shape (n, 3); below BASE_M where there is no cloud."""
    ceiling = tropopause_m(np.degrees(np.arcsin(np.clip(position[:, 2], -1.0, 1.0))))
    if field.pattern == "earth":
        s, at = earth_pattern.depth_at(field.coarse(), field.seed, position)
        return np.asarray(earth_pattern.top_m(s, at, ceiling, field.top_m, earth_pattern.numpy_arithmetic()))
    lowest, highest, rank = rank_table(field)
    u = np.interp(numpy_noise(position, field), np.linspace(lowest, highest, RANK_STEPS + 1), rank)
    s = (u - (1.0 - field.share)) / field.share
    span = np.minimum(field.top_m, ceiling) - BASE_M
    return BASE_M + span * np.where(s > 0.0, np.maximum(s, 0.0) ** field.exponent, s)


def albedo(field: CloudField, position: FloatArray) -> FloatArray:
    """Return the albedo of clouds of the pattern of the Earth at unit normals, shape (n, 3); 0 between them."""
    s, at = earth_pattern.depth_at(field.coarse(), field.seed, position)
    return np.minimum(earth_pattern.albedo(s, at, earth_pattern.numpy_arithmetic()), field.albedo)
