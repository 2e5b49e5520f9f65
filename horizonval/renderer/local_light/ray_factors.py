r"""By how much the ground counts that a ray's air was lit from: a table over the rays of one camera position.

The radiance of the air along a ray is ``L = L_air + q L_B``: L_B over a ground of reflected flux 1, and q the mean of
what the ray's air sees of the true ground (:mod:`horizonval.renderer.local_light.ground_light`), weighted by what each
piece of the ray adds to L_B,

    w = (1 - exp(-dtau)) exp(-tau) s / k I_B

with the scattering coefficient s, the extinction k and the mean radiance I_B of the field over a ground of flux 1 at
the place's height and Sun. The weights leave out that the field is not the same from all sides. q is bilinear on an
even grid of rows and azimuths; L_air and L_B are as smooth as over a uniform ground. Rays that end on a cloud have the
q of the whole ray.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.renderer.kernel.node_batches import Place, SolarNodes
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.local_light.ground_light import GroundLight
from horizonval.renderer.planet import dot
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION, find_path, warp
from horizonval.renderer.tables import gather_row, vectors
from horizonval.renderer.types import Values, Vec

GROUND_ROWS, GROUND_AZIMUTHS, GROUND_STEPS = 448, 512, 5
LIMB_ROWS, LIMB_AZIMUTHS, LIMB_STEPS = 12, 768, 24
"""Rays of the tables, and steps along each. At 500 km rows are 6 km apart on the ground in the middle of the disc.

Chosen after seeing the Monte Carlo's rays over squares of 50 and 100 km: half as many rows and three quarters as many
azimuths, with 8 steps, were up to 2.9 % off beside borders; these are 2.3 %, as are finer ones.
"""
_NO_LIGHT = 1e-60


@dataclass(frozen=True)
class RayFactors:
    """q of a batch: ``values``, shape (rows * azimuths * width,)."""

    values: mi.Float32
    rows: int
    azimuths: int
    width: int

    @property
    def size_bytes(self) -> int:
        """Return the memory of the table."""
        return 4 * self.rows * self.azimuths * self.width

    def look(self, x: mi.Float64, azimuth: mi.Float64) -> Values:
        """Return q per node at places x from 0 to 1 on the rows' axis."""
        row, turn = dr.clip(x, 0.0, 1.0) * (self.rows - 1.0), azimuth * (0.5 / math.pi)
        column = (turn - dr.floor(turn)) * float(self.azimuths)
        i, j = dr.minimum(mi.UInt32(row), self.rows - 2), dr.minimum(mi.UInt32(column), self.azimuths - 1)
        wx, wy = row - mi.Float64(i), column - mi.Float64(j)
        after = dr.select(j == self.azimuths - 1, 0, j + 1)
        places = ((i + a) * self.azimuths + b for a, b in ((0, j), (0, after), (1, j), (1, after)))
        corners = (gather_row(self.values, place, self.width) for place in places)
        return [
            dr.lerp(dr.lerp(mi.Float64(a), mi.Float64(b), wy), dr.lerp(mi.Float64(c), mi.Float64(d), wy), wx)
            for a, b, c, d in zip(*corners, strict=True)
        ]


def ray_factors(
    batch: SolarNodes,
    coordinates: RayCoordinates,
    ground: GroundLight,
    light: Vec,
    top_m: float,
    to_ground: bool,
) -> RayFactors:
    """Return the table of a batch, for the rays to the ground or for those past it."""
    rows, azimuths, steps = LIMB_ROWS, LIMB_AZIMUTHS, LIMB_STEPS
    if to_ground:
        rows, azimuths, steps = GROUND_ROWS, GROUND_AZIMUTHS, GROUND_STEPS
    axis = coordinates.ground if to_ground else coordinates.limb
    x, azimuth = np.meshgrid(np.linspace(0.0, 1.0, rows), np.arange(azimuths) * (2.0 * np.pi / azimuths), indexing="ij")
    directions = coordinates.directions(axis.value(x.ravel()), azimuth.ravel(), to_ground)
    o, d = vectors(coordinates.origin[None, :]), vectors(directions)
    planet, width = coordinates.planet, batch.width
    assert batch.bounce is not None
    field = batch.bounce.field
    path = find_path(planet, top_m, o, d, mi.Bool(to_ground))
    low, span = (-1.0, 1.0) if to_ground else (-1.0, 2.0)

    def body(i: mi.UInt32, tau: Values, total: Values, weighted: Values) -> tuple[mi.UInt32, Values, Values, Values]:
        tau, total, weighted = list(tau), list(total), list(weighted)
        y = [dr.clip(low + span / steps * (mi.Float64(i) + k), path.y0, path.y1) for k in (0.0, 0.5, 1.0)]
        before, t, after = (warp(path, v, SOLAR_CONCENTRATION) for v in y)
        place = Place.of(planet, batch.grid, o, d, t)
        extinction, scattering = batch.extinction_at(place), batch.scattering_at(place)
        shining = field.mean_radiance(mi.Float32(place.height_m), mi.Float32(dot(place.normal, light)))
        seen = ground.in_air(place.height_m, place.normal)
        for n in range(width):
            depth = extinction[n] * (after - before)
            share = dr.select(depth > 1e-12, (1.0 - dr.exp(-depth)) / dr.maximum(extinction[n], 1e-30), 0.0)
            w = dr.exp(-tau[n]) * share * scattering[n] * mi.Float64(shining[n]) + _NO_LIGHT
            total[n] = total[n] + w
            weighted[n] = dr.fma(w, mi.Float64(seen[n]), weighted[n])
            tau[n] = tau[n] + depth
        return i + 1, tau, total, weighted

    nothing = [dr.zeros(mi.Float64, dr.width(path.t_low)) for _ in range(3 * width)]
    _, _, total, weighted = dr.while_loop(
        (mi.UInt32(0), nothing[:width], nothing[width : 2 * width], nothing[2 * width :]),
        lambda i, *_: i < steps,
        body,
        labels=("i", "tau", "total", "weighted"),
        label="local light",
    )
    factors = [mi.Float32(w / t) for w, t in zip(weighted, total, strict=True)]
    # once: every scatter would march again
    dr.eval(factors)
    values = dr.empty(mi.Float32, rows * azimuths * width)
    lane = dr.arange(mi.UInt32, rows * azimuths)
    for n, factor in enumerate(factors):
        dr.scatter(values, factor, lane * width + n)
    dr.eval(values)
    return RayFactors(values, rows, azimuths, width)
