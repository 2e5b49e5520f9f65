r"""Tables of a thermal band from one camera position: march a few ten thousand rays, look millions of cells up.

Tabulated over the two numbers of a ray (:mod:`horizonval.renderer.kernel.ray_coordinates`), clouds left out:

- limb: radiance of the air; and of the Sun's disc behind it, ``sum over g of through_g sun_g``;
- ground: for every kind of ground and a few temperatures T_j the whole radiance of a ray that ends on such ground,
  ``L_air + sum over g of through_g [e_g S_g(T_j) + (1 - e_g) sky_g]``. A cell mixes kinds by their shares and reads
  each at its own temperature: with Lagrange's polynomials through Chebyshev nodes, of which there are as many as keep
  S within :data:`TEMPERATURE_ERROR`;
- where there are clouds: P and Q of :mod:`horizonval.renderer.thermal.emission_march` at :data:`STATIONS` stations
  through the layer of the tops.

A cloud of emissivity e in front of a ray of radiance L gives ``P + e Q + (1 - e) (L - P)``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand, SourceSpline
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.planet import Planet, dot
from horizonval.renderer.spline_table import Azimuths, SplineTable, StationTable
from horizonval.renderer.tables import vectors
from horizonval.renderer.thermal.emission_columns import AirColumns, ColumnBatch
from horizonval.renderer.thermal.emission_ground import GroundSource, kinds_of, mirrored, temperature_range_k
from horizonval.renderer.thermal.emission_march import Stations, march_emission
from horizonval.renderer.types import Number, Vec

TEMPERATURE_ERROR = 2e-5
STATIONS, STATION_STEPS = 80, 1
ABOVE_TOPS_M = 3000.0
"""The stations begin this much above the highest cloud: at the very edge of a layer a ray's way through it has a square
root in its height."""


@dataclass(frozen=True)
class ThermalAir:
    """A thermal band as the renderer keeps it: for all frames of a scene."""

    band: EmittingBand
    top_m: float
    batches: list[ColumnBatch]
    source: GroundSource

    @classmethod
    def of(cls, band: EmittingBand, emission: GroundEmission, columns: AirColumns) -> ThermalAir:
        """Build; ``columns`` are over apparent heights with refraction."""
        return cls(band, columns.top_m, list(columns.batches()), GroundSource(band, emission))


@dataclass(frozen=True)
class WarmKind:
    """A kind of ground and the temperatures at which its radiance is tabulated."""

    name: str
    temperature_k: FloatArray

    @classmethod
    def of(cls, name: str, emission: GroundEmission, spline: SourceSpline) -> WarmKind:
        """Choose the fewest temperatures."""
        low, high = temperature_range_k(emission, name)
        if high - low < 1e-6:
            return cls(name, np.array([0.5 * (low + high)]))
        fine = np.linspace(low, high, 101)
        exact = spline(fine)
        for count in range(2, 12):
            nodes = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(math.pi * (np.arange(count) + 0.5) / count)
            basis = np.array(lagrange(fine, nodes))
            if np.abs(np.tensordot(basis, spline(nodes), (0, 0)) / exact - 1.0).max() < TEMPERATURE_ERROR:
                break
        return cls(name, nodes)


def lagrange(t: Number, nodes: Sequence[Number] | FloatArray) -> list[Number]:
    """Return Lagrange's polynomials of the nodes at ``t``; numpy or kernel arrays."""
    out: list[Number] = []
    for j, node in enumerate(nodes):
        factor: Any = 1.0
        for k, other in enumerate(nodes):
            if k != j:
                factor = factor * ((t - other) * (1.0 / (node - other)))
        out.append(factor)
    return out


@dataclass(frozen=True)
class BandTables:
    """Everything a cell of one band looks up. ``clouds_*``: None without clouds; ``layer_m`` their stations' begin."""

    coordinates: RayCoordinates
    kinds: list[WarmKind]
    ground: SplineTable | None
    limb: SplineTable | None
    clouds_ground: StationTable | None
    clouds_limb: StationTable | None
    layer_m: float


def make_tables(
    air: ThermalAir,
    emission: GroundEmission,
    coordinates: RayCoordinates,
    azimuths: Azimuths,
    nodes: int,
    cloud_top_m: float | None,
    to_ground_and_limb: tuple[bool, bool],
) -> BandTables:
    """Return the tables of a band.

    Parameters
    ----------
    azimuths : Azimuths
        Those that the camera sees.
    nodes : int
        Evaluations along each ray.
    cloud_top_m : float or None
        Of the highest cloud; None without clouds.
    to_ground_and_limb : tuple of bool
        Whether there are rays to the ground, and rays past it.
    """
    layer_m = 0.0 if cloud_top_m is None else cloud_top_m + ABOVE_TOPS_M
    angle = azimuths.node_azimuths()
    o = vectors(coordinates.origin[None, :])
    kinds = [WarmKind.of(kind, emission, air.source.spline) for kind in kinds_of(emission)]
    ground = limb = clouds_ground = clouds_limb = None
    if to_ground_and_limb[0]:
        v = coordinates.ground.nodes()
        d = coordinates.directions(v, angle, to_ground=True).reshape(-1, 3)
        values = _ground_values(air, coordinates.planet, kinds, o, d, nodes)
        ground = SplineTable.of(values.reshape(len(v), len(angle), -1), azimuths)
        if layer_m:
            stations = _station_values(air, coordinates.planet, o, d, True, nodes, layer_m)
            clouds_ground = StationTable.of(stations.reshape(len(v), len(angle), STATIONS, 2), azimuths)
    if to_ground_and_limb[1]:
        v = coordinates.limb.nodes()
        d = coordinates.directions(v, angle, to_ground=False).reshape(-1, 3)
        values = _limb_values(air, coordinates.planet, o, d, nodes)
        limb = SplineTable.of(values.reshape(len(v), len(angle), 2), azimuths)
        if layer_m:
            rows = _rows_below(coordinates, v, layer_m)
            stations = _station_values(air, coordinates.planet, o, d[: rows * len(angle)], False, nodes, layer_m)
            clouds_limb = StationTable.of(stations.reshape(rows, len(angle), STATIONS, 2), azimuths)
    return BandTables(coordinates, kinds, ground, limb, clouds_ground, clouds_limb, layer_m)


def _rows_below(coordinates: RayCoordinates, v: FloatArray, layer_m: float) -> int:
    """Return how many rows of the limb's axis may meet a layer, and two more."""
    highest = layer_m * 1.01
    a, r = coordinates.planet.a_m, coordinates.distance_m
    if not coordinates.inside:
        limit = highest
    elif r > a + highest:
        limit = math.asin((a + highest) / r) - math.asin(a / r)
    else:
        return len(v)
    return min(int(np.searchsorted(v, limit)) + 3, len(v))


def _limb_values(air: ThermalAir, planet: Planet, o: Vec, d: FloatArray, nodes: int) -> FloatArray:
    """Return radiance of the air and of the Sun's disc through it, shape (rays, 2)."""
    out = np.zeros((len(d), 2))
    first = 0
    for batch in air.batches:
        more, through, _ = march_emission(planet, air.top_m, batch, o, vectors(d), mi.Bool(False), nodes)
        out[:, 0] += sum(np.array(m) for m in more)
        for transmittance, sun in zip(through, air.band.sun_radiance[first : first + batch.used], strict=True):
            out[:, 1] += np.array(transmittance) * sun
        first += batch.used
    return out


def _ground_values(
    air: ThermalAir, planet: Planet, kinds: list[WarmKind], o: Vec, d: FloatArray, nodes: int
) -> FloatArray:
    """Return the radiance of rays that end on every kind of ground at every temperature, shape (rays, kinds x T)."""
    ray, source = vectors(d), air.source
    p, normal, up = mirrored(planet, o, ray)
    dr.eval(p, up)
    cosine, sin_latitude = -np.array(dot(normal, ray)), np.array(normal[2])
    black = {k.name: source.spline(k.temperature_k) for k in kinds}
    out = np.zeros((sum(len(k.temperature_k) for k in kinds), len(d)))
    first = 0
    for batch in air.batches:
        more, through, _ = march_emission(planet, air.top_m, batch, o, ray, mi.Bool(True), nodes)
        part = slice(first, first + batch.used)
        transmittance = np.stack([np.array(t) for t in through])
        out += sum(np.array(m) for m in more)
        sky = mirror = source.sky_at(sin_latitude, part)
        if source.mirrors:
            above, _, _ = march_emission(planet, air.top_m, batch, p, up, mi.Bool(False), nodes // 2)
            mirror = np.stack([np.array(a) for a in above])
        column = 0
        for k in kinds:
            e = source.emissivities(k.name, cosine, part)
            reflected = np.sum(transmittance * (1.0 - e) * (mirror if k.name == "water" else sky), axis=0)
            rows = slice(column, column + len(k.temperature_k))
            out[rows] += black[k.name][:, part] @ (transmittance * e) + reflected
            column = rows.stop
        first += batch.used
    return out.T


def way_through(planet: Planet, o: Vec, d: Vec, layer_m: float, to_ground: bool) -> tuple[mi.Float64, mi.Float64]:
    """Return the ray parameters between which the stations lie."""
    mid, half, _ = planet.chord(o, d, layer_m)
    start, end = dr.maximum(mid - half, 0.0), dr.maximum(mid + half, 0.0)
    if to_ground:
        ground_mid, ground_half, _ = planet.chord(o, d)
        end = ground_mid - ground_half
    return start, dr.maximum(end, start)


def _station_values(
    air: ThermalAir, planet: Planet, o: Vec, d: FloatArray, to_ground: bool, nodes: int, layer_m: float
) -> FloatArray:
    """Return P and Q, shape (rays, stations, 2)."""
    ray = vectors(d)
    start, end = way_through(planet, o, ray, layer_m, to_ground)
    stations = Stations(start, end, STATIONS, STATION_STEPS)
    total = np.zeros((2, STATIONS, len(d)))
    for batch in air.batches:
        _, _, at_stations = march_emission(planet, air.top_m, batch, o, ray, mi.Bool(to_ground), nodes, stations)
        assert at_stations is not None
        total += np.stack([np.array(k).reshape(STATIONS, len(d)) for k in at_stations])
    return np.moveaxis(total, 0, -1).swapaxes(0, 1)
