r"""Thermal emission by Monte Carlo: an integrator for Mitsuba, whose ``volpath`` has no emitting air of this kind.

A path is walked backward from the camera, and ends where a photon that came along it was emitted: at the first
absorption. Along the ray the optical depth to that place is distributed as :math:`\exp(-\tau)`, and so

.. math:: L_g = \int S_g \, e^{-\tau_g} \, d\tau_g + \dots = E[S_g(\text{place of absorption})]

with S = 0 for paths that leave into space. Each path belongs to one g point, sampled with a probability :math:`p_g`,
and counts :math:`1 / p_g` times. Half of :math:`p_g` is :math:`S_g / \sum S_g` of air of :data:`TYPICAL_K`, half the
same for all: line centres, which are all that shines high up, would otherwise have too few paths.

Distances are found by null collisions (Woodcock): a tentative flight through air of the majorant :math:`M \ge k`, then
absorption with the probability :math:`k / M`. Height above a convex body is a convex function along a line, so that a
ray at height h whose height changes by :math:`\mu` per metre is never below :math:`h + \mu s`: the majorant holds. A
flight ends where the ray may have sunk by :data:`SINK_M`, and goes on with the majorant from there.

**Air** lies on even heights, linear in height and in the sine of latitude. Below the height where the optical depth
straight up is :data:`UNSEEN` the extinction is constant: light from deeper is a share of 2e-9, and paths need no steps
of metres. **Ground**: shares and temperatures of :mod:`horizonval.earth.surface.ground_emission` lie on a grid of
latitude and longitude inside the camera's horizon. A path meets one kind of ground, by chance. There it ends with the
probability of its emissivity, or is reflected: by water as by a mirror, by all else evenly into all directions.

Mitsuba provides the rays of the camera, the ground that they hit and its normal (an ``instance``, as in sunlight), the
random numbers and the film. With the march it shares no code but that of the optical properties.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.surface.ground_emission import KINDS, GroundEmission, emitting_places, ground_emissivity, ground_k
from horizonval.renderer.reference.reference_scene import KM, Placement, geodetic
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import PluginDict, constant, constant_vector, inverse_root

UNSEEN = 20.0
STEP_M = 50.0
"""Half a step of the band's own grid."""
MAJORANT_STEP_M = 1000.0


@dataclass(frozen=True)
class AirTables:
    """A band's air in the kernel's memory, Float32, g points outermost.

    ``extinction`` [1/m] and ``source`` [W m-2 sr-1]: shape (g, rows, heights), flat. ``majorant`` [1/m], shape
    (g, levels): the largest extinction at a height and above. ``low``, ``per_row``: rows on the sine of latitude.
    """

    extinction: mi.Float32
    source: mi.Float32
    majorant: mi.Float32
    rows: int
    heights: int
    levels: int
    low: mi.Float64
    per_row: mi.Float64
    top_m: mi.Float64

    @classmethod
    def of(cls, band: EmittingBand) -> AirTables:
        """Build from a band without a map of columns."""
        top = float(band.altitude_m[-1])
        z = np.linspace(0.0, top, 1 + round(top / STEP_M))
        coarse_extinction, coarse_source = band.columns()
        extinction = _seen(_on(z, band.altitude_m, coarse_extinction), z)
        source = _on(z, band.altitude_m, coarse_source)
        above = np.maximum.accumulate(extinction.max(axis=1)[:, ::-1], axis=-1)[:, ::-1]
        level = np.arange(0.0, top + MAJORANT_STEP_M, MAJORANT_STEP_M)
        # of the node below each level: never too small
        node = np.clip((level / (z[1] - z[0])).astype(int), 0, len(z) - 1)
        rows = len(band.sin_latitude)
        low = float(band.sin_latitude[0])
        span = float(band.sin_latitude[-1]) - low
        return cls(
            table_of(mi.Float32, extinction),
            table_of(mi.Float32, source),
            table_of(mi.Float32, above[:, node] * (1.0 + 1e-5)),
            rows,
            len(z),
            len(level),
            constant(low),
            constant((rows - 1) / span if rows > 1 else 0.0),
            constant(top),
        )

    def at(self, g: mi.UInt32, height_m: mi.Float64, sine: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return extinction and source of g points at heights and sines of latitude; nothing above the top."""
        x = dr.clip(height_m * ((self.heights - 1) / self.top_m), 0.0, self.heights - 1.0)
        i = dr.minimum(mi.UInt32(x), self.heights - 2)
        up = x - mi.Float64(i)
        corners = [(g * self.rows, mi.Float64(1.0))]
        if self.rows > 1:
            y = dr.clip((sine - self.low) * self.per_row, 0.0, self.rows - 1.0)
            row = dr.minimum(mi.UInt32(y), self.rows - 2)
            north = y - mi.Float64(row)
            corners = [(g * self.rows + row, 1.0 - north), (g * self.rows + row + 1, north)]
        extinction, source = mi.Float64(0.0), mi.Float64(0.0)
        for line, share in corners:
            for k, w in ((i, share * (1.0 - up)), (i + 1, share * up)):
                place = line * self.heights + k
                extinction += w * mi.Float64(dr.gather(mi.Float32, self.extinction, place))
                source += w * mi.Float64(dr.gather(mi.Float32, self.source, place))
        return dr.select(height_m <= self.top_m, extinction, 0.0), source

    def most_above(self, g: mi.UInt32, height_m: mi.Float64) -> mi.Float64:
        """Return what no extinction at these heights and above exceeds; 0 above the top."""
        i = dr.minimum(mi.UInt32(dr.maximum(height_m, 0.0) / MAJORANT_STEP_M), self.levels - 1)
        value = mi.Float64(dr.gather(mi.Float32, self.majorant, g * self.levels + i))
        return dr.select(height_m < self.top_m, value, 0.0)


def _on(z: FloatArray, altitude_m: FloatArray, values: FloatArray) -> FloatArray:
    i = np.clip(np.searchsorted(altitude_m, z, side="right") - 1, 0, len(altitude_m) - 2)
    w = (z - altitude_m[i]) / (altitude_m[i + 1] - altitude_m[i])
    return np.asarray(values[..., i] * (1.0 - w) + values[..., i + 1] * w)


def _seen(extinction: FloatArray, z: FloatArray) -> FloatArray:
    """Return columns whose extinction stays the same below the height where nothing is seen any more."""
    layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(z)
    above = np.zeros_like(extinction)
    above[..., :-1] = np.cumsum(layer[..., ::-1], axis=-1)[..., ::-1]
    deepest = np.argmax(above < UNSEEN, axis=-1)[..., None]
    there = np.take_along_axis(extinction, deepest, axis=-1)
    return np.where(np.arange(len(z)) < deepest, there, extinction)


CELLS = 1024
"""Of the grid, along each axis."""
COLDEST_K, WARMEST_K, STEP_K = 80.0, 400.0, 0.25
"""Of the table of sources, which is linear between: 5e-6 of S."""
COSINES = 257
MARGIN_RAD = 0.01
"""Geodetic latitudes differ from geocentric ones by up to a third of this."""


@dataclass(frozen=True)
class GroundGrid:
    """Shares and temperatures over latitude and longitude [rad], shape (cells, cells, 2 kinds), flat Float32.

    ``low``, ``per_cell``: of latitude, and of longitude from ``middle`` on.
    """

    kinds: tuple[str, ...]
    values: mi.Float32
    low: tuple[mi.Float64, mi.Float64]
    per_cell: tuple[mi.Float64, mi.Float64]
    middle: mi.Float64

    @classmethod
    def below(cls, place: Placement, emission: GroundEmission) -> GroundGrid:
        """Build for all places inside the camera's horizon."""
        x, y, z = place.camera_m
        distance = float(np.linalg.norm(place.camera_m))
        latitude, longitude = math.asin(z / distance), math.atan2(y, x)
        reach = math.acos(min(place.planet.b_m / distance, 1.0)) + MARGIN_RAD
        south, north = max(latitude - reach, -math.pi / 2), min(latitude + reach, math.pi / 2)
        around = max(abs(south), abs(north)) > math.pi / 2 - 1e-3
        wide = math.pi if around else math.asin(min(math.sin(reach) / math.cos(latitude), 1.0))
        rows, columns = np.linspace(south, north, CELLS), np.linspace(-wide, wide, CELLS)
        a, b = (v.ravel() for v in np.meshgrid(rows, longitude + columns, indexing="ij"))
        places = emitting_places(emission, a, b, math.atan2(place.sun[1], place.sun[0]))
        kinds = tuple(kind for kind in KINDS if kind in places.shares)
        shares = [places.shares[kind] for kind in kinds]
        warmth = [ground_k(emission, kind, places) for kind in kinds]
        return cls(
            kinds,
            table_of(mi.Float32, np.stack(shares + warmth, axis=-1)),
            (constant(south), constant(-wide)),
            (constant((CELLS - 1) / (north - south)), constant((CELLS - 1) / (2.0 * wide))),
            constant(longitude),
        )

    def at(self, normal: Any, sample: mi.Float32) -> tuple[mi.UInt32, mi.Float64]:
        """Return a kind of ground, drawn by its share, and its temperature at places of unit normals."""
        east = dr.atan2(normal.y, normal.x) - self.middle
        east -= 2.0 * dr.pi * dr.round(east / (2.0 * dr.pi))
        cells, parts = [], []
        angles: tuple[Any, Any] = (dr.asin(normal.z), east)
        for value, low, per in zip(angles, self.low, self.per_cell, strict=True):
            x = dr.clip((value - low) * per, 0.0, CELLS - 1.0)
            i = dr.minimum(mi.UInt32(x), CELLS - 2)
            cells.append(i)
            parts.append(x - mi.Float64(i))
        count = len(self.kinds)
        found = [mi.Float64(0.0)] * (2 * count)
        for j, v in ((0, 1.0 - parts[0]), (1, parts[0])):
            for k, u in ((0, 1.0 - parts[1]), (1, parts[1])):
                place = ((cells[0] + j) * CELLS + cells[1] + k) * (2 * count)
                for n in range(2 * count):
                    found[n] = found[n] + v * u * mi.Float64(dr.gather(mi.Float32, self.values, place + n))
        kind, temperature = mi.UInt32(0), found[count]
        below = found[0]
        for n in range(1, count):
            later = mi.Float64(sample) >= below
            kind = dr.select(later, n, kind)
            temperature = dr.select(later, found[count + n], temperature)
            below = below + found[n]
        return kind, temperature


@dataclass(frozen=True)
class GroundTables:
    """Ground by g point: ``emissivity`` (g, kinds, cosines), flat; ``source`` [W m-2 sr-1] (g, temperatures), flat."""

    grid: GroundGrid
    emissivity: mi.Float32
    source: mi.Float32

    @classmethod
    def of(cls, grid: GroundGrid, emission: GroundEmission, band: EmittingBand) -> GroundTables:
        """Build for a band."""
        cosine = np.linspace(0.0, 1.0, COSINES)
        values = [ground_emissivity(emission, kind, band.wavelength_um[:, None], cosine) for kind in grid.kinds]
        temperature = np.arange(COLDEST_K, WARMEST_K + 0.5 * STEP_K, STEP_K)
        return cls(
            grid,
            table_of(mi.Float32, np.stack(values, axis=1)),
            table_of(mi.Float32, np.ascontiguousarray(band.source(temperature).T)),
        )

    @property
    def water(self) -> int:
        """Index of the kind that mirrors; past the last for none."""
        return self.grid.kinds.index("water") if "water" in self.grid.kinds else len(self.grid.kinds)

    def emissivity_of(self, g: mi.UInt32, kind: mi.UInt32, cosine: mi.Float64) -> mi.Float64:
        """Return the emissivity of kinds of ground at view cosines."""
        x = dr.clip(cosine, 0.0, 1.0) * (COSINES - 1)
        return _linear(self.emissivity, (g * len(self.grid.kinds) + kind) * COSINES, x, COSINES)

    def source_of(self, g: mi.UInt32, temperature_k: mi.Float64) -> mi.Float64:
        """Return S_g(T)."""
        count = 1 + round((WARMEST_K - COLDEST_K) / STEP_K)
        return _linear(self.source, g * count, (temperature_k - COLDEST_K) / STEP_K, count)


def _linear(table: mi.Float32, first: mi.UInt32, x: mi.Float64, count: int) -> mi.Float64:
    x = dr.clip(x, 0.0, count - 1.0)
    i = dr.minimum(mi.UInt32(x), count - 2)
    low, high = (mi.Float64(dr.gather(mi.Float32, table, first + i + k)) for k in (0, 1))
    return dr.lerp(low, high, x - mi.Float64(i))


TYPICAL_K = 250.0
SINK_M = 4000.0
LONGEST_M = 100e3
"""Of a flight within the air."""
_NEVER = 1e12


def emission_scene(place: Placement, band: EmittingBand, ground: GroundTables, sensor: PluginDict) -> PluginDict:
    """Return the scene of a thermal band: the ellipsoid, the camera, and the integrator with the band's air."""
    planet = place.planet
    axes = [planet.a_m * KM, planet.a_m * KM, planet.b_m * KM]
    return {
        "type": "scene",
        "integrator": _integrator(place, band, ground),
        "unit_sphere": {"type": "shapegroup", "id": "unit_sphere", "sphere": {"type": "sphere"}},
        "ground": {
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate(place.centre_km.tolist()).scale(axes),
            "shapegroup": {"type": "ref", "id": "unit_sphere"},
        },
        "sensor": sensor,
    }


def _integrator(place: Placement, band: EmittingBand, ground: GroundTables) -> Any:
    """Return the integrator of the module text, made for the active variant."""
    air = AirTables.of(band)
    weight = band.source(TYPICAL_K)
    share = 0.5 * weight / weight.sum() + 0.5 / len(weight)
    until = table_of(mi.Float32, np.cumsum(share)[:-1] if len(share) > 1 else np.ones(1))
    shares = table_of(mi.Float32, share)
    origin = mi.Vector3d(*constant_vector(place.origin_m))
    planet = place.planet

    def flight(
        height: mi.Float64, rise: mi.Float64, g: mi.UInt32, sample: mi.Float64
    ) -> tuple[mi.Float64, mi.Bool, mi.Float64]:
        """Return how far to go, whether a tentative collision is there, and the majorant."""
        sink = dr.maximum(SINK_M, height - air.top_m + 1.0)
        down = rise < 0.0
        lowest = height - dr.select(down, sink, 10.0)
        reach = dr.select(down, sink, SINK_M) / dr.maximum(dr.abs(rise), 1e-9)
        reach = dr.select(height > air.top_m, reach, dr.minimum(reach, LONGEST_M))
        majorant = air.most_above(g, lowest)
        free = -dr.log(1.0 - sample) / dr.maximum(majorant, 1e-30)
        return dr.minimum(free, reach), free < reach, majorant

    class EmissionWalk(mi.SamplingIntegrator):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)

        def sample(
            self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
        ) -> tuple[Any, Any, list[Any]]:
            count = sampler.sample_count()
            index = dr.arange(mi.UInt32, sampler.wavefront_size()) % dr.opaque(mi.UInt32, count, 1)
            u = (mi.Float32(index) + sampler.next_1d()) / dr.opaque(mi.Float32, count, 1)
            g = mi.UInt32(0)
            if len(share) > 1:
                g = dr.binary_search(0, len(share) - 1, lambda i: dr.gather(mi.Float32, until, i) <= u)
            si = scene.ray_intersect(mi.Ray3f(ray), active=mi.Bool(active))
            o: Any = mi.Vector3d(ray.o) / KM + origin
            d = _unit(mi.Vector3d(ray.d))
            hit = si.is_valid()
            t_hit = dr.select(hit, mi.Float64(si.t) / KM, _NEVER)
            _, normal = geodetic(planet, o + dr.select(hit, t_hit, 0.0) * d)
            kind, temperature = ground.grid.at(normal, sampler.next_1d())
            cosine = -dr.dot(normal, d)
            lens = sampler.next_2d()
            stays = mi.Float64(sampler.next_1d()) < ground.emissivity_of(g, kind, cosine)
            glow = ground.source_of(g, temperature)
            even = mi.Vector3d(mi.Frame3f(mi.Vector3f(normal)).to_world(mi.warp.square_to_cosine_hemisphere(lens)))
            up = _unit(dr.select(kind == ground.water, d + 2.0 * cosine * normal, even))

            def body(
                sampler: Any,
                walking: mi.Bool,
                o: Any,
                d: Any,
                t: mi.Float64,
                t_hit: mi.Float64,
                tentative: mi.Bool,
                majorant: mi.Float64,
                found: mi.Float64,
            ) -> tuple[Any, ...]:
                height, normal = geodetic(planet, o + t * d)
                rise = dr.dot(normal, d)
                extinction, source = air.at(g, height, normal.z)
                absorbed = tentative & (mi.Float64(sampler.next_1d(walking)) * majorant < extinction)
                step, tentative, majorant = flight(height, rise, g, mi.Float64(sampler.next_1d(walking)))
                lands = ~absorbed & (t + step >= t_hit)
                ends = lands & stays
                found = dr.select(absorbed, source, dr.select(ends, glow, found))
                walking = walking & ~absorbed & ~ends & ((height <= air.top_m) | (rise < 0.0))
                reflected = lands & ~stays
                return (
                    sampler,
                    walking,
                    dr.select(reflected, o + t_hit * d, o),
                    dr.select(reflected, up, d),
                    dr.select(reflected, 0.0, t + step),
                    dr.select(reflected, _NEVER, t_hit),
                    tentative & ~lands,
                    majorant,
                    found,
                )

            zero = dr.zeros(mi.Float64, dr.width(t_hit))
            state = (sampler, mi.Bool(active), o, d, zero, t_hit, mi.Bool(False), zero, zero)
            names = ("sampler", "walking", "o", "d", "t", "t_hit", "tentative", "majorant", "found")
            *_, found = dr.while_loop(state, lambda _, walking, *rest: walking, body, labels=names)
            counts = found / mi.Float64(dr.gather(mi.Float32, shares, g))
            return mi.Spectrum(mi.Float32(counts)), mi.Bool(active), []

        def aov_names(self) -> list[str]:
            return []

    return EmissionWalk(mi.Properties("emission_walk"))


def _unit(v: Any) -> Any:
    return v * inverse_root(dr.squared_norm(v))
