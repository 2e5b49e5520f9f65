"""The source of light in the air of a node batch along rays.

Emission depends on the place alone (:class:`EmittingRays`). Scattered sunlight (:class:`SunlitRays`) carries two things
from step to step: the light scattered more than once, and with refraction the bending angle of the ray.

Light scattered more than once is smooth and expensive. It is read at every second step's end, and its logarithm is a
parabola through three of these values: :data:`STEPS` steps share them.

**Refraction** makes no bent rays: the columns are those of :mod:`horizonval.renderer.refraction`, in
which light goes straight; the bending angle is summed with the optical depth and turns the Sun instead. Light
scattered more than once is that of air without refraction, at the true height and under the true Sun.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.node_batches import (
    Beam,
    EmittingNodes,
    OpacityNodes,
    Place,
    SolarNodes,
)
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.planet import (
    GAUSS_LOW,
    AirPath,
    Planet,
    along,
    dot,
    umbra,
)
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

    ``powers``: of its ``ln``, polynomials of the share of the path, the lowest power first; empty for none.
    """

    start: mi.Float64
    per_m: mi.Float64
    powers: Sequence[Sequence[mi.Float32]] = ()

    def share(self, t: mi.Float64) -> mi.Float32:
        """Return which share of the way lies before ray parameters."""
        return mi.Float32((t - self.start) * self.per_m)

    def at(self, share: mi.Float32 | float) -> Values:
        """Return the diffuse source."""
        if not self.powers:
            return []
        values = list(self.powers[-1])
        for lower in reversed(self.powers[:-1]):
            values = [dr.fma(v, share, c) for v, c in zip(values, lower, strict=True)]
        return [mi.Float64(dr.exp(v)) for v in values]


@dataclass(frozen=True)
class Point:
    """A Gauss point of a step: its bending angle, and the diffuse source."""

    bending: mi.Float64 | None = None
    diffuse: Values = field(default_factory=list)


@dataclass(frozen=True)
class EmittingRays:
    """Rays through air whose emission depends on the place alone."""

    batch: EmittingNodes

    def state_at(self, zero: mi.Float64) -> State:
        """Nothing is carried."""
        return [], None

    def over_round(self, t0: mi.Float64, t1: mi.Float64, state: State, begins: mi.Bool) -> tuple[DiffuseAlong, State]:
        """Return nothing: the place is enough."""
        return DiffuseAlong(t0, t0), state

    def over_step(
        self, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64 | None, light: DiffuseAlong
    ) -> tuple[Point, Point, mi.Float64 | None]:
        """Return points that say nothing."""
        return Point(), Point(), None

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
        """Return the emission per metre, per node."""
        return self.batch.source_at(place, extinction)

    def ground_radiance(self, path: AirPath, hit: SurfaceHit | None, state: State, sky: Values | None) -> Values:
        """Return the radiance of the batch's ground."""
        assert not isinstance(self.batch, OpacityNodes)
        return self.batch.ground


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

    def over_round(self, t0: mi.Float64, t1: mi.Float64, state: State, begins: mi.Bool) -> tuple[DiffuseAlong, State]:
        """Return the diffuse source between ray parameters, and the state at the latter."""
        first, bending = state
        if not first:
            return DiffuseAlong(t0, t0), state
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
        length = dr.maximum(t1 - t0, 1e-3)
        return DiffuseAlong(t0, 1.0 / length, _powers(looked)), (looked[-1], None)

    def over_step(
        self, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64 | None, light: DiffuseAlong
    ) -> tuple[Point, Point, mi.Float64 | None]:
        """Return the Gauss points of a step, and the bending angle at its end."""
        at_a = at_b = None
        if self.bent is not None and bending is not None:
            at_a, at_b, bending = bending_over_step(self.bent, self.o, self.d, t0, t1, bending)
        share_a, share_b = (light.share(dr.fma(t1 - t0, share, t0)) for share in (GAUSS_LOW, 1.0 - GAUSS_LOW))
        return Point(at_a, light.at(share_a)), Point(at_b, light.at(share_b)), bending

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
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

    def ground_radiance(self, path: AirPath, hit: SurfaceHit | None, state: State, sky: Values | None) -> Values:
        """Return the radiance of what is at the rays' ends, towards the observer, per node."""
        return sunlit_ends(self.batch, self.planet, path, self.o, self.d, self.sun, hit, self.bent, state[1], sky)


RaySource: TypeAlias = EmittingRays | SunlitRays


def _powers(looked: Sequence[Sequence[mi.Float32]]) -> list[list[mi.Float32]]:
    """Return polynomials of the share of the way, lowest power first, through three values."""
    triples = list(zip(*looked, strict=True))
    return [
        list(looked[0]),
        [4.0 * middle - 3.0 * first - last for first, middle, last in triples],
        [2.0 * (first - 2.0 * middle + last) for first, middle, last in triples],
    ]


def sunlit_ends(
    batch: SolarNodes,
    planet: Planet,
    path: AirPath,
    o: Vec,
    d: Vec,
    sun: Vec,
    hit: SurfaceHit | None,
    bent: BentRay | None,
    bending: mi.Float64 | None,
    reflected: Values | None = None,
) -> Values:
    """Return ``direct E0 mu T_sun + diffuse E_sky`` with the two reflectances [1/sr] of what is at the rays' ends.

    Both are albedo / pi for a Lambert ground. Cloud tops get as much skylight as the ground. ``bending``: angle at the
    end of the path. ``reflected``: the flux of the ground around, as the sky sees it, per node, where it is separate.
    """
    height, normal = planet.height_and_normal(along(o, d, path.t_low + path.length_after))
    height = mi.Float64(0.0) if hit is None else dr.select(hit.cloud, height, 0.0)
    direct, diffuse = (batch.reflectance, batch.reflectance) if hit is None else hit.reflectance()
    if bent is not None and bending is not None:
        mu = dot(normal, bent.sun_at(bending))
        share, lit, local, _ = bent.sunlight(height, normal, bending, batch.width, batch.columns)
        level: mi.Float64 = dr.maximum(local, 0.0)
        level = dr.select(lit, level, 0.0)
    else:
        assert not isinstance(batch.sunlight, RefractionTables)
        mu = dot(normal, sun)
        share = batch.sunlight.transmittance(height, mu, batch.width, batch.depth_factor(height, normal))
        level = dr.maximum(mu, 0.0)
    radiance = [a * e * level * t for a, e, t in zip(direct, batch.irradiance, share, strict=True)]
    if batch.diffuse is None:
        return radiance
    sky = batch.diffuse.ground_irradiance(mu)
    if batch.bounce is not None and reflected is not None:
        bounced = batch.bounce.field.ground_irradiance(mu)
        sky = [a + f * b for a, f, b in zip(sky, reflected, bounced, strict=True)]
    sky = [e * v for e, v in zip(batch.irradiance, sky, strict=True)]
    return [r + a * e for r, a, e in zip(radiance, diffuse, sky, strict=True)]
