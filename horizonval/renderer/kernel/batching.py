"""From an optical model to the tables the march reads, a few spectral nodes at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.clouds.layers import merged_bands
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.renderer.column_air import ColumnAir
from horizonval.renderer.kernel.march import march, optical_depth
from horizonval.renderer.kernel.node_batches import (
    BATCH_WIDTH,
    Bounce,
    GappedLayer,
    GlowNodes,
    OpacityNodes,
    Particles,
    SolarNodes,
)
from horizonval.renderer.planet import Bands, Planet, layer_bands
from horizonval.renderer.refraction import (
    ApparentRadiusAir,
    BendingField,
    RefractedSunTable,
    RefractionTables,
    refracted_sun_table,
)
from horizonval.renderer.scattering.multiple_scattering import content_key, multiple_scattering
from horizonval.renderer.scattering.shells import (
    SOLVED_TOGETHER,
    DiffuseField,
    MultipleScattering,
    Quality,
    without_peaks,
)
from horizonval.renderer.scattering.source_table import HorizontalTransfer, SourceTable
from horizonval.renderer.tables import TAU_FLOOR, AltitudeGrid, SunShell, SunTable, packet_type, table_of
from horizonval.renderer.types import Values, constant

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


_Refraction: TypeAlias = tuple[RefractedSunTable, FloatArray, FloatArray]
"""The table of the Sun that all batches of a model share, with its heights and local cosines."""


def make_batches(
    model: OpticalModel,
    planet: Planet,
    size: TableSize,
    scattering: Quality | None = None,
    progress: Progress | None = None,
    air: ApparentRadiusAir | None = None,
) -> Iterator[tuple[list[SpectralNode], SolarNodes]]:
    """Yield ``(nodes, batch)`` until every spectral node of the model has been served.

    ``scattering``: resolution of the tables of light scattered more than once; None for single scattering. ``air``:
    refraction; model and planet are then over apparent heights, and light scattered more than once is that of the true
    model, without refraction.
    """
    if scattering is not None:
        model = without_peaks(model, scattering.particle_degree)
    refraction = None
    true_model, true_planet = model, planet
    if air is not None:
        true_model, true_planet = air.true_model, air.true_planet
        if scattering is not None:
            true_model = without_peaks(true_model, scattering.particle_degree)
        if model.nodes:
            refraction = refracted_sun_table(BendingField.of(air), size.n_height, size.n_mu, size.path_nodes)
    true_grid, true_node = AltitudeGrid.of(true_model.altitude_m), {n.name: n for n in true_model.nodes}
    grid = AltitudeGrid.of(model.altitude_m)
    for group in _groups(model.nodes):
        batch = _solar_nodes(group, model, planet, grid, size, refraction)
        if scattering is not None and any(n.scattering_per_m.any() for n in group):
            true_nodes = [true_node[n.name] for n in group]
            solved = _diffuse_fields(true_nodes, true_model, true_planet, true_grid, scattering, progress)
            batch = _with_diffuse(batch, solved, true_nodes, true_model, true_planet, scattering)
        yield group, batch


def _groups(nodes: Sequence[SpectralNode]) -> list[list[SpectralNode]]:
    return [list(nodes[first : first + BATCH_WIDTH]) for first in range(0, len(nodes), BATCH_WIDTH)]


def _width(nodes: Sequence[SpectralNode]) -> int:
    return 1 if len(nodes) == 1 else BATCH_WIDTH


def _diffuse_fields(
    nodes: Sequence[SpectralNode],
    model: OpticalModel,
    planet: Planet,
    grid: AltitudeGrid,
    quality: Quality,
    progress: Progress | None,
) -> list[MultipleScattering]:
    def sun_table(missing: Sequence[SpectralNode]) -> SunTable:
        shells = _sun_shells(missing, model, SOLVED_TOGETHER)
        gas = _without_layers(missing, SOLVED_TOGETHER)
        return _fill_sun_table(planet, model.top_m, grid, gas, SOLVED_TOGETHER, IMAGE_TABLE, shells)

    return multiple_scattering(nodes, model.altitude_m, planet.mean_radius_m, quality, sun_table, progress)


def _with_diffuse(
    batch: SolarNodes,
    solved: Sequence[MultipleScattering],
    nodes: Sequence[SpectralNode],
    model: OpticalModel,
    planet: Planet,
    quality: Quality,
) -> SolarNodes:
    """Return the batch with the light scattered more than once; the ground's part is apart where it varies."""

    def table(fields: Sequence[DiffuseField]) -> SourceTable:
        return SourceTable.of(fields, batch.width, batch.particles is not None)

    if not model.ground_varies:
        return replace(batch, diffuse=table([s.over_ground(model.albedo) for s in solved]))
    bounce = Bounce(
        table([s.bounce for s in solved]),
        tuple(s.spherical_albedo for s in solved),
        tuple(HorizontalTransfer.of(node, model.altitude_m) for node in nodes),
        tuple(node.wavelength_um for node in nodes),
        batch.width,
        " ".join(content_key(node, model.altitude_m, planet.mean_radius_m, quality) for node in nodes),
    )
    return replace(batch, diffuse=table([s.air for s in solved]), bounce=bounce)


def _padded(values: Sequence[float], width: int) -> Values:
    return [constant(v) for v in [*values, *[0.0] * (width - len(values))]]


def _solar_nodes(
    nodes: Sequence[SpectralNode],
    model: OpticalModel,
    planet: Planet,
    grid: AltitudeGrid,
    size: TableSize,
    refraction: _Refraction | None,
) -> SolarNodes:
    """Return the batch without light scattered more than once."""
    width = _width(nodes)
    extinction = _interleave([n.extinction_per_m for n in nodes], width)
    molecular = _interleave([n.molecular_per_m for n in nodes], width)
    gas, shells = _without_layers(nodes, width), _sun_shells(nodes, model, width)
    sunlight: SunTable | RefractionTables
    if refraction is None:
        sunlight = _fill_sun_table(planet, model.top_m, grid, gas, width, size, shells)
    else:
        sun, height_m, cosine = refraction
        depth = _sun_depth(planet, model.top_m, grid, gas, width, height_m, cosine, size.path_nodes)
        sunlight = RefractionTables(sun, depth, shells)
    particles = None
    irradiance = _padded([n.solar_irradiance for n in nodes], width)
    reflectance = [constant(model.albedo / math.pi)] * width
    cos2 = _padded([n.molecular_cos2 for n in nodes], width)
    if any(n.particle_per_m.any() for n in nodes):
        asymmetry, forward = [n.asymmetry for n in nodes], None
        if model.layers:
            asymmetry = [_nearest(n.asymmetry, n.particle_per_m) for n in nodes]
        if any(len(n.forward_per_m) for n in nodes):
            shares = [_nearest(n.forward_per_m / np.maximum(n.particle_per_m, 1e-300), n.particle_per_m) for n in nodes]
            forward = _interleave(shares, width)
        particles = Particles(
            _interleave([n.particle_per_m for n in nodes], width), _interleave(asymmetry, width), forward
        )
    moonlight, columns = None, None
    if model.columns is not None:
        columns = ColumnAir.of(model.columns, nodes, model.altitude_m, width, planet.mean_radius_m)
    glow = _glow_nodes(nodes, model, planet, width, size)
    if any(n.moon_irradiance for n in nodes):
        moonlight = _padded([n.moon_irradiance for n in nodes], width)
    return SolarNodes(
        width,
        grid,
        extinction,
        molecular,
        cos2,
        particles,
        irradiance,
        reflectance,
        sunlight,
        glow=glow,
        moonlight=moonlight,
        columns=columns,
        bands=_bands(model),
        gapped=_gapped(nodes, model, width),
    )


def _bands(model: OpticalModel, more: Sequence[tuple[float, float]] = ()) -> Bands:
    """Return the heights of a model's layers with the softened edges, and of others, whose edges are a step soft."""
    if not model.layers:
        return ()
    step = float(model.altitude_m[1] - model.altitude_m[0])
    soft = [(base - step, top + step) for base, top in more]
    heights = merged_bands([*(_reach(model, i) for i in range(len(model.layers))), *soft], 0.0)
    gaps = zip(model.layers, model.gaps, strict=False)
    return layer_bands(heights, [(base, top, g.scale_m) for (base, top), g in gaps if g is not None])


def _reach(model: OpticalModel, layer: int) -> tuple[float, float]:
    """Return the heights between which a layer's column on the model's altitudes differs from zero."""
    column = np.max([node.layer_per_m[layer] for node in model.nodes], axis=0)
    # refraction moves columns to other heights, which leaves traces of rounding
    where = np.flatnonzero(column > 1e-9 * column.max())
    last = len(column) - 1
    return float(model.altitude_m[max(where[0] - 1, 0)]), float(model.altitude_m[min(where[-1] + 1, last)])


def _gapped(
    nodes: Sequence[SpectralNode], model: OpticalModel, width: int, altitude_m: FloatArray | None = None
) -> tuple[GappedLayer, ...]:
    """Return the layers of a model that have gaps, for a batch on the model's altitudes, or on others above them."""

    def columns(i: int, scale: Sequence[float]) -> mi.Float64:
        values = [s * n.layer_per_m[i] for s, n in zip(scale, nodes, strict=True)]
        if altitude_m is not None:
            values = [np.interp(altitude_m, model.altitude_m, v, right=0.0) for v in values]
        return _interleave(values, width)

    return tuple(
        GappedLayer(
            i,
            columns(i, [1.0] * len(nodes)),
            columns(i, [n.layer_albedo[i] for n in nodes]),
            _padded([n.layer_asymmetry[i] for n in nodes], width),
        )
        for i, gaps in enumerate(model.gaps)
        if gaps is not None
    )


def _nearest(values: FloatArray, scattering: FloatArray) -> FloatArray:
    """Return a column whose heights without scattering take the value of the nearest height that scatters."""
    where = np.flatnonzero(scattering > 0.0)
    if not len(where):
        return values
    return np.asarray(values[where[np.abs(where[:, None] - np.arange(len(values))).argmin(axis=0)]])


def _without_layers(nodes: Sequence[SpectralNode], width: int) -> mi.Float64:
    gas = [n.extinction_per_m - n.layer_per_m.sum(axis=0) if len(n.layer_per_m) else n.extinction_per_m for n in nodes]
    return _interleave([np.maximum(k, 0.0) for k in gas], width)


def _sun_shells(nodes: Sequence[SpectralNode], model: OpticalModel, width: int) -> tuple[SunShell, ...]:
    shells = []
    for i, (base, top) in enumerate(model.layers):
        per_m = [float(np.trapezoid(n.layer_per_m[i], model.altitude_m)) / (top - base) for n in nodes]
        shells.append(SunShell(constant(base), constant(top), _padded(per_m, width)))
    return tuple(shells)


def _glow_nodes(
    nodes: Sequence[SpectralNode], model: OpticalModel, planet: Planet, width: int, size: TableSize
) -> GlowNodes | None:
    """Return the airglow of solar nodes; the ground reflects it and the sky behind, as they come through the air."""
    behind = [n.sky_radiance for n in nodes]
    glowing = any(len(n.glow_per_m) for n in nodes)
    if not glowing and not any(behind):
        return None
    z = model.glow_altitude_m if glowing else model.altitude_m
    glow = [n.glow_per_m if len(n.glow_per_m) else np.zeros_like(z) for n in nodes]
    thin = [np.interp(z, model.altitude_m, n.extinction_per_m, right=0.0) for n in nodes]
    lowest = int(np.argmax(np.any([g > 0.0 for g in glow], axis=0)))
    over_black = GlowNodes(
        width,
        AltitudeGrid.of(z),
        _interleave(thin, width),
        _interleave(glow, width),
        [constant(0.0)] * width,
        float(z[max(lowest - 1, 0)]),
        bands=_bands(model, [(float(z[max(lowest - 1, 0)]), float(z[-1]))] if glowing else ()),
        gapped=_gapped(nodes, model, width, z),
    )
    sky = _downwelling(planet, float(z[-1]), over_black, size.path_nodes, behind)
    ground = [model.albedo / math.pi * s for s in sky[: len(nodes)]] + [0.0] * (width - len(nodes))
    return replace(over_black, ground=[constant(g) for g in ground])


def _interleave(columns: Sequence[FloatArray], width: int) -> mi.Float64:
    table = np.zeros((len(columns[0]), width))
    for k, column in enumerate(columns):
        table[:, k] = column
    return table_of(mi.Float64, table)


def _fill_sun_table(
    planet: Planet,
    top_m: float,
    grid: AltitudeGrid,
    extinction: mi.Float64,
    width: int,
    size: TableSize,
    shells: tuple[SunShell, ...] = (),
) -> SunTable:
    radius = planet.mean_radius_m
    h, mu = SunTable.nodes(size.n_height, size.n_mu, radius, top_m)
    values = _sun_depth(planet, top_m, grid, extinction, width, h, mu, size.path_nodes)
    return SunTable(values, size.n_height, size.n_mu, radius, top_m, shells)


def _sun_depth(
    planet: Planet,
    top_m: float,
    grid: AltitudeGrid,
    extinction: mi.Float64,
    width: int,
    height_m: FloatArray,
    mu: FloatArray,
    path_nodes: int,
) -> mi.Float64:
    """Return ``ln(tau + tau_0)`` from heights (n_height,) in directions of zenith cosine ``mu`` (n_height, n_mu)."""
    radius = planet.mean_radius_m
    height, cosine = table_of(mi.Float64, np.repeat(height_m, mu.shape[1])), table_of(mi.Float64, mu)
    zero = mi.Float64(0.0)
    o = (zero, zero, height + radius)
    d = (dr.sqrt(dr.maximum(1.0 - cosine * cosine, 0.0)), zero, cosine)
    sphere = Planet(radius, radius)
    tau = optical_depth(sphere, top_m, OpacityNodes(width, grid, extinction), o, d, path_nodes)
    logarithms = [dr.log(t + TAU_FLOOR) for t in tau]
    # at once: every launch that wanted one of them would march for all
    dr.eval(logarithms)
    if width == 1:
        return logarithms[0]
    values = dr.empty(mi.Float64, mu.size * width)
    dr.scatter(values, packet_type(mi.Float64)(*logarithms), dr.arange(mi.UInt32, mu.size))
    dr.eval(values)
    return values


def _downwelling(
    planet: Planet, top_m: float, batch: GlowNodes, nodes: int, behind: Sequence[float] = ()
) -> list[float]:
    """Return the irradiance of air and ``behind`` on the ground [sr times radiance], Gauss quadrature over the sky."""
    x, w = np.polynomial.legendre.leggauss(SKY_POLAR_NODES)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    radius = planet.mean_radius_m
    zero = mi.Float64(0.0)
    cosine, sine = table_of(mi.Float64, mu), table_of(mi.Float64, np.sqrt(1.0 - mu**2))
    o = (zero, zero, mi.Float64(radius))
    d = (sine, zero, cosine)
    sphere = Planet(radius, radius)
    sky, through = march(sphere, top_m, batch, o, d, (zero, zero, mi.Float64(1.0)), mi.Bool(False), nodes)
    for k, radiance in enumerate(behind):
        sky[k] = sky[k] + radiance * through[k]
    return [float(2.0 * math.pi * np.sum(w * mu * np.broadcast_to(np.array(s), mu.shape))) for s in sky]
