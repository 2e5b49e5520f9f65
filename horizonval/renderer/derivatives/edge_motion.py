"""How the cells on the hard edge change with the camera's pose: covered share, and both rays.

By central differences of the geometry alone, which is smooth to rounding: steps of a 3e-5th of a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.cells import edge_geometry
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.types import Vec

CELL_SHARE = 3e-5
"""Step in cells."""


@dataclass(frozen=True)
class EdgeMotion:
    """Derivatives of edge cells by one parameter: of the share, and of the directions of both rays."""

    share: mi.Float64
    inner: Vec
    outer: Vec


def edge_motion(view_at: Callable[[float], FrameGeometry], u: mi.Float64, v: mi.Float64, step: float) -> EdgeMotion:
    """Return the derivatives for edge cells with centres at pixel coordinates.

    ``view_at`` gives the frame at a value of the parameter.
    """
    high, low = (edge_geometry(view_at(s), u, v) for s in (step, -step))
    half = 0.5 / step

    def slope(a: Vec, b: Vec) -> Vec:
        x, y, z = ((p - q) * half for p, q in zip(a, b, strict=True))
        return x, y, z

    motion = EdgeMotion((high.share - low.share) * half, slope(high.inner, low.inner), slope(high.outer, low.outer))
    dr.eval(motion)
    return motion
