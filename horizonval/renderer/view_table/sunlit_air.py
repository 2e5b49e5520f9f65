r"""What a view table of sunlight holds: for every spectral node the radiance of the air and its transmittance.

Rays of the table are marched once, with :data:`MORE_NODES` times the evaluations of the direct march, or half of that,
without what reflects at the rays' ends.

**Air before clouds**: radiance and transmittance from the camera to stations along rays.
The stations lie between where a ray enters the layer of the cloud tops and where it leaves it or meets the ground. The
edges of layers of thin cloud cut that stretch into pieces, each with a fixed number of stations, evenly spaced:
radiance and transmittance have a kink at a layer's edge, which must not move past a station from ray to ray.
A ray that ends on a cloud uses Lagrange's cubic through the four stations of one piece around its end.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, RayCoordinates
from horizonval.renderer.kernel.march import AirMarch, SunlitStations, march_air, march_to_stations
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.planet import way_through
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.ray_table import HALVED, HALVED_AT_EDGES, PACKET, RayPlane, RayTable
from horizonval.renderer.view_table.stations import LEAST_INTERVALS, StationPlace

USUAL = 1e-3
"""Accuracy at which tables have the steps that the constants below say."""
MORE_NODES, MORE_NODES_IN_SHADOW = 2.0, 4.0
"""Times the evaluations of the direct march at the usual accuracy, without and with a shadow that may cut rays."""
OF_A_KINK = 4.0
"""How many accuracies the splines through every second node may miss. The spline through all of them halves that at a
kink, and divides it by sixteen where radiance is smooth."""
FAINT = 0.01
"""A light that brightens no limb all round by this share of the accuracy is left out."""
LEAST_TRANSMITTANCE = 0.1
"""Smaller ones may have its error."""
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
    def over_varied_ground(self) -> bool:
        """Whether the ground's part of the light is kept apart."""
        return any(isinstance(b, SolarNodes) and b.bounce is not None for b in self.batches)

    @property
    def packets(self) -> int:
        """Packets of a batch in tables: radiance, transmittance, and perhaps what a ground of flux 1 adds."""
        return 3 if self.over_varied_ground else 2

    def packets_of(self, nodes: SolarNodes | GlowNodes, batch: int) -> list[int]:
        """Return the packets of a batch of nodes; ``batch``: its index."""
        apart = isinstance(nodes, SolarNodes) and nodes.bounce is not None
        return [batch * self.packets + m for m in range(2 + apart)]

    @property
    def times_steps(self) -> float:
        """Return how many times the steps at the usual accuracy are taken: the march is of fourth order."""
        return (USUAL / self.accuracy) ** 0.25

    def in_thirds(self, steps: int) -> int:
        """Return as many steps as the accuracy needs in place of the usual ones, a multiple of three."""
        return 3 * math.ceil(self.times_steps * steps / 3)

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
    ) -> AirMarch:
        """March as rays of the table are."""
        lit = self.shines_everywhere(coordinates)
        more = MORE_NODES if lit else MORE_NODES_IN_SHADOW
        return march_air(
            coordinates.planet,
            self.top_m,
            batch,
            o,
            d,
            self.direction,
            mi.Bool(to_ground),
            round(more * self.times_steps * self.nodes),
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


def lights_of(view: FrameGeometry, batches: Sequence[SolarNodes], nodes: int, accuracy: float) -> list[Light]:
    """Return what may shine in the air: Sun, Moon, and the air itself."""
    glow = [b.glow for b in batches]
    moonlit = view.moon is not None and view.moon.lights_earth
    moon = [b.in_moonlight() if b.moonlight is not None and moonlit else None for b in batches]
    solar: list[SolarNodes | None] = list(batches)
    if view.sunless:
        solar = [b if g is None and m is None else None for b, g, m in zip(batches, glow, moon, strict=True)]
    lights = [Light("sun", solar, view.sun, view.top_m, nodes, accuracy)]
    if view.moon is not None:
        lights.append(Light("moon", moon, view.moon.light, view.top_m, nodes, accuracy))
    # airglow is known to a factor of two: 0.6 % of error in it, with half the nodes, is plenty
    lights.append(Light("glow", glow, view.sun, view.highest_m, max(nodes // 2, 8), accuracy))
    return lights


def limb_plane(light: Light, view: FrameGeometry) -> RayPlane:
    """Return the plane of the survey of the limb."""
    return RayPlane(view.coordinates(light.top_m), False)


def bright_limb(lights: Sequence[Light], view: FrameGeometry) -> FloatArray:
    """Return the radiance of the limb in every light, shape (lights, rows, azimuths, batches * 4).

    Of each row the largest from there on upwards.
    """
    width = PACKET * len(lights[0].batches)
    brightest = np.zeros((len(lights), SURVEY_ROWS, SURVEY_AZIMUTHS, width))
    turn = np.arange(SURVEY_AZIMUTHS) * (2.0 * np.pi / SURVEY_AZIMUTHS)
    x, azimuth = np.meshgrid(np.linspace(0.0, 1.0, SURVEY_ROWS), turn, indexing="ij")
    for number, light in enumerate(lights):
        found = _marched(light, limb_plane(light, view), x.ravel(), azimuth.ravel())
        rows = found[:, :, 0].reshape(SURVEY_ROWS, SURVEY_AZIMUTHS, width)
        brightest[number] = np.maximum.accumulate(rows[::-1])[::-1]
    return brightest


def brightest_air(lights: Sequence[Light], view: FrameGeometry, d: Vec) -> FloatArray:
    """Return the largest radiance of the air along rays to the ground, in all lights together, (batches * 4,)."""
    total = np.zeros(PACKET * len(lights[0].batches))
    for light in lights:
        coordinates = view.coordinates(light.top_m)
        for k, batch in enumerate(light.batches):
            if batch is not None:
                air = light.march(batch, coordinates, view.origin, d, True)
                dr.eval(air.radiance)
                total[PACKET * k : PACKET * k + batch.width] += [float(np.max(np.asarray(v))) for v in air.radiance]
    return total


def _marched(light: Light, plane: RayPlane, x: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return the quantities of a table at places, shape (n, batches, packets, PACKET)."""
    out = np.zeros((len(x), len(light.batches), light.packets, PACKET))
    for k, batch in enumerate(light.batches):
        if batch is not None:
            air = light.march(batch, plane.coordinates, plane.camera, plane.directions(x, azimuth), plane.to_ground)
            dr.eval(air.radiance, air.bounce, air.transmittance)
            for m, part in enumerate((air.radiance, air.transmittance, air.bounce)):
                for n, value in enumerate(part):
                    out[:, k, m, n] = np.asarray(value)
    return out


def sunlit_air(light: Light, plane: RayPlane, bright: FloatArray) -> RayTable:
    """Return an empty table of a light's air over a plane of rays."""

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        return _marched(light, plane, x, azimuth).reshape(len(x), -1)

    return air_table(light, values, *_scales(light, bright))


def _scales(light: Light, bright: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the arguments of :func:`air_table`; ``bright``: radiance of the bright limb, (batches * 4,)."""
    shape = len(light.batches), light.packets, PACKET
    scale, own = np.broadcast_to(bright.reshape(-1, 1, PACKET), shape).copy(), np.zeros(shape, dtype=bool)
    scale[:, 1], own[:, 1] = LEAST_TRANSMITTANCE, True
    return scale.ravel(), own.ravel()


def air_table(
    light: Light,
    values: Callable[[FloatArray, FloatArray], FloatArray],
    scale: FloatArray,
    own: NDArray[np.bool_],
    *,
    single: bool = False,
) -> RayTable:
    """Return an empty table of ``values``, with an error that is the light's accuracy.

    As a share of ``scale``, shape (quantities,), or of values themselves where ``own`` and they are larger.
    """
    miss = OF_A_KINK * light.accuracy

    def allowed(known: FloatArray) -> FloatArray:
        found = np.broadcast_to(scale, known.shape).copy()
        found[..., own] = np.maximum(np.abs(known[..., own]), scale[own])
        found *= miss
        return found

    knots = HALVED_AT_EDGES if light.edges_m else HALVED
    return RayTable(values, len(scale), knots, allowed, single=single)


STATIONS, STATIONS_TO_GROUND = 19, 13
"""Stations on rays past the ground and on rays to it, without layers. Every edge of a layer that cuts the way adds
:data:`LEAST_INTERVALS`."""
STEPS, STEPS_BEFORE = 3, 24
"""Steps of the march from one station to the next, and up to the first, at the usual accuracy."""
IN_SHADOW_BEFORE = 2
"""Factor on :data:`STEPS_BEFORE` where the Earth's shadow may cut rays; three pieces then share them."""
ABOVE_TOPS_M = 3000.0
"""Height of the first station above the highest cloud: at a layer's edge a ray's path has a square root in height."""


def stations_along(
    light: Light, coordinates: RayCoordinates, o: Vec, d: Vec, to_ground: bool, top_m: float
) -> SunlitStations:
    """Return the stations along rays before clouds whose highest top is at ``top_m``."""
    highest = top_m + ABOVE_TOPS_M
    levels = sorted((edge for edge in light.edges_m if 0.0 < edge < highest), reverse=True)
    heights = [highest, *levels, 0.0]
    each = [(2 if light.in_layer(0.5 * sum(ends)) else 1) * STEPS for ends in pairwise(heights)]
    if not to_ground:
        each += each[-2::-1]
    way = way_through(coordinates.planet, o, d, constant(highest), to_ground)
    return stations_between(
        light, coordinates, o, d, way, levels, [] if to_ground else levels[::-1], _numbers(heights, to_ground), each
    )


def stations_between(
    light: Light,
    coordinates: RayCoordinates,
    o: Vec,
    d: Vec,
    way: tuple[mi.Float64, mi.Float64],
    down_m: Sequence[float],
    up_m: Sequence[float],
    numbers: Sequence[int],
    steps: Sequence[int],
) -> SunlitStations:
    """Return stations from the beginning to the end of a way, cut where rays cross heights downwards and upwards.

    ``numbers``: stations at the cuts; ``steps``: of the march between two stations of each piece, at the usual
    accuracy.
    """
    cuts, last = [way[0]], way[1]
    for level, sign in [*((level, -1.0) for level in down_m), *((level, 1.0) for level in up_m)]:
        mid, half, _ = coordinates.planet.chord(o, d, constant(level))
        cuts.append(dr.clip(dr.fma(half, sign, mid), cuts[-1], last))
    shadow = not light.shines_everywhere(coordinates)
    before = light.in_thirds(STEPS_BEFORE * (IN_SHADOW_BEFORE if shadow else 1))
    each = (light.in_thirds(n) * (end - begin) for n, (begin, end) in zip(steps, pairwise(numbers), strict=True))
    taken = [0, *accumulate(each)]
    places = tuple(constant(n) for n in numbers), tuple(constant(n) for n in taken)
    return SunlitStations((*cuts, last), *places, numbers[-1] + 1, taken[-1], before, shadow)


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


def cloudy_air(light: Light, plane: RayPlane, bright: FloatArray, top_m: float) -> RayTable:
    """Return an empty table of a light's air before clouds whose highest top is at ``top_m``; as :func:`sunlit_air`."""
    coordinates, to_ground, o = plane.coordinates, plane.to_ground, plane.camera
    one = plane.directions(np.zeros(1), np.zeros(1))
    stations_a_ray = stations_along(light, coordinates, o, one, to_ground, top_m).count

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = plane.directions(x, azimuth)
        stations = stations_along(light, coordinates, o, d, to_ground, top_m)
        out = np.zeros((len(x), stations.count, len(light.batches), light.packets, PACKET))
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
            out[:, :, k, 1, : batch.width] = np.moveaxis(through, 0, -1)
            for m, added in ((0, radiance), (2, bounce)):
                if len(added):
                    out[:, :, k, m, : batch.width] = np.moveaxis(np.cumsum(before * added, axis=-1), 0, -1)
        return out.reshape(len(x), -1)

    scale, own = _scales(light, bright)
    return air_table(light, values, np.tile(scale, stations_a_ray), np.tile(own, stations_a_ray), single=True)


def place_among(stations: SunlitStations, t: mi.Float64) -> StationPlace:
    """Return the places of cloud tops at ray parameters ``t``."""
    low, high, first, last = stations.piece(lambda k: t >= stations.cuts[k])
    number = dr.fma(dr.clip((t - low) / dr.maximum(high - low, 1e-3), 0.0, 1.0), last - first, first)
    return StationPlace.at(number, first, last)
