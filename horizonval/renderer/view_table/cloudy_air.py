"""What a view table holds of the air before clouds: radiance and transmittance from the camera to stations along rays.

The stations lie between where a ray enters the layer of the cloud tops and where it leaves it or meets the ground. The
edges of layers of thin cloud cut that way into pieces. Every piece has a number of stations of its own, evenly spaced:
radiance and transmittance have a kink at a layer's edge, and at a station of fixed number they would have one wherever
the edge comes past it from ray to ray.

A ray that ends on a cloud reads the stations beside its end, by Lagrange's cubic through four of one piece.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.march import SunlitStations
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.ray_path import way_through
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable
from horizonval.renderer.view_table.ray_plane import RayPlane
from horizonval.renderer.view_table.sunlit_air import Light, air_table, bounce_packet, packets_of

STATIONS = 48
STEPS, STEPS_BEFORE = 1, 48
"""Of the march: from one station to the next, and up to the first. With 32 before, haze of a great eruption, which lies
above the clouds in one dense layer, was off by 2.4e-5 in the median of a frame, with 48 and 64 by 6e-6 and 1.2e-5;
seventeen other frames drawn at random by at most 1.4e-5, 1.1e-5 and 1.1e-5. With two from one station to the next the
worst pixels under clouds were as far from the march."""
STEPS_IN_LAYER = 4
"""From one station to the next in layers of thin cloud, which few stations cross. With 1, 2 and 4 a frame under clouds
was off by 4e-3, 5e-4 and 1e-4, in the median by 1.4e-4, 3e-5 and 7e-6."""
IN_SHADOW, IN_SHADOW_BEFORE = 6, 12
"""How many times as many where the Earth's shadow may cut rays, where each of three pieces has a third of them."""
ABOVE_TOPS_M = 3000.0
"""The stations begin this much above the highest cloud: at the very edge of a layer a ray's way through it has a square
root in its height."""
LOOSER = 2.0
"""Times the tolerance of the air's other tables, with the Sun at most 75 deg from the zenith. With so few steps from
station to station profiles' kinks at their nodes show, a patch that is halved has half the error, not a sixteenth, and
what it misses is seen in few pixels. Of eight frames four took a third less rays, and none was further off, in its
worst pixel or the median. With the Sun at 80 deg in haze the worst went from 1.0e-3 to 1.7e-3."""
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

    Intervals are shared out by what a ray needs for each piece: by thickness where it meets the ground, and else by the
    way of one that grazes it.
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
