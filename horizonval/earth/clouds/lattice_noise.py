"""Gradient noise on a cubic lattice, one octave at a time, and its rank over the globe.

The lattice is hashed, not stored. The arithmetic is written once and runs on numpy and on Dr.Jit arrays alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.directions import GOLDEN_ANGLE_RAD

EARTH_RADIUS_M = 6.371e6
FALLOFF = 0.5 ** (1.0 / 3.0)
"""Of amplitudes from one octave to the next: the -5/3 law of cloud fields (R. F. Cahalan and J. B. Snider, Remote Sens.
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
    """Return one octave of noise at positions in lattice cells, in no particular unit.

    Parameters
    ----------
    position : three arrays
        Above minus 8192.
    octave : int
        Octaves have lattices of their own.
    seed : int or unsigned 32-bit array
    split : callable
        Splits an array of positive floats into whole part (unsigned 32-bit) and fraction.
    real : callable
        Turns unsigned 32-bit arrays into floats.
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
