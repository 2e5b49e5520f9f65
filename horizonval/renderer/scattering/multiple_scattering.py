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

**One pass** is in :mod:`.diffuse_march`. Everything that spans decades in twilight is interpolated as ``ln I_00`` and
ratios to it.

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

import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress, Silent
from horizonval.earth.column import SpectralNode
from horizonval.renderer.scattering.diffuse_field import SMALLEST, DiffuseField, MultipleScattering
from horizonval.renderer.scattering.diffuse_march import DiffuseMarch
from horizonval.renderer.scattering.first_order import ground_light, single_scattering
from horizonval.renderer.scattering.harmonics import cosines, polar_parts
from horizonval.renderer.scattering.quality import Quality
from horizonval.renderer.scattering.shell_column import ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.tables import SunTable

LAST_ORDER = 2e-3
"""Orders are summed one by one until one adds less than this share anywhere; the geometric rest is then 1e-5."""
MOST_ORDERS = 60


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
        self.column = ShellColumn(node, altitude_m, planet_m, sun_table, quality)
        self.sun_cosines = self.column.sun_cosines
        self.progress = progress or Silent()
        self.tell(1, 1.0)
        q, degree = quality, self.column.degree
        self.rays = self.column.rays(q.n_up, q.n_down, q.n_nodes)
        # odd harmonics of the azimuth up to the degree must survive the sum over azimuths
        self.n_azimuth = max(q.n_azimuth, degree + 2)
        self.basis = self.basis_of(self.rays, self.n_azimuth)
        self.passes = DiffuseMarch(self.column, self.rays, self.n_azimuth)

    def tell(self, order: int, share: float) -> None:
        """Tell that an order of scattering is done, and the share of the sum that it added."""
        self.progress.step(f"multiple scattering at {self.column.node.name}", f"order {order}, adding {share:.1%}")

    def basis_of(self, rays: ShellRays, n_azimuth: int) -> FloatArray:
        """Return the weights that make moments of radiance, (n_height, n_harmonics, n_direction * n_azimuth)."""
        mu, weight = rays.cosine, rays.solid_angle
        phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
        polar = polar_parts(self.column.degree, mu, np.sqrt(1.0 - mu**2))
        azimuthal = cosines(self.column.degree, np.cos(phi))
        basis = np.stack([polar[n, m][..., None] * azimuthal[m] for n, m in self.column.pairs], axis=1)
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
        q = self.column.quality
        rays = self.column.rays(q.first_up, q.n_down, q.first_nodes)
        n_azimuth = max(q.first_azimuth, self.column.degree + 2)
        return self.moments_of(single_scattering(self.column, rays, n_azimuth), rays, n_azimuth)

    def from_ground(self, lit: FloatArray) -> _Field:
        return self.moments_of(ground_light(self.column, self.rays, self.n_azimuth, lit), self.rays, self.n_azimuth)

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
        return DiffuseField(self.column.top_m, self.column.planet_m, self.column.degree, total, irradiance)
