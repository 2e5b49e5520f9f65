"""Radiance of rays and its derivatives along given changes of the rays, by forward differentiation.

What decides by a jump (which kind of ground, whether there is a cloud) counts as fixed: its derivative is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi

from horizonval.renderer.derivatives.vectors import added, scaled
from horizonval.renderer.types import Values, Vec, constant_vector

Radiance = Callable[[Vec, Vec], Values]
"""Radiance per band of rays from origins along directions."""


def slopes(
    radiance: Radiance, o: Vec, d: Vec, changes: Sequence[tuple[Vec | None, Vec]]
) -> tuple[Values, list[Values]]:
    """Return radiance per band, and for every change its derivative per band.

    Parameters
    ----------
    o, d : Vec
    changes : sequence of (Vec or None, Vec)
        By which origin (None: not at all) and direction change per unit.
    """
    count, copies = dr.width(d[0]), len(changes)
    step = dr.zeros(mi.Float64, count * copies)
    dr.enable_grad(step)
    origin = o
    if any(change_o is not None for change_o, _ in changes):
        still = constant_vector((0.0, 0.0, 0.0))
        origin = added(o, scaled(_in_turn([still if c is None else c for c, _ in changes], count), step))
    direction = added(_in_turn([d] * copies, count), scaled(_in_turn([c for _, c in changes], count), step))
    # one copy of the rays for every change: tables and kernels are made once
    bands = radiance(origin, direction)
    dr.set_grad(step, 1.0)
    # a band may hang on nothing: a black sky
    dr.forward_to(*bands, flags=dr.ADFlag.Default | dr.ADFlag.AllowNoGrad)
    value: Values = []
    out: list[Values] = [[] for _ in changes]
    for band in bands:
        slope = dr.grad(band) + dr.zeros(mi.Float64, count * copies)
        # where a ray leaves the air a root's slope is infinite and its factor zero
        slope = dr.select(dr.isfinite(slope), slope, 0.0)
        radiant = dr.detach(band) + dr.zeros(mi.Float64, count * copies)
        dr.eval(slope, radiant)
        index = dr.arange(mi.UInt32, count)
        value.append(dr.gather(mi.Float64, radiant, index))
        for copy in range(copies):
            out[copy].append(dr.gather(mi.Float64, slope, index + copy * count))
    dr.eval(value, out)
    return value, out


def _in_turn(vectors: Sequence[Vec], count: int) -> Vec:
    """Return vectors of ``count`` rays, or of one for all of them, one after the other."""
    x, y, z = (dr.concat([v[k] + dr.zeros(mi.Float64, count) for v in vectors]) for k in range(3))
    return x, y, z
