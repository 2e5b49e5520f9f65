"""One order of scattering from the last: the march of diffuse light along all rays of a few columns.

One pass for all heights i, polar directions j, ray nodes n and Sun angles k first contracts the harmonics of the node
with the moments at its radius, leaving ``F_m(i, j, n, k)``: along the ray only ``sum_m F_m cos(m phi)`` at the node's
own Sun angle remains to be interpolated. The columns differ in extinction and scattering alone, so that one march finds
the places for all of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer import tables
from horizonval.renderer.scattering.diffuse_field import SMALLEST
from horizonval.renderer.scattering.first_order import lane_indices
from horizonval.renderer.scattering.harmonics import cosines, pairs, polar_parts
from horizonval.renderer.scattering.quality import MOLECULAR_DEGREE
from horizonval.renderer.scattering.shell_column import ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.scattering.sun_angles import SUN_LOWEST, sun_angle_position
from horizonval.renderer.tables import table_of

_SLAB = 4_000_000
"""Contracted values per launch."""


@dataclass(frozen=True)
class _Slab:
    """Neighbouring heights that are marched in one launch, with the tables of their rays.

    Attributes
    ----------
    n_height : int
    mu, start : Float32
        The rays' cosines; radii [m] they start from.
    places : Float32, shape (rays * nodes * 4,)
        What the cosine of the Sun's zenith angle is made of, and the cosine of the ray's angle to the zenith.
    weight : Float32, shape (rays * nodes * columns,)
        Of emission per metre.
    level, level_weight : UInt32 and Float32, shape (rays * nodes,)
        Height below, and the weight of the one above.
    factors : Float32, shape (rays * nodes * columns * slots,)
        By which the moments enter.
    """

    n_height: int
    mu: mi.Float32
    places: mi.Float32
    weight: mi.Float32
    level: mi.UInt32
    level_weight: mi.Float32
    factors: mi.Float32


class DiffuseMarch:
    """The march of diffuse light along all rays, prepared once and applied to every order.

    Parameters
    ----------
    columns, rays : sequences of equal length
        Of one geometry and degree.
    n_azimuth : int
    degree : int
        Of the moments that scatter.
    """

    def __init__(self, columns: Sequence[ShellColumn], rays: Sequence[ShellRays], n_azimuth: int, degree: int) -> None:
        column, geometry = columns[0], rays[0]
        self.degree, self.n_azimuth, self.n_columns = degree, n_azimuth, len(columns)
        self.n_sun = len(column.sun_cosines)
        self.n_direction, self.n_node = geometry.node_radius_m.shape[1:]
        # molecules scatter by even harmonics only
        self.used = [(n, m) for n, m in pairs(degree) if column.degree > MOLECULAR_DEGREE or n in (0, 2)]
        self.positions = [column.pairs.index(pair) for pair in self.used]
        self.slots = 4 * -(-len(self.used) // 4)
        self.packets = -(-(self.degree + 2) // 4)
        self.sun_cosines = table_of(mi.Float32, column.sun_cosines)
        n_height = len(column.heights)
        values = self.n_direction * self.n_node * self.n_sun * 4 * self.packets * self.n_columns
        step = max(1, _SLAB // values)
        factors = np.stack([self._factors(c, r) for c, r in zip(columns, rays, strict=True)], axis=-2)
        position = np.sqrt((geometry.node_radius_m - column.planet_m).clip(0.0) / column.top_m) * (n_height - 1)
        if column.bands:
            height = geometry.node_radius_m - column.planet_m
            position = np.interp(height, column.heights, np.arange(n_height))
        level = np.minimum(position.astype(np.uint32), n_height - 2)
        start = np.broadcast_to(geometry.radius_m[:, None, None], position.shape)
        zero = np.zeros_like(position)
        r = geometry.node_radius_m
        places = np.stack([start / r, geometry.node_distance_m / r, geometry.node_up, zero], axis=-1)
        weight = np.stack([v.node_weight for v in rays], axis=-1)
        self.slabs = []
        for first in range(0, n_height, step):
            part = slice(first, min(first + step, n_height))
            self.slabs.append(
                _Slab(
                    part.stop - part.start,
                    table_of(mi.Float32, geometry.cosine[part]),
                    table_of(mi.Float32, places[part]),
                    table_of(mi.Float32, weight[part]),
                    mi.UInt32(table_of(mi.Float32, level[part])),
                    table_of(mi.Float32, (position - level)[part]),
                    table_of(mi.Float32, factors[part]),
                )
            )
        dr.eval([slab.level for slab in self.slabs])

    def _factors(self, column: ShellColumn, rays: ShellRays) -> FloatArray:
        """Return by which factors moments enter at every node, shape (n_height, n_direction, n_node, slots)."""
        node, degree = column.node, self.degree
        molecular = column.at(node.molecular_per_m, rays.node_radius_m)
        particle = column.at(node.particle_per_m, rays.node_radius_m)
        asymmetry = column.at(node.asymmetry, rays.node_radius_m)
        chi = {0: 1.0, 2: 2.0 * node.molecular_cos2 / 15.0}
        polar = polar_parts(degree, rays.node_up, np.sqrt(np.maximum(1.0 - rays.node_up**2, 0.0)))
        forward = column.at(node.forward_per_m, rays.node_radius_m) if len(node.forward_per_m) else 0.0
        scattering = [molecular * chi.get(n, 0.0) + particle * asymmetry**n - forward for n in range(degree + 1)]
        factors = np.zeros((*rays.node_up.shape, self.slots), dtype=np.float32)
        for p, (n, m) in enumerate(self.used):
            factors[..., p] = polar[n, m] * scattering[n]
        return factors

    def apply(self, moments: Sequence[FloatArray]) -> list[FloatArray]:
        """Return the radiance (n_height, n_direction, n_azimuth, n_sun) that every column's field makes."""
        n_height, n_sun = moments[0].shape[:2]
        packed = np.zeros((n_height, n_sun, self.n_columns, self.slots), dtype=np.float32)
        for c, field in enumerate(moments):
            total = np.maximum(field[..., 0], SMALLEST)
            packed[:, :, c, 0] = np.log(total)
            packed[:, :, c, 1 : len(self.used)] = field[..., self.positions[1:]] / total[..., None]
        table = table_of(mi.Float32, packed)
        parts = [self._march(slab, self._contracted(slab, table)) for slab in self.slabs]
        return [np.concatenate([part[c] for part in parts], axis=0) for c in range(self.n_columns)]

    def _contracted(self, slab: _Slab, moments: mi.Float32) -> mi.Float32:
        """Return ``ln I_00`` and ``F_m / I_00`` at (height, direction, node, Sun angle, column), packed by fours."""
        packet, blocks = tables.packet_type(mi.Float32), self.slots // 4
        n_points = slab.n_height * self.n_direction * self.n_node
        lane = dr.arange(mi.UInt32, n_points * self.n_sun * self.n_columns)
        column, rest = lane % self.n_columns, lane // self.n_columns
        k, point = rest % self.n_sun, rest // self.n_sun
        w = dr.gather(mi.Float32, slab.level_weight, point)
        low = ((dr.gather(mi.UInt32, slab.level, point) * self.n_sun + k) * self.n_columns + column) * blocks
        high = low + self.n_sun * self.n_columns * blocks
        factor = (point * self.n_columns + column) * blocks
        values = [mi.Float32(0.0)] * (4 * self.packets)
        for q in range(blocks):
            a, b = dr.gather(packet, moments, low + q), dr.gather(packet, moments, high + q)
            f = dr.gather(packet, slab.factors, factor + q)
            for p in range(4 * q, min(4 * q + 4, len(self.used))):
                between = dr.fma(b[p % 4] - a[p % 4], w, a[p % 4])
                if p == 0:
                    values[0], values[1] = between, f[0]
                else:
                    m = 1 + self.used[p][1]
                    values[m] = dr.fma(between, f[p % 4], values[m])
        packed = dr.empty(mi.Float32, dr.width(lane) * 4 * self.packets)
        for q in range(self.packets):
            dr.scatter(packed, packet(*values[4 * q : 4 * q + 4]), lane * self.packets + q)
        dr.eval(packed)
        return packed

    def _march(self, slab: _Slab, contracted: mi.Float32) -> list[FloatArray]:
        degree, n_sun, n_node, packets, columns = self.degree, self.n_sun, self.n_node, self.packets, self.n_columns
        shape = (slab.n_height, self.n_direction, self.n_azimuth, n_sun)
        ray, azimuth, k, lane = lane_indices(shape)
        mu_s = dr.gather(mi.Float32, self.sun_cosines, k)
        mu = dr.gather(mi.Float32, slab.mu, ray)
        phi = (mi.Float32(azimuth) + 0.5) * (math.pi / self.n_azimuth)
        nu = mu_s * mu + dr.sqrt(dr.maximum((1.0 - mu_s * mu_s) * (1.0 - mu * mu), 0.0)) * dr.cos(phi)
        packet = tables.packet_type(mi.Float32)

        def body(n: mi.UInt32, radiance: list[mi.Float32]) -> tuple[mi.UInt32, list[mi.Float32]]:
            at = ray * n_node + n
            place, weight = dr.gather(packet, slab.places, at), dr.gather(packet, slab.weight, at)
            mu_n = dr.clip(dr.fma(place[0], mu_s, place[1] * nu), SUN_LOWEST, 1.0)
            up = place[2]
            sines = dr.sqrt(dr.maximum((1.0 - mu_n * mu_n) * (1.0 - up * up), 1e-9))
            angles = cosines(degree, dr.clip((nu - mu_n * up) / sines, -1.0, 1.0))
            x = sun_angle_position(mu_n, n_sun)
            j = dr.minimum(mi.UInt32(x), n_sun - 2)
            w = x - mi.Float32(j)
            row = (at * n_sun + j) * (columns * packets)
            gained = []
            for c in range(columns):
                values: list[mi.Float32] = []
                for q in range(c * packets, (c + 1) * packets):
                    a = dr.gather(packet, contracted, row + q)
                    b = dr.gather(packet, contracted, row + columns * packets + q)
                    values += [dr.fma(b[v] - a[v], w, a[v]) for v in range(4)]
                angular = sum(v * cosine for v, cosine in zip(values[1:], angles, strict=False))
                gained.append(radiance[c] + weight[c] * dr.exp(values[0]) * angular)
            return n + 1, gained

        zero = dr.zeros(mi.Float32, dr.width(lane))
        nothing = [zero + 0.0 for _ in range(columns)]
        _, radiance = dr.while_loop((mi.UInt32(0), nothing), lambda n, _: n < n_node, body, label="diffuse march")
        dr.eval(radiance)
        return [np.array(v, dtype=np.float64).reshape(shape) for v in radiance]
