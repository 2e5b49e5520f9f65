"""Light scattered more than once in a spherical shell, by successive orders, as moments of the sky at every point.

At radius r, where the Sun's zenith angle has the cosine ``mu_s``, the diffuse radiance ``I(Omega)`` that arrives from
direction ``Omega`` enters the source of scattered light only through its moments with the spherical harmonics::

    J(Omega) = sum_l s_l(r) sum_m Y_lm(Omega) I_lm,        I_lm = int I Y_lm dOmega
    s_l = s_molecules chi_l + s_particles g^l,             chi_0 = 1, chi_2 = 2 c / 15

by the addition theorem, because phase functions depend on one angle only. Molecules (phase function
``(1 - c/3 + c cos^2) / 4 pi``) need l = 0 and 2 only, which is exact; particles are cut at ``particle_degree``.

**Successive orders.** I^(1) is light scattered once (exact phase functions); ``I^(n+1) = K[J(I^(n))]`` with K the march
along straight rays in all directions. Orders are added until the last one is small, the rest is summed as a geometric
series point by point. A second series begins with the light of the ground and holds what one reflection there adds;
any further reflection multiplies it by almost the same factor, the spherical albedo s of the air seen from below, so
that every Lambert albedo A is served::

    I(A) = I_air + A I_bounce / (1 - A s)

(0.1 % of the diffuse light by day, 0.4 % with the Sun 6 deg below the horizon, at 450 nm and an albedo of 0.8.)
Whatever spans decades in twilight is interpolated as ``ln I_00`` and ratios to it.

**Accuracy** of the total radiance of molecules: 0.6 % against another code (1.2 % with ozone) and 1 % plus its noise
against Monte Carlo, from a high Sun to one 18 deg below the horizon. With particles of asymmetry 0.7: haze 0.7 % by
day, 1 % until the Sun is 2 deg and 5 % until it is 5 deg below the horizon, in the dark rays towards the Sun; a dense
layer with sharp edges 1.5 %. LOWTRAN7's background, the Sun 5 to 12 deg below the horizon: 2.4 % at worst, 0.6 % rms;
after a large eruption (``LAYERED``, 850 nm) 4.6 % looking away from the Sun, 2.3 % rms.

Light scattered once or twice has high moments; later orders and light from the ground have those up to
``later_degree`` on half of the Sun's angles: a quarter of the time, 0.1 % by day and at most 1 % more in the dark rays
of twilight. Neglected: polarisation (1 % at 90 deg from the Sun), refraction, horizontal change of the air.

**One pass** for all heights i, polar directions j, ray nodes n and Sun angles k first contracts the harmonics of the
node with the moments at its radius, leaving ``F_m(i, j, n, k)``: along the ray only ``sum_m F_m cos(m phi)`` at the
node's Sun angle remains to be interpolated. Columns differ in extinction and scattering alone, so that one
march finds the places for all of them.

**On disk** a solution lies under a hash of everything it depends on: the planet's radius, the columns, the phase
functions, the quality and the version of the method. Of processes that need the same one solves it, and the others
wait; a damaged file is solved again.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.interpolate import CubicSpline

from horizonval.core.arrays import FloatArray
from horizonval.core.cache import array_of, cached_arrays, keep_arrays, making
from horizonval.core.environment import cache_folder
from horizonval.core.errors import DamagedFileError
from horizonval.core.progress import Progress, Silent, made_once
from horizonval.earth.column import SpectralNode
from horizonval.renderer import tables
from horizonval.renderer.scattering.shells import (
    MOLECULAR_DEGREE,
    SMALLEST,
    SOLVED_TOGETHER,
    SUN_LOWEST,
    DiffuseField,
    MultipleScattering,
    Quality,
    ShellColumn,
    ShellRays,
    cosines,
    degree_of,
    field_heights,
    layer_bands,
    pairs,
    polar_parts,
    sun_angle_cosines,
    sun_angle_position,
)
from horizonval.renderer.tables import SunTable, table_of
from horizonval.renderer.types import Values, constant


def lane_shape(column: ShellColumn, rays: ShellRays, n_azimuth: int) -> tuple[int, ...]:
    return (*rays.cosine.shape, n_azimuth, len(column.sun_cosines))


def lane_indices(shape: tuple[int, ...]) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32]:
    """Return height-and-direction, azimuth, Sun angle indices of all lanes; the Sun angle runs fastest."""
    n_h, n_d, n_a, n_k = shape
    lane = dr.arange(mi.UInt32, n_h * n_d * n_a * n_k)
    return lane // (n_a * n_k), (lane // n_k) % n_a, lane % n_k, lane


def _along_sun(mu_s: mi.Float64, mu: mi.Float64, azimuth: mi.Float64) -> mi.Float64:
    """Return the cosine of the angle between ray and Sun."""
    sines = dr.sqrt(dr.maximum(1.0 - mu_s * mu_s, 0.0) * dr.maximum(1.0 - mu * mu, 0.0))
    return mu_s * mu + sines * dr.cos(azimuth)


def single_scattering(
    columns: Sequence[ShellColumn], rays: Sequence[ShellRays], n_azimuth: int, sun_table: SunTable
) -> list[FloatArray]:
    """Return radiance of light scattered once, per column, Float64: the shadow's edge is found to the metre.

    The columns differ in their nodes alone, ``SOLVED_TOGETHER`` of them; ``sun_table`` is as wide.
    """
    first, geometry = columns[0], rays[0]
    shape = lane_shape(first, geometry, n_azimuth)
    ray, azimuth, k, lane = lane_indices(shape)
    r = geometry.node_radius_m
    n_nodes = r.shape[-1]
    packet = tables.packet_type(mi.Float64)
    start = np.broadcast_to(geometry.radius_m[:, None, None], r.shape)
    height = r - first.planet_m
    # the cosine of the Sun's zenith angle at a node is a sum of two terms of these factors
    places = table_of(mi.Float64, np.stack([height, r, start / r, geometry.node_distance_m / r], axis=-1))
    with_particles = first.degree > MOLECULAR_DEGREE

    def table(values: Sequence[FloatArray]) -> mi.Float64:
        return table_of(mi.Float64, np.stack(values, axis=-1))

    def weighted(name: str) -> mi.Float64:
        return table([v.node_weight * c.at(getattr(c.node, name), r) for c, v in zip(columns, rays, strict=True)])

    molecular = weighted("molecular_per_m")
    if with_particles:
        particle = weighted("particle_per_m")
        asymmetry = table([c.at(c.node.asymmetry, r) for c in columns])
    peaks = any(len(c.node.forward_per_m) for c in columns)
    forward = weighted("forward_per_m") if peaks else mi.Float64(0.0)
    mu_s = dr.gather(mi.Float64, table_of(mi.Float64, first.sun_cosines), k)
    mu = dr.gather(mi.Float64, table_of(mi.Float64, geometry.cosine), ray)
    nu = _along_sun(mu_s, mu, (mi.Float64(azimuth) + 0.5) * (math.pi / n_azimuth))
    cos2 = [constant(c.node.molecular_cos2) for c in columns]
    molecules = [(1.0 - c / 3.0 + c * nu * nu) * (0.25 / math.pi) for c in cos2]
    sun_table = replace(sun_table, values=mi.Float32(sun_table.values))
    dr.eval(sun_table.values)
    ground2 = constant(first.planet_m**2)
    peak = _cut_peak(nu, first.degree) if peaks else nu

    def body(n: mi.UInt32, radiance: Values) -> tuple[mi.UInt32, Values]:
        at = ray * n_nodes + n
        place = dr.gather(packet, places, at)
        h_n, r_n = place[0], place[1]
        mu_n = dr.fma(place[2], mu_s, place[3] * nu)
        lit = (mu_n > 0.0) | (r_n * r_n * (1.0 - mu_n * mu_n) > ground2)
        scattering = dr.gather(packet, molecular, at)
        emitted = [scattering[c] * molecules[c] for c in range(len(columns))]
        if with_particles:
            scattering, asymmetries = dr.gather(packet, particle, at), dr.gather(packet, asymmetry, at)
            for c in range(len(columns)):
                g = asymmetries[c]
                base = 1.0 + g * g - 2.0 * g * nu
                phase = (1.0 - g * g) / (base * dr.sqrt(base)) * (0.25 / math.pi)
                emitted[c] = emitted[c] + scattering[c] * phase
            if peaks:
                ahead = dr.gather(packet, forward, at)
                emitted = [e - ahead[c] * peak for c, e in enumerate(emitted)]
        through = sun_table.transmittance(h_n, mu_n, len(columns))
        gain = [dr.select(lit, e * t, 0.0) for e, t in zip(emitted, through, strict=True)]
        return n + 1, [v + g for v, g in zip(radiance, gain, strict=True)]

    zero = dr.zeros(mi.Float64, dr.width(lane))
    nothing = [zero + 0.0 for _ in columns]
    _, radiance = dr.while_loop((mi.UInt32(0), nothing), lambda n, _: n < n_nodes, body, label="single scattering")
    dr.eval(radiance)
    return [np.array(v).reshape(shape) for v in radiance]


def _cut_peak(cosine: mi.Float64, degree: int) -> mi.Float64:
    """Return a peak straight on as moments up to a degree have it: ``sum of (2 l + 1) P_l / 4 pi``.

    What scatters so has not left the beam (:mod:`.forward_peak`).
    """
    before, now = mi.Float64(1.0), cosine
    total = before + 3.0 * now
    for n in range(2, degree + 1):
        before, now = now, ((2.0 * n - 1.0) * cosine * now - (n - 1.0) * before) * (1.0 / n)
        total = dr.fma(2.0 * n + 1.0, now, total)
    return total * (0.25 / math.pi)


def ground_light(column: ShellColumn, rays: ShellRays, n_azimuth: int, lit: FloatArray) -> FloatArray:
    """Return radiance that comes straight from a ground of radiance ``lit`` (n_sun,)."""
    shape = lane_shape(column, rays, n_azimuth)
    phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
    mu_s, mu = column.sun_cosines, rays.cosine[:, :, None, None]
    sines = np.sqrt((1 - mu_s**2) * (1 - mu**2))
    nu = mu_s * mu + sines * np.cos(phi)[:, None]
    at_ground = (rays.radius_m[:, None, None, None] * mu_s + rays.end_m[:, :, None, None] * nu) / column.planet_m
    position = sun_angle_position(at_ground, len(mu_s))
    value = np.exp(np.interp(position, np.arange(len(mu_s)), np.log(np.maximum(lit, SMALLEST))))
    seen = rays.reaches_ground * rays.end_transmittance
    return np.broadcast_to(value * seen[:, :, None, None], shape)


_SLAB = 4_000_000
"""Contracted values per launch."""


@dataclass(frozen=True)
class _Slab:
    """Neighbouring heights that are marched in one launch, with the tables of their rays.

    ``mu``, ``start``: the rays' cosines, and radii [m] they start from. ``places``, (rays * nodes * 4,): terms of the
    cosine of the Sun's zenith angle, and the cosine of the ray's angle to the zenith. ``weight``, (rays * nodes *
    columns,): of emission per metre. ``level``, ``level_weight``, (rays * nodes,): height below, and the weight of the
    one above. ``factors``, (rays * nodes * columns * slots,): of the moments.
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

    ``columns``, ``rays``: of equal number, one geometry and one degree of the moments that scatter. ``n_sun``: Sun
    angles, between which light is linear in its logarithm.
    """

    def __init__(
        self, columns: Sequence[ShellColumn], rays: Sequence[ShellRays], n_azimuth: int, degree: int, n_sun: int
    ) -> None:
        column, geometry = columns[0], rays[0]
        self.degree, self.n_azimuth, self.n_columns = degree, n_azimuth, len(columns)
        self.n_sun = n_sun
        self.n_direction, self.n_node = geometry.node_radius_m.shape[1:]
        # molecules scatter by even harmonics only
        self.used = [(n, m) for n, m in pairs(degree) if column.degree > MOLECULAR_DEGREE or n in (0, 2)]
        self.positions = [column.pairs.index(pair) for pair in self.used]
        self.slots = 4 * -(-len(self.used) // 4)
        self.packets = -(-(self.degree + 2) // 4)
        self.sun_cosines = table_of(mi.Float32, sun_angle_cosines(n_sun))
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


LAST_ORDER = 1e-1
"""Orders are summed until one adds less than this share.

The geometric rest is then right to 3e-4 by day, 4e-3 in the dark.
"""
LATER_ANGLES = 0.5
"""Share of the Sun angles for later orders than the second, which have nothing left of the shadow's edge."""
MOST_ORDERS = 60


def solve(
    nodes: Sequence[SpectralNode],
    altitude_m: FloatArray,
    planet_m: float,
    sun_table: SunTable,
    quality: Quality,
    progress: Progress | None = None,
) -> list[MultipleScattering]:
    """Return the light scattered more than once in columns of air that need moments of one degree.

    A column's solution has the same bits whatever columns it is solved with. ``nodes``: 1 to ``SOLVED_TOGETHER``;
    ``altitude_m``, (n,): of their columns; ``planet_m``: radius of the ground; ``sun_table``: the nodes' optical depths
    towards the Sun, ``SOLVED_TOGETHER`` wide.
    """
    solver = _Solver(nodes, altitude_m, planet_m, sun_table, quality, progress)
    air = solver.sum_of_orders(solver.scattered_once())
    mu = solver.sun_cosines
    direct = [np.maximum(mu, 0.0) * through for through in _transmittance(sun_table, np.zeros_like(mu), mu)]
    lit = [(d + a.irradiance) / math.pi for d, a in zip(direct, air, strict=True)]
    bounce = solver.sum_of_orders(solver.from_ground(lit))
    day = mu > 0.2
    albedo = [float(np.sum(b.irradiance[day]) / np.sum(math.pi * e[day])) for b, e in zip(bounce, lit, strict=True)]
    return [MultipleScattering(*solution) for solution in zip(air, bounce, albedo, strict=True)][: len(nodes)]


def _transmittance(table: SunTable, height_m: FloatArray, mu: FloatArray) -> list[FloatArray]:
    through = table.transmittance(table_of(mi.Float64, height_m), table_of(mi.Float64, mu), SOLVED_TOGETHER)
    dr.eval(through)
    return [np.array(t).reshape(mu.shape) for t in through]


@dataclass(frozen=True)
class _Field:
    """One order of scattering: moments (n_height, n_sun, n_harmonics) and irradiance (n_sun,)."""

    moments: FloatArray
    irradiance: FloatArray


class _Basis:
    """Weights from radiance along the rays of a geometry to moments up to a degree.

    ``weights``: shape (n_height, n_harmonics, n_direction * n_azimuth); ``down``: of directions in the irradiance.
    """

    def __init__(self, rays: ShellRays, n_azimuth: int, degree: int) -> None:
        self.n_azimuth = n_azimuth
        mu, weight = rays.cosine, rays.solid_angle
        phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
        polar = polar_parts(degree, mu, np.sqrt(1.0 - mu**2))
        azimuthal = cosines(degree, np.cos(phi))
        weights = np.stack([polar[n, m][..., None] * azimuthal[m] for n, m in pairs(degree)], axis=1)
        weights *= (weight * (2 * math.pi / n_azimuth))[:, None, :, None]
        self.weights = weights.reshape(*weights.shape[:2], -1)
        self.down = (rays.solid_angle * np.maximum(rays.cosine, 0.0))[0] * (2 * math.pi / n_azimuth)

    def field(self, radiance: FloatArray) -> _Field:
        """Return the moments of radiance (n_height, n_direction, n_azimuth, n_sun)."""
        n_h, _, _, n_k = radiance.shape
        moments = np.matmul(self.weights, radiance.reshape(n_h, -1, n_k)).transpose(0, 2, 1)
        return _Field(moments, self.down @ radiance[0].sum(axis=1))


@dataclass(frozen=True)
class _Pass:
    """From one order of scattering to the next: the march, and the moments of what it gives."""

    march: DiffuseMarch
    basis: _Basis

    @classmethod
    def of(cls, columns: Sequence[ShellColumn], rays: Sequence[ShellRays], degree: int, n_sun: int) -> _Pass:
        """Prepare one for moments up to a degree."""
        # odd harmonics of the azimuth up to the degree must survive the sum over azimuths
        n_azimuth = max(columns[0].quality.n_azimuth, degree + 2)
        return cls(DiffuseMarch(columns, rays, n_azimuth, degree, n_sun), _Basis(rays[0], n_azimuth, degree))

    def next_order(self, moments: Sequence[FloatArray]) -> list[_Field]:
        """Return the following order of columns, on as many Sun angles as the last."""
        n_sun = moments[0].shape[1]
        light = self.march.apply([resampled(column, self.march.n_sun) for column in moments])
        fields = [self.basis.field(radiance) for radiance in light]
        return [
            _Field(resampled(f.moments, n_sun), resampled(f.irradiance[None, :, None], n_sun)[0, :, 0]) for f in fields
        ]


def resampled(moments: FloatArray, n_sun: int) -> FloatArray:
    """Return moments (heights, angles, k) on another number of Sun angles, by cubic splines through logarithms."""
    count = moments.shape[1]
    if count == n_sun:
        return moments
    total = np.maximum(moments[..., :1], SMALLEST)
    packed = np.concatenate([np.log(total), moments[..., 1:] / total], axis=-1)
    found = np.asarray(CubicSpline(np.linspace(0.0, 1.0, count), packed, axis=1)(np.linspace(0.0, 1.0, n_sun)))
    total = np.exp(found[..., :1])
    return np.concatenate([total, found[..., 1:] * total], axis=-1)


class _Sum:
    """The sum of a column's orders, until what is left adds little."""

    def __init__(self, first: _Field, degree: int) -> None:
        self.moments = _padded(first.moments, len(pairs(degree)))
        self.irradiance = first.irradiance.copy()
        self.last = first
        self.share = 1.0

    @property
    def complete(self) -> bool:
        return self.share < LAST_ORDER

    def add(self, following: _Field) -> None:
        self.moments[..., : following.moments.shape[-1]] += following.moments
        self.irradiance += following.irradiance
        self.share = float(np.max(following.moments[..., 0] / np.maximum(self.moments[..., 0], SMALLEST)))
        self.ratio = following.moments[..., 0] / np.maximum(self.last.moments[..., 0], SMALLEST)
        self.last = following

    def field(self, column: ShellColumn) -> DiffuseField:
        """Return the sum of all orders, the rest taken as a geometric series."""
        rest = np.clip(self.ratio, 0.0, 0.9)
        moments = self.moments.copy()
        moments[..., : self.last.moments.shape[-1]] += self.last.moments * (rest / (1.0 - rest))[..., None]
        irradiance = self.irradiance + self.last.irradiance * rest[0] / (1.0 - rest[0])
        heights = column.heights if column.bands else None
        return DiffuseField(column.top_m, column.planet_m, column.degree, moments, irradiance, heights)


def _padded(moments: FloatArray, count: int) -> FloatArray:
    """Return a copy of moments with zeros for those of higher degrees."""
    return np.concatenate([moments, np.zeros((*moments.shape[:-1], count - moments.shape[-1]))], axis=-1)


class _Solver:
    def __init__(
        self,
        nodes: Sequence[SpectralNode],
        altitude_m: FloatArray,
        planet_m: float,
        sun_table: SunTable,
        quality: Quality,
        progress: Progress | None = None,
    ) -> None:
        together = [*nodes, *[nodes[-1]] * (SOLVED_TOGETHER - len(nodes))]
        self.columns = [ShellColumn(node, altitude_m, planet_m, quality) for node in together]
        self.column, self.sun_table = self.columns[0], sun_table
        self.sun_cosines = self.column.sun_cosines
        self.progress = progress or Silent()
        self.name = nodes[0].name if len(nodes) == 1 else f"{nodes[0].name} to {nodes[-1].name}"
        self.tell(1, 1.0)
        q, degree = quality, self.column.degree
        self.rays = [column.rays(q.n_up, q.n_down, q.n_nodes) for column in self.columns]
        self.second = _Pass.of(self.columns, self.rays, degree, q.n_sun)
        self.later = _Pass.of(self.columns, self.rays, min(q.later_degree, degree), round(LATER_ANGLES * q.n_sun))

    def tell(self, order: int, share: float) -> None:
        """Tell that an order of scattering is done, and the share of the sum that it added."""
        self.progress.step(f"multiple scattering at {self.name}", f"order {order}, adding {share:.1%}")

    def scattered_once(self) -> list[_Field]:
        q = self.column.quality
        rays = [column.rays(q.first_up, q.n_down, q.first_nodes) for column in self.columns]
        n_azimuth = max(q.first_azimuth, self.column.degree + 2)
        basis = _Basis(rays[0], n_azimuth, self.column.degree)
        return [basis.field(radiance) for radiance in single_scattering(self.columns, rays, n_azimuth, self.sun_table)]

    def from_ground(self, lit: Sequence[FloatArray]) -> list[_Field]:
        basis = self.later.basis
        return [
            basis.field(ground_light(self.column, rays, basis.n_azimuth, e))
            for rays, e in zip(self.rays, lit, strict=True)
        ]

    def sum_of_orders(self, first: Sequence[_Field]) -> list[DiffuseField]:
        """Return all light that comes of the first: that of the ground has no moments beyond the later degree."""
        sums = [_Sum(field, self.column.degree) for field in first]
        once_scattered = first[0].moments.shape[-1] == sums[0].moments.shape[-1]
        for order in range(2, MOST_ORDERS):
            one = self.second if order == 2 and once_scattered else self.later
            fields = one.next_order([column.last.moments for column in sums])
            for column, field in zip(sums, fields, strict=True):
                if not column.complete:
                    column.add(field)
            self.tell(order, max(column.share for column in sums))
            if all(column.complete for column in sums):
                break
        return [s.field(column) for s, column in zip(sums, self.columns, strict=True)]


METHOD = 4
"""To be raised with every change of the method that changes its numbers."""

_KEPT = 64
_memory: OrderedDict[str, MultipleScattering] = OrderedDict()


def content_key(node: SpectralNode, altitude_m: FloatArray, planet_m: float, quality: Quality) -> str:
    """Return the name under which a solution is kept."""
    digest = hashlib.sha256()
    digest.update(repr((METHOD, planet_m, node.molecular_cos2, astuple(quality))).encode())
    for column in (altitude_m, node.extinction_per_m, node.molecular_per_m, node.particle_per_m, node.asymmetry):
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    if len(node.layer_per_m):
        digest.update(np.ascontiguousarray(node.layer_per_m, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(node.forward_per_m, dtype="<f8").tobytes())
        heights = field_heights(float(altitude_m[-1]), quality.n_height, layer_bands(node, altitude_m))
        digest.update(np.ascontiguousarray(heights, dtype="<f8").tobytes())
    return digest.hexdigest()[:32]


def multiple_scattering(
    nodes: Sequence[SpectralNode],
    altitude_m: FloatArray,
    planet_m: float,
    quality: Quality,
    sun_table: Callable[[Sequence[SpectralNode]], SunTable],
    progress: Progress | None = None,
) -> list[MultipleScattering]:
    """Return solutions from memory, from disk, or solved now, with a ``sun_table`` ``SOLVED_TOGETHER`` wide."""
    top_m = float(altitude_m[-1])
    keys = [content_key(node, altitude_m, planet_m, quality) for node in nodes]

    def kept(key: str, node: SpectralNode) -> MultipleScattering | None:
        bands = layer_bands(node, altitude_m)
        heights = field_heights(top_m, quality.n_height, bands) if bands else None
        return _memory.get(key) or _read(key, top_m, planet_m, degree_of(node, quality), quality, heights)

    solutions = {key: kept(key, node) for key, node in zip(keys, nodes, strict=True)}
    missing: dict[int, dict[str, SpectralNode]] = {}
    for key, node in zip(keys, nodes, strict=True):
        if solutions[key] is None:
            missing.setdefault(degree_of(node, quality), {})[key] = node
    for columns in missing.values():
        for first in range(0, len(columns), SOLVED_TOGETHER):
            together = dict(list(columns.items())[first : first + SOLVED_TOGETHER])
            with making(_path(next(iter(together)))), made_once("tables"):
                solutions |= {key: kept(key, node) for key, node in together.items()}
                some = {key: node for key, node in together.items() if solutions[key] is None}
                if some:
                    table = sun_table(list(some.values()))
                    solved = solve(list(some.values()), altitude_m, planet_m, table, quality, progress)
                    for key, solution in zip(some, solved, strict=True):
                        _write(_path(key), key, solution)
                        solutions[key] = solution
    result = [found for key in keys if (found := solutions[key]) is not None]
    for key, one in zip(keys, result, strict=True):
        _memory[key] = one
        _memory.move_to_end(key)
    while len(_memory) > _KEPT:
        _memory.popitem(last=False)
    return result


def _path(key: str) -> Path:
    return cache_folder() / "scattering" / f"{key}.npz"


def _write(path: Path, key: str, solution: MultipleScattering) -> None:
    """Keep a solution."""
    arrays = {
        "key": np.asarray(key),
        "air": solution.air.moments,
        "air_irradiance": solution.air.irradiance,
        "bounce": solution.bounce.moments,
        "bounce_irradiance": solution.bounce.irradiance,
        "spherical_albedo": np.asarray(solution.spherical_albedo),
    }
    keep_arrays(path, arrays)


def _read(
    key: str, top_m: float, planet_m: float, degree: int, quality: Quality, heights: FloatArray | None
) -> MultipleScattering | None:
    path, n_height = _path(key), quality.n_height if heights is None else len(heights)

    def build(arrays: Mapping[str, np.ndarray]) -> MultipleScattering:
        if str(arrays["key"]) != key:
            raise DamagedFileError("holds the solution of another column of air", where=str(path))
        fields = []
        for name in ("air", "bounce"):
            moments = array_of(arrays, name, (n_height, quality.n_sun, len(pairs(degree))))
            irradiance = array_of(arrays, f"{name}_irradiance", (quality.n_sun,))
            fields.append(DiffuseField(top_m, planet_m, degree, moments, irradiance, heights))
        return MultipleScattering(fields[0], fields[1], float(array_of(arrays, "spherical_albedo", ())))

    return cached_arrays(path, build)
