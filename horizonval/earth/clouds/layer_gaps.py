r"""Gaps in layers of thin cloud: where a layer is cloudy, drawn from a seed.

Gradient noise of two octaves, cells of the given scale and of half of it, amplitudes as those of cloud tops
(:mod:`.lattice_noise`). u is its rank among its values over the globe, uniform from 0 to 1. With cover c the cloud's
share of its full optical depth is::

    f = min(1, max(0, (u - (1 - c)) / w + 1/2)),        w = min(0.3, c, 1 - c)

whose mean over the globe is c exactly. From 0 to 1 it takes a sixth of the scale or so: cloud thins out towards its
edges. The layer's mean column times ``f / c`` is its column at a place; base and top are the same everywhere.

The mean is that of the globe. Within one horizon, 2600 km from 500 km, the covered share differs from it by chance.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.lattice_noise import (
    EARTH_RADIUS_M,
    FALLOFF,
    even_points,
    lattice_noise,
    numpy_split,
    ranked,
)
from horizonval.spec.scene import SceneSpec

OCTAVES = 2
SOFT = 0.3
"""w of the module text, where cover leaves room for it."""
RANK_POINTS, RANK_STEPS = 100_000, 512


@dataclass(frozen=True)
class LayerGaps:
    """The pattern of a layer: covered share between 0 and 1, size of the noise's largest cells, and what draws it."""

    cover: float
    scale_m: float
    seed: int

    @property
    def softness(self) -> float:
        """Ranks over which cloud thins out."""
        return min(SOFT, self.cover, 1.0 - self.cover)


def seed_of(scene: SceneSpec, index: int) -> int:
    """Return the seed of a scene's layer that has none of its own."""
    identity = json.dumps(["layer", index, scene.scene.draw or scene.scene.name, scene.scene.seed])
    return int.from_bytes(hashlib.sha256(identity.encode()).digest()[:4], "little")


def noise(
    gaps: LayerGaps,
    position: tuple[Any, Any, Any],
    seed: Any,
    split: Callable[[Any], tuple[Any, Any]],
    real: Callable[[Any], Any],
) -> Any:
    """Return the noise at unit vectors, in no particular unit; ``split`` and ``real`` as in :mod:`.lattice_noise`.

    ``seed``: that of the gaps, in whatever kind is added to hashes.
    """
    total: Any = 0.0
    for octave in range(OCTAVES):
        per_cell = EARTH_RADIUS_M / gaps.scale_m * 2.0**octave
        x, y, z = (v * per_cell for v in position)
        total = total + FALLOFF**octave * lattice_noise((x, y, z), octave, seed, split, real)
    return total


@lru_cache(maxsize=8)
def rank_table(gaps: LayerGaps) -> tuple[float, float, FloatArray]:
    """Return ``(lowest, highest, rank)``: rank of the noise at RANK_STEPS + 1 even steps from lowest to highest."""
    points = even_points(RANK_POINTS)
    place = points[:, 0], points[:, 1], points[:, 2]
    return ranked(noise(gaps, place, gaps.seed, numpy_split, lambda h: h.astype(np.float64)), RANK_STEPS)


def cloudiness(gaps: LayerGaps, position: FloatArray) -> FloatArray:
    """Return f of the module text at unit vectors, shape (n, 3)."""
    place = position[:, 0], position[:, 1], position[:, 2]
    n = noise(gaps, place, gaps.seed, numpy_split, lambda h: h.astype(np.float64))
    lowest, highest, rank = rank_table(gaps)
    u = np.interp(n, np.linspace(lowest, highest, RANK_STEPS + 1), rank)
    return np.clip((u - (1.0 - gaps.cover)) / gaps.softness + 0.5, 0.0, 1.0)
