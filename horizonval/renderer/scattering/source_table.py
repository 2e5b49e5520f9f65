"""The diffuse field as the march reads it: the source it makes at a point of a ray, and the skylight on the ground.

For every node of a batch the moments of :mod:`multiple_scattering` lie side by side in memory: ``ln I_00`` and the
ratios ``I_lm / I_00``, bilinear in height (``h = top x^2``) and Sun angle. With the local zenith as polar axis, the
ray's angle to it and its azimuth from the Sun's side, one lookup gives the source per unit of scattering coefficient
and solar irradiance, of molecules and of particles::

    S_molecules = I_00 Y_00 + chi_2 sum_m Y_2m I_2m,        S_particles = sum_l g^l sum_m Y_lm I_lm

Everything is Float32 in here: 1e-6 of the diffuse light. The tables are made for a sphere; on the ellipsoid they are
read at geodetic height and with the angle between Sun and geodetic vertical.

**Light from the ground** spreads sideways before the air scatters it, by a transfer function over the ground. Over a
ground of reflected flux ``F(x)`` the mean radiance at height z is a convolution of F. For a wave of F with horizontal
wave number k (in a plane-parallel column, scattering isotropic) it obeys, as an amplitude,

    J_k(z) = D_k(z) + sum over z' of s(z') dz' G_k(z, z') J_k(z')
    D_k(z)     = int_0^1 exp(-tau(0, z) / mu) J0(k z sqrt(1 - mu^2) / mu) dmu           straight from the ground
    G_k(z, z') = 1/2 int_0^1 exp(-tau(z, z') / mu) J0(k |z - z'| sqrt(1 - mu^2) / mu) dmu / mu     scattered at z'

with J0 Bessel's function: without air, D is ``exp(-k z)``, the Fourier transform of the solid angle that an element of
ground fills, ``z / (2 pi (x^2 + z^2)^(3/2))``. What is wanted is the ratio to k = 0, ``H_k(z) = J_k(z) / J_0(z)``,
by which the waves of a map of the ground are weakened. The skylight that comes back to the ground is the sum of
``s dz J_k D_k / 2``; its ratio to k = 0 is the other function.

Nothing in here is tuned. Forward scattering of particles counts as none: ``s = molecules + (1 - g) particles``. Light
flatter than the Earth's horizon is left out of D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.special import j0

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import SpectralNode
from horizonval.renderer.planet import dot
from horizonval.renderer.scattering.shells import (
    SMALLEST,
    DiffuseField,
    cosines,
    pairs,
    polar_parts,
    sun_angle_position,
)
from horizonval.renderer.tables import interpolate, table_of
from horizonval.renderer.types import Values, Vec, Vec3, in_single

ROW_STEP_M = 10.0


@dataclass(frozen=True)
class SourceTable:
    """Diffuse fields of a node batch.

    ``moments``: (n_height * n_sun * n_used * width,); ``irradiance``: ``ln`` of that on the ground, (n_sun * width,);
    ``used``: harmonics (l, m) stored, the first is (0, 0); ``row_of_height``: fractional rows at heights
    :data:`ROW_STEP_M` apart, where the fields' heights are not ``top x^2``.
    """

    moments: mi.Float32
    irradiance: mi.Float32
    used: list[tuple[int, int]]
    n_height: int
    n_sun: int
    top_m: float
    width: int
    row_of_height: mi.Float32 | None = None

    @classmethod
    def of(cls, fields: Sequence[DiffuseField], width: int, with_particles: bool) -> SourceTable:
        """Pack the fields of a node batch's nodes; fields of lower degree have zeros above it."""
        first = fields[0]
        n_height, n_sun = first.moments.shape[:2]
        everything = pairs(max(_degree(f) for f in fields))
        used = [(n, m) for n, m in everything if with_particles or n in (0, 2)]
        moments = np.zeros((n_height, n_sun, len(used), width), dtype=np.float32)
        irradiance = np.full((n_sun, width), np.log(SMALLEST), dtype=np.float32)
        for k, field in enumerate(fields):
            total = np.maximum(field.moments[..., 0], SMALLEST)
            moments[..., 0, k] = np.log(total)
            for p, pair in enumerate(used[1:], start=1):
                if pair[0] <= field.degree:
                    moments[..., p, k] = field.moments[..., pairs(field.degree).index(pair)] / total
            irradiance[:, k] = np.log(np.maximum(field.irradiance, SMALLEST))
        return cls(
            table_of(mi.Float32, moments),
            table_of(mi.Float32, irradiance),
            used,
            n_height,
            n_sun,
            first.top_m,
            width,
            None if first.heights is None else _rows(first.heights),
        )

    def log_sources(
        self,
        height_m: mi.Float32,
        normal: Vec3[mi.Float32],
        d: Vec,
        sun: Vec,
        cos2: Values,
        asymmetry: Values | None,
        forward: Values | None = None,
    ) -> list[mi.Float32]:
        """Return ``ln`` of the source per scattering coefficient and irradiance [1/sr].

        Of molecules, then of particles, per node.

        ``height_m``, ``normal``: geodetic height and vertical of the point; ``d``, ``sun``: the ray's direction and
        that to the Sun; ``cos2``, ``asymmetry``: phase functions of the nodes, without ``asymmetry`` no particles;
        ``forward``: share of what particles scatter that goes straight on (:mod:`.forward_peak`).
        """
        degree = self.used[-1][0]
        zenith, ray, light = normal, in_single(d), in_single(sun)
        mu_s, up, nu = dot(zenith, light), dot(zenith, ray), mi.Float32(dot(d, sun))
        sine = dr.sqrt(dr.maximum(1.0 - up * up, 0.0))
        sines = dr.maximum(sine * dr.sqrt(dr.maximum(1.0 - mu_s * mu_s, 0.0)), 1e-5)
        azimuthal = cosines(degree, dr.clip((nu - mu_s * up) / sines, -1.0, 1.0))
        polar = polar_parts(degree, up, sine)
        row, wx, wy = self._locate(height_m, mu_s)
        stored = [self._bilinear(row, p, wx, wy) for p in range(len(self.used))]
        width = self.width
        by_degree: list[list[mi.Float32]] = [[mi.Float32(0.0)] * width for _ in range(degree + 1)]
        by_degree[0] = [polar[0, 0]] * width
        for values, (n, m) in zip(stored[1:], self.used[1:], strict=True):
            shape = polar[n, m] * azimuthal[m]
            by_degree[n] = [dr.fma(shape, v, s) for v, s in zip(values, by_degree[n], strict=True)]
        shapes = [dr.fma(mi.Float32(cos2[k] * (2.0 / 15.0)), by_degree[2][k], by_degree[0][k]) for k in range(width)]
        for k in range(width) if asymmetry is not None else ():
            assert asymmetry is not None
            g = mi.Float32(asymmetry[k])
            total = by_degree[degree][k]
            for n in range(degree - 1, -1, -1):
                total = dr.fma(total, g, by_degree[n][k])
            if forward is not None:
                total = dr.fma(-mi.Float32(forward[k]), sum(by_degree[n][k] for n in range(degree + 1)), total)
            shapes.append(total)
        # cut short, the series may fall below zero where there is next to no light
        return [stored[0][n % width] + dr.log(dr.maximum(shape, 1e-6)) for n, shape in enumerate(shapes)]

    def mean_radiance(self, height_m: mi.Float32, mu_s: mi.Float32) -> list[mi.Float32]:
        """Return the mean diffuse radiance per unit solar irradiance, per node; of no unit that counts."""
        row, wx, wy = self._locate(height_m, mu_s)
        return [dr.exp(v) for v in self._bilinear(row, 0, wx, wy)]

    def ground_irradiance(self, mu_s: mi.Float64) -> Values:
        """Return the diffuse irradiance on level ground per unit solar irradiance, per node."""
        x = sun_angle_position(mi.Float32(mu_s), self.n_sun)
        j = dr.minimum(mi.UInt32(x), self.n_sun - 2)
        values = interpolate(self.irradiance, j, x - mi.Float32(j), self.width)
        return [mi.Float64(dr.exp(v)) for v in values]

    def _locate(self, height_m: mi.Float32, mu_s: mi.Float32) -> tuple[mi.UInt32, mi.Float32, mi.Float32]:
        if self.row_of_height is None:
            x = dr.sqrt(dr.clip(height_m * (1.0 / self.top_m), 0.0, 1.0)) * (self.n_height - 1)
        else:
            steps = dr.clip(height_m, 0.0, self.top_m) * (1.0 / ROW_STEP_M)
            k = dr.minimum(mi.UInt32(steps), int(self.top_m / ROW_STEP_M) - 1)
            low, high = (dr.gather(mi.Float32, self.row_of_height, k + j) for j in (0, 1))
            x = dr.fma(high - low, steps - mi.Float32(k), low)
        y = sun_angle_position(mu_s, self.n_sun)
        i = dr.minimum(mi.UInt32(x), self.n_height - 2)
        j = dr.minimum(mi.UInt32(y), self.n_sun - 2)
        return i * self.n_sun + j, x - mi.Float32(i), y - mi.Float32(j)

    def _bilinear(self, row: mi.UInt32, p: int, wx: mi.Float32, wy: mi.Float32) -> list[mi.Float32]:
        used = len(self.used)

        def at(r: mi.UInt32) -> list[mi.Float32]:
            return interpolate(self.moments, r * used + p, wy, self.width, stride=used)

        near, far = at(row), at(row + self.n_sun)
        return [dr.fma(b - a, wx, a) for a, b in zip(near, far, strict=True)]


def _degree(field: DiffuseField) -> int:
    """Return the highest degree of which a field has any light, 2 at least: the light from the ground has few."""
    lit = np.any(field.moments != 0.0, axis=(0, 1))
    return max([2, *(pair[0] for pair, any_light in zip(pairs(field.degree), lit, strict=True) if any_light)])


def _rows(heights: FloatArray) -> mi.Float32:
    z = ROW_STEP_M * np.arange(int(heights[-1] / ROW_STEP_M) + 1)
    return table_of(mi.Float32, np.interp(z, heights, np.arange(len(heights))))


LEVELS_M = (700.0, 2000.0, 5000.0, 12_000.0, 30_000.0)
"""Heights at which the light is wanted; between them it is linear in the logarithm of the height."""
WAVE_NUMBERS_PER_M = np.concatenate([[0.0], np.geomspace(1e-6, 5e-4, 18)])
_EDGES_M = np.concatenate([[0.0], np.geomspace(400.0, 60e3, 22)])
_COSINES = 48
_FLATTEST = 0.004
_EARTH_M = 6.371e6


@dataclass(frozen=True)
class HorizontalTransfer:
    """Transfer functions of a column, 1 at wave number 0: ``air`` at the levels, shape (levels, k), and ``sky``."""

    air: FloatArray
    sky: FloatArray

    @classmethod
    def of(cls, node: SpectralNode, altitude_m: FloatArray) -> HorizontalTransfer:
        """Solve the equation of the module text for a column."""
        z, mu, weight = _heights(), *_cosines()
        width = np.diff(_EDGES_M)
        sideways = node.scattering_per_m - node.particle_per_m * np.clip(node.asymmetry, 0.0, 1.0)
        # a forward peak may be out of the extinction, but not of the scattering
        peak = node.forward_per_m if len(node.forward_per_m) else 0.0
        absorption = np.maximum(node.extinction_per_m - node.scattering_per_m + peak, 0.0)
        scattering = np.interp(z, altitude_m, sideways, right=0.0)
        fine = np.linspace(0.0, _EDGES_M[-1], 1201)
        k = np.interp(fine, altitude_m, absorption + sideways, right=0.0)
        depth = np.concatenate([[0.0], np.cumsum(0.5 * (k[1:] + k[:-1]) * np.diff(fine))])
        tau, tau_edge = np.interp(z, fine, depth), np.interp(_EDGES_M, fine, depth)
        levels = np.array(LEVELS_M)
        tau_level = np.interp(levels, fine, depth)

        def direct(height: FloatArray, depth: FloatArray) -> FloatArray:
            seen = mu > np.sqrt(height / (2.0 * _EARTH_M))[:, None]
            through = np.exp(-depth[:, None] / mu) * weight * mu * seen
            return np.einsum("im,imk->ik", through, _waves(height, np.zeros(1))[:, 0])

        def scattered(height: FloatArray, depth: FloatArray) -> FloatArray:
            through = 0.5 * np.exp(-np.abs(depth[:, None] - tau)[..., None] / mu) * weight
            return np.einsum("ijm,ijmk->ijk", through, _waves(height, z)) * (scattering * width)[:, None]

        ground = direct(z, tau)
        between = scattered(z, tau)
        # within a layer: the chance that isotropic light of it meets it again, shared as its scattering is
        own = np.diff(tau_edge)
        meets = 1.0 - (0.5 - _e3(own)) / np.maximum(own, 1e-12)
        meets = np.where(own > 1e-6, meets, 0.0) * scattering * width / np.maximum(own, 1e-12)
        same = np.arange(len(z))
        between[same, same] = meets[:, None]
        system = np.eye(len(z)) - between.transpose(2, 0, 1)
        inside = np.linalg.solve(system, ground.T[..., None])[..., 0].T
        at_levels = direct(levels, tau_level) + np.einsum("ijk,jk->ik", scattered(levels, tau_level), inside)
        sky = np.einsum("i,ik,ik->k", scattering * width, inside, ground)
        sky_scale = sky[0] if sky[0] > 0.0 else 1.0
        return cls(at_levels / at_levels[:, :1], sky / sky_scale)


def _heights() -> FloatArray:
    return np.asarray(0.5 * (_EDGES_M[1:] + _EDGES_M[:-1]))


@cache
def _cosines() -> tuple[FloatArray, FloatArray]:
    """Return cosines and their weights in ``d ln mu``."""
    x, w = np.polynomial.legendre.leggauss(_COSINES)
    reach = -np.log(_FLATTEST)
    return np.exp(-0.5 * reach * (1.0 - x)), 0.5 * reach * w


def _waves(height: FloatArray, other: FloatArray) -> FloatArray:
    """Return J0 of the module text, shape (heights, others, cosines, wave numbers)."""
    return _waves_between(tuple(height.tolist()), tuple(other.tolist()))


@cache
def _waves_between(height: tuple[float, ...], other: tuple[float, ...]) -> FloatArray:
    mu = _cosines()[0]
    slope = np.sqrt(1.0 - mu**2) / mu
    apart = np.abs(np.array(height)[:, None] - np.array(other))
    waves = j0(apart[..., None, None] * slope[:, None] * WAVE_NUMBERS_PER_M)
    waves.setflags(write=False)
    return waves


def _e3(x: FloatArray) -> FloatArray:
    """Return the exponential integral of third order."""
    mu, w = _cosines()
    return np.asarray(np.sum(w * mu**2 * np.exp(-x[..., None] / mu), axis=-1))
