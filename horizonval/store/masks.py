"""Masks: pixels that have something in common, 1 where they have and 0 elsewhere, made from the truth maps.

They are there for people and other programs; nothing here is read back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.frame import FrameTruth, Hit

Mask = NDArray[np.float16]


def earth(maps: Mapping[str, NDArray[Any]]) -> Mask:
    """Return where the ray through the pixel's centre meets the ground or a cloud, shape (H, W)."""
    return _mask(np.isin(maps["hit"], (Hit.SURFACE, Hit.CLOUD)))


def sunlit(maps: Mapping[str, NDArray[Any]], truth: FrameTruth) -> Mask:
    """Return where the Sun's centre is above the horizon of what the pixel sees, shape (H, W).

    That is the place of ground or cloud, or the lowest point of a ray through air, from whose height ``h`` the horizon
    dips by ``acos(R / (R + h))`` with the mean radius ``R``. Refraction is left out, as in the truth.
    """
    hit = maps["hit"]
    radius = (2 * truth.ellipsoid_a_m + truth.ellipsoid_b_m) / 3
    in_air = hit == Hit.ATMOSPHERE
    height = np.where(in_air, np.maximum(maps["tangent_height"], 0.0), 0.0).astype(np.float64)
    dip_deg = np.degrees(np.arccos(radius / (radius + height)))
    return _mask((in_air | (earth(maps) > 0)) & (maps["solar_zenith"] < 90.0 + dip_deg))


def saturated(dn: NDArray[Any], full_scale: int) -> Mask:
    """Return where the converter is at its end, shape (H, W)."""
    return _mask(np.asarray(dn) >= full_scale)


def _mask(where: NDArray[np.bool_]) -> Mask:
    return np.ascontiguousarray(where, dtype=np.float16)
