"""What a view table of sunlight holds: for every spectral node the radiance of the air and its transmittance.

Rays of the table are marched once, with :data:`MORE_NODES` times the evaluations of the direct march, or half of that.
Whatever reflects at the rays' ends is left out. With refraction the bending angle at the rays' ends is there too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.march import AirMarch, SunlitStations, march_air, march_to_stations
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Values, Vec
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable, Tabulated
from horizonval.renderer.view_table.ray_plane import RayPlane

MORE_NODES, MORE_NODES_IN_HAZE = 4, 2
"""Times the evaluations of the direct march; the latter with particles, on rays that no shadow cuts, past the ground or
through layers of thin cloud, which share out as many above and below.
The parabolas of the diffuse source (:mod:`horizonval.renderer.kernel.ray_sources`) leave those good to 9e-6 in the
median; frames of the ground were off by 5e-5."""
TOLERANCE, TOLERANCE_IN_TWILIGHT = 5e-4, 2e-3
"""Of the prediction (:mod:`horizonval.renderer.view_table.patch_table`), as a share of the radiance: with the Sun up
where the camera is, and for a low Sun, the Moon and airglow."""
TOLERANCE_IN_HAZE = 1.7e-4
"""With the Sun up, but lower than 75 deg from the zenith, in air with particles; with 5e-4 and 2.5e-4 the median of a
frame under a Sun at 85 deg was 2.8e-5 and 2.1e-5."""
TOLERANCE_ON_A_MAP = 2e-3
"""Through columns on a map, whose structure asks for many patches: with 5e-4 frames took 2.2 to 3.2 times the time, and
their worst pixels under a Sun at 50 and 80 deg were off by 2.4e-4 in place of 5e-4 and 7e-4."""
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
        """Heights between which what scatters in the batches' own columns ends: two neighbouring nodes of theirs.

        Both are ``top_m`` where it does not end below.
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
        """Return what the light's tables may be off, as a share of the radiance.

        ``looser``: times that of others under a Sun at most 75 deg from the zenith.
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
    """Return an empty table of ``values``, whose quantities are, for every station, those of :func:`sunlit_air`.

    ``looser``: as of :meth:`Light.tolerance`.
    """
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
