r"""The march: radiance along rays through a spherical-shell atmosphere over an ellipsoid, without Monte Carlo noise.

For every spectral node, with extinction k, optical depth :math:`\tau(t) = \int_0^t k\,dt'` from the observer and source
function S::

    L = int S exp(-tau) dtau  +  L_ground exp(-tau_ground)

    sunlight:  S = (k_scattering / k) E0 P(Theta) T_sun        single scattering; T_sun = 0 in the umbra
    emission:  S = B(T)                                        LTE
    airglow:   k S = g                                         emission per metre, given

    sunlight, scattered before:  S = (k_molecules S_molecules + k_particles S_particles) E0 / k     (source_table)

Which of them a march adds up, its node batch says (``node_batches``). Where the steps go is in
:mod:`horizonval.renderer.planet`: dense where the air is dense, no step straddles the umbra's edge, and airglow,
which comes from a thin layer high up, has steps of its own there.

**One step** holds two Gauss points. Extinction and source are linear through them: the optical depth at the points and
over the step follow exactly; thin steps (optical depth below 0.5) sum ``k S exp(-tau)`` with Gauss weights, thick ones
integrate a source linear in optical depth against ``exp(-tau)`` exactly, so that an isothermal black body comes out as
one however thick the step.

Neglected: polarisation, a Sun that is not a point (for illumination). Deterministic: no random numbers, no
atomics; every ray is summed in its own lane in a fixed order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.node_batches import GlowNodes, OpacityNodes, ShiningNodes, SolarNodes
from horizonval.renderer.kernel.ray_sources import STEPS, Point, State, SunlitRays
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.planet import (
    GAUSS_LOW,
    SOLAR_CONCENTRATION,
    AirPath,
    LayerBand,
    Planet,
    find_path,
    layered_steps,
    warp,
)
from horizonval.renderer.types import Values, Vec

THICK_STEP = 0.5


def march(
    planet: Planet,
    top_m: float,
    batch: ShiningNodes,
    o: Vec,
    d: Vec,
    sun: Vec,
    to_ground: mi.Bool,
    nodes: int,
    hit: SurfaceHit | None = None,
    ground_factors: tuple[Values, Values | None] | None = None,
) -> tuple[Values, Values]:
    """Return radiance and transmittance of every spectral node of a batch along rays: two lists of Float64.

    Parameters
    ----------
    o, d : Vec
        Origins [m, planet-centred] and unit directions.
    sun : Vec
        Unit vector towards the Sun.
    to_ground : Bool
        Add the ground and stop there; the rays must hit it.
    nodes : int
        Evaluations along each ray (two per step).
    hit : SurfaceHit, optional
        What is at the rays' ends, clouds included; default: a Lambert ground, no clouds.
    ground_factors : tuple of Values, optional
        Factors of the ground's light for the air along the rays and for the sky at their ends, where that light is
        separate (``SolarNodes.bounce``). By default it is left out.
    """
    cloud = None if hit is None else (hit.cloud, hit.t)
    air = march_air(planet, top_m, batch, o, d, sun, to_ground, nodes, cloud)
    along_rays, sky = ground_factors or (None, None)
    if isinstance(batch, GlowNodes):
        ground = batch.ground
    else:
        assert air.rays is not None
        ground = air.rays.ground_radiance(air.path, hit, air.state[1], sky)
    ends = to_ground if hit is None else hit.ends
    pairs = zip(air.over_ground(along_rays), ground, air.transmittance, strict=True)
    return [r + dr.select(ends, g * t, 0.0) for r, g, t in pairs], air.transmittance


@dataclass(frozen=True)
class AirMarch:
    """Radiance and transmittance of the air along rays, per node, and the state of the march at their ends.

    ``bounce``: what a ground of reflected flux 1 adds to the radiance; empty where it is included.
    """

    radiance: Values
    bounce: Values
    transmittance: Values
    path: AirPath
    rays: SunlitRays | None
    state: State

    def over_ground(self, factors: Values | None) -> Values:
        """Return the radiance over a ground that counts by given factors."""
        return with_ground(self.radiance, self.bounce, factors)


def with_ground(radiance: Values, bounce: Values, factors: Values | None) -> Values:
    """Return radiance with the ground's part by given factors."""
    if not bounce or factors is None:
        return radiance
    return [r + b * f for r, b, f in zip(radiance, bounce, factors, strict=True)]


def march_air(
    planet: Planet,
    top_m: float,
    batch: ShiningNodes,
    o: Vec,
    d: Vec,
    sun: Vec,
    to_ground: mi.Bool,
    nodes: int,
    cloud: tuple[mi.Bool, mi.Float64] | None = None,
    lit: bool | None = None,
) -> AirMarch:
    """Return the radiance and transmittance of the air along rays, without what is at their ends.

    Parameters as of :func:`march`, and ``cloud`` as of :func:`horizonval.renderer.planet.find_path`; ``lit``:
    whether no shadow cuts the rays; None if that is not known, and rays that one cuts have twice the steps.
    """
    count = max(nodes // 2, 3)
    # as data, so that rays to the ground and past it share a kernel
    dr.make_opaque(to_ground)
    path = find_path(planet, top_m, o, d, to_ground, cloud)
    bands, shadow = batch.bands, None
    rays = None
    if isinstance(batch, SolarNodes):
        rays = SunlitRays.of(batch, planet, path, o, d, sun)
        shadow = rays.shadow(path, 0 if lit else count // 2)
    else:
        bands = bands or (LayerBand(batch.layer_m, top_m),)
    steps = layered_steps(planet, path, o, d, bands, count, umbra=shadow, spare=bool(lit), twice=lit is None)

    def bound(i: mi.Float64) -> mi.Float64:
        return warp(path, steps.boundary(i))

    tau, radiance, state = _integrate(planet, path, batch, rays, o, d, steps.count, bound)
    width = batch.width
    return AirMarch(radiance[:width], radiance[width:], [dr.exp(-v) for v in tau], path, rays, state)


def optical_depth(planet: Planet, top_m: float, batch: OpacityNodes, o: Vec, d: Vec, nodes: int) -> Values:
    """Return the optical depth of every spectral node of a batch along rays past the ground; as :func:`march`."""
    path = find_path(planet, top_m, o, d, mi.Bool(False))
    steps = layered_steps(planet, path, o, d, (), max(nodes // 2, 3))

    def bound(i: mi.Float64) -> mi.Float64:
        return warp(path, steps.boundary(i))

    return _integrate(planet, path, batch, None, o, d, steps.count, bound)[0]


@dataclass(frozen=True)
class SunlitStations:
    """Points along rays at which a march records its sums: evenly spaced in t within each piece.

    ``cuts``: ends of the pieces, rising [m]; ``numbers``: stations there, from 0 to ``count`` - 1, size-1 arrays.
    ``taken``: how many steps lie before them, from the first station on, as many for each interval of a piece;
    ``steps`` of all, and ``before`` steps up to the first. Where ``shadow`` may cut the rays, both are divided among
    the pieces before, in and behind the umbra, a third each, so that no step straddles its edge.
    """

    cuts: tuple[mi.Float64, ...]
    numbers: tuple[mi.Float64, ...]
    taken: tuple[mi.Float64, ...]
    count: int
    steps: int
    before: int
    shadow: bool = True

    def piece(self, past: Callable[[int], mi.Bool]) -> tuple[mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
        """Return begin and end of pieces [m], and the numbers of the stations there; ``past``: cut k is behind."""
        low, high = self._ends(self.cuts, past)
        return low, high, *self._ends(self.numbers, past)

    def interval(self, past: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return the station that steps come from, counted from the first station, and their share of the interval."""

        def behind(k: int) -> mi.Bool:
            return past >= self.taken[k]

        (first, last), (number, following) = (self._ends(of, behind) for of in (self.taken, self.numbers))
        intervals = (past - first) * ((following - number) / (last - first))
        whole = dr.floor(intervals + 1e-9)
        return number + whole, intervals - whole

    @staticmethod
    def _ends(values: tuple[mi.Float64, ...], past: Callable[[int], mi.Bool]) -> tuple[mi.Float64, mi.Float64]:
        low, high = values[0], values[1]
        for k in range(1, len(values) - 1):
            low, high = dr.select(past(k), values[k], low), dr.select(past(k), values[k + 1], high)
        return low, high

    def bound(self, path: AirPath, edges: Sequence[mi.Float64], i: mi.Float64) -> mi.Float64:
        """Return the ray parameter at the beginning of a step; ``edges`` of the umbra, where a shadow may cut rays."""
        start = path.t_low - path.length_before
        ahead = i < self.before
        past = dr.maximum(i - self.before, 0.0)
        station, within = self.interval(past)
        first, last, number, following = self.piece(lambda k: station >= self.numbers[k])
        spacing = (last - first) / (following - number)
        low = dr.select(ahead, start, dr.fma(spacing, station - number, first))
        high = dr.select(ahead, self.cuts[0], low + spacing)
        pieces = 3.0 if edges else 1.0
        share = dr.select(ahead, i * (pieces / self.before), within * pieces)
        begin, end = low, high
        if edges:
            piece = dr.minimum(dr.floor(share + 1e-9), 2.0)
            share = share - piece
            cuts = [low, *(dr.clip(edge, low, high) for edge in edges), high]
            begin = dr.select(piece < 0.5, cuts[0], dr.select(piece < 1.5, cuts[1], cuts[2]))
            end = dr.select(piece < 0.5, cuts[1], dr.select(piece < 1.5, cuts[2], cuts[3]))
        # dense towards the stations, where the air is
        left = 1.0 - share
        left = left * dr.fma(left * left, 1.0 - SOLAR_CONCENTRATION, SOLAR_CONCENTRATION)
        t = dr.select(ahead, end - (end - begin) * left, begin + (end - begin) * share)
        # where a ray just touches the top of the air the first station may lie before it
        return dr.maximum(t, start)


def march_to_stations(
    planet: Planet,
    top_m: float,
    batch: SolarNodes | GlowNodes,
    o: Vec,
    d: Vec,
    sun: Vec,
    to_ground: bool,
    stations: SunlitStations,
    *,
    attenuated: bool = True,
) -> tuple[Values, Values, Values, mi.Float64 | None]:
    """Return what the pieces between stations add, per node, each (stations * rays,), and the bending at rays' ends.

    Radiance, bounce and optical depth, the first from the observer to the first station, seen from their beginnings;
    with ``attenuated`` False what a piece adds is its emission, of which nothing is absorbed.
    """
    ends = mi.Bool(to_ground)
    dr.make_opaque(ends)
    path = find_path(planet, top_m, o, d, ends)
    count = stations.before + stations.steps
    rays, edges = None, list[mi.Float64]()
    if isinstance(batch, SolarNodes):
        rays = SunlitRays.of(batch, planet, path, o, d, sun)
        if stations.shadow:
            edges = [warp(path, y) for y in rays.shadow(path, count // 2)]
    lanes = dr.width(path.t_low)
    # as data: frames with other numbers of rays share the kernel
    lane, width = dr.arange(mi.UInt32, lanes), dr.opaque(mi.UInt32, lanes, 1)
    parts = _parts(batch)
    noted = [dr.zeros(mi.Float64, lanes * stations.count) for _ in range((parts + 1) * batch.width)]

    def bound(i: mi.Float64) -> mi.Float64:
        return stations.bound(path, edges, i)

    def note(i: mi.UInt32, tau: Values, radiance: Values) -> tuple[Values, Values]:
        station, within = stations.interval(dr.maximum(mi.Float64(i) - stations.before, 0.0))
        # the last round may go past the last station
        here = (i >= stations.before) & (i <= count) & (within < 1e-6)
        index = mi.UInt32(station) * width + lane
        for values, value in zip(noted, [*radiance, *tau], strict=True):
            dr.scatter(values, value, index, here, mode=dr.ReduceMode.NoConflicts)
        tau, radiance = ([dr.select(here, 0.0, v) for v in sums] for sums in (tau, radiance))
        return tau, radiance

    _, _, state = _integrate(planet, path, batch, rays, o, d, count, bound, note, attenuated)
    first, last = batch.width, parts * batch.width
    return noted[:first], noted[first:last], noted[last:], state[1]


def _parts(batch: ShiningNodes | OpacityNodes) -> int:
    """Return how many radiances a march adds up per node: 2 where the ground's part is kept apart."""
    return 2 if isinstance(batch, SolarNodes) and batch.bounce is not None else 1


Bound: TypeAlias = "Callable[[mi.Float64], mi.Float64]"
"""Ray parameter [m] at a step's beginning, by the step's number."""


def _integrate(
    planet: Planet,
    path: AirPath,
    batch: ShiningNodes | OpacityNodes,
    rays: SunlitRays | None,
    o: Vec,
    d: Vec,
    count: int | mi.UInt32,
    bound: Bound,
    note: Callable[[mi.UInt32, Values, Values], tuple[Values, Values]] | None = None,
    attenuated: bool = True,
) -> tuple[Values, Values, State]:
    """Return optical depth and radiances per node, and the state of sunlit ``rays`` at the end.

    ``note`` gets both after each step, and returns with what to go on.
    """

    def evaluate(t: mi.Float64, point: Point) -> tuple[Values, Values]:
        place = batch.place(planet, o, d, t)
        k = batch.extinction_at(place)
        if isinstance(batch, SolarNodes):
            assert rays is not None
            return k, rays.source_at(place, point)
        return k, batch.source_at(place)

    def body(
        i: mi.UInt32, t0: mi.Float64, tau: Values, radiance: Values, state: State
    ) -> tuple[mi.UInt32, mi.Float64, Values, Values, State]:
        light, looked = None, state[0]
        if rays is not None:
            light, looked = rays.over_round(t0, bound(mi.Float64(i) + float(STEPS)), state, i == 0)

        def step(
            k: mi.UInt32, t0: mi.Float64, tau: Values, radiance: Values, bending: mi.Float64 | None
        ) -> tuple[mi.UInt32, mi.Float64, Values, Values, mi.Float64 | None]:
            tau, radiance = list(tau), list(radiance)
            t1 = bound(mi.Float64(i + k) + 1.0)
            low, high = Point(), Point()
            if rays is not None:
                low, high, bending = rays.over_step(t0, t1, bending, light)
            h = t1 - t0
            k_a, j_a = evaluate(t0 + GAUSS_LOW * h, low)
            k_b, j_b = evaluate(t0 + (1.0 - GAUSS_LOW) * h, high)
            for n in range(batch.width):
                depth = 0.5 * h * (k_a[n] + k_b[n])
                for m in range(n, len(j_a), batch.width):
                    added = 0.5 * h * (j_a[m] + j_b[m])
                    if attenuated:
                        added = dr.exp(-tau[n]) * gain(h, k_a[n], k_b[n], j_a[m], j_b[m], depth)
                    radiance[m] = radiance[m] + added
                tau[n] = tau[n] + depth
            if note is not None:
                tau, radiance = note(i + k + 1, tau, radiance)
            return k + 1, t1, tau, radiance, bending

        begin = mi.UInt32(0), t0 + 0.0, tau, radiance, state[1]
        _, t0, tau, radiance, bending = dr.while_loop(begin, lambda k, *_: k < STEPS, step, label="steps")
        return i + STEPS, t0, tau, radiance, (looked, bending)

    zero = dr.zeros(mi.Float64, dr.width(path.t_low))
    start = bound(zero)
    nothing = [zero + 0.0] * batch.width
    dark = [zero + 0.0] * (batch.width * _parts(batch))
    state: State = ([], None) if rays is None else rays.state_at(zero)
    _, _, tau, radiance, state = dr.while_loop(
        (mi.UInt32(0), start, nothing, dark, state),
        lambda i, *_: i < count,
        body,
        labels=("i", "t", "tau", "radiance", "state"),
        label="limb march",
    )
    return tau, radiance, state


def gain(
    h: mi.Float64,
    k_a: mi.Float64,
    k_b: mi.Float64,
    j_a: mi.Float64,
    j_b: mi.Float64,
    step: mi.Float64,
) -> mi.Float64:
    """Return what one step adds, seen from its beginning."""
    slope = (k_b - k_a) / (1.0 - 2.0 * GAUSS_LOW)  # of k over the step, per unit of h
    k_0 = k_a - slope * GAUSS_LOW
    tau_a = dr.maximum(h * GAUSS_LOW * (k_0 + 0.5 * GAUSS_LOW * slope), 0.0)
    tau_b = h * (1.0 - GAUSS_LOW) * (k_0 + 0.5 * (1.0 - GAUSS_LOW) * slope)
    thin = 0.5 * h * (j_a * dr.exp(-tau_a) + j_b * dr.exp(-tau_b))
    # thick: S linear in tau through the two points, integrated against exp(-tau)
    s_a, s_b = j_a / dr.maximum(k_a, 1e-300), j_b / dr.maximum(k_b, 1e-300)
    escaped = dr.exp(-step)
    e0 = 1.0 - escaped
    e1 = e0 - step * escaped
    thick = s_a * e0 + (s_b - s_a) * (e1 - tau_a * e0) / dr.maximum(tau_b - tau_a, 1e-30)
    return dr.select(step < THICK_STEP, thin, dr.maximum(thick, 0.0))
