"""Tables of a thermal band from one camera position: march a few thousand rays, interpolate millions of cells.

Tabulated over the two numbers of a ray (:mod:`horizonval.renderer.kernel.frame_geometry`), clouds left out:

- limb: radiance of the air; and of the Sun's disc behind it, ``sum over g of through_g sun_g``;
- ground: for every kind of ground and a few temperatures T_j the whole radiance of a ray that ends on such ground,
  ``L_air + sum over g of through_g [e_g S_g(T_j) + (1 - e_g) sky_g]``. A cell mixes kinds by their shares and reads
  each at its temperature: with Lagrange's polynomials through as many Chebyshev nodes as approximate
  S within :data:`TEMPERATURE_ERROR`;
- where there are clouds: P and Q of :mod:`horizonval.renderer.thermal.emission_march` at :data:`STATIONS` stations
  through the layer of the tops.

Gaps of thin cloud are finer than any table over directions: with them every ray is marched (:func:`limb_values`,
:func:`ground_values`), and only what opaque clouds hide is that of the mean layers, from the tables.

A cloud of emissivity e in front of a ray of radiance L gives ``P + e Q + (1 - e) (L - P)``.

Tables depend neither on where the camera looks nor on the Sun or the time of day: they serve all frames from a
position, and grow where frames need them (:mod:`horizonval.renderer.view_table.ray_table`). Knots are even: the air's
profile bends at heights that are the same all around, so that halved patches would need five times the rays for the
same error. ``render.accuracy`` sets knots and evaluations along rays together (:func:`knots_for`, :func:`nodes_for`).

**The ends of rays.** Ground of temperature T and emissivity e sends ``sum over g of through_g [e_g S_g(T) + (1 - e_g)
sky_g]`` along a ray. Water mirrors: its sky is the air along the reflected ray. For all else sky_g is the mean radiance
of the air above (downwelling irradiance over pi), that of the row of columns at its latitude::

    sky_g = int S_g 2 E_2(tau) dtau,        layer by layer  S (2 E_3(tau_low) - 2 E_3(tau_high))

in plane layers: the Earth's curvature changes a sky by less than 1 %, of which a ground
of emissivity 0.95 reflects a twentieth. Reflected sunlight is neglected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.special import expn

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.earth.atmosphere.emission import EmittingBand, SourceSpline
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.earth.surface import ground_map
from horizonval.earth.surface.emissivity import emissivity, water_emissivity
from horizonval.earth.surface.ground_emission import (
    KINDS,
    LAG_RAD,
    EmittingPlaces,
    GroundEmission,
    emitting_places,
    ground_k,
)
from horizonval.renderer.kernel.clouds import GapMap
from horizonval.renderer.kernel.frame_geometry import RayCoordinates
from horizonval.renderer.planet import Planet, along, dot, way_through
from horizonval.renderer.position import Position
from horizonval.renderer.refraction import ApparentRadiusAir
from horizonval.renderer.thermal.emission_march import AirColumns, ColumnBatch, Stations, march_emission
from horizonval.renderer.types import Number, Vec
from horizonval.renderer.view_table.ray_table import PACKET, Knots, NodeValues, RayPlane, RayTable

SKY_LAYERS = 160
ALL = slice(None)


def kinds_of(emission: GroundEmission) -> tuple[str, ...]:
    """Return the kinds of ground there are; a uniform one is all land."""
    return KINDS if emission.kind == "earth" else KINDS[:1]


def places_below(emission: GroundEmission, normal: FloatArray, sun_itrs: FloatArray) -> EmittingPlaces:
    """Return what emits below unit normals (n, 3), the Sun in a direction."""
    latitude = np.arcsin(np.clip(normal[:, 2], -1.0, 1.0))
    longitude = np.arctan2(normal[:, 1], normal[:, 0])
    return emitting_places(emission, latitude, longitude, math.atan2(sun_itrs[1], sun_itrs[0]))


def temperature_range_k(emission: GroundEmission, kind: str) -> tuple[float, float]:
    """Return bounds of how cold and how warm a kind of ground can be, all heights and hours of a latitude together."""
    rows = np.arcsin(np.array(emission.sin_latitude))
    latitude = np.unique(np.concatenate([rows, np.radians(np.arange(-90.0, 90.01, 0.25))]))
    high = ground_map.highest_m(np.degrees(latitude)) if emission.kind == "earth" else np.zeros_like(latitude)
    found = []
    for hour, height, sheet, land in product((0.0, math.pi), (0.0 * high, high), (0.0, 1.0), (False, True)):
        same = np.ones_like(latitude)
        at = EmittingPlaces(np.sin(latitude), (hour + LAG_RAD) * same, {}, (land * same) > 0.0, height, sheet * same)
        found.append(ground_k(emission, kind, at))
    return float(np.min(found)), float(np.max(found))


def emissivities(emission: GroundEmission, kind: str, wavelength_um: FloatArray, cosine: FloatArray) -> FloatArray:
    """Return the emissivity of a kind of ground, shape (g, n), at view cosines (n,)."""
    shape = len(wavelength_um), len(cosine)
    if emission.kind != "earth":
        return np.full(shape, emission.emissivity)
    if kind == "water":
        return water_emissivity(wavelength_um[:, None], cosine)
    return np.broadcast_to(emissivity(kind, wavelength_um)[:, None], shape)


def sky_radiance(extinction: FloatArray, source: FloatArray, altitude_m: FloatArray) -> FloatArray:
    """Return sky_g of the module text [W m-2 sr-1]; columns of shape (..., n) from the ground up."""
    layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(altitude_m)
    tau = np.concatenate([np.zeros((*layer.shape[:-1], 1)), np.cumsum(layer, axis=-1)], axis=-1)
    escaped = 2.0 * expn(3, np.minimum(tau, 700.0))
    # a source linear in tau: of a thick layer the lower end counts for most; the light comes steeply, mu about 2/3
    steep = np.maximum(1.5 * layer, 1e-3)
    high = 1.0 / steep - 1.0 / np.expm1(np.minimum(steep, 700.0))
    low = 1.0 - high
    mean = source[..., :-1] * low + source[..., 1:] * high
    return np.asarray(np.sum(mean * (escaped[..., :-1] - escaped[..., 1:]), axis=-1))


def mirrored(planet: Planet, o: Vec, d: Vec) -> tuple[Vec, Vec, Vec]:
    """Return where rays meet the ground, its normals there, and the reflected directions; kernel arrays."""
    mid, half, _ = planet.chord(o, d)
    p = along(o, d, mid - half)
    _, normal = planet.height_and_normal(p)
    return p, normal, along(d, normal, -2.0 * dot(d, normal))


class GroundSource:
    """What the ground of a band emits and reflects.

    ``sky``: shape (g, m), of everything but water, at the columns of ``coarse``; computed on first use, since black
    ground needs none.
    """

    def __init__(self, band: EmittingBand, emission: GroundEmission) -> None:
        self.band, self.emission = band, emission
        self.spline = band.source_spline()

    @cached_property
    def coarse(self) -> EmittingBand:
        """Return the band with the columns of the sky: every fourth of a map.

        Ten degrees change a sky by a few per cent.
        """
        return self.band.coarser()

    @cached_property
    def sky(self) -> FloatArray:
        """Return the mean radiance of the air above, on a grid that is fine at the ground."""
        band = self.coarse
        z = band.altitude_m[-1] * np.linspace(0.0, 1.0, SKY_LAYERS + 1) ** 2
        if len(band.layers):
            z = np.union1d(z, band.altitude_m[band.layer_per_m.any(axis=0)])
        return sky_radiance(band.extinction_at(z), np.moveaxis(self.spline(band.air_k(z)), 2, 0), z)

    @property
    def mirrors(self) -> bool:
        """Whether there is water."""
        return self.emission.kind == "earth"

    def black(self, temperature_k: FloatArray, part: slice = ALL) -> FloatArray:
        """Return S_g(T) of some g points at temperatures (n,), shape (g, n)."""
        return self.spline.of(part)(temperature_k).T

    def emissivities(self, kind: str, cosine: FloatArray, part: slice = ALL) -> FloatArray:
        """Return the emissivity of some g points at view cosines (n,), shape (g, n)."""
        wavelengths, owner = np.unique(self.band.wavelength_um[part], return_inverse=True)
        return emissivities(self.emission, kind, wavelengths, cosine)[owner]

    def sky_at(self, normal: FloatArray, part: slice = ALL) -> FloatArray:
        """Return the sky's mean radiance over places of unit normals (n, 3) for some g points, shape (g, n)."""
        if self.emission.kind != "earth" and self.emission.emissivity == 1.0:
            return np.zeros((len(self.band.wavelength_um[part]), len(normal)))
        return self.coarse.between(self.sky[part], normal)


TEMPERATURE_ERROR = 2e-5
STATIONS, STATION_STEPS = 80, 1
USUAL_ACCURACY = 1e-3
"""Share of the bright limb for which the numbers below are."""
LIMB_PATCHES, GROUND_PATCHES = 14, 5
"""Patches along rows."""
CROWDED_PATCHES = 64
"""The same of the limb where layers of thin cloud have edges, and of the sky around a camera inside the air."""
STEP_SHARE = 0.75
"""Evaluations along rays of tables, as a share of those that a scene asks for."""
PATCHES_PER_RAD, FEWEST_PATCHES = 4.0, 2
"""Patches over half a circle for each radian from the point below the camera to its horizon: the wider the circle, the
more air. One is enough where the air is the same everywhere."""
ON_A_MAP = 6
"""Times the patches of half a circle, all round through columns on a map, at each of which the air bends."""
ABOVE_TOPS_M = 3000.0
"""Height of the first station above the highest cloud: at a layer's edge a ray's path has a square root in height."""


@dataclass(frozen=True)
class ThermalAir:
    """A thermal band as the renderer keeps it: for all frames of a scene."""

    band: EmittingBand
    emission: GroundEmission
    top_m: float
    batches: list[ColumnBatch]
    source: GroundSource
    digest: str

    @classmethod
    def of(
        cls,
        band: EmittingBand,
        emission: GroundEmission,
        air: ApparentRadiusAir | None = None,
        gaps: Sequence[LayerGaps | None] = (),
    ) -> ThermalAir:
        """Build; with refraction (``air``) over apparent heights. ``gaps``: of the band's layers of thin cloud."""
        columns = AirColumns.of(band, air, gaps)
        refraction = None if air is None else (air.height_m, air.dr_dx, columns.altitude_m)
        # what clouds emit is not tabulated, and a name says nothing
        digest = content_digest(replace(band, name=""), replace(emission, cloud_emissivity=0.0), refraction)
        batches = list(columns.batches(single=True))
        return cls(band, emission, columns.top_m, batches, GroundSource(band, emission), digest)

    def under(self, maps: Sequence[GapMap | None]) -> ThermalAir:
        """Return the air with the gaps of its layers, by the maps of all layers."""
        return replace(self, batches=[batch.under(maps) for batch in self.batches])

    @cached_property
    def kinds(self) -> list[WarmKind]:
        """Kinds of ground and their temperatures."""
        return [WarmKind.of(kind, self.emission, self.source.spline) for kind in kinds_of(self.emission)]


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


def knots_for(coordinates: RayCoordinates, band: EmittingBand, accuracy: float, to_ground: bool) -> Knots:
    """Return the knots of a band's tables, as many as an accuracy needs."""
    finer = USUAL_ACCURACY / accuracy
    crowded = len(band.layers) or coordinates.inside
    horizon_rad = math.acos(min(coordinates.planet.a_m / coordinates.distance_m, 1.0))
    half = max(math.ceil(PATCHES_PER_RAD * horizon_rad), FEWEST_PATCHES)
    rows = CROWDED_PATCHES if crowded else LIMB_PATCHES
    if to_ground:
        # a quarter circle is about as long as the way to the horizon
        rows = GROUND_PATCHES if band.is_uniform else max(2 * half, GROUND_PATCHES)
    rows, half = math.ceil(rows * finer**0.25), math.ceil(half * math.sqrt(finer))
    if band.column_map is None:
        return Knots(rows, 1 if band.is_uniform else half, mirrored=True)
    return Knots(rows, ON_A_MAP * half)


def nodes_for(nodes: int, accuracy: float = USUAL_ACCURACY) -> int:
    """Return the evaluations along rays of a table, of those that a scene asks for."""
    return max(2 * math.ceil(0.5 * STEP_SHARE * nodes * (USUAL_ACCURACY / accuracy) ** (1.0 / 3.0)), 16)


@dataclass(frozen=True)
class ThermalView:
    """A band from one camera position.

    ``layer_m``: where the stations begin, None without clouds.
    """

    air: ThermalAir
    position: Position
    coordinates: RayCoordinates
    nodes: int
    accuracy: float
    layer_m: float | None = None

    def table(self, to_ground: bool) -> RayTable:
        """Return the table through clear air as far as it is made.

        To the ground the radiance over every kind at every temperature, else the air's and that of the Sun's disc.
        """
        quantities = sum(len(kind.temperature_k) for kind in self.air.kinds) if to_ground else 2
        march = ground_values if to_ground else limb_values

        def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
            plane = RayPlane(self.coordinates, to_ground)
            return march(self.air, self.coordinates.planet, plane.camera, plane.directions(x, azimuth), self.nodes)

        return self._table("clear", values, quantities, to_ground)

    def cloud_table(self, to_ground: bool) -> RayTable:
        """Return the table of P and Q at the stations along rays as far as it is made."""
        layer_m = self.layer_m
        assert layer_m is not None

        def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
            plane = RayPlane(self.coordinates, to_ground)
            found = _station_values(self.air, plane, plane.directions(x, azimuth), self.nodes, layer_m)
            return np.pad(found, ((0, 0), (0, 0), (0, PACKET - 2))).reshape(len(x), -1)

        return self._table(f"clouds below {layer_m}", values, PACKET * STATIONS, to_ground, single=True)

    def _table(
        self, name: str, values: NodeValues, quantities: int, to_ground: bool, *, single: bool = False
    ) -> RayTable:
        knots = knots_for(self.coordinates, self.air.band, self.accuracy, to_ground)
        key = "thermal", name, to_ground, self.air.digest, self.coordinates.limb, knots, self.nodes
        return self.position.table(lambda: RayTable(values, quantities, knots, single=single), *key)


def limb_values(air: ThermalAir, planet: Planet, o: Vec, d: Vec, nodes: int) -> FloatArray:
    """Return radiance of the air and of the Sun's disc through it, shape (rays, 2)."""
    out = np.zeros((dr.width(d[0]), 2))
    first = 0
    for batch in air.batches:
        more, through, _ = march_emission(planet, air.top_m, batch, o, d, mi.Bool(False), nodes)
        out[:, 0] += sum(np.array(m) for m in more)
        for transmittance, sun in zip(through, air.band.sun_radiance[first : first + batch.used], strict=True):
            out[:, 1] += np.array(transmittance) * sun
        first += batch.used
    return out


def ground_values(air: ThermalAir, planet: Planet, o: Vec, d: Vec, nodes: int) -> FloatArray:
    """Return the radiance of rays that end on every kind of ground at every temperature, shape (rays, kinds x T)."""
    source, kinds = air.source, air.kinds
    p, normal, up = mirrored(planet, o, d)
    dr.eval(p, up)
    cosine, up_there = -np.array(dot(normal, d)), np.stack([np.array(c) for c in normal], axis=-1)
    black = {k.name: source.spline(k.temperature_k) for k in kinds}
    out = np.zeros((sum(len(k.temperature_k) for k in kinds), dr.width(d[0])))
    first = 0
    for batch in air.batches:
        more, through, _ = march_emission(planet, air.top_m, batch, o, d, mi.Bool(True), nodes)
        part = slice(first, first + batch.used)
        transmittance = [np.array(t) for t in through]
        out += sum(np.array(m) for m in more)
        sky = mirror = source.sky_at(up_there, part)
        if source.mirrors:
            above, _, _ = march_emission(planet, air.top_m, batch, p, up, mi.Bool(False), nodes // 2)
            mirror = np.stack([np.array(a) for a in above])
        column = 0
        for k in kinds:
            e = source.emissivities(k.name, cosine, part)
            behind = mirror if k.name == "water" else sky
            rows = slice(column, column + len(k.temperature_k))
            # term by term: products of matrices and sums of NumPy round by how many rays there are
            for g, passed in enumerate(transmittance):
                warm = black[k.name][:, first + g, None] * e[g]
                out[rows] += passed * (warm + (1.0 - e[g]) * behind[g])
            column = rows.stop
        first += batch.used
    return out.T


def _station_values(air: ThermalAir, plane: RayPlane, d: Vec, nodes: int, layer_m: float) -> FloatArray:
    """Return P and Q, shape (rays, stations, 2)."""
    planet, o, to_ground, rays = plane.coordinates.planet, plane.camera, plane.to_ground, dr.width(d[0])
    start, end = way_through(planet, o, d, layer_m, to_ground)
    stations = Stations(start, end, STATIONS, STATION_STEPS)
    total = np.zeros((2, STATIONS, rays))
    for batch in air.batches:
        _, _, at_stations = march_emission(planet, air.top_m, batch, o, d, mi.Bool(to_ground), nodes, stations)
        assert at_stations is not None
        total += np.stack([np.array(k).reshape(STATIONS, rays) for k in at_stations])
    return np.moveaxis(total, 0, -1).swapaxes(0, 1)
