"""Images: the radiance of every cell of a frame, and of every pixel.

A cell is one ray, or on the hard edge two that are mixed by the covered share (see ``cells``)::

    L_cell = c L_ground + (1 - c) L_limb + discs

``discs`` adds Sun and Moon. By night the sky behind shines through, except behind clouds. Solar bands are marched cell
by cell; thermal ones come from tables (``emission_image``). The outline of clouds above the limb cuts cells as the hard
edge does; in front of the ground the ray of a cell decides whether it ends on a cloud.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.earth.column import SpectralNode
from horizonval.earth.surface import city_lights
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.renderer.kernel.cells import Cells, Rays, group_cells
from horizonval.renderer.kernel.discs import DiscCells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.kernel.march import march
from horizonval.renderer.kernel.node_batches import ShiningNodes, SolarNodes
from horizonval.renderer.kernel.surface import SurfaceHit, surface_hits
from horizonval.renderer.local_light import LocalLight
from horizonval.renderer.thermal.emission_image import ThermalFrame
from horizonval.renderer.thermal.emission_table import ThermalAir
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.frame_tables import FrameTables, LitRays
from horizonval.renderer.view_table.sunlit_air import Light, lights_of

NodePart: TypeAlias = "tuple[mi.UInt32, mi.Float64, Values]"
"""Slots of cells, the share of each, and the radiance of every spectral node of a batch."""


@dataclass
class _Channels:
    """Images of a frame while they grow, by name: Float64, one value per pixel in row order."""

    cells: Cells
    images: dict[str, mi.Float64] = field(default_factory=dict)

    def add(self, names: Sequence[str], parts: Iterable[NodePart]) -> None:
        """Add parts with one value for every name."""
        totals = [dr.zeros(mi.Float64, self.cells.count) for _ in names]
        for slot, share, values in parts:
            for total, value in zip(totals, values, strict=True):
                dr.scatter_add(total, share * value, slot, mode=dr.ReduceMode.NoConflicts)
            # ground and limb share edge cells: left to one launch, their kernels would race for them
            dr.eval(totals)
        for name, total in zip(names, totals, strict=True):
            image = self.cells.image(total)
            self.images[name] = self.images[name] + image if name in self.images else image
        dr.eval(self.images)

    def of(self, names: Iterable[str]) -> dict[str, mi.Float64]:
        """Return some of the images, black where nothing was added."""
        pixels = self.cells.view.width * self.cells.view.height
        return {name: self.images[name] if name in self.images else dr.zeros(mi.Float64, pixels) for name in names}


def render_bands(
    view: FrameGeometry,
    batches: Iterable[tuple[list[SpectralNode], SolarNodes]],
    bands: list[str],
    nodes: int,
    thermal: Sequence[ThermalAir] = (),
    emission: GroundEmission | None = None,
    digest: str | None = None,
    accuracy: float = 1e-3,
    cells: Cells | None = None,
) -> tuple[dict[str, mi.Float64], dict[str, mi.Float64]]:
    """Return radiance per band, and energy radiance per solar band: Float64 arrays, one value per pixel in row order.

    The same spectral nodes serve both, with other weights (``SpectralNode.energy_ratio``). ``thermal``: the thermal
    bands among ``bands``. ``digest``: of air, planet and orders of scattering, the key of view tables of sunlight; None
    to march every cell. ``accuracy``: error that tables may have, as a share of the bright limb. ``cells``: the cells
    of the view, where they are known.
    """
    cells = cells or group_cells(view)
    emitted = {air.band.name for air in thermal}
    channels = _Channels(cells)
    energy_of = {band: f"energy of {band}" for band in bands if band not in emitted}
    batches = [(group, batch.under(view.gap_maps) if view.gap_maps else batch) for group, batch in batches]
    solar = [batch for _, batch in batches]
    lights = lights_of(view, solar, nodes, accuracy)
    hits = surface_looks(view, cells) if batches else []
    tables = None
    if digest is not None and batches:
        tables = FrameTables.of(view, cells, (hits[0].ground, hits[0].limb), lights, digest, accuracy)
    for number, (group, batch) in enumerate(batches):
        parts = list(node_parts(view, cells, hits, group, batch, lights, tables, number))
        own = list(dict.fromkeys(node.band for node in group))
        weights = [[n.weight * (n.band == band) for n in group] for band in own]
        weights += [[n.weight * n.energy_ratio * (n.band == band) for n in group] for band in own]
        channels.add([*own, *(energy_of[band] for band in own)], _band_parts(parts, weights))
    if thermal:
        assert emission is not None
        frame = ThermalFrame.of(view, cells, emission, thermal, nodes, accuracy)
        for air in thermal:
            channels.add([air.band.name], ((slot, share, [value]) for slot, share, value in frame.parts(air)))
    energy = channels.of(energy_of.values())
    return channels.of(bands), {band: energy[name] for band, name in energy_of.items()}


def _band_parts(parts: Iterable[NodePart], weights: Sequence[Sequence[float]]) -> Iterator[NodePart]:
    """Yield the parts with one sum over the nodes for each list of weights."""
    opaque = [[dr.opaque(mi.Float64, w, 1) for w in one] for one in weights]
    for slot, share, radiance in parts:
        yield slot, share, [_weighted(one, radiance) for one in opaque]


def _weighted(weights: Values, radiance: Values) -> mi.Float64:
    return sum((w * r for w, r in zip(weights, radiance, strict=False)), start=mi.Float64(0.0))


@dataclass(frozen=True)
class SurfaceLook:
    """Where the rays of every group of cells end; None for a Lambert ground without clouds."""

    ground: SurfaceHit | None = None
    limb: SurfaceHit | None = None
    sun: SurfaceHit | None = None
    moon: SurfaceHit | None = None


def surface_looks(view: FrameGeometry, cells: Cells) -> list[SurfaceLook]:
    """Return what rays end on, under the Sun, and under the Moon where it lights the Earth; once for all nodes."""
    lights = [view.sun]
    if view.moon is not None and view.moon.lights_earth:
        lights.append(view.moon.light)

    def ends(rays: Rays | DiscCells | None, to_ground: bool) -> Sequence[SurfaceHit | None]:
        if view.ground is None or rays is None or not rays.count or not (to_ground or view.ground.clouds):
            return [None] * len(lights)
        return surface_hits(view.ground, view.planet, view.origin, rays.direction, lights, to_ground, view.bending)

    groups = (ends(cells.ground, True), ends(cells.limb, False), ends(cells.sun, False), ends(cells.moon, False))
    return [SurfaceLook(*under) for under in zip(*groups, strict=True)]


def node_parts(
    view: FrameGeometry,
    cells: Cells,
    hits: list[SurfaceLook],
    group: list[SpectralNode],
    batch: SolarNodes,
    lights: Sequence[Light],
    tables: FrameTables | None = None,
    number: int = 0,
) -> Iterator[NodePart]:
    """Yield ``(cells, share of the cell, radiance per node)`` of all that shines; each cell once in each.

    ``hits``: under the Sun, and under the Moon where it lights the Earth. ``tables``: None to march; ``number``: index
    of the batch.
    """

    def of_batch(hit: SurfaceHit | None) -> SurfaceHit | None:
        if hit is None or view.ground is None:
            return hit
        return hit.at(view.ground.model, [node.wavelength_um for node in group], batch.width)

    def march_light(
        light: Light, lit: ShiningNodes, direction: Vec, to_ground: bool, hit: SurfaceHit | None
    ) -> tuple[Values, Values]:
        factors = None
        if isinstance(lit, SolarNodes) and lit.bounce is not None:
            cloud = None if hit is None else (hit.cloud, hit.t)
            local = LocalLight(view).factors(lit, light.direction, direction, to_ground, cloud)
            factors = None if local is None else (local.air, local.sky)
        return march(
            view.planet,
            light.top_m,
            lit,
            view.origin,
            direction,
            light.direction,
            mi.Bool(to_ground),
            light.nodes,
            of_batch(hit),
            factors,
        )

    def through(
        rays: Rays, to_ground: bool, hits_under: list[SurfaceHit | None], seen: LitRays | None
    ) -> tuple[Values, Values]:
        """Add up the lights: the Sun, the Moon, the air itself. The march is linear in them."""
        shining = [light for light in lights if light.batches[number] is not None]
        if seen is not None:
            shining = [light for light in shining if light.name in seen.looked] or shining[:1]
        total: list[tuple[Values, Values]] = []
        for light in shining:
            hit, lit = hits_under[1 if light.name == "moon" else 0], light.batches[number]
            assert lit is not None
            if tables is not None and seen is not None and light.name in seen.looked:
                total.append(tables.shine(seen, light.name, number, of_batch(hit)))
            else:
                total.append(march_light(light, lit, rays.direction, to_ground, hit))
                dr.eval(total)
        radiance = [sum(parts, start=mi.Float64(0.0)) for parts in zip(*(r for r, _ in total), strict=True)]
        dr.eval(radiance)
        return radiance, total[0][1]

    sky = [dr.opaque(mi.Float64, n.sky_radiance, 1) for n in group] if any(n.sky_radiance for n in group) else []

    def past_clouds(disc: DiscCells, hit: SurfaceHit | None) -> Values:
        # of which nothing but the transmittance is evaluated
        dark = replace(batch, diffuse=None, bounce=None)
        _, transmittance = march_light(lights[0], dark, disc.direction, False, None)
        dr.eval(transmittance)
        return transmittance if hit is None else [dr.select(hit.ends, 0.0, t) for t in transmittance]

    if cells.ground.count:
        hits_under = [under.ground for under in hits]
        seen = None if tables is None else tables.ground
        radiance, transmittance = through(cells.ground, True, hits_under, seen)
        under = hits_under[0]
        if under is not None and under.lamps is not None:
            lamps = [constant(city_lights.radiance_per_luminance(n.wavelength_um)) * under.lamps for n in group]
            radiance = [r + t * lit for r, t, lit in zip(radiance, transmittance, lamps, strict=False)]
        yield cells.ground.slot, cells.ground.share, radiance
    if cells.limb.count:
        seen = None if tables is None else tables.limb
        radiance, transmittance = through(cells.limb, False, [under.limb for under in hits], seen)
        clouds = hits[0].limb
        for k, behind in enumerate(sky):
            shining = behind * transmittance[k]
            radiance[k] = radiance[k] + (shining if clouds is None else dr.select(clouds.ends, 0.0, shining))
        yield cells.limb.slot, cells.limb.share, radiance
    if sky and dr.width(cells.space):
        yield cells.space, mi.Float64(1.0), sky
    if cells.sun is not None and cells.sun.count:
        transmittance = past_clouds(cells.sun, hits[0].sun)
        disc = math.pi * dr.sin(view.sun_radius) ** 2
        light = [
            cells.sun.radiance(dr.opaque(mi.Float64, n.sun_radiance, 1) * disc, n.limb_darkening, t)
            for n, t in zip(group, transmittance, strict=False)
        ]
        yield cells.sun.cell, mi.Float64(1.0), light
    if cells.moon is not None and cells.moon.count and any(n.moon_irradiance for n in group):
        assert view.moon is not None
        transmittance = past_clouds(cells.moon, hits[0].moon)
        light = [
            cells.moon.radiance(dr.opaque(mi.Float64, n.moon_irradiance * view.moon.nearness, 1), (1.0,), t)
            for n, t in zip(group, transmittance, strict=False)
        ]
        yield cells.moon.cell, mi.Float64(1.0), light
