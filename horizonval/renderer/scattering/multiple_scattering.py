r"""Light scattered more than once in a spherical shell, by successive orders, as moments of the sky at every point.

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

**One pass** for all heights i, polar directions j, ray nodes n and Sun angles k first contracts the harmonics of the
node with the moments at its radius, leaving ``F_m(i, j, n, k)``: along the ray only ``sum_m F_m cos(m phi)`` at the
node's own Sun angle remains to be interpolated. Everything that spans decades in twilight is interpolated as
``ln I_00`` and ratios to it.

**Accuracy** of the radiance in all, as tested: 0.6 % against another code (1.2 % with ozone) and 1 % beside its noise
against Monte Carlo, from a high Sun to one 18 deg below the horizon, for molecules. With particles of asymmetry 0.7:
haze 0.7 % by day, 1 % until the Sun is 2 deg below the horizon and 5 % until 5 deg, in the dark rays towards the Sun;
a dense layer with sharp edges 1.5 % (``FINE``: 0.7 %). Beyond 5 deg particles are not checked. On the ellipsoid, read
at geodetic height, 0.5 % against Monte Carlo over WGS84, which is its noise.

Neglected: polarisation (1 % of radiance at 90 deg from the Sun), refraction, horizontal change of air and ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress, Silent
from horizonval.earth.column import SpectralNode
from horizonval.renderer import tables
from horizonval.renderer.scattering.harmonics import cosines, pairs, polar_parts
from horizonval.renderer.scattering.shell_rays import ShellRays, shell_rays
from horizonval.renderer.scattering.sun_angles import SUN_LOWEST, sun_angle_cosines, sun_angle_position
from horizonval.renderer.tables import SunTable

SMALLEST = 1e-30
LAST_ORDER = 2e-3
"""Orders are summed one by one until one adds less than this share anywhere; the geometric rest is then 1e-5."""
MOST_ORDERS = 60
_SLAB = 4_000_000
"""Contracted values per launch."""


@dataclass(frozen=True)
class Quality:
    """Resolution of the tables and of the quadratures behind them.

    ``n_*``: heights, Sun angles; directions above and below the horizon, azimuths in half a turn and nodes on a ray;
    ``first_*`` the same for the light scattered once, which has the shadow's edge and the aureole in it.
    ``particle_degree``: up to which moments are kept where there are particles.
    """

    n_height: int
    n_sun: int
    n_up: int
    n_down: int
    n_azimuth: int
    n_nodes: int
    first_up: int
    first_azimuth: int
    first_nodes: int
    particle_degree: int


STANDARD = Quality(24, 128, 20, 4, 6, 24, 28, 10, 64, 8)
"""For images. Molecules at 450 to 850 nm, against a table of far higher resolution: at most 0.06 % of the radiance with
the Sun up, 0.3 % until it is 8 deg below the horizon, 0.8 % (850 nm: 3 %) until 18 deg."""

FINE = Quality(32, 160, 24, 4, 8, 48, 32, 16, 96, 12)
"""For single rays: 0.02 %, 0.3 % and 0.4 % (850 nm: 1.1 %)."""


@dataclass(frozen=True)
class DiffuseField:
    """Moments of diffuse light on heights ``top x^2`` and the angles of ``sun_angles``, per unit solar irradiance.

    Attributes
    ----------
    top_m, planet_m : float
    degree : int
    moments : ndarray, shape (n_height, n_sun, n_harmonics)
        ``I_lm`` in the order of :func:`harmonics.pairs`.
    irradiance : ndarray, shape (n_sun,)
        Diffuse irradiance on the ground.
    """

    top_m: float
    planet_m: float
    degree: int
    moments: FloatArray
    irradiance: FloatArray


@dataclass(frozen=True)
class MultipleScattering:
    """What :func:`solve` returns: the air alone, one reflection at a ground of albedo 1, and the air's albedo s."""

    air: DiffuseField
    bounce: DiffuseField
    spherical_albedo: float

    def over_ground(self, albedo: float) -> DiffuseField:
        """Return the field over a Lambert ground."""
        factor = albedo / (1.0 - albedo * self.spherical_albedo)
        return DiffuseField(
            self.air.top_m,
            self.air.planet_m,
            self.air.degree,
            self.air.moments + factor * self.bounce.moments,
            self.air.irradiance + factor * self.bounce.irradiance,
        )


def degree_of(node: SpectralNode, quality: Quality) -> int:
    """Return the degree of the moments a node needs."""
    return quality.particle_degree if node.particle_per_m.any() else 2


def solve(
    node: SpectralNode,
    altitude_m: FloatArray,
    planet_m: float,
    sun_table: SunTable,
    quality: Quality,
    progress: Progress | None = None,
) -> MultipleScattering:
    """Return the light scattered more than once in one column of air.

    Parameters
    ----------
    node : SpectralNode
    altitude_m : ndarray, shape (n,)
        Of the node's columns.
    planet_m : float
        Radius of the ground.
    sun_table : SunTable
        Optical depth towards the Sun of this node (width 1).
    quality : Quality
    progress : Progress, optional
    """
    solver = _Solver(node, altitude_m, planet_m, sun_table, quality, progress)
    air = solver.sum_of_orders(solver.scattered_once())
    mu = solver.sun_cosines
    direct = np.maximum(mu, 0.0) * _transmittance(sun_table, np.zeros_like(mu), mu)
    lit = (direct + air.irradiance) / math.pi
    bounce = solver.sum_of_orders(solver.from_ground(lit))
    day = mu > 0.2
    albedo = float(np.sum(bounce.irradiance[day]) / np.sum(math.pi * lit[day]))
    return MultipleScattering(air, bounce, albedo)


def _transmittance(table: SunTable, height_m: FloatArray, mu: FloatArray) -> FloatArray:
    return np.array(table.transmittance(mi.Float64(height_m.ravel()), mi.Float64(mu.ravel()), 1)[0]).reshape(mu.shape)


@dataclass(frozen=True)
class _Field:
    """One order of scattering: moments (n_height, n_sun, n_harmonics) and irradiance (n_sun,)."""

    moments: FloatArray
    irradiance: FloatArray


class _Solver:
    def __init__(
        self,
        node: SpectralNode,
        altitude_m: FloatArray,
        planet_m: float,
        sun_table: SunTable,
        quality: Quality,
        progress: Progress | None = None,
    ) -> None:
        self.node, self.altitude_m, self.planet_m, self.quality = node, altitude_m, planet_m, quality
        self.top_m = float(altitude_m[-1])
        self.degree = degree_of(node, quality)
        self.pairs = pairs(self.degree)
        self.heights = self.top_m * np.linspace(0.0, 1.0, quality.n_height) ** 2
        self.sun_cosines = sun_angle_cosines(quality.n_sun)
        self.sun_table = sun_table
        self.progress = progress or Silent()
        self.tell(1, 1.0)
        q = quality
        self.rays = self._rays(q.n_up, q.n_down, q.n_nodes)
        # odd harmonics of the azimuth up to the degree must survive the sum over azimuths
        self.n_azimuth = max(q.n_azimuth, self.degree + 2)
        self.basis = self.basis_of(self.rays, self.n_azimuth)
        self.passes = _Passes(self, self.rays, self.n_azimuth)

    def tell(self, order: int, share: float) -> None:
        """Tell that an order of scattering is done, and the share of the sum that it added."""
        self.progress.step(f"multiple scattering at {self.node.name}", f"order {order}, adding {share:.1%}")

    def _rays(self, n_up: int, n_down: int, n_nodes: int) -> ShellRays:
        return shell_rays(
            self.altitude_m, self.node.extinction_per_m, self.planet_m, self.heights, n_up, n_down, n_nodes
        )

    def column(self, values: FloatArray, radius_m: FloatArray) -> FloatArray:
        return np.interp(radius_m - self.planet_m, self.altitude_m, values)

    def basis_of(self, rays: ShellRays, n_azimuth: int) -> FloatArray:
        """Return the weights that make moments of radiance, (n_height, n_harmonics, n_direction * n_azimuth)."""
        mu, weight = rays.cosine, rays.solid_angle
        phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
        polar = polar_parts(self.degree, mu, np.sqrt(1.0 - mu**2))
        azimuthal = cosines(self.degree, np.cos(phi))
        basis = np.stack([polar[n, m][..., None] * azimuthal[m] for n, m in self.pairs], axis=1)
        basis *= (weight * (2 * math.pi / n_azimuth))[:, None, :, None]
        return basis.reshape(*basis.shape[:2], -1)

    def moments_of(
        self, radiance: FloatArray, rays: ShellRays, n_azimuth: int, basis: FloatArray | None = None
    ) -> _Field:
        """Return moments of radiance (n_height, n_direction, n_azimuth, n_sun)."""
        if basis is None:
            basis = self.basis_of(rays, n_azimuth)
        n_h, _, _, n_k = radiance.shape
        moments = np.matmul(basis, radiance.reshape(n_h, -1, n_k)).transpose(0, 2, 1)
        down = (rays.solid_angle * np.maximum(rays.cosine, 0.0))[0] * (2 * math.pi / n_azimuth)
        return _Field(moments, down @ radiance[0].sum(axis=1))

    def scattered_once(self) -> _Field:
        q = self.quality
        rays = self._rays(q.first_up, q.n_down, q.first_nodes)
        n_azimuth = max(q.first_azimuth, self.degree + 2)
        return self.moments_of(_single_scattering(self, rays, n_azimuth), rays, n_azimuth)

    def from_ground(self, lit: FloatArray) -> _Field:
        return self.moments_of(_ground_light(self, self.rays, self.n_azimuth, lit), self.rays, self.n_azimuth)

    def sum_of_orders(self, first: _Field) -> DiffuseField:
        total, irradiance = first.moments.copy(), first.irradiance.copy()
        last = first
        for order in range(2, MOST_ORDERS):
            following = self.moments_of(self.passes.apply(last.moments), self.rays, self.n_azimuth, self.basis)
            total += following.moments
            irradiance += following.irradiance
            share = float(np.max(following.moments[..., 0] / np.maximum(total[..., 0], SMALLEST)))
            self.tell(order, share)
            ratio = following.moments[..., 0] / np.maximum(last.moments[..., 0], SMALLEST)
            last = following
            if share < LAST_ORDER:
                break
        rest = np.clip(ratio, 0.0, 0.9)
        total += last.moments * (rest / (1.0 - rest))[..., None]
        irradiance += last.irradiance * rest[0] / (1.0 - rest[0])
        return DiffuseField(self.top_m, self.planet_m, self.degree, total, irradiance)


def _lanes(solver: _Solver, rays: ShellRays, n_azimuth: int) -> tuple[int, ...]:
    return (*rays.cosine.shape, n_azimuth, len(solver.sun_cosines))


def _level_lanes(shape: tuple[int, ...]) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32]:
    """Return height-and-direction, azimuth, Sun angle indices of all lanes; the Sun angle runs fastest."""
    n_h, n_d, n_a, n_k = shape
    lane = dr.arange(mi.UInt32, n_h * n_d * n_a * n_k)
    return lane // (n_a * n_k), (lane // n_k) % n_a, lane % n_k, lane


def _along_sun(mu_s: mi.Float64, mu: mi.Float64, azimuth: mi.Float64) -> mi.Float64:
    """Return the cosine of the angle between ray and Sun."""
    sines = dr.sqrt(dr.maximum(1.0 - mu_s * mu_s, 0.0) * dr.maximum(1.0 - mu * mu, 0.0))
    return mu_s * mu + sines * dr.cos(azimuth)


def _single_scattering(solver: _Solver, rays: ShellRays, n_azimuth: int) -> FloatArray:
    """Return radiance of light scattered once, Float64: the shadow's edge is found to the metre."""
    node = solver.node
    shape = _lanes(solver, rays, n_azimuth)
    ray, azimuth, k, lane = _level_lanes(shape)
    n_nodes = rays.node_radius_m.shape[-1]
    r = rays.node_radius_m
    height = mi.Float64((r - solver.planet_m).ravel())
    radius, distance = mi.Float64(r.ravel()), mi.Float64(rays.node_distance_m.ravel())
    molecular = mi.Float64((rays.node_weight * solver.column(node.molecular_per_m, r)).ravel())
    particle = mi.Float64((rays.node_weight * solver.column(node.particle_per_m, r)).ravel())
    asymmetry = mi.Float64(solver.column(node.asymmetry, r).ravel())
    start = dr.gather(mi.Float64, mi.Float64(np.repeat(rays.radius_m, shape[1])), ray)
    mu_s = dr.gather(mi.Float64, mi.Float64(solver.sun_cosines), k)
    mu = dr.gather(mi.Float64, mi.Float64(rays.cosine.ravel()), ray)
    nu = _along_sun(mu_s, mu, (mi.Float64(azimuth) + 0.5) * (math.pi / n_azimuth))
    cos2 = dr.opaque(mi.Float64, node.molecular_cos2, 1)
    with_particles = bool(node.particle_per_m.any())
    molecules = (1.0 - cos2 / 3.0 + cos2 * nu * nu) * (0.25 / math.pi)

    def body(n: mi.UInt32, radiance: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
        at = ray * n_nodes + n
        r_n = dr.gather(mi.Float64, radius, at)
        h_n = dr.gather(mi.Float64, height, at)
        mu_n = (start * mu_s + dr.gather(mi.Float64, distance, at) * nu) / r_n
        lit = (mu_n > 0.0) | (r_n * r_n * (1.0 - mu_n * mu_n) > solver.planet_m**2)
        emitted = dr.gather(mi.Float64, molecular, at) * molecules
        if with_particles:
            g = dr.gather(mi.Float64, asymmetry, at)
            base = 1.0 + g * g - 2.0 * g * nu
            phase = (1.0 - g * g) / (base * dr.sqrt(base)) * (0.25 / math.pi)
            emitted = emitted + dr.gather(mi.Float64, particle, at) * phase
        emitted = emitted * solver.sun_table.transmittance(h_n, mu_n, 1)[0]
        return n + 1, radiance + dr.select(lit, emitted, 0.0)

    zero = dr.zeros(mi.Float64, dr.width(lane))
    _, radiance = dr.while_loop((mi.UInt32(0), zero), lambda n, _: n < n_nodes, body, label="single scattering")
    return np.array(radiance).reshape(shape)


def _ground_light(solver: _Solver, rays: ShellRays, n_azimuth: int, lit: FloatArray) -> FloatArray:
    """Return radiance that comes straight from a ground of radiance ``lit`` (n_sun,)."""
    shape = _lanes(solver, rays, n_azimuth)
    phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
    mu_s, mu = solver.sun_cosines, rays.cosine[:, :, None, None]
    sines = np.sqrt((1 - mu_s**2) * (1 - mu**2))
    nu = mu_s * mu + sines * np.cos(phi)[:, None]
    at_ground = (rays.radius_m[:, None, None, None] * mu_s + rays.end_m[:, :, None, None] * nu) / solver.planet_m
    position = sun_angle_position(at_ground, len(mu_s))
    value = np.exp(np.interp(position, np.arange(len(mu_s)), np.log(np.maximum(lit, SMALLEST))))
    seen = rays.reaches_ground * rays.end_transmittance
    return np.broadcast_to(value * seen[:, :, None, None], shape)


class _Passes:
    """The march of diffuse light along all rays, prepared once and applied to every order."""

    def __init__(self, solver: _Solver, rays: ShellRays, n_azimuth: int) -> None:
        self.solver, self.rays, self.n_azimuth = solver, rays, n_azimuth
        node, degree = solver.node, solver.degree
        self.n_sun = len(solver.sun_cosines)
        n_height = len(solver.heights)
        position = np.sqrt((rays.node_radius_m - solver.planet_m).clip(0.0) / solver.top_m) * (n_height - 1)
        self.level = np.minimum(position.astype(int), n_height - 2)
        self.level_weight = position - self.level
        molecular = solver.column(node.molecular_per_m, rays.node_radius_m)
        particle = solver.column(node.particle_per_m, rays.node_radius_m)
        asymmetry = solver.column(node.asymmetry, rays.node_radius_m)
        chi = {0: 1.0, 2: 2.0 * node.molecular_cos2 / 15.0}
        polar = polar_parts(degree, rays.node_up, np.sqrt(np.maximum(1.0 - rays.node_up**2, 0.0)))
        scattering = [molecular * chi.get(n, 0.0) + particle * asymmetry**n for n in range(degree + 1)]
        self.weight = rays.node_weight
        self.packets = -(-(degree + 2) // 4)
        # for each order m of the harmonics: which moments, and by which factors they enter at every node
        self.by_order: list[tuple[list[int], FloatArray | None]] = []
        for m in range(degree + 1):
            used = [(p, n) for p, (n, k) in enumerate(solver.pairs) if k == m and scattering[n].any()]
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
        rays, degree, n_sun = self.rays, self.solver.degree, self.n_sun
        n_n = rays.node_radius_m.shape[-1]
        shape = (rays.cosine[part].shape[0], rays.cosine.shape[1], self.n_azimuth, n_sun)
        ray, azimuth, k, lane = _level_lanes(shape)
        radius = mi.Float32(rays.node_radius_m[part].ravel())
        distance = mi.Float32(rays.node_distance_m[part].ravel())
        node_up = mi.Float32(rays.node_up[part].ravel())
        weight = mi.Float32(self.weight[part].ravel())
        start = dr.gather(mi.Float32, mi.Float32(np.repeat(rays.radius_m[part], shape[1])), ray)
        mu_s = dr.gather(mi.Float32, mi.Float32(self.solver.sun_cosines), k)
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
