"""Thermal bands of a frame: every cell looks up what the tables of its camera position say.

Nothing here marches. Kinds of ground and their temperatures are found once for all bands, and so are clouds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.surface.ground_emission import LAG_RAD, GroundEmission
from horizonval.renderer.kernel.cells import Cells, Rays
from horizonval.renderer.kernel.clouds import first_cloud
from horizonval.renderer.kernel.discs import DiscCells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.kernel.surface import is_land, snow_share
from horizonval.renderer.planet import along
from horizonval.renderer.spline_table import Azimuths, StationTable, azimuths_in_view
from horizonval.renderer.thermal.emission_table import (
    BandTables,
    ThermalAir,
    WarmKind,
    lagrange,
    make_tables,
    way_through,
)
from horizonval.renderer.types import Vec, indices_where

AZIMUTHS_ALIKE, FEWEST_AZIMUTHS, MOST_AZIMUTHS = 24, 96, 256
"""Steps of a full circle: through air that is the same everywhere, and through air that is not."""
LIMB_STEP_RAD = math.radians(1.5)
"""Distance along the limb of rays through air that varies, at most, up to :data:`MOST_AZIMUTHS`."""
OUTLINE_POINTS = 64


@dataclass(frozen=True)
class RayEnds:
    """What rays meet. ``cloud`` (None: no clouds), ``t``: where; ``shares``, ``warmth`` [K] by kind of ground."""

    cloud: mi.Bool | None
    t: mi.Float64 | None
    shares: dict[str, mi.Float64]
    warmth: dict[str, mi.Float64]


@dataclass(frozen=True)
class ThermalFrame:
    """What all thermal bands of a frame share."""

    view: FrameGeometry
    cells: Cells
    emission: GroundEmission
    coordinates: RayCoordinates
    ground: RayEnds
    limb: RayEnds
    sun: RayEnds
    nodes: int

    @classmethod
    def of(cls, view: FrameGeometry, cells: Cells, emission: GroundEmission, top_m: float, nodes: int) -> ThermalFrame:
        """Look where all rays end."""
        origin = np.array([float(c[0]) for c in view.origin])
        return cls(
            view,
            cells,
            emission,
            RayCoordinates.of(view.planet, origin, top_m),
            _ends(view, cells.ground, emission, to_ground=True),
            _ends(view, cells.limb, emission, to_ground=False),
            _ends(view, cells.sun, emission, to_ground=False),
            nodes,
        )

    def parts(self, air: ThermalAir) -> Iterator[tuple[mi.UInt32, mi.Float64, mi.Float64]]:
        """Yield ``(cells, share of the cell, radiance)`` of all that shines in a band; each cell once in each."""
        cells, view = self.cells, self.view
        sun = cells.sun if cells.sun is not None and cells.sun.count else None
        clouds = view.ground.model.clouds if view.ground is not None else None
        tables = make_tables(
            air,
            self.emission,
            self.coordinates,
            self._azimuths(len(air.band.sin_latitude)),
            self.nodes,
            None if clouds is None else clouds.top_m,
            (cells.ground.count > 0, cells.limb.count > 0 or sun is not None),
        )
        if cells.ground.count:
            yield cells.ground.slot, cells.ground.share, self._ground(tables)
        if cells.limb.count:
            yield cells.limb.slot, cells.limb.share, self._limb(tables)
        if sun is not None:
            yield sun.cell, mi.Float64(1.0), self._disc(tables, sun)

    def _azimuths(self, rows: int) -> Azimuths:
        whole = AZIMUTHS_ALIKE
        if rows > 1:
            horizon = math.acos(min(self.view.planet.a_m / self.coordinates.distance_m, 1.0))
            steps = 2.0 * math.pi * math.sin(horizon) / LIMB_STEP_RAD
            whole = 8 * math.ceil(min(max(steps, FEWEST_AZIMUTHS), MOST_AZIMUTHS) / 8)
        _, azimuth = self.coordinates.place(self.view.origin, _outline(self.view), to_ground=False)
        return azimuths_in_view(np.array(azimuth), whole)

    def _ground(self, tables: BandTables) -> mi.Float64:
        assert tables.ground is not None
        d = self.cells.ground.direction
        row, azimuth = tables.coordinates.place(self.view.origin, d, to_ground=True)
        radiance = mixed(tables.ground.look(row, azimuth), tables.kinds, self.ground)
        return self._behind_clouds(tables, tables.clouds_ground, self.ground, d, radiance, to_ground=True)

    def _limb(self, tables: BandTables) -> mi.Float64:
        assert tables.limb is not None
        d = self.cells.limb.direction
        row, azimuth = tables.coordinates.place(self.view.origin, d, to_ground=False)
        radiance = tables.limb.look(row, azimuth)[0]
        return self._behind_clouds(tables, tables.clouds_limb, self.limb, d, radiance, to_ground=False)

    def _disc(self, tables: BandTables, sun: DiscCells) -> mi.Float64:
        assert tables.limb is not None
        row, azimuth = tables.coordinates.place(self.view.origin, sun.direction, to_ground=False)
        through = tables.limb.look(row, azimuth)[1]
        if self.sun.cloud is not None:
            through = through * dr.select(self.sun.cloud, 1.0 - self.emission.cloud_emissivity, 1.0)
        return sun.radiance(math.pi * dr.sin(self.view.sun_radius) ** 2, (1.0,), through)

    def _behind_clouds(
        self,
        tables: BandTables,
        table: StationTable | None,
        ends: RayEnds,
        d: Vec,
        radiance: mi.Float64,
        to_ground: bool,
    ) -> mi.Float64:
        """Return the radiance of rays with the clouds before them."""
        if table is None or ends.cloud is None:
            return radiance
        dr.eval(radiance)
        index = indices_where(ends.cloud)
        if not dr.width(index):
            return radiance
        x, y, z = (dr.gather(mi.Float64, c, index) for c in d)
        o, near = self.view.origin, (x, y, z)
        start, end = way_through(self.view.planet, o, near, tables.layer_m, to_ground)
        share = (dr.gather(mi.Float64, ends.t, index) - start) / dr.maximum(end - start, 1e-3)
        row, azimuth = tables.coordinates.place(o, near, to_ground)
        before, black = table.look(row, azimuth, share)
        e = dr.opaque(mi.Float64, self.emission.cloud_emissivity, 1)
        behind = dr.gather(mi.Float64, radiance, index) - before
        dr.scatter(radiance, before + e * black + (1.0 - e) * behind, index)
        return radiance


def _outline(view: FrameGeometry) -> Vec:
    """Return directions along the frame's edge, once around."""
    s = (np.arange(OUTLINE_POINTS) + 0.0) / OUTLINE_POINTS
    zero, unity = np.zeros(OUTLINE_POINTS), np.ones(OUTLINE_POINTS)
    x = np.concatenate([s, unity, 1.0 - s, zero]) * view.width - 0.5
    y = np.concatenate([zero, s, unity, 1.0 - s]) * view.height - 0.5
    return view.rays.direction(mi.Float64(x), mi.Float64(y))


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


def _ends(view: FrameGeometry, rays: Rays | DiscCells | None, emission: GroundEmission, to_ground: bool) -> RayEnds:
    """Look where rays end: on which kind of ground, how warm, and on which cloud before it."""
    if rays is None or not rays.count:
        return RayEnds(None, None, {}, {})
    cloud = t = None
    if view.ground is not None and view.ground.clouds is not None:
        cloud, t = first_cloud(view.ground.clouds, view.planet, view.origin, rays.direction, to_ground)
        dr.eval(cloud, t)
    if not to_ground:
        return RayEnds(cloud, t, {}, {})
    mid, half, _ = view.planet.chord(view.origin, rays.direction)
    _, normal = view.planet.height_and_normal(along(view.origin, rays.direction, mid - half))
    shares: dict[str, mi.Float64] = {}
    if emission.kind == "earth":
        assert view.ground is not None
        assert view.ground.land is not None
        dry = dr.select(is_land(view.ground.land, normal), mi.Float64(1.0), 0.0)
        snow = snow_share(normal, view.ground.model.snow_line_deg)
        shares = {"land": dry * (1.0 - snow), "snow": dry * snow, "water": 1.0 - dry}
    warmth = warmth_k(emission, normal, view.sun)
    dr.eval(shares, warmth)
    return RayEnds(cloud, t, shares, warmth)


def warmth_k(emission: GroundEmission, normal: Vec, sun: Vec) -> dict[str, mi.Float64]:
    """Return :func:`horizonval.renderer.thermal.emission_ground.temperatures_k` for the kernel."""
    count = len(emission.sin_latitude)
    low = emission.sin_latitude[0]
    x = (normal[2] - low) * ((count - 1) / (emission.sin_latitude[-1] - low))
    x = dr.clip(x, 0.0, count - 1.0)
    i = dr.minimum(mi.UInt32(x), count - 2)
    w = x - mi.Float64(i)

    def at(values: tuple[float, ...]) -> mi.Float64:
        table = mi.Float64(np.array(values))
        return dr.lerp(dr.gather(mi.Float64, table, i), dr.gather(mi.Float64, table, i + 1), w)

    land_k = at(emission.land_k)
    if any(emission.diurnal_k):
        flat = dr.rsqrt(dr.maximum((normal[0] ** 2 + normal[1] ** 2) * (sun[0] ** 2 + sun[1] ** 2), 1e-24))
        cosine = (normal[0] * sun[0] + normal[1] * sun[1]) * flat
        sine = (normal[1] * sun[0] - normal[0] * sun[1]) * flat
        land_k = land_k + at(emission.diurnal_k) * (math.cos(LAG_RAD) * cosine + math.sin(LAG_RAD) * sine)
    return {"land": land_k, "snow": at(emission.snow_k), "water": at(emission.water_k)}
