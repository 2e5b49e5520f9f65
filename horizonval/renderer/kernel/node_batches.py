"""Node batches: the tables of a few spectral nodes, interleaved in memory, and what their air shines at a place.

The nodes of a batch share all geometry of a march. Everything in them is evaluated (no literals), so that batches of
one kind share compiled kernels. There is one type per kind of source:

- :class:`SolarNodes`: scattered light of the Sun, or of the Moon in its place;
- :class:`GlowNodes`: airglow, an emission per metre;
- :class:`OpacityNodes`: no source, transmittance only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self, TypeAlias

import drjit as dr
import mitsuba as mi

from horizonval.renderer.column_air import ColumnAir, DepthFactor
from horizonval.renderer.planet import Bands, Planet, along
from horizonval.renderer.refraction import RefractionTables
from horizonval.renderer.scattering.source_table import HorizontalTransfer, SourceTable
from horizonval.renderer.tables import AltitudeGrid, SunTable, interpolate
from horizonval.renderer.types import Values, Vec

BATCH_WIDTH = 4
"""Spectral nodes per kernel launch; they share all geometry."""


@dataclass(frozen=True)
class Place:
    """Points of rays and their cells on an altitude grid.

    ``node``, ``weight``: lower node of the grid and weight of the upper one; ``inside``: not above the top. ``excess``:
    how far the batch's layers with gaps exceed their mean columns; empty for the mean.
    """

    position: Vec
    height_m: mi.Float64
    normal: Vec
    node: mi.UInt32
    weight: mi.Float64
    inside: mi.Bool
    excess: tuple[mi.Float64, ...] = ()

    @classmethod
    def of(cls, planet: Planet, grid: AltitudeGrid, o: Vec, d: Vec, t: mi.Float64) -> Place:
        """Build for ray parameters ``t``."""
        p = along(o, d, t)
        height, normal = planet.height_and_normal(p)
        return cls(p, height, normal, *grid.locate(height))

    def read(self, table: mi.Float64, width: int) -> Values:
        """Return a table's values at the place, per node."""
        return interpolate(table, self.node, self.weight, width)


class Gaps(Protocol):
    """Where a layer is cloudy."""

    def excess(self, normal: Vec) -> mi.Float64:
        """Return by how much of the mean column a layer exceeds it below unit normals: -1 in a gap."""


@dataclass(frozen=True)
class GappedLayer:
    """A layer of thin cloud with gaps in a batch; ``number``: index among the model's layers.

    ``extinction``, ``scattering``: Float64, shape (n_altitude * width,), mean columns, which the batch's columns
    include. ``map``: where it is cloudy; None for the mean everywhere.
    """

    number: int
    extinction: mi.Float64
    scattering: mi.Float64
    asymmetry: Values
    map: Gaps | None = None


@dataclass(frozen=True)
class _Air:
    """Extinction of a batch: ``extinction``, shape (n_altitude * width,), over ``grid``; ``width`` counts padding.

    ``bands``: the heights between which layers of thin cloud lie; ``gapped``: those of them that have gaps.
    """

    width: int
    grid: AltitudeGrid
    extinction: mi.Float64
    bands: Bands = field(default=(), kw_only=True)
    gapped: tuple[GappedLayer, ...] = field(default=(), kw_only=True)

    def under(self, maps: Sequence[Gaps | None]) -> Self:
        """Return the batch with the gaps of its layers, by the maps of all layers."""
        return replace(self, gapped=tuple(replace(layer, map=maps[layer.number]) for layer in self.gapped))

    def place(self, planet: Planet, o: Vec, d: Vec, t: mi.Float64) -> Place:
        """Return points of rays, with the gaps there."""
        place = Place.of(planet, self.grid, o, d, t)
        maps = [layer.map for layer in self.gapped if layer.map is not None]
        return replace(place, excess=tuple(m.excess(place.normal) for m in maps)) if maps else place

    def extinction_at(self, place: Place) -> Values:
        """Return the extinction [1/m] per node; 0 above the top."""
        values = place.read(self.extinction, self.width)
        for excess, layer in zip(place.excess, self.gapped, strict=False):
            mean = place.read(layer.extinction, self.width)
            values = [dr.maximum(dr.fma(excess, m, v), 0.0) for m, v in zip(mean, values, strict=True)]
        return [dr.select(place.inside, v, 0.0) for v in values]


@dataclass(frozen=True)
class OpacityNodes(_Air):
    """Air that does not shine."""

    def source_at(self, place: Place) -> Values:
        """Return nothing for no node: there is no emission to add up."""
        return []


@dataclass(frozen=True)
class GlowNodes(_Air):
    """The airglow of solar nodes, marched separately.

    ``emission``: per metre, shape (n_altitude * width,); ``ground``: radiance of the ground, which reflects airglow and
    sky, size 1; ``layer_m``: height below which nothing glows.
    """

    emission: mi.Float64
    ground: Values
    layer_m: float

    def source_at(self, place: Place) -> Values:
        """Return the emission per metre."""
        return [dr.select(place.inside, v, 0.0) for v in place.read(self.emission, self.width)]


@dataclass(frozen=True)
class Particles:
    """Scattering coefficient and Henyey-Greenstein asymmetry of particles, each of shape (n_altitude * width,).

    ``forward``: share of the scattering that is not in the extinction; None for nothing.
    """

    scattering: mi.Float64
    asymmetry: mi.Float64
    forward: mi.Float64 | None = None


@dataclass(frozen=True)
class Beam:
    """The Sun's beam at points of rays.

    ``share``: of its irradiance across the ray, per node; ``lit``: where it shines; ``molecular``: irradiance times
    molecules' phase function, per node; ``cosine`` of the scattering angle.
    """

    share: Values
    lit: mi.Bool
    cosine: mi.Float64
    molecular: Values


@dataclass(frozen=True)
class Bounce:
    """What a batch needs over a ground whose reflected flux varies.

    ``field``: diffuse fields that a ground of reflected flux 1 adds; ``spherical_albedo`` of the air from below and
    ``transfer`` (how far the ground's light spreads), per node; ``width`` includes padding; ``digest``: of the columns.
    """

    field: SourceTable
    spherical_albedo: tuple[float, ...]
    transfer: tuple[HorizontalTransfer, ...]
    wavelength_um: tuple[float, ...]
    width: int
    digest: str


@dataclass(frozen=True)
class SolarNodes(_Air):
    """Air that scatters sunlight. Lists are per node, of size-1 arrays.

    ``molecular``: scattering coefficient of molecules, (n_altitude * width,). ``cos2``: the c of their phase function
    ``(1 - c/3 + c cos^2) / (4 pi)``. ``particles``: None where no node has any. ``irradiance``: of the light above the
    air. ``reflectance``: ground albedo / pi. ``sunlight``: towards the Sun, along straight lines or with refraction.
    ``diffuse``: light scattered more than once; None for single scattering. ``bounce``: None over a uniform ground,
    whose light ``diffuse`` includes. ``glow``: the airglow of the same nodes. ``moonlight``: the Moon's irradiance, to
    replace the Sun's. ``columns``: how the air differs from ``extinction`` and ``molecular`` from place to place; None
    where it does not.
    """

    molecular: mi.Float64
    cos2: Values
    particles: Particles | None
    irradiance: Values
    reflectance: Values
    sunlight: SunTable | RefractionTables
    diffuse: SourceTable | None = None
    bounce: Bounce | None = None
    glow: GlowNodes | None = None
    moonlight: Values | None = None
    columns: ColumnAir | None = None

    def under(self, maps: Sequence[Gaps | None]) -> SolarNodes:
        """Return the batch, and its airglow, with the gaps of its layers."""
        glow = None if self.glow is None else self.glow.under(maps)
        return replace(super().under(maps), glow=glow)

    def in_moonlight(self) -> SolarNodes:
        """Return the same under the Moon's irradiance."""
        assert self.moonlight is not None
        return replace(self, irradiance=self.moonlight)

    def molecular_light(self, cosine: mi.Float64) -> Values:
        """Return irradiance times the molecules' phase function at cosines of the scattering angle, per node."""
        return [e * _molecular_phase(c, cosine) for e, c in zip(self.irradiance, self.cos2, strict=True)]

    def extinction_at(self, place: Place) -> Values:
        """Return the extinction [1/m] per node; 0 above the top."""
        own = super().extinction_at(place)
        if self.columns is None:
            return own
        more = self.columns.more_extinction(place.height_m, place.normal)
        total: Values = [dr.maximum(a + b, 0.0) for a, b in zip(own, more, strict=True)]
        return [dr.select(place.inside, v, 0.0) for v in total]

    def molecular_at(self, place: Place) -> Values:
        """Return the scattering coefficient of molecules [1/m] per node; above the top it is not 0."""
        own = place.read(self.molecular, self.width)
        if self.columns is None:
            return own
        more = self.columns.more_molecular(place.height_m, place.normal)
        return [dr.maximum(a + b, 0.0) for a, b in zip(own, more, strict=True)]

    def depth_factor(self, height_m: mi.Float64, normal: Vec) -> DepthFactor | None:
        """Return by what the optical depth from places towards the Sun is larger than ``sunlight`` says."""
        return None if self.columns is None else self.columns.depth_factor(height_m, normal)

    def scattering_at(self, place: Place) -> Values:
        """Return the scattering coefficient of everything [1/m] per node; 0 above the top."""
        total = self.molecular_at(place)
        if self.particles is not None:
            particle = place.read(self.particles.scattering, self.width)
            total = [a + b for a, b in zip(total, particle, strict=True)]
        return [dr.select(place.inside, v, 0.0) for v in total]

    def source_at(self, place: Place, beam: Beam, diffuse: Values) -> Values:
        """Return the scattered light per metre, and then what a ground of reflected flux 1 adds if it is separate.

        ``diffuse``: source of light scattered more than once, per scattering coefficient and irradiance: of molecules
        for every node, then of particles for every node, then both for the ground's part; empty for single scattering.
        """
        width, inside = self.width, place.inside
        molecular = self.molecular_at(place)
        scattered = [s * f for s, f in zip(molecular, beam.molecular, strict=True)]
        particle: Values = []
        if self.particles is not None:
            particle = place.read(self.particles.scattering, width)
            g = place.read(self.particles.asymmetry, width)
            if place.excess:
                particle, g = self._with_gaps(place, particle, g)
            phase = [e * _particle_phase(v, beam.cosine) for e, v in zip(self.irradiance, g, strict=True)]
            scattered = [a + s * f for a, s, f in zip(scattered, particle, phase, strict=True)]
        emission = [dr.select(inside & beam.lit, s * v, 0.0) for s, v in zip(scattered, beam.share, strict=True)]
        scatterers = molecular + particle
        if self.bounce is not None and diffuse:
            emission += [mi.Float64(0.0)] * width
        for n, source in enumerate(diffuse):
            part, n_part = divmod(n, len(scatterers))
            scatterer = scatterers[n_part] * self.irradiance[n_part % width]
            k = part * width + n_part % width
            emission[k] = emission[k] + dr.select(inside, scatterer * source, 0.0)
        return emission

    def _with_gaps(self, place: Place, scattering: Values, asymmetry: Values) -> tuple[Values, Values]:
        """Return scattering and asymmetry of particles, from their means, where layers have gaps."""
        along = [s * g for s, g in zip(scattering, asymmetry, strict=True)]
        total = scattering
        for excess, layer in zip(place.excess, self.gapped, strict=True):
            more = [excess * s for s in place.read(layer.scattering, self.width)]
            along = [dr.fma(m, g, a) for m, g, a in zip(more, layer.asymmetry, along, strict=True)]
            total = [s + m for s, m in zip(total, more, strict=True)]
        # in a gap rounding is left over, of no direction
        total = [dr.maximum(s, 0.0) for s in total]
        mixed = [dr.select(s > 1e-14, a / dr.maximum(s, 1e-14), 0.0) for s, a in zip(total, along, strict=True)]
        return total, [dr.clip(g, -0.99, 0.99) for g in mixed]


ShiningNodes: TypeAlias = SolarNodes | GlowNodes


def _molecular_phase(cos2: mi.Float64, cosine: mi.Float64) -> mi.Float64:
    return (dr.fma(cos2, cosine * cosine, 1.0) - cos2 / 3.0) * (0.25 / math.pi)


def _particle_phase(asymmetry: mi.Float64, cosine: mi.Float64) -> mi.Float64:
    """Return the phase function of Henyey and Greenstein."""
    g2 = asymmetry * asymmetry
    base = 1.0 + g2 - 2.0 * asymmetry * cosine
    return (1.0 - g2) / (base * dr.sqrt(base)) * (0.25 / math.pi)
