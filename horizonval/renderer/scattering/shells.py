"""Straight rays through a spherical shell from every height in every direction: the fixed geometry of skylight.

A ray from radius ``r0`` with the cosine ``mu`` of its angle to the zenith depends on neither the Sun nor the azimuth,
so that its nodes, extinction and slopes are found once. With the impact parameter ``b = r0 sqrt(1 - mu^2)`` and a ray
parameter y::

    r = r_b + D y^2,       s = +-sqrt((r_b - b + D y^2) (r + b)),       ds/dy = 2 r D y / s

    up        mu >= 0           r_b = r0, D = r_top - r0, y from 0 to 1
    limb      mu_h < mu < 0     r_b = b,  D = r_top - b,  y from -sqrt((r0 - b) / D) to 1
    ground    mu <= mu_h        r_b = R,  D = r0 - R,     y from -1 to 0

``s`` is counted from the point nearest to the centre. The form is regular at tangent points and dense where the air is.
``r_b - b`` is carried on its own (``r0 mu^2 / (1 + sqrt(1 - mu^2))`` for rays going up): the difference of the two
radii cancels for level rays. ``mu_h`` is the cosine of the geometric horizon; directions are split there, cubed above
it and squared below, because the sky changes fastest just above the horizon.

**Harmonics.** The diffuse field of a spherical shell is symmetric about the plane that holds the local vertical and the
Sun, so that only the cosine harmonics are needed. With the polar axis up, the azimuth counted from the Sun's side, c
the cosine of the polar angle theta and the orthonormal associated Legendre functions P_lm (without Condon and
Shortley's phase)::

    Y_l0 = P_l0(c),        Y_lm = sqrt(2) P_lm(c) cos(m phi)

    P_mm = sqrt((2 m + 1) / (2 m)) sin(theta) P_(m-1)(m-1),          P_00 = sqrt(1 / (4 pi))
    P_lm = sqrt((4 l^2 - 1) / (l^2 - m^2)) (c P_(l-1)m - sqrt(((l-1)^2 - m^2) / (4 (l-1)^2 - 1)) P_(l-2)m)

The recurrences hold for numpy and Dr.Jit arrays alike. Source: Holmes and Featherstone, J. Geodesy 76, 279 (2002),
eqs. 11 to 13, rescaled to unit norm over the sphere.

**Sun angles** are dense where day turns into night. With ``u`` uniform between its ends, ``mu_s = -0.05 + 0.1 sinh(u)``
runs from -0.40 (Sun 23.6 deg below the horizon) to 1: 0.3 deg at the terminator for 96 points, 3 deg with the Sun
overhead.

**Forward peaks of thin cloud** count as not scattered, because a cut series of moments cannot hold them: Wiscombe's
delta-M method (J. Atmos. Sci. 34, 1408 (1977)). A phase function of asymmetry g has the moments ``g^l``; of those up to
a degree N the share ``f = g^(N + 1)`` is a peak straight ahead::

    k' = k - f k_s,        source of light scattered before: k_s (g^l - f) for l <= N

Light scattered once keeps its phase function, with the smaller extinction towards the Sun and the camera (TMS; Nakajima
and Tanaka, J. Quant. Spectrosc. Radiat. Transf. 40, 51 (1988)). Seen through such a layer the Sun's disc is brighter by
``exp(f tau)``: it holds light that a real one has within a few degrees around it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.layers import merged_bands
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.renderer.types import Number


@dataclass(frozen=True)
class ShellRays:
    """Rays from ``n_r`` radii in ``n_d`` polar directions with ``n_n`` nodes each.

    ``radius_m``: (n_r,). Of the directions, (n_r, n_d): ``cosine`` to the zenith, ``solid_angle`` per radian of
    azimuth, ``reaches_ground``, and ``end_m``, ``end_transmittance``: distance and transmittance to the ground or top.
    Of the nodes, (n_r, n_d, n_n): ``node_radius_m``, ``node_distance_m`` from the origin, ``node_up``: the ray's cosine
    to the zenith, ``node_weight`` of emission per metre: the step times the transmittance from the origin.
    """

    radius_m: FloatArray
    cosine: FloatArray
    solid_angle: FloatArray
    reaches_ground: NDArray[np.bool_]
    end_m: FloatArray
    end_transmittance: FloatArray
    node_radius_m: FloatArray
    node_distance_m: FloatArray
    node_up: FloatArray
    node_weight: FloatArray


def polar_directions(height_m: FloatArray, planet_m: float, n_up: int, n_down: int) -> tuple[FloatArray, FloatArray]:
    """Return cosines and weights of polar directions, shape (n_r, n_up + n_down), from just above the horizon on."""
    horizon = -np.sqrt(height_m * (2 * planet_m + height_m)) / (planet_m + height_m)
    x, w = (v / 2 for v in np.polynomial.legendre.leggauss(n_up))
    x = x + 0.5
    above = horizon[:, None] + (1 - horizon[:, None]) * x**3
    above_weight = (1 - horizon[:, None]) * 3 * x**2 * w
    x, w = (v / 2 for v in np.polynomial.legendre.leggauss(n_down))
    x = x + 0.5
    below = horizon[:, None] - (1 + horizon[:, None]) * x**2
    below_weight = (1 + horizon[:, None]) * 2 * x * w
    return np.concatenate([above, below], axis=1), np.concatenate([above_weight, below_weight], axis=1)


def shell_rays(
    altitude_m: FloatArray,
    extinction_per_m: FloatArray,
    planet_m: float,
    height_m: FloatArray,
    n_up: int,
    n_down: int,
    n_nodes: int,
    bands: Sequence[tuple[float, float]] = (),
) -> ShellRays:
    """Return the rays of a shell with extinction linear in altitude.

    ``altitude_m``, ``extinction_per_m``, (n,): from the ground to the top; ``planet_m``: radius of the ground;
    ``height_m``, (n_r,): where rays start, the ground included; ``n_up``, ``n_down``, ``n_nodes``: directions above and
    below the horizon, nodes on every ray, with ``bands`` about twice as many; ``bands``: heights of sharp layers,
    rising, at whose edges rays are cut into pieces with separate nodes.
    """
    top = planet_m + altitude_m[-1]
    cosine, solid_angle = polar_directions(height_m, planet_m, n_up, n_down)
    mu = cosine
    r0 = np.broadcast_to((planet_m + height_m)[:, None], mu.shape)
    impact = r0 * np.sqrt(1 - mu**2)
    up = mu >= 0
    ground = np.broadcast_to(np.arange(mu.shape[1]) >= n_up, mu.shape)
    base = np.where(up, r0, np.where(ground, planet_m, impact))
    gap = np.where(up, r0 * mu**2 / (1 + np.sqrt(1 - mu**2)), np.where(ground, planet_m - impact, 0.0))
    depth = np.where(ground, r0 - planet_m, top - base)
    limb_start = -np.sqrt(np.maximum(r0 - impact, 0.0) / np.maximum(top - impact, 1e-9))
    y0 = np.where(up, 0.0, np.where(ground, -1.0, limb_start))
    y1 = np.where(ground, 0.0, 1.0)

    def place(y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return radius, distance from the lowest point and ds/dy; ``y`` has one axis more than the directions."""
        b, g, d = impact[..., None], gap[..., None], depth[..., None]
        r = base[..., None] + d * y**2
        s_abs = np.sqrt(np.maximum((g + d * y**2) * (r + b), 0.0))
        slope = np.where(s_abs > 0, 2 * r * d * np.abs(y) / np.where(s_abs > 0, s_abs, 1.0), 0.0)
        # level rays at y = 0: the limit of the quotient
        slope = np.where((s_abs <= 0) & (g == 0), 2 * r * np.sqrt(d / (r + b)), slope)
        return r, np.where((y < 0) | ground[..., None], -s_abs, s_abs), slope

    def extinction(r: FloatArray) -> FloatArray:
        return np.interp(r - planet_m, altitude_m, extinction_per_m)

    edge_m = [height for band in bands for height in band]
    reach = [np.sqrt(np.maximum(planet_m + height - base, 0.0) / np.maximum(depth, 1e-9)) for height in edge_m]
    cuts = np.stack([y0, *(np.clip(-v, y0, y1) for v in reversed(reach)), *(np.clip(v, y0, y1) for v in reach), y1], -1)
    pieces = cuts.shape[-1] - 1
    x, w = np.polynomial.legendre.leggauss(n_nodes if pieces == 1 else -(-2 * n_nodes // pieces))
    halves = 0.5 * np.diff(cuts, axis=-1)
    inner = 0.5 * (cuts[..., 1:] + cuts[..., :-1])[..., None] + halves[..., None] * x
    edges = np.concatenate([cuts[..., :-1, None], inner], axis=-1).reshape(*mu.shape, -1)
    edges = np.concatenate([edges, y1[..., None]], axis=-1)
    y, half, w = inner.reshape(*mu.shape, -1), np.repeat(halves, len(x), axis=-1), np.tile(w, pieces)
    tau = np.cumsum(_optical_depth(edges, place, extinction), axis=-1)
    end_tau = tau[..., -1]
    tau = tau[..., np.arange(tau.shape[-1]) % (len(x) + 1) != len(x)]
    r, s, slope = place(y)
    start = place(y0[..., None])[1]
    # a ray straight up from the ground has s = r0 mu at its start, not 0
    start = np.where(up[..., None], (r0 * mu)[..., None], start)
    weight = w * half * slope * np.exp(-tau)
    end = place(y1[..., None])[1] - start
    return ShellRays(
        planet_m + height_m,
        cosine,
        solid_angle,
        ground,
        end[..., 0],
        np.exp(-end_tau),
        r,
        s - start,
        s / r,
        weight,
    )


def _optical_depth(
    edges: FloatArray,
    place: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
    extinction: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return the optical depth between neighbouring edges, two 4-point Gauss rules each."""
    x, w = np.polynomial.legendre.leggauss(4)
    x = np.concatenate([0.25 + 0.25 * x, 0.75 + 0.25 * x])
    w = np.concatenate([w, w]) / 4
    low, width = edges[..., :-1, None], np.diff(edges, axis=-1)[..., None]
    y = low + width * x
    shape = y.shape
    r, _, slope = place(y.reshape(*shape[:-2], -1))
    return np.sum((extinction(r) * slope).reshape(shape) * width * w, axis=-1)


def pairs(degree: int) -> list[tuple[int, int]]:
    """Return ``(l, m)`` of all harmonics up to a degree, in the order they are stored."""
    return [(n, m) for n in range(degree + 1) for m in range(n + 1)]


def polar_parts(degree: int, cosine: Number, sine: Number) -> dict[tuple[int, int], Number]:
    """Return the harmonics without ``cos(m phi)``, by ``(l, m)``; ``sine >= 0``."""
    p: dict[tuple[int, int], Number] = {(0, 0): cosine * 0.0 + math.sqrt(0.25 / math.pi)}
    for m in range(1, degree + 1):
        p[m, m] = math.sqrt((2 * m + 1) / (2 * m)) * sine * p[m - 1, m - 1]
    for m in range(degree + 1):
        for n in range(m + 1, degree + 1):
            value = cosine * p[n - 1, m]
            if n - 2 >= m:
                value = value - math.sqrt(((n - 1) ** 2 - m**2) / (4 * (n - 1) ** 2 - 1)) * p[n - 2, m]
            p[n, m] = math.sqrt((4 * n**2 - 1) / (n**2 - m**2)) * value
    return {(n, m): v if m == 0 else math.sqrt(2.0) * v for (n, m), v in p.items()}


def cosines(degree: int, cosine: Number) -> list[Number]:
    """Return ``cos(m phi)`` for m from 0 to ``degree`` by Chebyshev's recurrence, from ``cos(phi)``."""
    out = [cosine * 0.0 + 1.0, cosine]
    while len(out) <= degree:
        out.append(2.0 * cosine * out[-1] - out[-2])
    return out[: degree + 1]


Mu = TypeVar("Mu", FloatArray, "mi.Float32", "mi.Float64")

SUN_LOWEST = -0.40
_MIDDLE, _SCALE = -0.05, 0.1
_FIRST = math.asinh((SUN_LOWEST - _MIDDLE) / _SCALE)
_LAST = math.asinh((1.0 - _MIDDLE) / _SCALE)


def sun_angle_cosines(count: int) -> FloatArray:
    """Return the cosines of the Sun's zenith angle, shape (count,), rising."""
    mu = _MIDDLE + _SCALE * np.sinh(np.linspace(_FIRST, _LAST, count))
    mu[0], mu[-1] = SUN_LOWEST, 1.0
    return mu


def sun_angle_position(mu: Mu, count: int) -> Mu:
    """Return the fractional index of cosines (numpy or Dr.Jit); beyond the ends they count as the ends."""
    x = (mu - _MIDDLE) / _SCALE
    scale = (count - 1) / (_LAST - _FIRST)
    if isinstance(mu, np.ndarray):
        return np.clip((np.arcsinh(x) - _FIRST) * scale, 0.0, count - 1)
    size = dr.abs(x)
    u = dr.mulsign(dr.log(size + dr.sqrt(dr.fma(size, size, 1.0))), x)
    return dr.clip((u - _FIRST) * scale, 0.0, count - 1)


@dataclass(frozen=True)
class Quality:
    """Resolution of the tables and of the quadratures behind them.

    ``n_*``: heights, Sun angles; directions above and below the horizon, azimuths in half a turn and nodes on a ray;
    ``first_*`` the same for the light scattered once, which contains the shadow's edge and the aureole.
    ``particle_degree``: of the moments where there are particles, for light scattered once or twice;
    ``later_degree``: for light scattered more often or reflected at the ground, which has no narrow features.
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
    later_degree: int


STANDARD = Quality(24, 128, 20, 4, 6, 24, 28, 10, 64, 8, 4)
"""For images. Molecules at 450 to 850 nm, against a table of far higher resolution: at most 0.06 % of the radiance with
the Sun up, 0.3 % until it is 8 deg below the horizon, 0.8 % (850 nm: 3 %) until 18 deg."""

FINE = Quality(32, 160, 24, 4, 8, 48, 32, 16, 96, 12, 6)
"""For single rays: 0.02 %, 0.3 % and 0.4 % (850 nm: 1.1 %)."""


LAYERED = replace(STANDARD, n_down=10, particle_degree=12, later_degree=6, first_azimuth=16)
"""For images with layers of thin cloud, which scatter forward: the high moments need more directions downwards."""

_DENSE_STRATOSPHERE = 0.015
"""Optical depth of particles above 12 km: half of it in a quiet stratosphere, twice and more after an eruption."""
_STRATOSPHERE_M = 12_000.0


def for_images(model: OpticalModel) -> Quality:
    """Return the resolution that images of a model need.

    A stratosphere full of particles needs the higher moments after sunset, too: light from the Sun over the horizon
    is scattered straight back, where moments up to the eighth leave 5 to 7 % too much at 850 nm.
    """
    if model.layers:
        return LAYERED
    above = model.altitude_m >= _STRATOSPHERE_M
    depth = max(
        (float(np.trapezoid(n.particle_per_m[above], model.altitude_m[above])) for n in model.nodes), default=0.0
    )
    return LAYERED if depth > _DENSE_STRATOSPHERE else STANDARD


MOLECULAR_DEGREE = 2
"""Of the moments that molecules scatter by."""


def degree_of(node: SpectralNode, quality: Quality) -> int:
    """Return the degree of the moments a node needs."""
    return quality.particle_degree if node.particle_per_m.any() else MOLECULAR_DEGREE


SOLVED_TOGETHER = 4
"""Columns per launch: they share the geometry of all rays. Always as many, so that one compiled kernel serves all."""


@dataclass(frozen=True)
class ShellColumn:
    """A column (n,) over a spherical ground of radius ``planet_m``."""

    node: SpectralNode
    altitude_m: FloatArray
    planet_m: float
    quality: Quality

    @property
    def top_m(self) -> float:
        """Vacuum above."""
        return float(self.altitude_m[-1])

    @property
    def degree(self) -> int:
        """Degree of the moments."""
        return degree_of(self.node, self.quality)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(l, m)`` of the moments."""
        return pairs(self.degree)

    @cached_property
    def bands(self) -> list[tuple[float, float]]:
        """Heights of layers of thin cloud with their softened edges, rising, without overlaps."""
        return layer_bands(self.node, self.altitude_m)

    @cached_property
    def heights(self) -> FloatArray:
        """Heights of the field, shape (n_height,)."""
        return field_heights(self.top_m, self.quality.n_height, self.bands)

    @cached_property
    def sun_cosines(self) -> FloatArray:
        """Cosines of the Sun's zenith angle of the field, shape (n_sun,)."""
        return sun_angle_cosines(self.quality.n_sun)

    def at(self, values: FloatArray, radius_m: FloatArray) -> FloatArray:
        """Return a column's values at radii."""
        return np.interp(radius_m - self.planet_m, self.altitude_m, values)

    def rays(self, n_up: int, n_down: int, n_nodes: int) -> ShellRays:
        """Return rays from every height in every polar direction."""
        return shell_rays(
            self.altitude_m, self.node.extinction_per_m, self.planet_m, self.heights, n_up, n_down, n_nodes, self.bands
        )


HEIGHTS_IN_LAYER = 13
"""Dense towards a layer's edges: a dense one is seen from the side by its outermost hundred metres."""


def layer_bands(node: SpectralNode, altitude_m: FloatArray) -> list[tuple[float, float]]:
    """Return the heights between which a node's layers are, rising, without overlaps."""
    bands = []
    for column in node.layer_per_m:
        inside = np.nonzero(column > 0.0)[0]
        if len(inside):
            last = len(altitude_m) - 1
            bands.append((float(altitude_m[max(inside[0] - 1, 0)]), float(altitude_m[min(inside[-1] + 1, last)])))
    return merged_bands(bands, 0.0)


def field_heights(top_m: float, n_height: int, bands: Sequence[tuple[float, float]] = ()) -> FloatArray:
    """Return the heights of a field: even in their roots, and :data:`HEIGHTS_IN_LAYER` in each sharp layer."""
    heights = top_m * np.linspace(0.0, 1.0, n_height) ** 2
    for base, top in bands:
        near = 0.1 * (top - base)
        outside = (heights < base - near) | (heights > top + near) | (heights == 0.0) | (heights == top_m)
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, HEIGHTS_IN_LAYER))
        heights = np.union1d(heights[outside], base + (top - base) * share)
    return heights


SMALLEST = 1e-30
"""Light below it counts as none: everything is interpolated as a logarithm."""


@dataclass(frozen=True)
class DiffuseField:
    """Moments of diffuse light on heights ``top x^2`` and the angles of ``sun_angles``, per unit solar irradiance.

    ``moments``, (n_height, n_sun, n_harmonics): ``I_lm`` in the order of :func:`harmonics.pairs`; ``irradiance``,
    (n_sun,): diffuse, on the ground; ``heights``, (n_height,): where they differ from ``top x^2``.
    """

    top_m: float
    planet_m: float
    degree: int
    moments: FloatArray
    irradiance: FloatArray
    heights: FloatArray | None = None


@dataclass(frozen=True)
class MultipleScattering:
    """What :func:`solve` returns: the air alone, one reflection at a ground of albedo 1, and the air's albedo s."""

    air: DiffuseField
    bounce: DiffuseField
    spherical_albedo: float

    def over_ground(self, albedo: float) -> DiffuseField:
        """Return the field over a Lambert ground."""
        factor = albedo / (1.0 - albedo * self.spherical_albedo)
        return replace(
            self.air,
            moments=self.air.moments + factor * self.bounce.moments,
            irradiance=self.air.irradiance + factor * self.bounce.irradiance,
        )


def without_peaks(model: OpticalModel, degree: int) -> OpticalModel:
    """Return a model whose layers scatter straight on what moments of a degree do not hold."""
    if not model.layers:
        return model
    return replace(model, nodes=tuple(_without_peak(node, degree) for node in model.nodes))


def _without_peak(node: SpectralNode, degree: int) -> SpectralNode:
    if not len(node.layer_per_m):
        return node
    share = [w * g ** (degree + 1) for w, g in zip(node.layer_albedo, node.layer_asymmetry, strict=True)]
    forward = np.array(share)[:, None] * node.layer_per_m
    total = forward.sum(axis=0)
    # what scatters stays as much, of less extinction
    albedo = tuple(w / (1.0 - f) for w, f in zip(node.layer_albedo, share, strict=True))
    return replace(
        node,
        extinction_per_m=node.extinction_per_m - total,
        layer_per_m=node.layer_per_m - forward,
        layer_albedo=albedo,
        forward_per_m=total,
    )
