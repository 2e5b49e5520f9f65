"""From an optical model to the tables the march reads, a few spectral nodes at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.renderer.kernel.march import CHUNK, Chunk, march
from horizonval.renderer.kernel.refraction import Turning, aim_at_sun
from horizonval.renderer.kernel.straightened import Bending, StraightAir, SunAim, mean_radius
from horizonval.renderer.planet import Planet
from horizonval.renderer.scattering.multiple_scattering import DiffuseField, Quality
from horizonval.renderer.scattering.source_store import multiple_scattering
from horizonval.renderer.scattering.source_table import SourceTable
from horizonval.renderer.tables import TAU_FLOOR, AltitudeGrid, SunTable, table_of

SKY_POLAR_NODES = 24


@dataclass(frozen=True)
class TableSize:
    """Resolution of the Sun's optical-depth table and of the quadrature that fills it."""

    n_height: int
    n_mu: int
    path_nodes: int


IMAGE_TABLE = TableSize(n_height=192, n_mu=384, path_nodes=256)
RAY_TABLE = TableSize(n_height=512, n_mu=2048, path_nodes=512)
"""For the ``radiance`` command, where accuracy counts more than the table's minute."""


def opaque(value: float) -> Any:
    """Return a size-1 array whose value is data, not a constant of the compiled kernel."""
    return dr.opaque(mi.Float64, float(value), 1)


@dataclass(frozen=True)
class _Bent:
    """What all chunks of a straightened model share."""

    turn: Any
    height: Any
    aim: SunAim
    height_m: FloatArray
    cosine: FloatArray


def make_chunks(
    model: OpticalModel,
    planet: Planet,
    size: TableSize,
    scattering: Quality | None = None,
    progress: Progress | None = None,
    air: StraightAir | None = None,
) -> Iterator[tuple[list[SpectralNode], Chunk]]:
    """Yield ``(nodes, chunk)`` until every spectral node of the model has been served.

    Parameters
    ----------
    scattering : Quality, optional
        Of the tables of light scattered more than once; None for single scattering.
    progress : Progress, optional
        Told about tables that must be solved first.
    air : StraightAir, optional
        Refraction: model and planet are its straightened ones. Light scattered more than once is that of the model as
        it was, without refraction.
    """
    bent = None
    unbent, ground = model, planet
    if air is not None:
        unbent, ground = air.unbent, air.ground
        if any(_kind(n) == "solar" for n in model.nodes):
            turning = Turning.of(air)
            aim = aim_at_sun(turning, size.n_height, size.n_mu, size.path_nodes)
            bent = _Bent(turning.turn, mi.Float64(np.ascontiguousarray(air.height_m)), *aim)
    unbent_grid, unbent_node = AltitudeGrid.of(unbent.altitude_m), {n.name: n for n in unbent.nodes}
    grid = AltitudeGrid.of(model.altitude_m)
    for kind in ("solar", "thermal"):
        nodes = [n for n in model.nodes if _kind(n) == kind]
        for first in range(0, len(nodes), CHUNK):
            group = nodes[first : first + CHUNK]
            chunk = _make_chunk(kind, group, model, planet, grid, size, bent)
            if kind == "solar" and scattering is not None and any(n.scattering_per_m.any() for n in group):
                fields = [
                    _diffuse_field(unbent_node[n.name], unbent, ground, unbent_grid, scattering, progress)
                    for n in group
                ]
                chunk = replace(chunk, diffuse=SourceTable.of(fields, chunk.width, chunk.particle is not None))
            yield group, chunk


def _diffuse_field(
    node: SpectralNode,
    model: OpticalModel,
    planet: Planet,
    grid: AltitudeGrid,
    quality: Quality,
    progress: Progress | None,
) -> DiffuseField:
    radius = mean_radius(planet)

    def sun_table() -> SunTable:
        return _fill_sun_table(planet, model.top_m, grid, mi.Float64(node.extinction_per_m), 1, IMAGE_TABLE)

    solution = multiple_scattering(node, model.altitude_m, radius, quality, sun_table, progress)
    around = (
        model.albedo_around[[n.name for n in model.nodes].index(node.name)] if model.albedo_around else model.albedo
    )
    return solution.over_ground(around)


def _kind(node: SpectralNode) -> Literal["solar", "thermal"]:
    return "solar" if node.solar_irradiance > 0.0 else "thermal"


def _make_chunk(
    kind: Literal["solar", "thermal"],
    nodes: Sequence[SpectralNode],
    model: OpticalModel,
    planet: Planet,
    grid: AltitudeGrid,
    size: TableSize,
    bent: _Bent | None,
) -> Chunk:
    width = 1 if len(nodes) == 1 else CHUNK
    pad = [0.0] * (width - len(nodes))
    extinction = _interleave([n.extinction_per_m for n in nodes], width)
    if kind == "thermal":
        emission = _interleave([n.source for n in nodes], width)
        black = Chunk(kind, width, grid, extinction, emission, None, [], [opaque(0.0)] * width, [])
        ground = [model.emissivity * n.surface_source for n in nodes]
        if model.emissivity < 1.0:
            sky = _downwelling(planet, model.top_m, black, size.path_nodes)
            ground = [g + (1.0 - model.emissivity) / math.pi * s for g, s in zip(ground, sky, strict=False)]
        return Chunk(kind, width, grid, extinction, emission, None, [], [opaque(g) for g in [*ground, *pad]], [])
    emission = _interleave([n.molecular_per_m for n in nodes], width)
    sun_table, bending = None, None
    if bent is None:
        sun_table = _fill_sun_table(planet, model.top_m, grid, extinction, width, size)
    else:
        depth = _sun_depth(planet, model.top_m, grid, extinction, width, bent.height_m, bent.cosine, size.path_nodes)
        bending = Bending(bent.turn, bent.height, bent.aim, depth)
    with_particles = any(n.particle_per_m.any() for n in nodes)
    return Chunk(
        kind,
        width,
        grid,
        extinction,
        emission,
        sun_table,
        [opaque(e) for e in [*(n.solar_irradiance for n in nodes), *pad]],
        [opaque(model.albedo / math.pi)] * width,
        [opaque(c) for c in [*(n.molecular_cos2 for n in nodes), *pad]],
        _interleave([n.particle_per_m for n in nodes], width) if with_particles else None,
        _interleave([n.asymmetry for n in nodes], width) if with_particles else None,
        glow=_glow_chunk(nodes, model, planet, width, size),
        moonlight=[opaque(e) for e in [*(n.moon_irradiance for n in nodes), *pad]]
        if any(n.moon_irradiance for n in nodes)
        else None,
        bending=bending,
    )


def _glow_chunk(
    nodes: Sequence[SpectralNode], model: OpticalModel, planet: Planet, width: int, size: TableSize
) -> Chunk | None:
    """Return the airglow of solar nodes; the ground reflects it and the sky behind, as they come through the air."""
    behind = [n.sky_radiance for n in nodes]
    glowing = any(len(n.glow_per_m) for n in nodes)
    if not glowing and not any(behind):
        return None
    z = model.glow_altitude_m if glowing else model.altitude_m
    glow = [n.glow_per_m if len(n.glow_per_m) else np.zeros_like(z) for n in nodes]
    thin = [np.interp(z, model.altitude_m, n.extinction_per_m, right=0.0) for n in nodes]
    lowest = int(np.argmax(np.any([g > 0.0 for g in glow], axis=0)))
    dark = Chunk(
        "glow",
        width,
        AltitudeGrid.of(z),
        _interleave(thin, width),
        _interleave(glow, width),
        None,
        [],
        [opaque(0.0)] * width,
        [],
        layer_m=float(z[max(lowest - 1, 0)]),
    )
    sky = _downwelling(planet, float(z[-1]), dark, size.path_nodes, behind)
    ground = [model.albedo / math.pi * s for s in sky[: len(nodes)]] + [0.0] * (width - len(nodes))
    return replace(dark, ground=[opaque(g) for g in ground])


def _interleave(columns: Sequence[NDArray[np.float64]], width: int) -> Any:
    table = np.zeros((len(columns[0]), width))
    for k, column in enumerate(columns):
        table[:, k] = column
    return table_of(mi.Float64, table)


def _fill_sun_table(
    planet: Planet, top_m: float, grid: AltitudeGrid, extinction: Any, width: int, size: TableSize
) -> SunTable:
    radius = mean_radius(planet)
    h, mu = SunTable.nodes(size.n_height, size.n_mu, radius, top_m)
    values = _sun_depth(planet, top_m, grid, extinction, width, h, mu, size.path_nodes)
    return SunTable(values, size.n_height, size.n_mu, radius, top_m)


def _sun_depth(
    planet: Planet,
    top_m: float,
    grid: AltitudeGrid,
    extinction: Any,
    width: int,
    height_m: FloatArray,
    mu: FloatArray,
    path_nodes: int,
) -> Any:
    """Return ``ln(tau + tau_0)`` from heights (n_height,) in directions of zenith cosine ``mu`` (n_height, n_mu)."""
    radius = mean_radius(planet)
    height, cosine = table_of(mi.Float64, np.repeat(height_m, mu.shape[1])), table_of(mi.Float64, mu)
    zero = mi.Float64(0.0)
    depth = Chunk("depth", width, grid, extinction, None, None, [], [], [])
    o = (zero, zero, height + radius)
    d = (dr.sqrt(dr.maximum(1.0 - cosine * cosine, 0.0)), zero, cosine)
    sphere = Planet(radius, radius)
    tau, _ = march(sphere, top_m, depth, o, d, (zero, zero, mi.Float64(1.0)), mi.Bool(False), path_nodes, 0.15)
    values = dr.zeros(mi.Float64, mu.size * width)
    row = dr.arange(mi.UInt32, mu.size)
    for k in range(width):
        dr.scatter(values, dr.log(tau[k] + TAU_FLOOR), row * width + k)
    dr.eval(values)
    return values


def _downwelling(planet: Planet, top_m: float, chunk: Chunk, nodes: int, behind: Sequence[float] = ()) -> list[float]:
    """Return the irradiance of air and ``behind`` on the ground [sr times radiance], Gauss quadrature over the sky."""
    x, w = np.polynomial.legendre.leggauss(SKY_POLAR_NODES)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    radius = mean_radius(planet)
    zero = mi.Float64(0.0)
    cosine, sine = table_of(mi.Float64, mu), table_of(mi.Float64, np.sqrt(1.0 - mu**2))
    o = (zero, zero, mi.Float64(radius))
    d = (sine, zero, cosine)
    sphere = Planet(radius, radius)
    sky, through = march(sphere, top_m, chunk, o, d, (zero, zero, mi.Float64(1.0)), mi.Bool(False), nodes, 0.15)
    for k, radiance in enumerate(behind):
        sky[k] = sky[k] + radiance * through[k]
    return [float(2.0 * math.pi * np.sum(w * mu * np.broadcast_to(np.array(s), mu.shape))) for s in sky]
