"""The source of light in the air of a node batch along rays.

Where the march's steps go, and the source at their points.

Emission depends on the place alone (:class:`EmittingRays`). Scattered sunlight (:class:`SunlitRays`) carries two things
from step to step: the light scattered more than once, and with refraction the bending angle of the ray.

Light scattered more than once is smooth and expensive. It is read at the steps' ends, and its logarithm is linear
between; with particles, whose many moments are expensive, at every second, and a parabola goes through three
(:data:`PARTICLES`).

**Refraction** makes no bent rays: the columns are those of :mod:`horizonval.renderer.refraction`, in
which light goes straight; the bending angle is summed with the optical depth and turns the Sun instead. Light
scattered more than once is that of air without refraction, at the true height and under the true Sun.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.node_batches import (
    Beam,
    EmittingNodes,
    GlowNodes,
    OpacityNodes,
    Place,
    ShiningNodes,
    SolarNodes,
)
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.planet import (
    GAUSS_LOW,
    AirPath,
    LayeredSteps,
    Planet,
    Steps,
    along,
    dot,
    even_steps,
    glow_steps,
    layered_steps,
    lit_steps,
    umbra,
)
from horizonval.renderer.refraction import BentRay, RefractionTables, bending_over_step, refracted_umbra
from horizonval.renderer.tables import interpolate
from horizonval.renderer.types import Values, Vec

State: TypeAlias = "tuple[list[mi.Float32], mi.Float64 | None]"
"""What is carried from step to step: ``ln`` of the diffuse source, and the bending angle."""


class Round(NamedTuple):
    """Steps that share lookups of the diffuse source: at their first point, and ``lookups`` more, even in t."""

    steps: int = 1
    lookups: int = 1


MOLECULES, PARTICLES = Round(), Round(steps=4, lookups=2)


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


class RaySource(Protocol):
    """The source of light along rays, for the march."""

    @property
    def steps(self) -> Steps | LayeredSteps:
        """Where the steps go."""

    @property
    def round(self) -> Round:
        """How many steps share lookups."""

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
        """Return the state where rays begin."""

    def over_round(self, t0: mi.Float64, t1: mi.Float64, state: State, begins: mi.Bool) -> tuple[DiffuseAlong, State]:
        """Return the diffuse source between ray parameters and the state at the end; ``begins``.

        Whether rays begin there.
        """

    def over_step(
        self, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64 | None, light: DiffuseAlong
    ) -> tuple[Point, Point, mi.Float64 | None]:
        """Return the Gauss points of a step, and the bending angle at its end."""

    def source_at(self, place: Place, extinction: Values, point: Point) -> Values:
        """Return the emission per metre, per node; empty where nothing shines."""

    def ground_radiance(self, path: AirPath, hit: SurfaceHit | None, state: State, sky: Values | None) -> Values:
        """Return the radiance of what is at the rays' ends, towards the observer, per node; ``sky``: `sunlit_ends`."""


@dataclass(frozen=True)
class EmittingRays:
    """Rays through air whose emission depends on the place alone."""

    batch: EmittingNodes
    steps: Steps | LayeredSteps
    round: Round = MOLECULES

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
            steps = layered_steps(planet, path, o, d, batch.bands, count, concentration)
        elif isinstance(batch, GlowNodes):
            steps = glow_steps(planet, path, o, d, batch.layer_m, count, concentration)
        return cls(batch, steps)

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
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
    steps: Steps | LayeredSteps
    bent: BentRay | None
    molecular: Values

    @property
    def round(self) -> Round:
        """How many steps share lookups."""
        return round_of(self.batch)

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
        lit: bool = False,
    ) -> SunlitRays:
        """Divide ``count`` steps among the pieces between the umbra's edges, so that no step straddles one.

        With ``to_ground`` also among those between the edges of layers of thin cloud. ``lit``: no shadow cuts the rays.
        """
        bent = bent_ray(batch, planet, path, o, d, sun)
        if bent is not None:
            edges = refracted_umbra(planet, path, o, d, bent, batch.grid, 0 if lit else count // 2, concentration)
        else:
            edges = umbra(planet, path, o, d, sun, concentration)
        steps: Steps | LayeredSteps
        if batch.bands and to_ground is not None:
            spare = steady and lit
            steps = layered_steps(planet, path, o, d, batch.bands, count, concentration, edges, spare=spare)
        else:
            steps = lit_steps(path, *edges, count, steady)
        molecular = batch.molecular_light(dot(d, sun)) if bent is None else []
        return cls(batch, planet, o, d, sun, steps, bent, molecular)

    def state_at(self, t: mi.Float64, bending: mi.Float64 | None) -> State:
        """Return the state where rays begin; in rounds of several lookups the first of them finds it."""
        bending = None if self.bent is None else bending
        if self.round.lookups == 1:
            return self._look(t, bending), bending
        parts = 1 if self.batch.bounce is None else 2
        return [dr.zeros(mi.Float32, dr.width(t)) for _ in range(2 * parts * self.batch.width)], bending

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
            height, sun = mi.Float32(self.bent.true_height(i, w)), self.bent.sun_at(bending)
        fields = [batch.diffuse] if batch.bounce is None else [batch.diffuse, batch.bounce.field]
        looked = [field.log_sources(height, normal, self.d, sun, batch.cos2, asymmetry, forward) for field in fields]
        return [source for sources in looked for source in sources]

    def over_round(self, t0: mi.Float64, t1: mi.Float64, state: State, begins: mi.Bool) -> tuple[DiffuseAlong, State]:
        """Return the diffuse source between ray parameters, and the state at the latter."""
        first, bending = state
        if not first:
            return DiffuseAlong(t0, t0), state
        count = self.round.lookups
        part = (t1 - t0) * (1.0 / count)

        def look(
            k: mi.UInt32, t: mi.Float64, bending: mi.Float64 | None, looked: list[list[mi.Float32]]
        ) -> tuple[mi.UInt32, mi.Float64, mi.Float64 | None, list[list[mi.Float32]]]:
            end = t1 if count == 1 else dr.select(k == 0, t, t + part)
            if self.bent is not None and bending is not None:
                grid = self.batch.grid
                _, _, bending = bending_over_step(self.planet, self.bent, grid, self.o, self.d, t, end, bending)
            return k + 1, end, bending, [*looked[1:], self._look(end, bending)]

        zero = dr.zeros(mi.Float32, dr.width(t0))
        before = [[zero + 0.0 for _ in first] for _ in range(count)]
        if count == 1:
            looked = look(mi.UInt32(1), t0, bending, [*before, first])[-1]
        else:
            # the many lines of a lookup are once in the kernel, that where rays begin among them
            number = dr.select(begins, mi.UInt32(0), 1)
            looked = repeated(count + 1, (number, t0 + 0.0, bending, [*before, first]), look, "lookups", begins)[-1]
        length = dr.maximum(t1 - t0, 1e-3)
        return DiffuseAlong(t0, 1.0 / length, _powers(looked)), (looked[-1], None)

    def over_step(
        self, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64 | None, light: DiffuseAlong
    ) -> tuple[Point, Point, mi.Float64 | None]:
        """Return the Gauss points of a step, and the bending angle at its end."""
        at_a = at_b = None
        if self.bent is not None and bending is not None:
            at_a, at_b, bending = bending_over_step(
                self.planet, self.bent, self.batch.grid, self.o, self.d, t0, t1, bending
            )
        low, high = GAUSS_LOW, 1.0 - GAUSS_LOW
        if self.round.steps == 1:
            return Point(at_a, light.at(low)), Point(at_b, light.at(high)), bending
        share_a, share_b = (light.share(dr.fma(t1 - t0, share, t0)) for share in (low, high))
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


def round_of(batch: ShiningNodes | OpacityNodes) -> Round:
    """Return how many steps share lookups of the diffuse source."""
    expensive = isinstance(batch, SolarNodes) and batch.diffuse is not None and batch.particles is not None
    return PARTICLES if expensive else MOLECULES


def _powers(looked: Sequence[Sequence[mi.Float32]]) -> list[list[mi.Float32]]:
    """Return polynomials of the share of the way, lowest power first, through two or three values."""
    if len(looked) == 2:
        return [list(looked[0]), [b - a for a, b in zip(*looked, strict=True)]]
    triples = list(zip(*looked, strict=True))
    return [
        list(looked[0]),
        [4.0 * middle - 3.0 * first - last for first, middle, last in triples],
        [2.0 * (first - 2.0 * middle + last) for first, middle, last in triples],
    ]


def repeated(
    count: int,
    start: tuple[Any, ...],
    body: Callable[..., tuple[Any, ...]],
    label: str,
    first: mi.Bool | None = None,
) -> tuple[Any, ...]:
    """Return what ``count`` rounds of a kernel's loop carry, whose counter is first; one round needs no loop.

    ``first``: whether the counter begins at 0, and not at 1; None: always.
    """
    if count == 1:
        for k in range(count):
            following = body(*start)
            start = following if k or first is None else dr.select(first, following, start)
        return start
    return dr.while_loop(start, lambda k, *_: k < count, body, label=label)


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


def bent_ray(batch: SolarNodes, planet: Planet, path: AirPath, o: Vec, d: Vec, sun: Vec) -> BentRay | None:
    """Return how rays turn; None without refraction."""
    if not isinstance(batch.sunlight, RefractionTables):
        return None
    vertical = planet.height_and_normal(along(o, d, path.t_low))[1]
    return BentRay.of(batch.sunlight, d, sun, vertical)
