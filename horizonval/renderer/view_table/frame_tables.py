"""The view tables of a frame, and the radiance of rays from them.

A ray's radiance is that of the air before its end, from a table, and that of its end, which is computed ray by ray with
the table's transmittance. Rays that end on a cloud have separate tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.cells import Cells, FrameGeometry
from horizonval.renderer.kernel.march import with_ground
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.kernel.ray_sources import SunlitRays
from horizonval.renderer.kernel.surface import SurfaceHit
from horizonval.renderer.local_light import LocalLight
from horizonval.renderer.planet import find_path
from horizonval.renderer.refraction import ray_end
from horizonval.renderer.table_store import Table
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import Values, Vec, indices_where
from horizonval.renderer.view_table.broken_air import BrokenAir
from horizonval.renderer.view_table.ray_table import PACKET, RayPlane, RayTable
from horizonval.renderer.view_table.stations import StationPlace, look_at_stations
from horizonval.renderer.view_table.sunlit_air import (
    FAINT,
    Light,
    bright_limb,
    brightest_air,
    cloudy_air,
    limb_plane,
    place_among,
    stations_along,
    sunlit_air,
)

GROUND_SAMPLES = 64
"""Rays of a frame without a limb, by which it is known how bright its air is."""
DARKEST = 1e-6
"""Frames darker than this share of the brightest limb all round have the accuracy of such a frame."""


@dataclass(frozen=True)
class _Cloudy:
    """Rays of a group that end on clouds: their indices, and places in the table before clouds and in its stations."""

    table: RayTable
    index: mi.UInt32
    x: mi.Float64
    azimuth: mi.Float64
    station: StationPlace


@dataclass(frozen=True)
class _Looked:
    """A light as a group of rays sees it: its table, and the rays' places in it."""

    light: Light
    table: RayTable
    x: mi.Float64
    azimuth: mi.Float64
    cloudy: _Cloudy | None
    broken: BrokenAir | None


@dataclass(frozen=True)
class LitRays:
    """A group of rays with its place in the table of every light, by the lights' names."""

    direction: Vec
    to_ground: bool
    looked: dict[str, _Looked]


class FrameTables:
    """The view tables of a frame, cached and extended by each frame; ``ground``, ``limb``.

    Groups of rays, None if empty.
    """

    def __init__(
        self, view: FrameGeometry, cells: Cells, lights: Sequence[Light], digest: str, accuracy: float
    ) -> None:
        self.view, self.digest, self.accuracy = view, digest, accuracy
        self.ground: LitRays | None = None
        self.limb: LitRays | None = None
        self._lights = list(lights)
        self._local = LocalLight(view)
        self._bright = self._bright_limb(cells)
        clouds = None if view.ground is None else view.ground.model.clouds
        self._cloud_top_m = None if clouds is None else clouds.top_m

    @classmethod
    def of(
        cls,
        view: FrameGeometry,
        cells: Cells,
        hits: tuple[SurfaceHit | None, SurfaceHit | None],
        lights: Sequence[Light],
        digest: str,
        accuracy: float,
    ) -> FrameTables | None:
        """Find the places of a frame's rays, and make missing patches; None where nothing shines by table.

        Frames with gaps of thin cloud and opaque clouds, or with two layers with gaps at one height, are marched.
        ``hits``: where rays to the ground end, and rays past it; ``digest``: of air, planet and orders of scattering;
        ``accuracy``: error allowed, as a share of the bright limb.
        """
        lights = [light for light in lights if any(batch is not None for batch in light.batches)]
        clouds = view.ground is not None and view.ground.model.clouds is not None
        if not lights or (view.gap_maps and (clouds or not all(light.gaps_apart for light in lights))):
            return None
        tables = cls(view, cells, lights, digest, accuracy)
        if cells.ground.count:
            tables.ground = tables.lit(cells.ground.direction, True, hits[0])
        if cells.limb.count:
            tables.limb = tables.lit(cells.limb.direction, False, hits[1])
        return tables

    def lit(self, direction: Vec, to_ground: bool, hit: SurfaceHit | None) -> LitRays:
        """Find the places of rays in all tables, and make what is missing there. ``hit``: where they end."""
        looked = {}
        clouded = mi.UInt32()
        if hit is not None and self._cloud_top_m is not None:
            clouded = indices_where(hit.cloud)
        for light in self._lights:
            plane = RayPlane(self.view.coordinates(light.top_m), to_ground)
            x, azimuth = plane.place(self.view.origin, direction)
            dr.eval(x, azimuth)
            broken = BrokenAir(light, plane, self.view.gap_maps) if self.view.gap_maps else None
            table = self._table(light, plane, broken=broken)
            table.cover(x, azimuth)
            cloudy = None
            if dr.width(clouded):
                assert hit is not None
                cloudy = self._cloudy(light, plane, clouded, (x, azimuth), direction, hit)
            looked[light.name] = _Looked(light, table, x, azimuth, cloudy, broken)
        return LitRays(direction, to_ground, looked)

    def _cloudy(
        self,
        light: Light,
        plane: RayPlane,
        index: mi.UInt32,
        place: tuple[mi.Float64, mi.Float64],
        direction: Vec,
        hit: SurfaceHit,
    ) -> _Cloudy:
        assert self._cloud_top_m is not None
        x, azimuth, t = (dr.gather(mi.Float64, v, index) for v in (*place, hit.t))
        d0, d1, d2 = (dr.gather(mi.Float64, c, index) for c in direction)
        top_m = self._cloud_top_m
        o = self.view.origin
        stations = stations_along(light, plane.coordinates, o, (d0, d1, d2), plane.to_ground, top_m)
        station = place_among(stations, t)
        dr.eval(x, azimuth, station.lowest, station.beyond)
        table = self._table(light, plane, self._cloud_top_m)
        table.cover(x, azimuth)
        return _Cloudy(table, index, x, azimuth, station)

    def _bright_limb(self, cells: Cells) -> FloatArray:
        """Return the radiance of the frame's bright limb, (batches * 4,), and leave out lights that add nothing to it.

        By the azimuths of its rays past the ground, and the lowest of them; of a frame without any the brightest air
        before the ground. In steps of a factor of four below the brightest all round, so that frames from one position
        share tables.
        """
        view, lights = self.view, self._lights
        each = self._kept(lambda: bright_limb(lights, view), "bright limb", [self._key_of(light) for light in lights])
        around = np.maximum(each.sum(axis=0), 1e-30)
        bright = self._brightest_in_frame(cells, around)
        shares = (each[:, 0].max(axis=1) / bright).max(axis=1)
        self._lights = [light for light, share in zip(lights, shares, strict=True) if share > FAINT * self.accuracy]
        self._lights = self._lights or lights[:1]
        return bright

    def _brightest_in_frame(self, cells: Cells, around: FloatArray) -> FloatArray:
        brightest = around[0].max(axis=0)
        if cells.limb.count:
            rows, sectors = around.shape[:2]
            x, azimuth = limb_plane(self._lights[0], self.view).place(self.view.origin, cells.limb.direction)
            sector = mi.UInt32(dr.floor(azimuth * (0.5 / math.pi * sectors) + (sectors + 0.5))) % sectors
            seen = dr.zeros(mi.UInt32, sectors)
            dr.scatter(seen, mi.UInt32(1), sector)
            lowest = int(float(dr.min(x)[0]) * (rows - 1))
            found = around[lowest, np.asarray(seen) > 0].max(axis=0)
        elif cells.ground.count:
            some = table_of(mi.Float64, np.linspace(0.0, cells.ground.count - 1.0, GROUND_SAMPLES))
            x, y, z = (dr.gather(mi.Float64, c, mi.UInt32(some)) for c in cells.ground.direction)
            dr.eval(x, y, z)
            found = brightest_air(self._lights, self.view, (x, y, z))
        else:
            # A camera that sees only space.
            return np.asarray(brightest)
        found = np.maximum(found, DARKEST * brightest)
        return np.asarray(brightest * 4.0 ** np.floor(np.log(found / brightest) / math.log(4.0)))

    def _kept(self, make: Callable[[], Table], *key: object) -> Table:
        return self.view.position.table(make, self.digest, self.accuracy, *key)

    @staticmethod
    def _key_of(light: Light) -> tuple[object, ...]:
        toward = tuple(float(c[0]) for c in light.direction)
        return light.name, toward, light.nodes, tuple(b is not None for b in light.batches)

    def _table(
        self, light: Light, plane: RayPlane, cloud_top_m: float | None = None, broken: BrokenAir | None = None
    ) -> RayTable:
        """Return the table of a light's air, or of that before clouds, made so far."""
        names = [self._key_of(other) for other in (light, *self._lights)]
        key = names, self._bright.tolist(), plane.to_ground, cloud_top_m, broken is not None

        def make() -> RayTable:
            if broken is not None:
                return broken.table(self._bright)
            if cloud_top_m is None:
                return sunlit_air(light, plane, self._bright)
            return cloudy_air(light, plane, self._bright, cloud_top_m)

        return self._kept(make, "sunlit air", *key)

    def shine(self, rays: LitRays, name: str, batch: int, hit: SurfaceHit | None) -> tuple[Values, Values]:
        """Return radiance and transmittance of every node of a batch along rays under the light ``name``.

        ``batch``: index among the light's batches; ``hit``: what is at the rays' ends, clouds included, for the nodes
        of the batch; default: a Lambert ground.
        """
        looked = rays.looked[name]
        nodes = looked.light.batches[batch]
        assert nodes is not None
        width = nodes.width
        apart = isinstance(nodes, SolarNodes) and nodes.bounce is not None
        if looked.broken is not None:
            o, d = self.view.origin, rays.direction
            parts = looked.broken.look(looked.table, looked.x, looked.azimuth, o, d, batch, width)
            found = [value for part in parts for value in part]
            dr.eval(found)
        else:
            packets = looked.light.packets_of(nodes, batch)
            values = looked.table.look(looked.x, looked.azimuth, packets)
            lights = [values[k * PACKET : k * PACKET + width] for k in range(2 + apart)]
            found = [dr.maximum(v, 0.0) if k != 1 else v for k, light in enumerate(lights) for v in light]
        if looked.cloudy is not None:
            dr.eval(found)
            self._before_clouds(looked, batch, found)
        radiance, transmittance = found[:width], found[width : 2 * width]
        reflected = None
        if isinstance(nodes, SolarNodes) and nodes.bounce is not None:
            cloud = None if hit is None else (hit.cloud, hit.t)
            factors = self._local.factors(nodes, looked.light.direction, rays.direction, rays.to_ground, cloud)
            assert factors is not None
            radiance, reflected = with_ground(radiance, found[2 * width : 3 * width], factors.air), factors.sky
        if not rays.to_ground and hit is None:
            return radiance, transmittance
        ground = self._ends(looked.light, nodes, rays, hit, reflected)
        counts = mi.Bool(True) if hit is None else hit.ends
        lit = zip(radiance, ground, transmittance, strict=True)
        return [r + dr.select(counts, g * t, 0.0) for r, g, t in lit], transmittance

    def _before_clouds(self, looked: _Looked, batch: int, found: list[mi.Float64]) -> None:
        """Put the values before clouds in the place of those of rays that end on them."""
        cloudy, nodes = looked.cloudy, looked.light.batches[batch]
        assert cloudy is not None
        assert nodes is not None
        packets = looked.light.packets_of(nodes, batch)
        each = len(looked.light.batches) * looked.light.packets
        values = look_at_stations(cloudy.table, cloudy.x, cloudy.azimuth, cloudy.station, each, packets)
        kept = [values[k * PACKET + n] for k in range(len(packets)) for n in range(nodes.width)]
        for replaced, value in zip(found, kept, strict=True):
            dr.scatter(replaced, dr.maximum(value, 0.0), cloudy.index)
        dr.eval(found)

    def _ends(
        self,
        light: Light,
        nodes: SolarNodes | GlowNodes,
        rays: LitRays,
        hit: SurfaceHit | None,
        reflected: Values | None,
    ) -> Values:
        """Return the radiance of what is at the rays' ends."""
        if isinstance(nodes, GlowNodes):
            return nodes.ground
        planet, o, d = self.view.planet, self.view.origin, rays.direction
        cloud = None if hit is None else (hit.cloud, hit.t)
        path = find_path(planet, light.top_m, o, d, mi.Bool(rays.to_ground), cloud)
        if hit is None:
            bending = ray_end(planet, self.view.bending, o, d, path.t_low + path.length_after).bending
        else:
            bending = hit.bending
        sunlit = SunlitRays.of(nodes, planet, path, o, d, light.direction)
        return sunlit.ground_radiance(path, hit, bending, reflected)
