"""Scattered sunlight in the air of a node batch along rays.

It carries two things from step to step: the light scattered more than once, and with refraction the bending angle of
the ray. Light scattered more than once is smooth and expensive: it is read at every second step's end, and its
logarithm is a parabola through three of these values.

**Refraction** makes no bent rays: the columns are those of :mod:`horizonval.renderer.refraction`, in
which light goes straight; the bending angle is summed with the optical depth and turns the Sun instead. Light
scattered more than once is that of air without refraction, at the true height and under the true Sun.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.node_batches import Beam, Place, SolarNodes
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.planet import GAUSS_LOW, AirPath, Planet, along, dot, umbra
from horizonval.renderer.refraction import BentRay, RefractionTables, bending_over_step, refracted_umbra
from horizonval.renderer.tables import interpolate
from horizonval.renderer.types import Values, Vec

State: TypeAlias = "tuple[list[mi.Float32], mi.Float64 | None]"
"""What is carried from step to step: ``ln`` of the diffuse source, and the bending angle."""

STEPS, LOOKUPS = 4, 2
"""Steps of a round, which share lookups of the diffuse source: at their first point, and these more, even in t."""


@dataclass(frozen=True)
class DiffuseAlong:
    """The diffuse source along a round of steps that begins at ``start``, ``1 / per_m`` long.

    ``looked``: ``ln`` of it at the beginning, in the middle and at the end; empty for none.
    """

    start: mi.Float64
    per_m: mi.Float64
    looked: list[list[mi.Float32]]

    def at(self, t: mi.Float64) -> Values:
        """Return the diffuse source at ray parameters."""
        share = mi.Float32((t - self.start) * self.per_m)
        return [
            mi.Float64(dr.exp(dr.fma(dr.fma(2.0 * (a - 2.0 * b + c), share, 4.0 * b - 3.0 * a - c), share, a)))
            for a, b, c in zip(*self.looked, strict=True)
        ]


@dataclass(frozen=True)
class Point:
    """A Gauss point of a step: its bending angle, and the diffuse source."""

    bending: mi.Float64 | None = None
    diffuse: Values = field(default_factory=list)


@dataclass(frozen=True)
class SunlitRays:
    """Rays through sunlit air. ``bent``: with refraction.

    ``molecular``: irradiance times the molecules' phase function; the scattering angle is constant along a straight
    ray.
    """

    batch: SolarNodes
    planet: Planet
    o: Vec
    d: Vec
    sun: Vec
    bent: BentRay | None
    molecular: Values

    @classmethod
    def of(cls, batch: SolarNodes, planet: Planet, path: AirPath, o: Vec, d: Vec, sun: Vec) -> SunlitRays:
        """Build for rays."""
        bent = None
        if isinstance(batch.sunlight, RefractionTables):
            vertical = planet.height_and_normal(along(o, d, path.t_low))[1]
            bent = BentRay.of(batch.sunlight, d, sun, vertical)
        return cls(batch, planet, o, d, sun, bent, batch.molecular_light(dot(d, sun)) if bent is None else [])

    def shadow(self, path: AirPath, count: int) -> tuple[mi.Float64, mi.Float64]:
        """Return ``y`` where rays enter and leave the umbra, with refraction by ``count`` evaluations."""
        if self.bent is None:
            return umbra(self.planet, path, self.o, self.d, self.sun)
        return refracted_umbra(path, self.o, self.d, self.bent, count)

    def state_at(self, zero: mi.Float64) -> State:
        """Return the state where rays begin, whose light the first round finds."""
        width = self.batch.width * (2 if self.batch.particles is not None else 1)
        width *= 0 if self.batch.diffuse is None else 1 if self.batch.bounce is None else 2
        return [mi.Float32(zero) for _ in range(width)], None if self.bent is None else zero + 0.0

    def _look(self, t: mi.Float64, bending: mi.Float64 | None) -> list[mi.Float32]:
        """Return ``ln`` of the diffuse source per scattering coefficient, in the order of ``SolarNodes.source_at``."""
        batch = self.batch
        if batch.diffuse is None:
            return []
        # in single precision heights are good to a metre, plenty for light that changes over kilometres
        x, y, z = (mi.Float32(v) for v in along(self.o, self.d, t))
        height, normal = self.planet.height_and_normal((x, y, z))
        i, w, _ = batch.grid.locate(mi.Float64(height))
        asymmetry = forward = None
        if batch.particles is not None:
            asymmetry = interpolate(batch.particles.asymmetry, i, w, batch.width)
            if batch.particles.forward is not None:
                forward = interpolate(batch.particles.forward, i, w, batch.width)
        sun = self.sun
        if self.bent is not None and bending is not None:
            height, sun = self.bent.tables.sun.field.true_height(height), self.bent.sun_at(bending)
        fields = [batch.diffuse] if batch.bounce is None else [batch.diffuse, batch.bounce.field]
        looked = [field.log_sources(height, normal, self.d, sun, batch.cos2, asymmetry, forward) for field in fields]
        return [source for sources in looked for source in sources]

    def over_round(
        self, t0: mi.Float64, t1: mi.Float64, state: State, begins: mi.Bool
    ) -> tuple[DiffuseAlong | None, list[mi.Float32]]:
        """Return the diffuse source between ray parameters, and at the latter; ``begins``: whether rays begin there."""
        first, bending = state
        if not first:
            return None, first
        part = (t1 - t0) * (1.0 / LOOKUPS)

        def look(
            k: mi.UInt32, t: mi.Float64, bending: mi.Float64 | None, looked: list[list[mi.Float32]]
        ) -> tuple[mi.UInt32, mi.Float64, mi.Float64 | None, list[list[mi.Float32]]]:
            end = dr.select(k == 0, t, t + part)
            if self.bent is not None and bending is not None:
                _, _, bending = bending_over_step(self.bent, self.o, self.d, t, end, bending)
            return k + 1, end, bending, [*looked[1:], self._look(end, bending)]

        zero = dr.zeros(mi.Float32, dr.width(t0))
        before = [[zero + 0.0 for _ in first] for _ in range(LOOKUPS)]
        # the many lines of a lookup are once in the kernel, that where rays begin among them
        start = dr.select(begins, mi.UInt32(0), 1), t0 + 0.0, bending, [*before, first]
        looked = dr.while_loop(start, lambda k, *_: k <= LOOKUPS, look, label="lookups")[-1]
        return DiffuseAlong(t0, 1.0 / dr.maximum(t1 - t0, 1e-3), looked), looked[-1]

    def over_step(
        self, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64 | None, light: DiffuseAlong | None
    ) -> tuple[Point, Point, mi.Float64 | None]:
        """Return the Gauss points of a step, and the bending angle at its end."""
        at_a = at_b = None
        if self.bent is not None and bending is not None:
            at_a, at_b, bending = bending_over_step(self.bent, self.o, self.d, t0, t1, bending)
        if light is None:
            return Point(at_a), Point(at_b), bending
        a, b = (light.at(dr.fma(t1 - t0, share, t0)) for share in (GAUSS_LOW, 1.0 - GAUSS_LOW))
        return Point(at_a, a), Point(at_b, b), bending

    def source_at(self, place: Place, point: Point) -> Values:
        """Return the scattered light per metre, per node."""
        return self.batch.source_at(place, self._beam(place, point.bending), point.diffuse)

    def _beam(self, place: Place, bending: mi.Float64 | None) -> Beam:
        batch = self.batch
        if self.bent is not None and bending is not None:
            share, lit, _, cosine = self.bent.sunlight(
                place.height_m, place.normal, bending, batch.width, batch.columns
            )
            return Beam(share, lit, cosine, batch.molecular_light(cosine))
        assert not isinstance(batch.sunlight, RefractionTables)
        lit = ~self.planet.in_umbra(place.position, self.sun)
        factor = batch.depth_factor(place.height_m, place.normal)
        mu = dot(place.normal, self.sun)
        share = batch.sunlight.transmittance(place.height_m, mu, batch.width, factor)
        return Beam(share, lit, dot(self.d, self.sun), self.molecular)

    def ground_radiance(
        self, path: AirPath, hit: SurfaceHit | None, bending: mi.Float64 | None, sky_flux: Values | None
    ) -> Values:
        """Return ``direct E0 mu T_sun + diffuse E_sky`` with the reflectances [1/sr] of what is at the rays' ends.

        Both are albedo / pi for a Lambert ground. Cloud tops get as much skylight as the ground. ``bending``: angle at
        the ends; ``sky_flux``: of the ground around, as the sky sees it, per node, where it is separate.
        """
        height, normal = self.planet.height_and_normal(along(self.o, self.d, path.t_low + path.length_after))
        height = mi.Float64(0.0) if hit is None else dr.select(hit.cloud, height, 0.0)
        batch, bent = self.batch, self.bent
        direct, diffuse = (batch.reflectance, batch.reflectance) if hit is None else hit.reflectance()
        if bent is not None and bending is not None:
            mu = dot(normal, bent.sun_at(bending))
            share, lit, local, _ = bent.sunlight(height, normal, bending, batch.width, batch.columns)
            level: mi.Float64 = dr.maximum(local, 0.0)
            level = dr.select(lit, level, 0.0)
        else:
            assert not isinstance(batch.sunlight, RefractionTables)
            mu = dot(normal, self.sun)
            share = batch.sunlight.transmittance(height, mu, batch.width, batch.depth_factor(height, normal))
            level = dr.maximum(mu, 0.0)
        radiance = [a * e * level * t for a, e, t in zip(direct, batch.irradiance, share, strict=True)]
        if batch.diffuse is None:
            return radiance
        sky = batch.diffuse.ground_irradiance(mu)
        if batch.bounce is not None and sky_flux is not None:
            bounced = batch.bounce.field.ground_irradiance(mu)
            sky = [a + f * b for a, f, b in zip(sky, sky_flux, bounced, strict=True)]
        sky = [e * v for e, v in zip(batch.irradiance, sky, strict=True)]
        return [r + a * e for r, a, e in zip(radiance, diffuse, sky, strict=True)]
