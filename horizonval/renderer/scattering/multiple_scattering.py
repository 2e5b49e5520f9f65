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
a dense layer with sharp edges 1.5 % (``FINE``: 0.7 %). LOWTRAN7's background, the Sun 5 to 12 deg below the horizon,
450 and 850 nm: 2.4 % at worst, 0.6 % rms; after a large eruption (``LAYERED``, 850 nm) 4.6 % looking away from the
Sun, 2.3 % rms in all, of which 1 % is the Monte Carlo's noise. On the ellipsoid, read at geodetic height, 0.5 % against
Monte Carlo over WGS84, which is its noise.

High moments are kept of the light that was scattered once or twice; of what follows, and of what the ground sends,
those up to ``later_degree``: a third of the time, 0.1 % by day and at most 1 % more in the dark rays of twilight.

Neglected: polarisation (1 % of radiance at 90 deg from the Sun), refraction, horizontal change of the air; for a ground
that varies the two parts are kept apart (:mod:`horizonval.renderer.local_light.ground_light`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress, Silent
from horizonval.earth.column import SpectralNode
from horizonval.renderer.scattering.diffuse_field import SMALLEST, DiffuseField, MultipleScattering
from horizonval.renderer.scattering.diffuse_march import DiffuseMarch
from horizonval.renderer.scattering.first_order import ground_light, single_scattering
from horizonval.renderer.scattering.harmonics import cosines, pairs, polar_parts
from horizonval.renderer.scattering.quality import Quality
from horizonval.renderer.scattering.shell_column import SOLVED_TOGETHER, ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.tables import SunTable, table_of

LAST_ORDER = 1e-2
"""Orders are summed one by one until one adds less than this share anywhere. The geometric rest is then right to 3e-6
until the Sun is 8 deg below the horizon, and to 2e-4 of the light beyond."""
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

    A column's solution has the same bits with whatever others it is solved.

    Parameters
    ----------
    nodes : sequence of SpectralNode
        1 to ``SOLVED_TOGETHER``.
    altitude_m : ndarray, shape (n,)
        Of the nodes' columns.
    planet_m : float
        Radius of the ground.
    sun_table : SunTable
        Optical depths towards the Sun of the nodes, ``SOLVED_TOGETHER`` wide.
    quality : Quality
    progress : Progress, optional
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
    """What makes moments of radiance along the rays of a geometry, up to a degree.

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
    def of(cls, columns: Sequence[ShellColumn], rays: Sequence[ShellRays], degree: int) -> _Pass:
        """Prepare one for moments up to a degree."""
        # odd harmonics of the azimuth up to the degree must survive the sum over azimuths
        n_azimuth = max(columns[0].quality.n_azimuth, degree + 2)
        return cls(DiffuseMarch(columns, rays, n_azimuth, degree), _Basis(rays[0], n_azimuth, degree))


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
        self.second = _Pass.of(self.columns, self.rays, degree)
        later = min(q.later_degree, degree)
        self.later = self.second if later == degree else _Pass.of(self.columns, self.rays, later)

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
            light = one.march.apply([column.last.moments for column in sums])
            for column, radiance in zip(sums, light, strict=True):
                if not column.complete:
                    column.add(one.basis.field(radiance))
            self.tell(order, max(column.share for column in sums))
            if all(column.complete for column in sums):
                break
        return [s.field(column) for s, column in zip(sums, self.columns, strict=True)]
