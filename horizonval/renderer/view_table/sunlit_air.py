r"""What a view table of sunlight holds: for every spectral node the radiance of the air and its transmittance.

Rays of the table are marched once, with :data:`MORE_NODES` times the evaluations of the direct march, without what
reflects at the rays' ends. With refraction the table also holds the bending angle at the rays' ends.

**Air before clouds**: radiance and transmittance from the camera to stations along rays.
The stations lie between where a ray enters the layer of the cloud tops and where it leaves it or meets the ground. The
edges of layers of thin cloud cut that stretch into pieces, each with a fixed number of stations, evenly spaced:
radiance and transmittance have a kink at a layer's edge, which must not move past a station from ray to ray.
A ray that ends on a cloud uses Lagrange's cubic through the four stations of one piece around its end.

**The plane of a view table**: rays from one camera position by x from 0 to 1 and azimuth, kinks on borders of patches.
For rays to the ground, and for those past it from inside the air, x is the place on the axis of
:mod:`horizonval.renderer.kernel.frame_geometry`, over its length. For rays past the ground seen from above the air
radiance has kinks along rows: where rays just touch the top of the air or the edge of a layer at a height h, their
paths below it begin as :math:`\sqrt{2 R (h - h_{low})}`. These heights are borders there, and whole patches lie between
two, in which x is even on that axis; but in the patch below a border, s of the way up, x goes with

    1 - sqrt(1 - s)

in which radiance is smooth. Borders in v, the height of the lowest point in the stretched space, differ from h
and with azimuth, by 0.3 % from pole to equator: a ray over the ellipsoid, seen from the point o, touches that raised
by h where its nadir angle theta solves

    |U|^2 tau^2 - 2 (p.U) tau + |p|^2 - |U x p|^2 |o|^2 / (a + h)^2 = 0,      tau = cot(theta)

with up U and the horizontal p of the ray, both stretched until the raised ellipsoid is a sphere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.frame_geometry import RayAxis, RayCoordinates
from horizonval.renderer.kernel.march import AirMarch, SunlitStations, march_air, march_to_stations
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.planet import Planet, way_through
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Number, Values, Vec, constant, inverse_root
from horizonval.renderer.view_table.patch_table import PACKET, ROW_PATCHES, PatchTable, Tabulated


@dataclass(frozen=True)
class _Raised:
    """The raised ellipsoid of the module text.

    ``up2`` is |U|^2, ``tilt`` stretching's share of z^2, ``reach2`` (|o|/(a+h))^2.
    """

    up2: float
    tilt: float
    reach2: float

    @classmethod
    def of(cls, coordinates: RayCoordinates, height_m: float) -> _Raised:
        planet = coordinates.planet
        a, b = planet.a_m, planet.b_m
        tilt = ((a + height_m) * b / ((b + height_m) * a)) ** 2 - 1.0
        up_z = float(coordinates.axes[2, 2])
        return cls(1.0 + tilt * up_z * up_z, tilt, (coordinates.distance_m / (a + height_m)) ** 2)


@dataclass(frozen=True)
class RayPlane:
    """The plane of the rays to the ground or of those past it.

    ``heights_m`` of the borders, rising, the last at the top of the air; ``patches``: rows between two. Empty without
    borders.
    """

    coordinates: RayCoordinates
    to_ground: bool
    heights_m: tuple[float, ...]
    patches: tuple[int, ...]

    @classmethod
    def of(cls, coordinates: RayCoordinates, to_ground: bool, edges_m: Iterable[float], top_m: float) -> RayPlane:
        """Build with borders at the edges of layers, those below the top of the air."""
        if to_ground or coordinates.inside:
            return cls(coordinates, to_ground, (), ())
        edges = sorted({edge for edge in edges_m if 0.0 < edge < top_m})
        # the highest ones only if there are more than patches
        heights = (*edges[max(len(edges) + 1 - ROW_PATCHES, 0) :], top_m)
        return cls(coordinates, to_ground, heights, _shared_out(coordinates.limb, heights))

    @property
    def axis(self) -> RayAxis:
        """The axis."""
        return self.coordinates.ground if self.to_ground else self.coordinates.limb

    def directions(self, x: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return unit directions at places, each of shape (n,); shape (n, 3)."""
        return self.coordinates.directions(self.axis.value(self._on_axis(x, azimuth)), azimuth, self.to_ground)

    def place(self, o: Vec, d: Vec) -> tuple[mi.Float64, mi.Float64]:
        """Return ``(x, azimuth)`` of kernel directions; ``o`` is the camera."""
        steps, azimuth = self.coordinates.place(o, d, self.to_ground)
        x = steps * (1.0 / (self.axis.count - 1))
        if not self.heights_m:
            return x, azimuth
        sine, cosine = dr.sincos(azimuth)
        north, west = (constant(v) for v in self.coordinates.axes[:2, 2])
        z, up_z = cosine * north + sine * west, constant(self.coordinates.axes[2, 2])
        low, place = mi.Float64(0.0), mi.Float64(0.0)
        for height, count in zip(self.heights_m, self.patches, strict=True):
            raised = _Raised.of(self.coordinates, height)
            up2, tilt, reach2 = (constant(v) for v in (raised.up2, raised.tilt, raised.reach2))
            cotangent = _cotangent(up2, tilt, reach2, z, up_z, dr.sqrt)
            nadir_sine = inverse_root(dr.fma(cotangent, cotangent, 1.0))
            v = nadir_sine * constant(self.coordinates.distance_m) - self.coordinates.planet.a_m
            high = self.axis.place(v) * (1.0 / (self.axis.count - 1))
            patches = constant(float(count))
            share = dr.clip((x - low) / (high - low), 0.0, 1.0) * patches
            last = share - (patches - 1.0)
            place += dr.select(last > 0.0, patches - dr.sqrt(dr.maximum(1.0 - last, 0.0)), share)
            low = high
        return place * (1.0 / ROW_PATCHES), azimuth

    def _on_axis(self, x: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return the places on the axis, over its length."""
        if not self.heights_m:
            return x
        place, first = x * ROW_PATCHES, 0
        low, on_axis = np.zeros_like(x), np.zeros_like(x)
        for height, count in zip(self.heights_m, self.patches, strict=True):
            high = self._border(height, azimuth)
            share = np.clip(place - first, 0.0, count)
            above = np.maximum(count - share, 0.0)
            share = np.where(above < 1.0, count - above * above, share) / count
            on_axis = np.where(place >= first, low + (high - low) * share, on_axis)
            low, first = high, first + count
        return on_axis

    def _border(self, height_m: float, azimuth: FloatArray) -> FloatArray:
        """Return the border at a height, on the axis over its length."""
        c = self.coordinates
        z = np.cos(azimuth) * c.axes[0, 2] + np.sin(azimuth) * c.axes[1, 2]
        raised = _Raised.of(c, height_m)
        up2, tilt, reach2, up_z = (np.asarray(v) for v in (raised.up2, raised.tilt, raised.reach2, c.axes[2, 2]))
        cotangent = _cotangent(up2, tilt, reach2, z, up_z, np.sqrt)
        v = c.distance_m / np.sqrt(1.0 + cotangent**2) - c.planet.a_m
        return np.asarray(np.arcsinh(v / self.axis.dense) / math.asinh(self.axis.most / self.axis.dense))


def _cotangent(
    up2: Number, tilt: Number, reach2: Number, z: Number, up_z: Number, root: Callable[[Number], Number]
) -> Number:
    """Return tau of the module text; ``z``, ``up_z``: of the horizontal and of up, before they are stretched."""
    product, horizontal2 = tilt * z * up_z, 1.0 + tilt * z * z
    aside2 = up2 * horizontal2 - product * product
    return (product + root(product * product - up2 * (horizontal2 - aside2 * reach2))) / up2


def _shared_out(axis: RayAxis, heights_m: Sequence[float]) -> tuple[int, ...]:
    """Return how many patches lie between borders: one at least, and more where the axis is longer."""
    ends = [0.0, *(math.asinh(height / axis.dense) for height in heights_m)]
    lengths = [high - low for low, high in pairwise(ends)]
    counts = [1] * len(lengths)
    for _ in range(ROW_PATCHES - len(lengths)):
        widest = max(range(len(lengths)), key=lambda k: lengths[k] / counts[k])
        counts[widest] += 1
    return tuple(counts)


USUAL = 1e-3
"""Accuracy at which tables have the steps that the constants below say."""
MORE_NODES = 2.0
"""Times the evaluations of the direct march at the usual accuracy."""
OF_A_KINK = 4.0
"""How many accuracies the splines through every second node may miss. The spline through all of them halves that at a
kink, and divides it by sixteen where radiance is smooth."""
FAINT = 0.01
"""A light that brightens no limb all round by this share of the accuracy is left out."""
LEAST_TRANSMITTANCE, LEAST_BENDING_RAD = 0.1, 0.01
"""Smaller ones may have their error."""
SURVEY_ROWS, SURVEY_AZIMUTHS = 12, 24


@dataclass(frozen=True)
class Light:
    """What shines in the air of a frame's batches: a batch for each of them, None where it does not shine.

    ``name``: "sun", "moon" or "glow"; ``direction``: to the Sun or Moon; ``top_m``: nothing scatters or glows above;
    ``nodes``: evaluations along a ray of the direct march; ``accuracy``: of tables, as a share of the bright limb.
    """

    name: str
    batches: Sequence[SolarNodes | GlowNodes | None]
    direction: Vec
    top_m: float
    nodes: int
    accuracy: float

    @property
    def edges_m(self) -> set[float]:
        """Heights at which layers of thin cloud, or of airglow, begin and end."""
        return {edge for batch in self.batches if batch is not None for band in batch.bands for edge in band[:2]}

    def in_layer(self, height_m: float) -> bool:
        """Return whether a layer of thin cloud, or of airglow, is at a height."""
        bands = [band for batch in self.batches if batch is not None for band in batch.bands]
        return any(band.base_m < height_m < band.top_m for band in bands)

    @property
    def gapped(self) -> list[list[int]]:
        """Return the numbers of the layers with gaps between neighbouring edges, from the highest on."""
        spans: dict[int, tuple[float, float]] = {}
        for batch in self.batches:
            for layer in () if batch is None else batch.gapped:
                assert batch is not None
                cloudy = np.flatnonzero(np.array(layer.extinction).reshape(-1, batch.width).any(axis=1))
                if len(cloudy):
                    z = np.array(batch.grid.altitude_m)
                    spans[layer.number] = float(z[cloudy[0]]), float(z[cloudy[-1]])
        between = [0.5 * (high + low) for high, low in pairwise(sorted(self.edges_m, reverse=True))]
        return [[n for n, (low, high) in spans.items() if low <= height <= high] for height in between]

    @property
    def gaps_apart(self) -> bool:
        """Whether no two layers with gaps share a height."""
        return all(len(numbers) < 2 for numbers in self.gapped)

    @property
    def air_ends_m(self) -> tuple[float, float]:
        """Two neighbouring nodes between which scattering of the batches' columns ends.

        Both ``top_m`` if not below it.
        """
        ends = []
        for batch in self.batches:
            if isinstance(batch, SolarNodes) and batch.columns is None:
                air = np.flatnonzero(np.array(batch.extinction).reshape(-1, batch.width).any(axis=1))
                nodes_m = np.array(batch.grid.altitude_m)
                if len(air):
                    last, above = (float(nodes_m[min(air[-1] + k, len(nodes_m) - 1)]) for k in (0, 1))
                    ends.append((min(above, self.top_m), min(last, self.top_m)))
            elif batch is not None:
                ends.append((self.top_m, self.top_m))
        top, last = max(ends, default=(self.top_m, self.top_m))
        return last, top

    @property
    def over_varied_ground(self) -> bool:
        """Whether the ground's part of the light is kept apart."""
        return any(isinstance(b, SolarNodes) and b.bounce is not None for b in self.batches)

    @property
    def times_steps(self) -> float:
        """Return how many times the steps at the usual accuracy are taken: the march is of fourth order."""
        return (USUAL / self.accuracy) ** 0.25

    def shines_everywhere(self, coordinates: RayCoordinates) -> bool:
        """Return whether the light is up wherever air is in sight, so that no shadow cuts a ray."""
        r, planet = float(np.linalg.norm(coordinates.origin)), coordinates.planet
        radius = min(planet.a_m, planet.b_m)
        reach = math.acos(min(radius / r, 1.0)) + math.acos(radius / (radius + self.top_m))
        toward = np.array([float(c[0]) for c in self.direction])
        zenith = math.acos(max(min(float(coordinates.origin @ toward) / r, 1.0), -1.0))
        # 1 deg for the ellipsoid's normals
        return zenith + reach < math.radians(89.0)

    def march(
        self,
        batch: SolarNodes | GlowNodes,
        coordinates: RayCoordinates,
        o: Vec,
        d: Vec,
        to_ground: bool,
        cloud: tuple[mi.Bool, mi.Float64] | None = None,
    ) -> AirMarch:
        """March as rays of the table are."""
        return march_air(
            coordinates.planet,
            self.top_m,
            batch,
            o,
            d,
            self.direction,
            mi.Bool(to_ground),
            round(MORE_NODES * self.times_steps * self.nodes),
            cloud,
            lit=self.shines_everywhere(coordinates),
        )

    def march_to_stations(
        self,
        batch: SolarNodes | GlowNodes,
        coordinates: RayCoordinates,
        o: Vec,
        d: Vec,
        to_ground: bool,
        stations: SunlitStations,
        *,
        attenuated: bool = True,
    ) -> tuple[Values, Values, Values, mi.Float64 | None]:
        """Return what pieces between stations along rays add, as :func:`march_to_stations`."""
        return march_to_stations(
            coordinates.planet,
            self.top_m,
            batch,
            o,
            d,
            self.direction,
            to_ground,
            stations,
            attenuated=attenuated,
        )


def radiance_packet(batch: int) -> int:
    """Return which packet of a table holds the radiances of a batch; the transmittances are in the next."""
    return 2 * batch


def bending_packet(batches: int) -> int:
    """Return which packet holds the bending angle."""
    return 2 * batches


def bounce_packet(batches: int, bends: bool, batch: int) -> int:
    """Return which packet holds what a ground of reflected flux 1 adds to the radiances of a batch."""
    return 2 * batches + bends + batch


def packets_of(light: Light, bends: bool) -> int:
    """Return how many packets a table has."""
    count = len(light.batches)
    return bounce_packet(count, bends, count if light.over_varied_ground else 0)


def limb_plane(light: Light, planet: Planet, origin: FloatArray) -> RayPlane:
    """Return the plane of the survey of the limb."""
    return RayPlane.of(RayCoordinates.of(planet, origin, light.top_m), False, (), light.top_m)


def bright_limb(lights: Sequence[Light], planet: Planet, origin: FloatArray) -> FloatArray:
    """Return the radiance of the limb in every light, shape (lights, rows, azimuths, batches * 4).

    Of each row the largest from there on upwards.
    """
    width = PACKET * len(lights[0].batches)
    brightest = np.zeros((len(lights), SURVEY_ROWS, SURVEY_AZIMUTHS, width))
    turn = np.arange(SURVEY_AZIMUTHS) * (2.0 * np.pi / SURVEY_AZIMUTHS)
    x, azimuth = np.meshgrid(np.linspace(0.0, 1.0, SURVEY_ROWS), turn, indexing="ij")
    for number, light in enumerate(lights):
        found = _marched(light, limb_plane(light, planet, origin), x.ravel(), azimuth.ravel(), bends=False)
        for k in range(len(light.batches)):
            of_batch = slice(PACKET * radiance_packet(k), PACKET * radiance_packet(k) + PACKET)
            rows = found[:, of_batch].reshape(SURVEY_ROWS, SURVEY_AZIMUTHS, PACKET)
            brightest[number, ..., PACKET * k : PACKET * (k + 1)] = np.maximum.accumulate(rows[::-1])[::-1]
    return brightest


def brightest_air(lights: Sequence[Light], planet: Planet, origin: FloatArray, d: Vec) -> FloatArray:
    """Return the largest radiance of the air along rays to the ground, in all lights together, (batches * 4,)."""
    total = np.zeros(PACKET * len(lights[0].batches))
    for light in lights:
        coordinates = RayCoordinates.of(planet, origin, light.top_m)
        for k, batch in enumerate(light.batches):
            if batch is not None:
                air = light.march(batch, coordinates, vectors(origin[None, :]), d, True)
                dr.eval(air.radiance)
                total[PACKET * k : PACKET * k + batch.width] += [float(np.max(np.asarray(v))) for v in air.radiance]
    return total


def _marched(light: Light, plane: RayPlane, x: FloatArray, azimuth: FloatArray, bends: bool) -> FloatArray:
    """Return the quantities of a table at places."""
    d = vectors(plane.directions(x, azimuth))
    o = vectors(plane.coordinates.origin[None, :])
    count = len(light.batches)
    out = np.zeros((len(x), PACKET * packets_of(light, bends)))
    for k, batch in enumerate(light.batches):
        if batch is None:
            continue
        air = light.march(batch, plane.coordinates, o, d, plane.to_ground)
        bending = air.state[1]
        dr.eval(air.radiance, air.bounce, air.transmittance, bending)
        first = PACKET * radiance_packet(k)
        for n, (radiance, transmittance) in enumerate(zip(air.radiance, air.transmittance, strict=True)):
            out[:, first + n] = np.asarray(radiance)
            out[:, first + PACKET + n] = np.asarray(transmittance)
        for n, bounce in enumerate(air.bounce):
            out[:, PACKET * bounce_packet(count, bends, k) + n] = np.asarray(bounce)
        if bends and bending is not None:
            out[:, PACKET * bending_packet(count)] = np.asarray(bending)
    return out


def sunlit_air(light: Light, plane: RayPlane, bright: FloatArray, bends: bool) -> PatchTable:
    """Return an empty table of a light's air over a plane of rays. ``bends``: whether to keep the bending angle."""

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        return _marched(light, plane, x, azimuth, bends)

    return air_table(light, values, *_scales(light, bright, bends))


def _scales(light: Light, bright: FloatArray, bends: bool) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the arguments of :func:`air_table`; ``bright``: radiance of the bright limb, (batches * 4,)."""
    packets, count = packets_of(light, bends), len(light.batches)
    scale, own = np.zeros((packets, PACKET)), np.zeros((packets, PACKET), dtype=bool)
    for k in range(count):
        of_batch = bright[PACKET * k : PACKET * (k + 1)]
        scale[radiance_packet(k)] = of_batch
        if light.over_varied_ground:
            scale[bounce_packet(count, bends, k)] = of_batch
    scale[1 : 2 * count : 2], own[1 : 2 * count : 2] = LEAST_TRANSMITTANCE, True
    if bends:
        scale[bending_packet(count)], own[bending_packet(count)] = LEAST_BENDING_RAD, True
    return scale.ravel(), own.ravel()


def air_table(
    light: Light,
    values: Callable[[FloatArray, FloatArray], FloatArray],
    scale: FloatArray,
    own: NDArray[np.bool_],
    *,
    single: bool = False,
) -> PatchTable:
    """Return an empty table of ``values``, with an error that is the light's accuracy.

    As a share of ``scale``, shape (quantities,), or of values themselves where ``own`` and they are larger.
    """
    miss = OF_A_KINK * light.accuracy

    def allowed(known: FloatArray) -> FloatArray:
        found = np.broadcast_to(scale, known.shape).copy()
        found[..., own] = np.maximum(np.abs(known[..., own]), scale[own])
        found *= miss
        return found

    return PatchTable(Tabulated(values, allowed, len(scale), single=single))


STATIONS, STATIONS_TO_GROUND = 19, 13
"""Stations on rays past the ground and on rays to it, without layers. Every edge of a layer that cuts the way adds
:data:`LEAST_INTERVALS`."""
STEPS, STEPS_BEFORE = 3, 24
"""Steps of the march from one station to the next, and up to the first, at the usual accuracy."""
IN_SHADOW_BEFORE = 2
"""Factor on :data:`STEPS_BEFORE` where the Earth's shadow may cut rays; three pieces then share them."""
ABOVE_TOPS_M = 3000.0
"""Height of the first station above the highest cloud: at a layer's edge a ray's path has a square root in height."""
LEAST_INTERVALS = 3
"""Of a piece: a cubic goes through four stations."""


@dataclass(frozen=True)
class StationPlace:
    """Places among the stations: the first of the four around, and how far from it, in stations."""

    lowest: mi.UInt32
    beyond: mi.Float64


def stations_along(
    light: Light, coordinates: RayCoordinates, o: Vec, d: Vec, to_ground: bool, top_m: float
) -> SunlitStations:
    """Return the stations along rays before clouds whose highest top is at ``top_m``."""
    planet, highest = coordinates.planet, top_m + ABOVE_TOPS_M
    levels = sorted((edge for edge in light.edges_m if 0.0 < edge < highest), reverse=True)
    first, last = way_through(planet, o, d, constant(highest), to_ground)
    down: list[mi.Float64] = []
    up: list[mi.Float64] = []
    for level in levels:
        mid, half, _ = planet.chord(o, d, constant(level))
        down.append(mid - half)
        up.insert(0, mid + half)
    cuts = [first]
    for t in [*down, *([] if to_ground else up)]:
        cuts.append(dr.clip(t, cuts[-1], last))
    heights = [highest, *levels, 0.0]
    numbers = _numbers(heights, to_ground)
    shadow = not light.shines_everywhere(coordinates)
    before = 3 * math.ceil(light.times_steps * STEPS_BEFORE * (IN_SHADOW_BEFORE if shadow else 1) / 3)
    inside = (light.in_layer(0.5 * sum(ends)) for ends in pairwise(heights))
    steps = 3 * math.ceil(light.times_steps * STEPS / 3)
    each = [(2 if layer else 1) * steps for layer in inside]
    if not to_ground:
        each += each[-2::-1]
    taken = [0, *accumulate(n * (end - begin) for n, (begin, end) in zip(each, pairwise(numbers), strict=True))]
    return SunlitStations(
        (*cuts, last),
        tuple(constant(n) for n in numbers),
        tuple(constant(n) for n in taken),
        numbers[-1] + 1,
        taken[-1],
        before,
        shadow,
    )


def _numbers(heights_m: Sequence[float], to_ground: bool) -> list[int]:
    """Return the numbers of the stations at the ends of pieces between heights, falling to the ground.

    Intervals are divided by what a ray needs for each piece: by thickness where it meets the ground, and else by the
    path of one that grazes it.
    """
    reach = [h if to_ground else math.sqrt(h) for h in heights_m]
    ways = [high - low for high, low in pairwise(reach)]
    if not to_ground:
        ways = [*ways[:-1], 2.0 * ways[-1], *reversed(ways[:-1])]
    free = (STATIONS_TO_GROUND if to_ground else STATIONS) - 1 - LEAST_INTERVALS
    shares = [LEAST_INTERVALS + math.floor(free * way / sum(ways)) for way in ways]
    longest = shares.index(max(shares))
    shares[longest] += free + LEAST_INTERVALS * len(ways) - sum(shares)
    return [0, *accumulate(shares)]


def cloudy_air(light: Light, plane: RayPlane, bright: FloatArray, top_m: float) -> PatchTable:
    """Return an empty table of a light's air before clouds whose highest top is at ``top_m``; as :func:`sunlit_air`."""
    coordinates, to_ground = plane.coordinates, plane.to_ground
    o = vectors(coordinates.origin[None, :])
    packets, count = packets_of(light, bends=False), len(light.batches)
    one = vectors(plane.directions(np.zeros(1), np.zeros(1)))
    stations_a_ray = stations_along(light, coordinates, o, one, to_ground, top_m).count

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = vectors(plane.directions(x, azimuth))
        stations = stations_along(light, coordinates, o, d, to_ground, top_m)
        out = np.zeros((len(x), stations.count, packets, PACKET))
        for k, batch in enumerate(light.batches):
            if batch is None:
                continue
            parts = light.march_to_stations(batch, coordinates, o, d, to_ground, stations)
            dr.eval(parts)
            radiance, bounce, depth = (
                np.array([np.asarray(v).reshape(stations.count, -1).T for v in part]) for part in parts[:3]
            )
            through = np.exp(-np.cumsum(depth, axis=-1))
            before = np.concatenate([np.ones_like(through[..., :1]), through[..., :-1]], axis=-1)
            out[:, :, 2 * k, : batch.width] = np.moveaxis(np.cumsum(before * radiance, axis=-1), 0, -1)
            out[:, :, 2 * k + 1, : batch.width] = np.moveaxis(through, 0, -1)
            if len(bounce):
                summed = np.moveaxis(np.cumsum(before * bounce, axis=-1), 0, -1)
                out[:, :, bounce_packet(count, False, k), : batch.width] = summed
        return out.reshape(len(x), -1)

    scale, own = _scales(light, bright, bends=False)
    return air_table(light, values, np.tile(scale, stations_a_ray), np.tile(own, stations_a_ray), single=True)


def place_among(stations: SunlitStations, t: mi.Float64) -> StationPlace:
    """Return the places of cloud tops at ray parameters ``t``."""
    low, high, first, last = stations.piece(lambda k: t >= stations.cuts[k])
    number = dr.fma(dr.clip((t - low) / dr.maximum(high - low, 1e-3), 0.0, 1.0), last - first, first)
    lowest = dr.clip(dr.floor(number) - 1.0, first, last - LEAST_INTERVALS)
    return StationPlace(mi.UInt32(lowest), number - lowest)


def look_at_stations(
    table: PatchTable, x: mi.Float64, azimuth: mi.Float64, place: StationPlace, each: int, packets: Sequence[int]
) -> Values:
    """Return the quantities of some packets of a station at places along rays; ``each``: packets of a station."""
    w = place.beyond
    weights = [
        -(w - 1.0) * (w - 2.0) * (w - 3.0) * (1.0 / 6.0),
        w * (w - 2.0) * (w - 3.0) * 0.5,
        -w * (w - 1.0) * (w - 3.0) * 0.5,
        w * (w - 1.0) * (w - 2.0) * (1.0 / 6.0),
    ]
    read = [(place.lowest + k) * each + packet for k in range(4) for packet in packets]
    values = table.look(x, azimuth, read)
    width = PACKET * len(packets)
    total = [mi.Float64(0.0)] * width
    for k, weight in enumerate(weights):
        total = [dr.fma(weight, v, t) for v, t in zip(values[k * width : (k + 1) * width], total, strict=True)]
    return total
