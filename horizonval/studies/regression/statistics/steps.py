"""Steps in a series: the piecewise constant that explains it best.

The Potts functional

    sum over pieces of sum |y - median of the piece|  +  gamma * (number of pieces - 1)

is minimised exactly by dynamic programming over where the last piece begins (F. Friedrich et al., J. Comput. Graph.
Statist. 17, 201, 2008); medians, so that a single bad night is no step. The number of pieces is that of the smallest
Bayesian information criterion under Laplace noise, ``2 n ln(cost / n) + k ln n``, with k = 3 for each further piece
(its level, its place, and one more, because a place is searched for among n).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

FEWEST = 4
"""Nights in a piece: a shorter one is told from two odd nights by luck only."""
PARAMETERS_PER_PIECE = 3


@dataclass(frozen=True)
class Piece:
    """Values ``start`` to ``stop`` (excluded) around one level."""

    start: int
    stop: int
    level: float


def pieces(values: Sequence[float], fewest: int = FEWEST) -> list[Piece]:
    """Return the pieces of a series in its order; a single one where there is no step.

    Parameters
    ----------
    values : sequence of float
        Finite.
    fewest : int
        Shortest piece.
    """
    y = np.asarray(values, dtype=np.float64)
    n = len(y)
    if n == 0:
        return []
    most = max(1, n // fewest)
    cost = _costs(y, fewest)
    best = np.full((most + 1, n + 1), np.inf)
    first = np.zeros((most + 1, n + 1), dtype=int)
    best[0, 0] = 0.0
    for k in range(1, most + 1):
        for end in range(1, n + 1):
            totals = best[k - 1, :end] + cost[:end, end]
            first[k, end] = int(np.argmin(totals))
            best[k, end] = totals[first[k, end]]
    # Rounding of stored values sets a floor under the noise: a constant series has no steps.
    floor = n * max(float(np.abs(y).max()), 1e-300) * 1e-9
    criterion = [
        2 * n * math.log(max(best[k, n], floor) / n) + PARAMETERS_PER_PIECE * k * math.log(n)
        if math.isfinite(best[k, n])
        else math.inf
        for k in range(1, most + 1)
    ]
    count = 1 + int(np.argmin(criterion)) if any(map(math.isfinite, criterion)) else 0
    if count == 0:
        return [Piece(0, n, float(np.median(y)))]
    found, end = [], n
    for k in range(count, 0, -1):
        start = int(first[k, end])
        found.append(Piece(start, end, float(np.median(y[start:end]))))
        end = start
    return found[::-1]


def _costs(y: np.ndarray, fewest: int) -> np.ndarray:
    """Return the absolute deviation from the median of every stretch [start, end) that is long enough, else inf."""
    n = len(y)
    cost = np.full((n + 1, n + 1), np.inf)
    for start in range(n):
        for end in range(start + min(fewest, n), n + 1):
            part = y[start:end]
            cost[start, end] = np.abs(part - np.median(part)).sum()
    return cost
