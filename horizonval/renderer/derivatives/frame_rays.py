"""The radiance of any rays in the light of a frame, as the frame's own cells get it, and marched.

A frame groups its rays and adds cells up; here are single rays, so that they can be turned and moved. Where there are
clouds, what lies at the rays' ends counts as fixed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface.ground_emission import ground_k
from horizonval.renderer.derivatives.ray_slopes import Radiance
from horizonval.renderer.kernel.cells import Cells, Rays
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.planet import dot
from horizonval.renderer.plugin.image import node_parts, surface_looks
from horizonval.renderer.plugin.integrator import Prepared
from horizonval.renderer.thermal.emission_columns import ColumnBatch
from horizonval.renderer.thermal.emission_ground import mirrored, places_below
from horizonval.renderer.thermal.emission_image import ThermalFrame
from horizonval.renderer.thermal.emission_march import march_emission
from horizonval.renderer.thermal.emission_table import ThermalAir
from horizonval.renderer.types import Values, Vec
from horizonval.renderer.view_table.frame_tables import FrameTables


@dataclass(frozen=True)
class FrameRays:
    """Rays of one frame.

    ``nodes``: evaluations along each. ``digest``: by which view tables of sunlight are found;
    None where cells are marched.
    """

    prepared: Prepared
    view: FrameGeometry
    cells: Cells
    nodes: int
    digest: str | None

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the bands, in the order of every list of values here."""
        return self.prepared.model.bands

    def looked(self, o: Vec, d: Vec, to_ground: bool) -> Values:
        """Return radiance per band as the frame's cells get it."""
        cells = self._cells_of(d, to_ground)
        view = replace(self.view, origin=o)
        out = self._solar(view, cells, self.digest)
        thermal = self.prepared.thermal
        if thermal:
            assert self.prepared.model.emission is not None
            clear = ThermalFrame.of(
                self._without_clouds(), cells, self.prepared.model.emission, thermal[0].top_m, self.nodes
            )
            for air in thermal:
                out[air.band.name] = next(iter(clear.parts(air)))[2]
            if self._cloudy():
                self._put_clouds(out, cells, to_ground)
        return [out[band] for band in self.bands]

    def marched(self, to_ground: bool) -> Iterator[tuple[tuple[int, ...], Radiance]]:
        """Yield parts of the radiance by the march, for derivatives along the ground: of which bands, and the part.

        A band's light is the sum of its parts. Each is small enough to be differentiated in one kernel: all g points
        of a thermal band at once would be compiled for minutes.

        Thermal bands are over ground that shines as at the rays' ends. Where air and ground are the same everywhere
        their light does not change along the ground (see ``transport``): it has no part.
        """
        if self.prepared.batches:
            thermal = {air.band.name for air in self.prepared.thermal}
            solar = tuple(i for i, band in enumerate(self.bands) if band not in thermal)
            yield solar, partial(self._solar_marched, bands=[self.bands[i] for i in solar], to_ground=to_ground)
        for air in self.prepared.thermal:
            first = 0
            for batch in () if self._alike(air) else air.batches:
                part = slice(first, first + batch.used)
                emission = partial(self._emission_marched, air=air, batch=batch, part=part, to_ground=to_ground)
                yield (self.bands.index(air.band.name),), emission
                first = part.stop

    def _solar_marched(self, o: Vec, d: Vec, bands: Sequence[str], to_ground: bool) -> Values:
        out = self._solar(replace(self.view, origin=o), self._cells_of(d, to_ground), None)
        return [out[band] for band in bands]

    def _emission_marched(
        self, o: Vec, d: Vec, air: ThermalAir, batch: ColumnBatch, part: slice, to_ground: bool
    ) -> Values:
        nodes = max(self.nodes // 4, 24)
        more, through, _ = march_emission(self.view.planet, air.top_m, batch, o, d, mi.Bool(to_ground), nodes)
        total = sum(more, start=0.0 * d[0])
        if to_ground:
            behind = self._ground_emission(air, part, o, d)
            total = sum((t * mi.Float64(b) for t, b in zip(through, behind, strict=True)), start=total)
        return [total]

    def _cells_of(self, d: Vec, to_ground: bool) -> Cells:
        """Return rays as cells that they fill."""
        count = dr.width(d[0])
        nothing, whole = mi.Float64(), dr.ones(mi.Float64, count)
        rays = Rays(dr.arange(mi.UInt32, count), d, whole, count)
        none = Rays(mi.UInt32(), (nothing, nothing, nothing), nothing, 0)
        ground, limb = (rays, none) if to_ground else (none, rays)
        return replace(self.cells, ground=ground, limb=limb, space=mi.UInt32(), sun=None, moon=None)

    def _cloudy(self) -> bool:
        return self.view.ground is not None and self.view.ground.clouds is not None

    def _without_clouds(self) -> FrameGeometry:
        ground = self.view.ground
        if ground is None or ground.clouds is None:
            return self.view
        return replace(self.view, ground=replace(ground, clouds=None, model=replace(ground.model, clouds=None)))

    def _put_clouds(self, out: dict[str, mi.Float64], cells: Cells, to_ground: bool) -> None:
        """Give rays that end on clouds their radiance, which counts as fixed in thermal bands."""
        thermal, emission = self.prepared.thermal, self.prepared.model.emission
        assert emission is not None
        frame = ThermalFrame.of(self.view, self._ends_of(cells), emission, thermal[0].top_m, self.nodes)
        placed = frame.ground if to_ground else frame.limb
        if placed is None or placed.ends.cloud is None:
            return
        for air in thermal:
            name = air.band.name
            out[name] = dr.select(placed.ends.cloud, next(iter(frame.parts(air)))[2], out[name])

    def _ends_of(self, cells: Cells) -> Cells:
        """Return the rays by which ends are found: with clouds, where rays end and what is there counts as fixed."""
        if not self._cloudy():
            return cells
        still = [
            replace(rays, direction=_still(rays.direction)) if rays.count else rays
            for rays in (cells.ground, cells.limb)
        ]
        return replace(cells, ground=still[0], limb=still[1])

    def _origin_of(self, o: Vec) -> Vec:
        return _still(o) if self._cloudy() else o

    def _alike(self, air: ThermalAir) -> bool:
        """Return whether rays of equal height see the same, seen from outside the air."""
        o1 = self.view.planet.stretch(self.view.origin)
        outside = float(dot(o1, o1)[0]) > (self.view.planet.a_m + 1.02 * air.top_m) ** 2
        return outside and air.band.is_uniform and air.emission.kind == "uniform"

    def _solar(self, view: FrameGeometry, cells: Cells, digest: str | None) -> dict[str, mi.Float64]:
        out: dict[str, mi.Float64] = {}
        batches = self.prepared.batches
        if view.gap_maps:
            batches = [(group, batch.under(view.gap_maps)) for group, batch in batches]
        if not batches:
            return out
        looks = surface_looks(replace(view, origin=self._origin_of(view.origin)), self._ends_of(cells))
        tables = None
        if digest is not None:
            hits = looks[0].ground, looks[0].limb
            tables = FrameTables.of(view, cells, hits, [batch for _, batch in batches], self.nodes, digest)
        for number, (group, batch) in enumerate(batches):
            ((_, _, radiance),) = node_parts(view, cells, looks, group, batch, self.nodes, tables, number)
            for node, value in zip(group, radiance, strict=False):
                out[node.band] = out.get(node.band, mi.Float64(0.0)) + dr.opaque(mi.Float64, node.weight, 1) * value
        return out

    def _ground_emission(self, air: ThermalAir, part: slice, o: Vec, d: Vec) -> FloatArray:
        """Return what the ground at the rays' ends sends to them, shape (g, rays); without mirrored air."""
        source = air.source
        o, d = _still(o), _still(d)
        _, normal, _ = mirrored(self.view.planet, o, d)
        up = np.stack([np.array(c) for c in normal], axis=-1)
        cosine = -np.sum(up * np.stack([np.array(c) for c in d], axis=-1), axis=-1)
        emission = source.emission
        places = places_below(emission, up, np.array([float(c[0]) for c in self.view.sun]))
        sky = source.sky_at(up, part)
        total = np.zeros_like(sky)
        for kind, weight in places.shares.items():
            e = source.emissivities(kind, cosine, part)
            total += weight * (e * source.black(ground_k(emission, kind, places), part) + (1.0 - e) * sky)
        return total


def _still(v: Vec) -> Vec:
    """Return a vector that is not differentiated."""
    x, y, z = (dr.detach(c) for c in v)
    return x, y, z
