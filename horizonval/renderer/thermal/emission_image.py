"""Thermal bands of a frame: every cell interpolates in the tables of its camera position.

Only table nodes that no earlier frame needed are marched; where thin cloud has gaps, every cell. Kinds of ground, their
temperatures and clouds are computed once for all bands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.surface.ground_emission import ICE_POINT_K, LAG_RAD, GroundEmission
from horizonval.renderer.kernel.cells import Cells, Rays
from horizonval.renderer.kernel.clouds import first_cloud
from horizonval.renderer.kernel.discs import DiscCells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, RayCoordinates
from horizonval.renderer.kernel.surface import Ground, Places, cover, height_m
from horizonval.renderer.planet import way_through
from horizonval.renderer.refraction import ray_end
from horizonval.renderer.tables import table_of
from horizonval.renderer.thermal.emission_table import (
    ABOVE_TOPS_M,
    STATIONS,
    ThermalAir,
    ThermalView,
    WarmKind,
    ground_values,
    lagrange,
    limb_values,
    nodes_for,
)
from horizonval.renderer.types import Values, Vec, indices_where, inverse_root
from horizonval.renderer.view_table.ray_table import RayPlane
from horizonval.renderer.view_table.stations import StationPlace, look_at_stations


@dataclass(frozen=True)
class RayEnds:
    """What rays meet. ``cloud`` (None: no clouds), ``t``: where; ``shares``, ``warmth`` [K] by kind of ground."""

    cloud: mi.Bool | None
    t: mi.Float64 | None
    shares: dict[str, mi.Float64]
    warmth: dict[str, mi.Float64]


@dataclass(frozen=True)
class CloudyRays:
    """Rays of a group that end on clouds: ``index`` in the group, place in the tables, and among the stations."""

    index: mi.UInt32
    x: mi.Float64
    azimuth: mi.Float64
    station: StationPlace


@dataclass(frozen=True)
class PlacedRays:
    """Rays of cells where tables have them. ``cloudy``: None without clouds in any ray's way."""

    rays: Rays | DiscCells
    to_ground: bool
    x: mi.Float64
    azimuth: mi.Float64
    ends: RayEnds
    cloudy: CloudyRays | None


@dataclass(frozen=True)
class ThermalFrame:
    """What all thermal bands of a frame share."""

    view: FrameGeometry
    cells: Cells
    emission: GroundEmission
    coordinates: RayCoordinates
    layer_m: float | None
    ground: PlacedRays | None
    limb: PlacedRays | None
    sun: PlacedRays | None
    nodes: int
    accuracy: float

    @classmethod
    def of(
        cls,
        view: FrameGeometry,
        cells: Cells,
        emission: GroundEmission,
        airs: Sequence[ThermalAir],
        nodes: int,
        accuracy: float,
    ) -> ThermalFrame:
        """Look where all rays end; ``airs``: of all bands, with the same layers of thin cloud."""
        coordinates = view.coordinates(airs[0].top_m)
        clouds = view.ground.model.clouds if view.ground is not None else None
        layer_m = None if clouds is None else clouds.top_m + ABOVE_TOPS_M

        def placed(rays: Rays | DiscCells | None, to_ground: bool) -> PlacedRays | None:
            if rays is None or not rays.count:
                return None
            x, azimuth = RayPlane(coordinates, to_ground).place(view.origin, rays.direction)
            ends = _ends(view, rays, emission, to_ground)
            dr.eval(x, azimuth, ends.shares, ends.warmth, ends.cloud, ends.t)
            cloudy = _cloudy(view, rays.direction, x, azimuth, ends, layer_m, to_ground)
            return PlacedRays(rays, to_ground, x, azimuth, ends, cloudy)

        return cls(
            view,
            cells,
            emission,
            coordinates,
            layer_m,
            placed(cells.ground, True),
            placed(cells.limb, False),
            placed(cells.sun, False),
            nodes,
            accuracy,
        )

    def parts(self, air: ThermalAir) -> Iterator[tuple[mi.UInt32, mi.Float64, mi.Float64]]:
        """Yield ``(slots of cells, share of each, radiance)`` of all that shines in a band; each cell once in each."""
        cells = self.cells
        nodes = nodes_for(self.nodes, self.accuracy)
        band = ThermalView(air, self.view.position, self.coordinates, nodes, self.accuracy, self.layer_m)
        clear = self._marched(air) if self.view.gap_maps else self._looked_up(band)
        if self.ground is not None:
            radiance = mixed(clear(self.ground), air.kinds, self.ground.ends)
            yield cells.ground.slot, cells.ground.share, self._behind_clouds(band, self.ground, radiance)
        if self.limb is not None:
            yield cells.limb.slot, cells.limb.share, self._behind_clouds(band, self.limb, clear(self.limb)[0])
        if self.sun is not None:
            assert cells.sun is not None
            yield cells.sun.cell, mi.Float64(1.0), self._disc(clear(self.sun)[1], cells.sun, self.sun)

    def _looked_up(self, band: ThermalView) -> Callable[[PlacedRays], Values]:
        """Return what gives the quantities of :meth:`ThermalView.table` along rays through clear air."""

        def look(placed: PlacedRays) -> Values:
            # negative ones are set to 0: radiance is never negative, but a spline dips below 0 where the air ends
            return [dr.maximum(v, 0.0) for v in band.table(placed.to_ground).covered(placed.x, placed.azimuth)]

        return look

    def _marched(self, air: ThermalAir) -> Callable[[PlacedRays], Values]:
        """Return what gives the same quantities by a march of every ray, through the gaps of thin cloud."""
        gapped, planet, o = air.under(self.view.gap_maps), self.view.planet, self.view.origin

        def marched(placed: PlacedRays) -> Values:
            march = ground_values if placed.to_ground else limb_values
            values = march(gapped, planet, o, placed.rays.direction, self.nodes)
            return [table_of(mi.Float64, column) for column in values.T]

        return marched

    def _disc(self, through: mi.Float64, disc: DiscCells, placed: PlacedRays) -> mi.Float64:
        if placed.ends.cloud is not None:
            through = through * dr.select(placed.ends.cloud, 1.0 - self.emission.cloud_emissivity, 1.0)
        return disc.radiance(math.pi * dr.sin(self.view.sun_radius) ** 2, (1.0,), through)

    def _behind_clouds(self, band: ThermalView, placed: PlacedRays, radiance: mi.Float64) -> mi.Float64:
        """Return the radiance of rays with the clouds before them."""
        cloudy = placed.cloudy
        if cloudy is None:
            return radiance
        dr.eval(radiance)
        table = band.cloud_table(placed.to_ground)
        table.cover(cloudy.x, cloudy.azimuth)
        before, black, *_ = look_at_stations(table, cloudy.x, cloudy.azimuth, cloudy.station, 1, [0])
        e = dr.opaque(mi.Float64, self.emission.cloud_emissivity, 1)
        behind = dr.gather(mi.Float64, radiance, cloudy.index) - before
        dr.scatter(radiance, before + e * black + (1.0 - e) * behind, cloudy.index)
        return radiance


def _cloudy(
    view: FrameGeometry,
    d: Vec,
    x: mi.Float64,
    azimuth: mi.Float64,
    ends: RayEnds,
    layer_m: float | None,
    to_ground: bool,
) -> CloudyRays | None:
    """Return the rays that end on clouds."""
    if ends.cloud is None or layer_m is None:
        return None
    index = indices_where(ends.cloud)
    if not dr.width(index):
        return None
    d0, d1, d2 = (dr.gather(mi.Float64, c, index) for c in d)
    start, end = way_through(view.planet, view.origin, (d0, d1, d2), layer_m, to_ground)
    along = (dr.gather(mi.Float64, ends.t, index) - start) / dr.maximum(end - start, 1e-3)
    station = StationPlace.at(along * (STATIONS - 1.0), 0.0, STATIONS - 1.0)
    cloudy = CloudyRays(index, dr.gather(mi.Float64, x, index), dr.gather(mi.Float64, azimuth, index), station)
    dr.eval(cloudy.x, cloudy.azimuth, station.lowest, station.beyond)
    return cloudy


def mixed(values: Sequence[mi.Float64], kinds: list[WarmKind], ends: RayEnds) -> mi.Float64:
    """Return the radiance of ground of several kinds, each at its own temperature."""
    total = mi.Float64(0.0)
    first = 0
    for kind in kinds:
        count = len(kind.temperature_k)
        part = values[first]
        if count > 1:
            nodes = [dr.opaque(mi.Float64, float(t), 1) for t in kind.temperature_k]
            basis = lagrange(ends.warmth[kind.name], nodes)
            terms = (b * v for b, v in zip(basis, values[first : first + count], strict=True))
            part = sum(terms, start=mi.Float64(0.0))
        total = total + (ends.shares[kind.name] * part if len(kinds) > 1 else part)
        first += count
    return total


def _ends(view: FrameGeometry, rays: Rays | DiscCells, emission: GroundEmission, to_ground: bool) -> RayEnds:
    """Look where rays end: on which kind of ground, how warm, and on which cloud before it."""
    cloud = t = None
    if view.ground is not None and view.ground.clouds is not None:
        cloud, t = first_cloud(view.ground.clouds, view.planet, view.origin, rays.direction, to_ground, view.bending)
    if not to_ground:
        return RayEnds(cloud, t, {}, {})
    mid, half, _ = view.planet.chord(view.origin, rays.direction)
    normal = ray_end(view.planet, view.bending, view.origin, rays.direction, mid - half).vertical
    return RayEnds(cloud, t, *_warm_ground(view.ground, emission, normal, view.sun))


def _warm_ground(
    ground: Ground | None, emission: GroundEmission, normal: Vec, sun: Vec
) -> tuple[dict[str, mi.Float64], dict[str, mi.Float64]]:
    """Return the shares of kinds of ground below normals and their temperatures."""
    if emission.kind != "earth":
        return {}, warmth_k(emission, normal, sun)
    assert ground is not None
    assert ground.table is not None
    places = Places.below(normal)
    land, below = cover(ground.table, places)
    white = below["snow"] + below["firn"]
    bare = dr.select(land, 1.0 - below["sand"] - white, 0.0)
    shares = {"land": bare, "desert": below["sand"], "snow": white, "water": below["water"]}
    height = dr.select(land, height_m(ground.table, places), 0.0)
    return shares, warmth_k(emission, normal, sun, height, land, below["firn"] / dr.maximum(white, 1e-9))


def warmth_k(
    emission: GroundEmission,
    normal: Vec,
    sun: Vec,
    height: mi.Float64 | None = None,
    land: mi.Bool | None = None,
    ice_sheet: mi.Float64 | None = None,
) -> dict[str, mi.Float64]:
    """Return :func:`horizonval.earth.surface.ground_emission.ground_k` of every kind of ground for the kernel."""
    count = len(emission.sin_latitude)
    low = emission.sin_latitude[0]
    x = (normal[2] - low) * ((count - 1) / (emission.sin_latitude[-1] - low))
    x = dr.clip(x, 0.0, count - 1.0)
    i = dr.minimum(mi.UInt32(x), count - 2)
    w = x - mi.Float64(i)

    def at(values: tuple[float, ...]) -> mi.Float64:
        table = mi.Float64(np.array(values))
        return dr.lerp(dr.gather(mi.Float64, table, i), dr.gather(mi.Float64, table, i + 1), w)

    warm = at(emission.land_k)
    if height is None or land is None or ice_sheet is None:
        return {"land": warm}
    flat = inverse_root(dr.maximum((normal[0] ** 2 + normal[1] ** 2) * (sun[0] ** 2 + sun[1] ** 2), 1e-24))
    cosine = (normal[0] * sun[0] + normal[1] * sun[1]) * flat
    sine = (normal[1] * sun[0] - normal[0] * sun[1]) * flat
    hour = math.cos(LAG_RAD) * cosine + math.sin(LAG_RAD) * sine
    lapse = dr.opaque(mi.Float64, emission.land_lapse_k_m, 1)
    warm -= lapse * height
    snow = at(emission.snow_k) - lapse * height
    sheet = at(emission.ice_sheet_k) - at(emission.ice_lapse_k_m) * height
    white = dr.select(land, dr.lerp(snow, sheet, ice_sheet), at(emission.sea_ice_k))
    if emission.land_lapse_k_m:
        white = dr.minimum(white, ICE_POINT_K)
    return {
        "land": warm + at(emission.diurnal_k) * hour,
        "desert": warm + at(emission.desert_warmer_k) + at(emission.desert_diurnal_k) * hour,
        "snow": white,
        "water": at(emission.water_k),
    }
