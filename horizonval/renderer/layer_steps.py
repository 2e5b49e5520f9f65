r"""Steps along rays through layers of thin cloud: no step straddles a layer's edge.

A ray is cut where it enters and leaves each layer's heights, on its way down and on its way up. Every piece has a
number of steps of its own, so that neighbouring rays differ smoothly: :data:`LAYER_STEPS` in a layer, more of them in
one with gaps (:func:`steps_among_gaps`), half the march's outside the highest and below the lowest one, a quarter
between two. A piece without length, of a ray that passes above, has no steps: as a piece shrinks so does what its steps
add up, and nothing jumps where they go.
Within a piece steps are even in the ray parameter of :mod:`horizonval.renderer.ray_path`; where the umbra's edge
crosses the ray, a third of them lies before, in and behind it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from horizonval.renderer.planet import Planet
from horizonval.renderer.ray_path import AirPath, unwarp
from horizonval.renderer.types import Vec, constant

LAYER_STEPS = 36
SPARE_OUTER = 3.0 / 8.0
"""Of tables under a light that no shadow cuts off: of the march's steps outside the highest layer, in place of half.
With 0.28 a layer of nothing and clear air were 1.3e-4 apart, above what its test allows."""
STEPS_PER_SCALE, MOST_STEPS = 12, 240
"""In a layer with gaps: steps per scale of the gaps on the longest passage, so that a softened edge, a sixth of the
scale, has four points; and at most."""
_RADIUS_M = 6.371e6


class LayerBand(NamedTuple):
    """Heights [m] of a layer, and steps of each passage through it."""

    base_m: float
    top_m: float
    steps: int = LAYER_STEPS


Bands = Sequence[LayerBand]
"""From the lowest on, without overlaps."""


def layer_bands(heights: Sequence[tuple[float, float]], gaps: Sequence[tuple[float, float, float]]) -> Bands:
    """Return heights (base, top) with their numbers of steps; ``gaps``: base, top and scale of layers with gaps [m]."""
    bands = []
    for base, top in heights:
        inside = [scale for low, high, scale in gaps if low < top and high > base]
        bands.append(LayerBand(base, top, max([LAYER_STEPS, *(steps_among_gaps(top - base, s) for s in inside)])))
    return tuple(bands)


def steps_among_gaps(thickness_m: float, scale_m: float) -> int:
    """Return the steps that the longest passage of a layer needs: from its top down to its base, level there."""
    longest = math.sqrt(2.0 * _RADIUS_M * thickness_m)
    return min(_twelve(STEPS_PER_SCALE * longest / scale_m), MOST_STEPS)


@dataclass(frozen=True)
class LayeredSteps:
    """Pieces of rays: ``cuts`` in y, and the number of the step at each; ``umbra``: y where rays enter and leave it."""

    cuts: tuple[mi.Float64, ...]
    starts: tuple[mi.Float64, ...]
    umbra: tuple[mi.Float64, mi.Float64] | None
    crossed: mi.Bool

    @property
    def count(self) -> mi.UInt32:
        """Steps of a ray."""
        return mi.UInt32(self.starts[-1])

    def boundary(self, path: AirPath, i: mi.Float64, count: mi.Float64 | int) -> mi.Float64:
        """Return ``y`` at step boundary ``i``."""
        low, high, first, last = self.cuts[0], self.cuts[1], self.starts[0], self.starts[1]
        for k in range(1, len(self.cuts) - 1):
            past = i >= self.starts[k]
            low, high = dr.select(past, self.cuts[k], low), dr.select(past, self.cuts[k + 1], high)
            first, last = dr.select(past, self.starts[k], first), dr.select(past, self.starts[k + 1], last)
        share = (i - first) / dr.maximum(last - first, 1.0)
        if self.umbra is None:
            return dr.fma(high - low, share, low)
        a, b = (dr.clip(edge, low, high) for edge in self.umbra)
        third = dr.minimum(dr.floor(3.0 * share + 1e-9), 2.0)
        within = 3.0 * share - third
        begin = dr.select(third < 0.5, low, dr.select(third < 1.5, a, b))
        end = dr.select(third < 0.5, a, dr.select(third < 1.5, b, high))
        return dr.select(self.crossed, dr.fma(end - begin, within, begin), dr.fma(high - low, share, low))


def layered_steps(
    planet: Planet,
    path: AirPath,
    o: Vec,
    d: Vec,
    bands: Bands,
    count: int,
    concentration: float,
    umbra: tuple[mi.Float64, mi.Float64] | None = None,
    *,
    spare: bool = False,
) -> LayeredSteps:
    """Return the steps of rays through layers.

    Parameters
    ----------
    bands : sequence of (float, float)
        Heights between which layers lie; :data:`Bands`.
    count : int
        Steps of the march without layers.
    umbra : tuple of Float64, optional
        ``y`` where rays enter and leave the umbra; their ends where they do not.
    spare : bool
        Whether fewer steps do above the layers: :data:`SPARE_OUTER`.
    """
    begin, end = path.t_low - path.length_before, path.t_low + path.length_after
    down: list[mi.Float64] = []
    up: list[mi.Float64] = []
    steps_down: list[int] = []
    below, inner = _twelve(count / 2), _twelve(count / 4)
    outer = _twelve(count * SPARE_OUTER) if spare else below
    for n, band in enumerate(reversed(bands)):
        steps_down += [outer if n == 0 else inner, band.steps]
        for height in (band.top_m, band.base_m):
            mid, half, _ = planet.chord(o, d, constant(height))
            down.append(mid - half)
            up.insert(0, mid + half)
    cuts = [begin]
    for t in [*down, *up]:
        cuts.append(dr.maximum(dr.clip(t, begin, end), cuts[-1]))
    cuts.append(end)
    starts = [constant(0.0)]
    for k, steps in enumerate([*steps_down, below, *reversed(steps_down)]):
        starts.append(starts[-1] + dr.select(cuts[k + 1] > cuts[k], constant(float(steps)), 0.0))
    y = [path.y0, *(dr.clip(unwarp(path, t, concentration), path.y0, path.y1) for t in cuts[1:-1]), path.y1]
    crossed = mi.Bool(False) if umbra is None else (umbra[0] > path.y0) | (umbra[1] < path.y1)
    ends = None if umbra is None else (umbra[0], dr.maximum(umbra[1], umbra[0]))
    return LayeredSteps(tuple(y), tuple(starts), ends, crossed)


def _twelve(steps: float) -> int:
    """Return a number of steps as a multiple of twelve: for rounds of four steps, and thirds of pieces."""
    return 12 * max(1, round(steps / 12.0))
