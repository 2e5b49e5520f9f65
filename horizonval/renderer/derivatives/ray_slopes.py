"""Radiance of rays and its derivatives along given changes of the rays, by forward differentiation.

What decides by a jump (which kind of ground, whether there is a cloud) counts as fixed: its derivative is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi

from horizonval.renderer.derivatives.transport import added, scaled
from horizonval.renderer.types import Values, Vec

Radiance = Callable[[Vec, Vec], Values]
"""Radiance per band of rays from origins along directions."""


def slopes(radiance: Radiance, o: Vec, d: Vec, changes: Sequence[tuple[Vec | None, Vec]]) -> tuple[Values, list[Values]]:
    """Return radiance per band, and for every change its derivative per band.

    Parameters
    ----------
    o, d : Vec
    changes : sequence of (Vec or None, Vec)
        By which origin (None: not at all) and direction change per unit.
    """
    count = dr.width(d[0])
    value: Values = []
    out: list[Values] = []
    for change_o, change_d in changes:
        step = dr.zeros(mi.Float64, count)
        dr.enable_grad(step)
        origin = o if change_o is None else added(o, scaled(change_o, step))
        bands = radiance(origin, added(d, scaled(change_d, step)))
        dr.set_grad(step, 1.0)
        dr.forward_to(*bands)
        value = [dr.detach(v) + dr.zeros(mi.Float64, count) for v in bands]
        # where a ray leaves the air a root's slope is infinite and its factor zero
        slope = [dr.select(dr.isfinite(dr.grad(v)), dr.grad(v), 0.0) + dr.zeros(mi.Float64, count) for v in bands]
        dr.eval(value, slope)
        out.append(slope)
    return value, out
