"""Coarse maps of clouds on disk: made once for a seed, a month and a cover, found again by their content.

A map takes a second to make and 2 MB to keep, so that the last :data:`KEPT` of them stay. The key is a hash of all that
a map depends on, its own code included; a damaged file is made again.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from horizonval.core.cache import cached_arrays, keep_arrays, keep_newest
from horizonval.core.code import FRAME_ROOMS, code_digest
from horizonval.core.digests import content_digest
from horizonval.core.environment import cache_folder
from horizonval.earth.clouds.earth_pattern import Coarse, coarse_map

KEPT = 64


@lru_cache(maxsize=4)
def kept_coarse_map(seed: int, month: int, cover: float | None) -> Coarse:
    """Return :func:`horizonval.earth.clouds.earth_pattern.coarse_map` from memory, from disk, or made now."""
    method = code_digest(rooms=FRAME_ROOMS)
    path = cache_folder() / "clouds" / f"{content_digest(method, seed, month, cover)[:32]}.npz"
    kept = cached_arrays(path)
    if kept is None:
        made = coarse_map(seed, month, cover)
        keep_arrays(path, {"values": made.values, "ends": np.array([made.lowest, made.highest]), "rank": made.rank})
        keep_newest(path.parent, KEPT)
        return made
    for array in kept.values():
        array.setflags(write=False)
    lowest, highest = kept["ends"]
    return Coarse(kept["values"], float(lowest), float(highest), kept["rank"])
