"""The designs that no other beats in every respect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def front(points: Sequence[Sequence[float | None]]) -> list[bool]:
    """Return which points no other dominates, all coordinates to be small.

    A point dominates another if it is nowhere larger and somewhere smaller; equal points do not dominate each other. A
    point with an unknown coordinate is on no front.

    Parameters
    ----------
    points : sequence of sequences
        ``None`` where a coordinate is unknown.
    """
    known = [i for i, point in enumerate(points) if all(value is not None for value in point)]
    on_front = [False] * len(points)
    values = np.array([points[i] for i in known], dtype=np.float64)
    for i, point in zip(known, values, strict=True):
        beaten = (values <= point).all(axis=1) & (values < point).any(axis=1)
        on_front[i] = not bool(beaten.any())
    return on_front
