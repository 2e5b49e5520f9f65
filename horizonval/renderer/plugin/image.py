"""Images: the radiance of every cell of a frame, and of every pixel.

A cell is one ray, or on the hard edge two that are mixed by the covered share (see ``cells``)::

    L_cell = c L_ground + (1 - c) L_limb + discs

What the discs of Sun and Moon add is in ``discs``. By night the sky behind shines through, where no cloud is before it.
Solar bands are marched cell by cell; thermal ones come from tables (``emission_image``).

Clouds have no outline: the one ray (or two) of a cell decides whether it ends on a cloud.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi

from horizonval.earth.column import SpectralNode
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.renderer.kernel.cells import Cells, FrameGeometry, Rays, group_cells
from horizonval.renderer.kernel.discs import DiscCells
from horizonval.renderer.kernel.march import Chunk, march
from horizonval.renderer.kernel.radiance import SOLAR_CONCENTRATION
from horizonval.renderer.kernel.surface import Landing, land_on
from horizonval.renderer.planet import Vec
from horizonval.renderer.thermal.emission_image import ThermalFrame
from horizonval.renderer.thermal.emission_table import ThermalAir


def render_bands(
    view: FrameGeometry,
    chunks: Iterable[tuple[list[SpectralNode], Chunk]],
    bands: list[str],
    nodes: int,
    thermal: Sequence[ThermalAir] = (),
    emission: GroundEmission | None = None,
) -> dict[str, Any]:
    """Return the radiance per band as Float64 arrays, one value per pixel in row order.

    ``thermal``: the thermal bands among ``bands``; they need to know what the ground emits.
    """
    cells = group_cells(view)
    out = {band: dr.zeros(mi.Float64, view.width * view.height) for band in bands}

    def add(band: str, parts: Iterable[tuple[Any, Any, Any]]) -> None:
        total = dr.zeros(mi.Float64, cells.count)
        for cell, share, radiance in parts:
            dr.scatter_add(total, share * radiance, cell, mode=dr.ReduceMode.NoConflicts)
            # ground and limb share edge cells: left to one launch, their kernels would race for them
            dr.eval(total)
        k2 = view.subsamples**2
        out[band] = out[band] + dr.block_sum(total, k2) / k2
        dr.eval(out[band])

    landings: list[_Landings] = []
    for group, chunk in chunks:
        if not landings:
            landings = [_land(view, cells, view.sun)]
            if view.moon is not None and view.moon.lights_earth:
                landings.append(_land(view, cells, view.moon.light))
        parts = list(_parts(view, cells, landings, group, chunk, nodes))
        for band in dict.fromkeys(node.band for node in group):
            weight = [dr.opaque(mi.Float64, n.weight if n.band == band else 0.0, 1) for n in group]
            add(band, ((cell, share, _weighted(weight, radiance)) for cell, share, radiance in parts))
    if thermal:
        assert emission is not None
        frame = ThermalFrame.of(view, cells, emission, thermal[0].top_m, nodes)
        for air in thermal:
            add(air.band.name, frame.parts(air))
    return out


def _weighted(weight: list[Any], radiance: list[Any]) -> Any:
    return sum(w * r for w, r in zip(weight, radiance, strict=False))


@dataclass(frozen=True)
class _Landings:
    """Where the rays of every group of cells end; None for a Lambert ground without clouds."""

    ground: Landing | None = None
    limb: Landing | None = None
    sun: Landing | None = None
    moon: Landing | None = None


def _land(view: FrameGeometry, cells: Cells, light: Vec) -> _Landings:
    """Look where rays end under a light, once for all spectral nodes. Rays past the Earth end on clouds only."""
    if view.ground is None:
        return _Landings()

    def look(rays: Rays | DiscCells | None, to_ground: bool) -> Landing | None:
        assert view.ground is not None
        if rays is None or not rays.count or not (to_ground or view.ground.clouds):
            return None
        return land_on(view.ground, view.planet, view.origin, rays.direction, light, to_ground)

    return _Landings(look(cells.ground, True), look(cells.limb, False), look(cells.sun, False), look(cells.moon, False))


def _parts(
    view: FrameGeometry, cells: Cells, landings: list[_Landings], group: list[SpectralNode], chunk: Chunk, nodes: int
) -> Iterator[tuple[Any, Any, list[Any]]]:
    """Yield ``(cells, share of the cell, radiance per node)`` of all that shines; each cell once in each.

    ``landings``: under the Sun, and under the Moon where it lights the Earth.
    """

    def marched(
        direction: Vec, to_ground: bool, lit: Chunk, light: Vec, landing: Landing | None
    ) -> tuple[list[Any], list[Any]]:
        # airglow is known to a factor of two: 0.6 % of error in it, with half the nodes, is plenty
        top_m, n = (view.highest_m, max(nodes // 2, 8)) if lit.kind == "glow" else (view.top_m, nodes)
        if landing is not None and view.ground is not None:
            landing = landing.at(view.ground.model, [node.wavelength_um for node in group], chunk.width)
        result = march(
            view.planet, top_m, lit, view.origin, direction, light, mi.Bool(to_ground), n, SOLAR_CONCENTRATION, landing
        )
        dr.eval(result)
        return result

    def through(rays: Rays, to_ground: bool, places: list[Landing | None]) -> tuple[list[Any], list[Any]]:
        """March once for every light: the Sun, the Moon, the air itself. The march is linear in them."""
        lights = [(chunk, view.sun, places[0])]
        if view.moon is not None and view.moon.lights_earth and chunk.moonlight is not None:
            lights.append((replace(chunk, irradiance=chunk.moonlight), view.moon.light, places[1]))
        if chunk.glow is not None:
            lights.append((chunk.glow, view.sun, places[0]))
        if view.sunless and len(lights) > 1:
            del lights[0]
        radiance, transmittance = marched(rays.direction, to_ground, *lights[0])
        for light in lights[1:]:
            more, _ = marched(rays.direction, to_ground, *light)
            radiance = [a + b for a, b in zip(radiance, more, strict=True)]
        dr.eval(radiance)
        return radiance, transmittance

    sky = [dr.opaque(mi.Float64, n.sky_radiance, 1) for n in group] if any(n.sky_radiance for n in group) else []

    def past_clouds(disc: DiscCells, landing: Landing | None) -> list[Any]:
        _, transmittance = marched(disc.direction, False, chunk, view.sun, None)
        return transmittance if landing is None else [dr.select(landing.hit, 0.0, t) for t in transmittance]

    def covered(rays: Rays) -> Any:
        return dr.gather(mi.Float64, cells.share, rays.cell)

    if cells.ground.count:
        places = [under.ground for under in landings]
        yield cells.ground.cell, covered(cells.ground), through(cells.ground, True, places)[0]
    if cells.limb.count:
        radiance, transmittance = through(cells.limb, False, [places.limb for places in landings])
        clouds = landings[0].limb
        for k, behind in enumerate(sky):
            seen = behind * transmittance[k]
            radiance[k] = radiance[k] + (seen if clouds is None else dr.select(clouds.hit, 0.0, seen))
        yield cells.limb.cell, 1.0 - covered(cells.limb), radiance
    if sky and dr.width(cells.space):
        yield cells.space, mi.Float64(1.0), sky
    if cells.sun is not None and cells.sun.count:
        transmittance = past_clouds(cells.sun, landings[0].sun)
        disc = math.pi * dr.sin(view.sun_radius) ** 2
        light = [
            cells.sun.radiance(dr.opaque(mi.Float64, n.sun_radiance, 1) * disc, n.limb_darkening, t)
            for n, t in zip(group, transmittance, strict=False)
        ]
        yield cells.sun.cell, mi.Float64(1.0), light
    if cells.moon is not None and cells.moon.count and any(n.moon_irradiance for n in group):
        assert view.moon is not None
        transmittance = past_clouds(cells.moon, landings[0].moon)
        light = [
            cells.moon.radiance(dr.opaque(mi.Float64, n.moon_irradiance * view.moon.nearness, 1), (1.0,), t)
            for n, t in zip(group, transmittance, strict=False)
        ]
        yield cells.moon.cell, mi.Float64(1.0), light
