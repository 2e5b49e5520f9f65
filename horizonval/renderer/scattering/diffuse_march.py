"""One order of scattering from the last: the march of diffuse light along all rays of a column.

One pass for all heights i, polar directions j, ray nodes n and Sun angles k first contracts the harmonics of the node
with the moments at its radius, leaving ``F_m(i, j, n, k)``: along the ray only ``sum_m F_m cos(m phi)`` at the node's
own Sun angle remains to be interpolated.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer import tables
from horizonval.renderer.scattering.diffuse_field import SMALLEST
from horizonval.renderer.scattering.first_order import lane_indices
from horizonval.renderer.scattering.harmonics import cosines, polar_parts
from horizonval.renderer.scattering.shell_column import ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.scattering.sun_angles import SUN_LOWEST, sun_angle_position

_SLAB = 4_000_000
"""Contracted values per launch."""


class DiffuseMarch:
    """The march of diffuse light along all rays, prepared once and applied to every order."""

    def __init__(self, column: ShellColumn, rays: ShellRays, n_azimuth: int) -> None:
        self.column, self.rays, self.n_azimuth = column, rays, n_azimuth
        node, degree = column.node, column.degree
        self.n_sun = len(column.sun_cosines)
        n_height = len(column.heights)
        position = np.sqrt((rays.node_radius_m - column.planet_m).clip(0.0) / column.top_m) * (n_height - 1)
        self.level = np.minimum(position.astype(int), n_height - 2)
        self.level_weight = position - self.level
        molecular = column.at(node.molecular_per_m, rays.node_radius_m)
        particle = column.at(node.particle_per_m, rays.node_radius_m)
        asymmetry = column.at(node.asymmetry, rays.node_radius_m)
        chi = {0: 1.0, 2: 2.0 * node.molecular_cos2 / 15.0}
        polar = polar_parts(degree, rays.node_up, np.sqrt(np.maximum(1.0 - rays.node_up**2, 0.0)))
        scattering = [molecular * chi.get(n, 0.0) + particle * asymmetry**n for n in range(degree + 1)]
        self.weight = rays.node_weight
        self.packets = -(-(degree + 2) // 4)
        # for each order m of the harmonics: which moments, and by which factors they enter at every node
        self.by_order: list[tuple[list[int], FloatArray | None]] = []
        for m in range(degree + 1):
            used = [(p, n) for p, (n, k) in enumerate(column.pairs) if k == m and scattering[n].any()]
            factors = [polar[n, m] * scattering[n] for _, n in used]
            self.by_order.append(([p for p, _ in used], np.stack(factors, axis=-1) if used else None))

    def apply(self, moments: FloatArray) -> FloatArray:
        """Return the radiance (n_height, n_direction, n_azimuth, n_sun) that a field of moments makes by scattering."""
        n_h, n_d, n_n = self.level.shape
        total = np.maximum(moments[..., 0], SMALLEST)
        logarithm, ratios = np.log(total), moments / total[..., None]
        levels = max(1, _SLAB // (n_d * n_n * self.n_sun * self.packets))
        parts = []
        for first in range(0, n_h, levels):
            part = slice(first, min(first + levels, n_h))
            parts.append(self._march(self._contracted(logarithm, ratios, part), part))
        return np.concatenate(parts, axis=0)

    def _contracted(self, logarithm: FloatArray, ratios: FloatArray, part: slice) -> mi.Float32:
        """Return ``ln I_00`` and ``F_m / I_00`` at (height, direction, node, Sun angle), packed by fours."""
        level, w = self.level[part].ravel(), self.level_weight[part].ravel()
        values = np.zeros((1 + len(self.by_order), level.size, self.n_sun), dtype=np.float32)
        # nodes between the same two heights share their moments: one product of matrices each
        for row in np.unique(level):
            at = np.flatnonzero(level == row)
            upper = w[at, None]
            values[0, at] = (1.0 - upper) * logarithm[row] + upper * logarithm[row + 1]
            for m, (used, factors) in enumerate(self.by_order):
                if factors is not None:
                    here = factors[part].reshape(level.size, -1)[at]
                    low, high = (ratios[k][:, used].T for k in (row, row + 1))
                    values[1 + m, at] = ((1.0 - upper) * here) @ low + (upper * here) @ high
        width = 4 * self.packets
        packed = dr.zeros(mi.Float32, level.size * self.n_sun * width)
        lane = dr.arange(mi.UInt32, level.size * self.n_sun)
        for n in range(1 + len(self.by_order)):
            dr.scatter(packed, mi.Float32(values[n].ravel()), lane * width + n)
        dr.eval(packed)
        return packed

    def _march(self, contracted: mi.Float32, part: slice) -> FloatArray:
        rays, degree, n_sun = self.rays, self.column.degree, self.n_sun
        n_n = rays.node_radius_m.shape[-1]
        shape = (rays.cosine[part].shape[0], rays.cosine.shape[1], self.n_azimuth, n_sun)
        ray, azimuth, k, lane = lane_indices(shape)
        radius = mi.Float32(rays.node_radius_m[part].ravel())
        distance = mi.Float32(rays.node_distance_m[part].ravel())
        node_up = mi.Float32(rays.node_up[part].ravel())
        weight = mi.Float32(self.weight[part].ravel())
        start = dr.gather(mi.Float32, mi.Float32(np.repeat(rays.radius_m[part], shape[1])), ray)
        mu_s = dr.gather(mi.Float32, mi.Float32(self.column.sun_cosines), k)
        mu = dr.gather(mi.Float32, mi.Float32(rays.cosine[part].ravel()), ray)
        phi = (mi.Float32(azimuth) + 0.5) * (math.pi / self.n_azimuth)
        nu = mu_s * mu + dr.sqrt(dr.maximum((1.0 - mu_s * mu_s) * (1.0 - mu * mu), 0.0)) * dr.cos(phi)
        width, packets = 4 * self.packets, self.packets
        packet = tables.packet_type(mi.Float32)

        def body(n: mi.UInt32, radiance: mi.Float32) -> tuple[mi.UInt32, mi.Float32]:
            at = ray * n_n + n
            mu_n = (start * mu_s + dr.gather(mi.Float32, distance, at) * nu) / dr.gather(mi.Float32, radius, at)
            mu_n = dr.clip(mu_n, SUN_LOWEST, 1.0)
            up = dr.gather(mi.Float32, node_up, at)
            sines = dr.sqrt(dr.maximum((1.0 - mu_n * mu_n) * (1.0 - up * up), 1e-9))
            cosine = dr.clip((nu - mu_n * up) / sines, -1.0, 1.0)
            x = sun_angle_position(mu_n, n_sun)
            j = dr.minimum(mi.UInt32(x), n_sun - 2)
            w = x - mi.Float32(j)
            row = (at * n_sun + j) * packets
            values: list[mi.Float32] = []
            for q in range(packets):
                a = dr.gather(packet, contracted, row + q)
                b = dr.gather(packet, contracted, row + packets + q)
                values += [dr.fma(b[c] - a[c], w, a[c]) for c in range(4)]
            angular = sum(v * c for v, c in zip(values[1:], cosines(degree, cosine), strict=False))
            gain = dr.gather(mi.Float32, weight, at) * dr.exp(values[0]) * angular
            return n + 1, radiance + gain

        assert width == 4 * packets
        zero = dr.zeros(mi.Float32, dr.width(lane))
        _, radiance = dr.while_loop((mi.UInt32(0), zero), lambda n, _: n < n_n, body, label="diffuse march")
        return np.array(radiance, dtype=np.float64).reshape(shape)
