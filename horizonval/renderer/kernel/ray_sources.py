"""What the air of a node batch shines along given rays: where the march's steps go, and the source at their points.

Emission depends on the place alone (:class:`EmittingRays`). Scattered sunlight (:class:`SunlitRays`) carries two things
from step to step: the light scattered before, and with refraction the bending angle of the ray.

The light scattered before is smooth and expensive: it is looked up at the steps' ends (with particles, many moments, at
every second), and its logarithm is linear between.

**Refraction** makes no bent rays: the columns are those of :mod:`horizonval.renderer.refraction.apparent_radius`, in
which light goes straight; the bending angle is summed beside the optical depth and turns the Sun instead. The light
scattered before is that of air without refraction, at the true height and under the true Sun.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.node_batches import (
    Beam,
    EmittingNodes,
    GlowNodes,
    OpacityNodes,
    Place,
    SolarNodes,
)
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.layer_steps import LayeredSteps, layered_steps
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.ray_path import GAUSS_LOW, AirPath, Steps, even_steps, glow_steps, lit_steps, umbra
from horizonval.renderer.refraction.bent_ray import BentRay, RefractionTables, bending_over_step, refracted_umbra
from horizonval.renderer.tables import interpolate
from horizonval.renderer.types import Values, Vec

PARTICLE_STRIDE = 2
"""Steps from one lookup of the diffuse source to the next where there are particles; without them 1."""

State: TypeAlias = "tuple[list[mi.Float32], mi.Float64 | None]"
"""What is carried from step to step: ``ln`` of the diffuse source, and the bending angle."""


@dataclass(frozen=True)
class Point:
    """A Gauss point of a step: its bending angle, and the diffuse source ``share`` of the way between two lookups."""

    bending: mi.Float64 | None = None
    before: Sequence[mi.Float32] = ()
    after: Sequence[mi.Float32] = ()
    share: float = 0.0

    def diffuse(self) -> Values:
        """Return the diffuse source."""
        pairs = zip(self.before, self.after, strict=True)
        return [mi.Float64(dr.exp(dr.fma(b - a, self.share, a))) for a, b in pairs]


class RaySource(Protocol):
    """The source of light along rays, for the march."""

    @property
    def steps(self) -> Steps | LayeredSteps:
        """Where the steps go."""

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
        """Return the state at ray parameters."""

    def over_steps(self, bounds: list[mi.Float64], state: State) -> tuple[list[tuple[Point, Point]], State]:
        """Return the Gauss points of the steps between bounds, and the state at the last; ``state`` is at the first."""

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
        """Return the emission per metre, per node; empty where nothing shines."""

    def ground_radiance(self, path: AirPath, hit: SurfaceHit | None, state: State, sky: Values | None) -> Values:
        """Return the radiance of what is at the rays' ends, towards the observer, per node; ``sky``: `sunlit_ends`."""


@dataclass(frozen=True)
class EmittingRays:
    """Rays through air whose emission depends on the place alone."""

    batch: EmittingNodes
    steps: Steps | LayeredSteps

    @classmethod
    def of(
        cls,
        batch: EmittingNodes,
        planet: Planet,
        path: AirPath,
        o: Vec,
        d: Vec,
        count: int,
        concentration: float,
        to_ground: mi.Bool | None = None,
    ) -> EmittingRays:
        """Share ``count`` steps out: evenly, but densely in a glowing layer, and piece by piece through thin cloud."""
        steps: Steps | LayeredSteps = even_steps(path, count)
        if batch.bands and to_ground is not None:
            steps = layered_steps(planet, path, o, d, to_ground, batch.bands, count, concentration)
        elif isinstance(batch, GlowNodes):
            steps = glow_steps(planet, path, o, d, batch.layer_m, count, concentration)
        return cls(batch, steps)

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
        """Nothing is carried."""
        return [], None

    def over_steps(self, bounds: list[mi.Float64], state: State) -> tuple[list[tuple[Point, Point]], State]:
        """Return points that say nothing: the place is enough."""
        return [(Point(), Point())] * (len(bounds) - 1), state

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
        """Return the emission per metre, per node."""
        return self.batch.source_at(place, extinction)

    def ground_radiance(self, path: AirPath, hit: SurfaceHit | None, state: State, sky: Values | None) -> Values:
        """Return the radiance of the batch's ground."""
        assert not isinstance(self.batch, OpacityNodes)
        return self.batch.ground


@dataclass(frozen=True)
class SunlitRays:
    """Rays through sunlit air.

    ``bent``: with refraction. ``molecular``: irradiance times the molecules' phase function; along a straight ray the
    scattering angle stays the same, so that it is found once.
    """

    batch: SolarNodes
    planet: Planet
    o: Vec
    d: Vec
    sun: Vec
    steps: Steps | LayeredSteps
    bent: BentRay | None
    molecular: Values

    @classmethod
    def of(
        cls,
        batch: SolarNodes,
        planet: Planet,
        path: AirPath,
        o: Vec,
        d: Vec,
        sun: Vec,
        count: int,
        concentration: float,
        steady: bool = False,
        to_ground: mi.Bool | None = None,
    ) -> SunlitRays:
        """Share ``count`` steps out among the pieces between the umbra's edges, so that no step straddles one.

        With ``to_ground`` also among those between the edges of layers of thin cloud.
        """
        bent = bent_ray(batch, planet, path, o, d, sun)
        if bent is not None:
            edges = refracted_umbra(planet, path, o, d, bent, batch.grid, count // 2, concentration)
        else:
            edges = umbra(planet, path, o, d, sun, concentration)
        steps: Steps | LayeredSteps
        if batch.bands and to_ground is not None:
            steps = layered_steps(planet, path, o, d, to_ground, batch.bands, count, concentration, edges)
        else:
            steps = lit_steps(path, *edges, count, steady)
        molecular = batch.molecular_light(dot(d, sun)) if bent is None else []
        return cls(batch, planet, o, d, sun, steps, bent, molecular)

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
        """Return ``ln`` of the diffuse source per scattering coefficient, in the order of ``SolarNodes.source_at``."""
        batch, bending = self.batch, None if self.bent is None else bending
        if batch.diffuse is None:
            return [], bending
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
            height, sun = mi.Float32(self.bent.true_height(i, w)), self.bent.sun_at(bending)
        fields = [batch.diffuse] if batch.bounce is None else [batch.diffuse, batch.bounce.field]
        looked = [field.log_sources(height, normal, self.d, sun, batch.cos2, asymmetry, forward) for field in fields]
        return [source for sources in looked for source in sources], bending

    def over_steps(self, bounds: list[mi.Float64], state: State) -> tuple[list[tuple[Point, Point]], State]:
        """Return the Gauss points of the steps between bounds, and the state behind the last."""
        before, bending = state
        angles: list[tuple[mi.Float64 | None, mi.Float64 | None]] = []
        for t0, t1 in pairwise(bounds):
            if self.bent is None or bending is None:
                angles.append((None, None))
                continue
            at_a, at_b, bending = bending_over_step(
                self.planet, self.bent, self.batch.grid, self.o, self.d, t0, t1, bending
            )
            angles.append((at_a, at_b))
        after, _ = self.state_at(bounds[-1], bending)
        stride = len(angles)
        points = [
            (
                Point(at_a, before, after, (k + GAUSS_LOW) / stride),
                Point(at_b, before, after, (k + 1.0 - GAUSS_LOW) / stride),
            )
            for k, (at_a, at_b) in enumerate(angles)
        ]
        return points, (after, bending)

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
        """Return the scattered light per metre, per node."""
        return self.batch.source_at(place, self._beam(place, point.bending), point.diffuse())

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

    Both are albedo / pi for a Lambert ground. Cloud tops get as much skylight as the ground. ``bending`` is that at the
    end of the path. ``reflected``: the flux of the ground around, as the sky sees it, per node, where it is kept apart.
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


def bent_ray(batch: SolarNodes, planet: Planet, path: AirPath, o: Vec, d: Vec, sun: Vec) -> BentRay | None:
    """Return how rays turn; None without refraction."""
    if not isinstance(batch.sunlight, RefractionTables):
        return None
    vertical = planet.height_and_normal(along(o, d, path.t_low))[1]
    return BentRay.of(batch.sunlight, d, sun, vertical)
