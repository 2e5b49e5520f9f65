"""The march of emitting air: band radiance along rays through columns that vary with height and latitude.

For every g point, with extinction k and source S at a place, seen from the observer::

    L_air = sum over g of int S_g exp(-tau_g) dtau_g,        through_g = exp(-tau_g at the end)

Steps, their two Gauss points and what a step adds are those of :mod:`horizonval.renderer.kernel.march`; there is no
Sun, so that steps are even in its ray parameter, and denser at the ground for rays that meet it. The latitude of a
place is that of the ellipsoid's normal below it.

Asked for stations, the march also writes down what a cloud top between the ends of a ray must know: at every station t
the radiance P of the air before it, and ``Q = sum over g of exp(-tau_g(t)) S_g(air at t)``, the emission of a black
body as warm as the air there.

**Columns of air** are read a few g points at a time. Extinction and source function are linear in height between the
nodes of one grid, linear in the sine of geodetic latitude between rows, and beyond the outermost rows as on them; or
bilinear between columns on a map. In memory the g points of a batch lie side by side, extinction and source of a node
one after the other, so that one node costs two packet gathers.

Geometry is in double precision. What is added up along a ray has the precision of the columns: double for given rays,
single for tables, which costs a few 1e-7 of the radiance and half the time.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.clouds.layers import LayerGaps, merged_bands
from horizonval.earth.weather.field import ColumnMap
from horizonval.renderer.column_air import ColumnsAround, LatitudeRows, Lattice
from horizonval.renderer.kernel.clouds import GapMap
from horizonval.renderer.planet import (
    GAUSS_LOW,
    SOLAR_CONCENTRATION,
    THERMAL_CONCENTRATION,
    AirPath,
    Bands,
    LayeredSteps,
    Planet,
    along,
    find_path,
    layer_bands,
    layered_steps,
    warp,
)
from horizonval.renderer.refraction import ApparentRadiusAir
from horizonval.renderer.tables import AltitudeGrid, gather_row, interpolate, table_of
from horizonval.renderer.types import Real, Values, Vec, constant

WIDTH = 8
"""g points per kernel launch; they share all geometry. More of them find no room in a processor's registers."""


@dataclass(frozen=True)
class AirColumns:
    """Columns of one band.

    ``altitude_m`` (n,), ``sin_latitude`` (m,); ``extinction``, ``source``: (g, m, n), 1/m and W m-2 sr-1; ``bands``:
    heights between which layers of thin cloud lie; ``column_map``: positions of the m columns, in place of
    ``sin_latitude``; ``gapped``: by layer, mean extinction (g, n) of layers with gaps.
    """

    altitude_m: FloatArray
    sin_latitude: FloatArray
    extinction: FloatArray
    source: FloatArray
    column_map: ColumnMap | None = None
    bands: Bands = ()
    gapped: dict[int, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(
        cls, band: EmittingBand, air: ApparentRadiusAir | None = None, gaps: Sequence[LayerGaps | None] = ()
    ) -> AirColumns:
        """Build from a band; with refraction (``air``) per metre of the straight line, over apparent heights.

        ``gaps``: of the band's layers, empty where none has any.
        """
        extinction, source = band.columns()
        gapped = {k: band.each_layer_per_m[k] for k, g in enumerate(gaps) if g is not None}
        if air is None:
            bands = _bands(band.layers, band.altitude_m, gaps)
            return cls(band.altitude_m, band.sin_latitude, extinction, source, band.column_map, bands, gapped)
        kept = np.arange(len(air.height_m))
        if band.column_map is not None:
            # hundreds of columns: only as many heights as the band itself has
            kept = np.searchsorted(air.model.altitude_m, band.altitude_m)
            kept = np.unique(np.clip(np.concatenate([[0], kept, [len(air.height_m) - 1]]), 0, len(air.height_m) - 1))
        height, dr_dx = air.height_m[kept], air.dr_dx[kept]
        i = np.clip(np.searchsorted(band.altitude_m, height, side="right") - 1, 0, len(band.altitude_m) - 2)
        w = (height - band.altitude_m[i]) / (band.altitude_m[i + 1] - band.altitude_m[i])
        w = np.clip(w, 0.0, 1.0)

        def at(values: FloatArray) -> FloatArray:
            return values[..., i] * (1.0 - w) + values[..., i + 1] * w

        inside = height <= band.altitude_m[-1] * (1.0 + 1e-12)
        apparent = air.model.altitude_m[kept]
        return cls(
            apparent,
            band.sin_latitude,
            at(extinction) * np.where(inside, dr_dx, 0.0),
            at(source),
            band.column_map,
            _bands(np.interp(band.layers, air.height_m, air.model.altitude_m), apparent, gaps),
            {k: at(column) * np.where(inside, dr_dx, 0.0) for k, column in gapped.items()},
        )

    @property
    def top_m(self) -> float:
        """Vacuum above."""
        return float(self.altitude_m[-1])

    def batches(self, *, single: bool = False) -> Iterator[ColumnBatch]:
        """Yield the columns for the kernel, :data:`WIDTH` g points at a time; the last is filled up with nothing.

        ``single``: march in single precision.
        """
        count = len(self.extinction)
        width = 1 if count == 1 else WIDTH
        grid = AltitudeGrid.of(self.altitude_m)
        places: ColumnsAround | None = None
        if self.column_map is not None:
            places = Lattice.of(self.column_map)
        elif len(self.sin_latitude) > 1:
            places = LatitudeRows.of(self.sin_latitude)
        for first in range(0, count, width):
            part = slice(first, min(first + width, count))
            packed = np.zeros((*self.extinction.shape[1:], 2, width), dtype=np.float32 if single else np.float64)
            packed[:, :, 0, : part.stop - first] = np.moveaxis(self.extinction[part], 0, -1)
            packed[:, :, 1, : part.stop - first] = np.moveaxis(self.source[part], 0, -1)
            yield ColumnBatch(
                table_of(mi.Float32, packed) if single else table_of(mi.Float64, packed),
                grid,
                width,
                part.stop - first,
                places,
                self.bands,
                tuple(GappedAbsorption(k, self._packed(v[part], width)) for k, v in self.gapped.items()),
            )

    def _packed(self, column: FloatArray, width: int) -> mi.Float64:
        """Return a column of some g points, shape (g, n), for the kernel."""
        packed = np.zeros((len(self.altitude_m), width))
        packed[:, : len(column)] = column.T
        return table_of(mi.Float64, packed)


def _bands(layers: FloatArray, altitude_m: FloatArray, gaps: Sequence[LayerGaps | None]) -> Bands:
    if not len(layers):
        return ()
    heights = [(float(base), float(top)) for base, top in layers]
    sizes = [(*height, g.scale_m) for height, g in zip(heights, gaps, strict=False) if g is not None]
    return layer_bands(merged_bands(heights, float(np.diff(altitude_m).max())), sizes)


@dataclass(frozen=True)
class GappedAbsorption:
    """A layer of thin cloud with gaps: its number, mean column (n * width,), and map; None for the mean everywhere."""

    number: int
    extinction: mi.Float64
    map: GapMap | None = None


@dataclass(frozen=True)
class ColumnBatch:
    """Columns of up to :data:`WIDTH` g points in the kernel's memory.

    ``values``: shape (columns, n, 2, width), flat. ``used``: g points that are not padding. ``places``: of the columns,
    None for a single one.
    """

    values: Any
    grid: AltitudeGrid
    width: int
    used: int
    places: ColumnsAround | None = None
    bands: Bands = ()
    gapped: tuple[GappedAbsorption, ...] = ()

    def under(self, maps: Sequence[GapMap | None]) -> ColumnBatch:
        """Return the columns with the gaps of layers, by the maps of all layers."""
        return replace(self, gapped=tuple(replace(layer, map=maps[layer.number]) for layer in self.gapped))

    def at(self, height_m: mi.Float64, normal: Vec) -> tuple[Values, Values]:
        """Return extinction and source per g point at heights above places of unit normals; none above the top."""
        i, w, inside = self.grid.locate(height_m)
        real = type(self.values)
        corners = [(i, 1.0 - w), (i + 1, w)]
        if self.places is not None:
            columns = self.places.corners(normal)
            corners = [(c * self.grid.count + k, v * share) for c, share in columns for k, v in corners]
        weighted = [(k, real(v)) for k, v in corners]
        out = []
        for part in (0, 1):
            total: list[Any] = []
            for k, v in weighted:
                values = gather_row(self.values, 2 * k + part, self.width)
                total = (
                    [dr.fma(a, v, b) for a, b in zip(values, total, strict=True)] if total else [a * v for a in values]
                )
            out.append(total)
        for layer in self.gapped:
            if layer.map is not None:
                excess = real(layer.map.excess(normal))
                mean = [real(m) for m in interpolate(layer.extinction, i, w, self.width)]
                out[0] = [dr.maximum(dr.fma(excess, m, k), 0.0) for m, k in zip(mean, out[0], strict=True)]
        return [dr.select(inside, k, 0.0) for k in out[0]], out[1]


THICK_STEP = 0.02
"""Optical depth from which the source is integrated against exp(-tau) exactly: 1e-6 for isothermal air."""
_FAR = 0.5 * GAUSS_LOW**2 / (1.0 - 2.0 * GAUSS_LOW)
_NEAR = GAUSS_LOW + _FAR
"""Optical depth from a step's beginning to its first point is ``h (_NEAR k_a - _FAR k_b)``."""
OPAQUE = 1e-9
"""Transmittance of all g points below which the march ends."""


@dataclass(frozen=True)
class Stations:
    """Points along rays at which P and Q are wanted: ``count`` of them, even in t from ``first`` to ``last``.

    ``steps``: march steps from each to the next.
    """

    first: mi.Float64
    last: mi.Float64
    count: int
    steps: int


def march_emission(
    planet: Planet,
    top_m: float,
    batch: ColumnBatch,
    o: Vec,
    d: Vec,
    to_ground: mi.Bool,
    nodes: int,
    stations: Stations | None = None,
) -> tuple[Values, Values, tuple[mi.Float64, mi.Float64] | None]:
    """Return radiance of the air and transmittance along rays, per g point without padding.

    And P, Q at stations or None.

    ``o``, ``d``: origins [m, planet-centred] and unit directions; ``to_ground``: stop at the ground (the ray must hit
    it); ``nodes``: evaluations along each ray, two per step, before the stations if there are any; ``stations``: the
    march ends at the last one. P and Q have the shape (count * rays,), station by station.
    """
    path = find_path(planet, top_m, o, d, to_ground)
    count = max(nodes // 2, 3)
    # of rays that begin or end at their lowest point most of the air lies there, of others on both sides
    from_below = to_ground | (path.length_before <= 0.0)
    concentration = dr.select(from_below, constant(SOLAR_CONCENTRATION), THERMAL_CONCENTRATION)
    layered = None
    if batch.bands and stations is None:
        layered = layered_steps(planet, path, o, d, batch.bands, count, concentration)
    rays = dr.width(path.t_low)
    real = type(batch.values)
    zero = dr.zeros(real, rays)
    total: int | mi.UInt32 = count if stations is None else count + (stations.count - 1) * stations.steps
    if layered is not None:
        total = layered.count
    # as data: frames with other numbers of rays share the kernel
    lane, width = dr.arange(mi.UInt32, rays), dr.opaque(mi.UInt32, rays, 1)
    at_stations = None
    if stations is not None:
        at_stations = dr.zeros(mi.Float64, rays * stations.count), dr.zeros(mi.Float64, rays * stations.count)

    def boundary(i: mi.UInt32) -> mi.Float64:
        return _boundary(path, mi.Float64(i), count, stations, layered, concentration)

    def air_at(t: mi.Float64) -> tuple[Values, Values]:
        height, normal = planet.height_and_normal(along(o, d, t))
        return batch.at(height, normal)

    def body(
        i: mi.UInt32, t0: mi.Float64, passed: Values, radiance: Values
    ) -> tuple[mi.UInt32, mi.Float64, Values, Values]:
        passed, radiance = list(passed), list(radiance)
        t1 = boundary(i + 1)
        h = t1 - t0
        k_a, s_a = air_at(t0 + GAUSS_LOW * h)
        k_b, s_b = air_at(t0 + (1.0 - GAUSS_LOW) * h)
        length = real(h)
        for n in range(batch.width):
            added, escaped = step_emission(length, k_a[n], k_b[n], s_a[n], s_b[n])
            radiance[n] = dr.fma(passed[n], added, radiance[n])
            passed[n] = passed[n] * escaped
        if stations is not None and at_stations is not None:
            _, s = air_at(t1)
            black = sum(passed[n] * s[n] for n in range(batch.width))
            past = i + 1 - count
            station = (i + 1 >= count) & (past % stations.steps == 0)
            index = past // stations.steps * width + lane
            for kept, value in zip(at_stations, (sum(radiance), black), strict=True):
                dr.scatter(kept, mi.Float64(value), index, station, mode=dr.ReduceMode.NoConflicts)
        return i + 1, t1, passed, radiance

    def goes_on(i: mi.UInt32, t0: mi.Float64, passed: Values, radiance: Values) -> mi.Bool:
        # every station must be written
        return i < total if stations is not None else (i < total) & (functools.reduce(dr.maximum, passed) > OPAQUE)

    nothing, everything = [zero + 0.0] * batch.width, [zero + 1.0] * batch.used + [zero] * (batch.width - batch.used)
    _, _, passed, radiance = dr.while_loop(
        (mi.UInt32(0), boundary(mi.UInt32(0)) + dr.zeros(mi.Float64, rays), everything, nothing),
        goes_on,
        body,
        labels=("i", "t", "passed", "radiance"),
        label="emission march",
    )
    through = passed[: batch.used]
    radiance = radiance[: batch.used]
    dr.eval(radiance, through, at_stations)
    return radiance, through, at_stations


def step_emission(h: Real, k_a: Real, k_b: Real, s_a: Real, s_b: Real) -> tuple[Real, Real]:
    """Return what one step of length ``h`` adds, seen from its beginning, and the transmittance through it.

    ``k``, ``s``: extinction and source at the step's Gauss points. Extinction is linear over the step. Below
    :data:`THICK_STEP` four terms of the exponential's series are as good as it is (7e-9), and cost a fraction.
    """
    tau_a = h * (_NEAR * k_a - _FAR * k_b)
    step = 0.5 * h * (k_a + k_b)
    tau_b = dr.fma(1.0 - 2.0 * GAUSS_LOW, step, tau_a)
    tau_a = dr.maximum(tau_a, 0.0)
    escaped = dr.exp(-step)

    def faded(tau: Real) -> Real:
        return dr.fma(tau, dr.fma(tau, dr.fma(tau, -1.0 / 6.0, 0.5), -1.0), 1.0)

    thin = 0.5 * h * (k_a * s_a * faded(tau_a) + k_b * s_b * faded(tau_b))
    # thick: S linear in tau through the two points, integrated against exp(-tau)
    e0 = 1.0 - escaped
    e1 = e0 - step * escaped
    thick = s_a * e0 + (s_b - s_a) * (e1 - tau_a * e0) / dr.maximum(tau_b - tau_a, 1e-30)
    return dr.select(step < THICK_STEP, thin, dr.maximum(thick, 0.0)), escaped


def _boundary(
    path: AirPath,
    i: mi.Float64,
    count: int,
    stations: Stations | None,
    layered: LayeredSteps | None,
    concentration: mi.Float64,
) -> mi.Float64:
    """Return the ray parameter of step boundary ``i``."""
    if layered is not None:
        return warp(path, layered.boundary(i), concentration)
    if stations is None:
        return warp(path, path.y0 + (path.y1 - path.y0) * (i / count), concentration)
    start = path.t_low - path.length_before
    before = start + (stations.first - start) * (i / count)
    x = (i - count) / ((stations.count - 1.0) * stations.steps)
    return dr.select(i < count, before, dr.fma(stations.last - stations.first, x, stations.first))
