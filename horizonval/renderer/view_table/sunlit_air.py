r"""What a view table of sunlight holds: for every spectral node the radiance of the air and its transmittance.

Rays of the table are marched once, with :data:`MORE_NODES` times the evaluations of the direct march, or half of that,
without what reflects at the rays' ends. With refraction the table also holds the bending angle at the rays' ends.

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

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.frame_geometry import RayAxis, RayCoordinates
from horizonval.renderer.kernel.march import AirMarch, SunlitStations, march_air, march_to_stations
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.planet import SOLAR_CONCENTRATION, way_through
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


MORE_NODES, MORE_NODES_IN_HAZE = 4, 2
"""Times the evaluations of the direct march; the latter with particles, on rays that no shadow cuts, past the ground or
through layers of thin cloud, which distribute as many above and below. The parabolas of the diffuse source
(:mod:`horizonval.renderer.kernel.ray_sources`) leave an error of 9e-6 in the median."""
TOLERANCE, TOLERANCE_IN_TWILIGHT = 5e-4, 2e-3
"""Of the prediction, as a share of the radiance: with the Sun up at the camera, and for a low Sun, Moon and airglow."""
TOLERANCE_IN_HAZE = 1.7e-4
"""With the Sun up, but lower than 75 deg from the zenith, in air with particles."""
TOLERANCE_ON_A_MAP = 2e-3
"""Through columns on a map, whose structure needs many patches; half of it costs 2.2 to 3.2 times the time."""
HIGH_SUN, LOW_SUN = math.cos(math.radians(85.5)), math.cos(math.radians(75.0))
FAINTEST = 1e-6
"""Radiances below this share of the brightest may have its error."""
OPAQUE = 0.05
"""Transmittances below this may have its error."""
BENT_RAD = 0.01
"""Bending angles below this may have its error."""
SURVEY_ROWS, SURVEY_AZIMUTHS = 9, 12


@dataclass(frozen=True)
class Light:
    """What shines in the air of a frame's batches: a batch for each of them, None where it does not shine.

    ``name``: "sun", "moon" or "glow"; ``direction``: to the Sun or Moon; ``top_m``: nothing scatters or glows above;
    ``nodes``: evaluations along a ray of the direct march.
    """

    name: str
    batches: Sequence[SolarNodes | GlowNodes | None]
    direction: Vec
    top_m: float
    nodes: int

    @property
    def edges_m(self) -> set[float]:
        """Heights at which layers of thin cloud, or of airglow, begin and end."""
        return {edge for batch in self.batches if batch is not None for band in batch.bands for edge in band[:2]}

    def in_layer(self, height_m: float) -> bool:
        """Return whether a layer of thin cloud, or of airglow, is at a height."""
        bands = [band for batch in self.batches if batch is not None for band in batch.bands]
        return any(band.base_m < height_m < band.top_m for band in bands)

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

    def tolerance(self, coordinates: RayCoordinates, looser: float = 1.0) -> float:
        """Return the light's table error as a share of the radiance.

        ``looser`` times it for a Sun at most 75 deg from zenith.
        """
        up = coordinates.origin / np.linalg.norm(coordinates.origin)
        cosine = float(up @ np.array([float(c[0]) for c in self.direction]))
        if self.name != "sun" or cosine <= HIGH_SUN:
            return TOLERANCE_IN_TWILIGHT
        if any(isinstance(batch, SolarNodes) and batch.on_a_map for batch in self.batches):
            return TOLERANCE_ON_A_MAP
        hazy = any(isinstance(batch, SolarNodes) and batch.particles is not None for batch in self.batches)
        if cosine < LOW_SUN:
            return TOLERANCE_IN_HAZE if hazy else TOLERANCE
        return looser * TOLERANCE

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
        hazy = isinstance(batch, SolarNodes) and batch.particles is not None
        lit = self.shines_everywhere(coordinates)
        fewer = hazy and lit and (not to_ground or bool(batch.bands))
        more = MORE_NODES_IN_HAZE if fewer else MORE_NODES
        return march_air(
            coordinates.planet,
            self.top_m,
            batch,
            o,
            d,
            self.direction,
            mi.Bool(to_ground),
            more * self.nodes,
            SOLAR_CONCENTRATION,
            cloud,
            steady=True,
            lit=lit,
        )

    def march_to_stations(
        self,
        batch: SolarNodes | GlowNodes,
        coordinates: RayCoordinates,
        o: Vec,
        d: Vec,
        to_ground: bool,
        stations: SunlitStations,
    ) -> tuple[Values, Values, Values]:
        """March up to stations along the rays."""
        return march_to_stations(
            coordinates.planet,
            self.top_m,
            batch,
            o,
            d,
            self.direction,
            to_ground,
            SOLAR_CONCENTRATION,
            stations,
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


def sunlit_air(light: Light, plane: RayPlane, bends: bool) -> PatchTable:
    """Return an empty table of a light's air over a plane of rays. ``bends``: whether to keep the bending angle."""
    coordinates, to_ground = plane.coordinates, plane.to_ground
    o = vectors(coordinates.origin[None, :])
    count = len(light.batches)
    quantities = PACKET * packets_of(light, bends)

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = vectors(plane.directions(x, azimuth))
        out = np.zeros((len(x), quantities))
        for k, batch in enumerate(light.batches):
            if batch is None:
                continue
            air = light.march(batch, coordinates, o, d, to_ground)
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

    return air_table(light, coordinates, values, bends)


def air_table(
    light: Light,
    coordinates: RayCoordinates,
    values: Callable[[FloatArray, FloatArray], FloatArray],
    bends: bool = False,
    stations: int = 1,
    looser: float = 1.0,
) -> PatchTable:
    """Return an empty table of ``values``: the quantities of :func:`sunlit_air` for every station."""
    x, azimuth = np.meshgrid(
        np.linspace(0.0, 1.0, SURVEY_ROWS), np.arange(SURVEY_AZIMUTHS) * (2.0 * np.pi / SURVEY_AZIMUTHS)
    )
    packets, count = packets_of(light, bends), len(light.batches)
    packet = np.arange(packets * PACKET) // PACKET
    ground = packet >= bounce_packet(count, bends, 0)
    tolerance = light.tolerance(coordinates, looser)
    # what the ground adds may be as far off as the radiance that it is added to
    scale = np.where(ground, packet - bounce_packet(count, bends, 0), 0) * 2 * PACKET + np.arange(len(packet)) % PACKET
    scale = np.where(ground, scale, np.arange(len(packet)))
    floors: list[FloatArray] = []

    def values_first(place: FloatArray, turned: FloatArray) -> FloatArray:
        """March the survey beside the first nodes: a launch less."""
        if floors:
            return values(place, turned)
        found = values(np.concatenate([place, x.ravel()]), np.concatenate([turned, azimuth.ravel()]))
        brightest = found[len(place) :].reshape(-1, stations, packets * PACKET).max(axis=(0, 1))
        radiances = (packet % 2 == 0) | (packet >= 2 * count)
        floor = np.where(radiances, np.maximum(FAINTEST * brightest, 1e-30), OPAQUE)
        if bends:
            floor[packet == bending_packet(count)] = BENT_RAD
        floors.append(np.tile(floor[scale], stations))
        return found[: len(place)]

    def allowed(known: FloatArray) -> FloatArray:
        size = np.abs(known)
        largest = np.maximum(size, floors[0])
        if ground.any():
            by_packet = (*known.shape[:-1], stations, packets, PACKET)
            theirs, ours = largest.reshape(by_packet), size.reshape(by_packet)
            for k in range(count):
                of_ground = theirs[..., bounce_packet(count, bends, k), :]
                np.maximum(of_ground, ours[..., radiance_packet(k), :], out=of_ground)
        largest *= tolerance
        return largest

    return PatchTable(Tabulated(values_first, allowed, packets * PACKET * stations, single=stations > 1))


STATIONS = 48
STEPS, STEPS_BEFORE = 1, 48
"""Of the march: from one station to the next, and up to the first, with the dense haze of a great eruption above."""
STEPS_IN_LAYER = 4
"""From one station to the next in layers of thin cloud, which few stations cross; error 7e-6 in the median."""
IN_SHADOW, IN_SHADOW_BEFORE = 6, 12
"""How many times as many where the Earth's shadow may cut rays, where each of three pieces has a third of them."""
ABOVE_TOPS_M = 3000.0
"""Height of the first station above the highest cloud: at a layer's edge a ray's path has a square root in height."""
LOOSER = 2.0
"""Times the tolerance of the air's other tables, with the Sun at most 75 deg from the zenith: with so few steps from
station to station the profiles' kinks are visible, and halving a patch halves the error instead of dividing it by 16.
"""
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
    times, before = (IN_SHADOW, IN_SHADOW_BEFORE * STEPS_BEFORE) if shadow else (1, STEPS_BEFORE)
    inside = (light.in_layer(0.5 * sum(ends)) for ends in pairwise(heights))
    each = [times * (STEPS_IN_LAYER if layer else STEPS) for layer in inside]
    if not to_ground:
        each += each[-2::-1]
    taken = [0, *accumulate(n * (end - begin) for n, (begin, end) in zip(each, pairwise(numbers), strict=True))]
    return SunlitStations(
        (*cuts, last),
        tuple(constant(n) for n in numbers),
        tuple(constant(n) for n in taken),
        STATIONS,
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
    free = STATIONS - 1 - LEAST_INTERVALS * len(ways)
    shares = [LEAST_INTERVALS + math.floor(free * way / sum(ways)) for way in ways]
    longest = shares.index(max(shares))
    shares[longest] += STATIONS - 1 - sum(shares)
    return [0, *accumulate(shares)]


def cloudy_air(light: Light, plane: RayPlane, top_m: float) -> PatchTable:
    """Return an empty table of a light's air before clouds whose highest top is at ``top_m``; as :func:`sunlit_air`."""
    coordinates, to_ground = plane.coordinates, plane.to_ground
    o = vectors(coordinates.origin[None, :])
    packets, count = packets_of(light, bends=False), len(light.batches)

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = vectors(plane.directions(x, azimuth))
        stations = stations_along(light, coordinates, o, d, to_ground, top_m)
        out = np.zeros((len(x), STATIONS, packets, PACKET))
        for k, batch in enumerate(light.batches):
            if batch is None:
                continue
            radiance, bounce, transmittance = light.march_to_stations(batch, coordinates, o, d, to_ground, stations)
            dr.eval(radiance, bounce, transmittance)
            for n, (r, t) in enumerate(zip(radiance, transmittance, strict=True)):
                out[:, :, 2 * k, n] = np.asarray(r).reshape(STATIONS, -1).T
                out[:, :, 2 * k + 1, n] = np.asarray(t).reshape(STATIONS, -1).T
            for n, b in enumerate(bounce):
                out[:, :, bounce_packet(count, False, k), n] = np.asarray(b).reshape(STATIONS, -1).T
        return out.reshape(len(x), -1)

    return air_table(light, coordinates, values, stations=STATIONS, looser=LOOSER)


def place_among(stations: SunlitStations, t: mi.Float64) -> StationPlace:
    """Return the places of cloud tops at ray parameters ``t``."""
    low, high, first, last = stations.piece(lambda k: t >= stations.cuts[k])
    number = dr.fma(dr.clip((t - low) / dr.maximum(high - low, 1e-3), 0.0, 1.0), last - first, first)
    lowest = dr.clip(dr.floor(number) - 1.0, first, last - LEAST_INTERVALS)
    return StationPlace(mi.UInt32(lowest), number - lowest)


def look_at_stations(
    table: PatchTable, x: mi.Float64, azimuth: mi.Float64, place: StationPlace, packets: Sequence[int]
) -> Values:
    """Return the quantities of some packets of a station at places along rays."""
    each = table.tabulated.quantities // (PACKET * STATIONS)
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
