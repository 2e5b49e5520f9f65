"""Emitting ground for the Monte Carlo reference: shares, temperatures and emissivities of the kinds of ground in view.

Shares and temperatures of :mod:`horizonval.earth.surface.ground_emission` lie on a grid of latitude and longitude over
all that the camera's horizon encloses, linear between: 0.04 degrees from 500 km up, where the map of ground has 0.05.
A path meets one kind of ground, by chance. There it ends with the probability of its emissivity, or is reflected: by
water as by a mirror, by all else in all directions alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.surface.ground_emission import (
    KINDS,
    GroundEmission,
    emitting_places,
    ground_emissivity,
    ground_k,
)
from horizonval.renderer.reference.reference_scene import Placement
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import constant

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
    """What a band's g points see of the ground.

    ``emissivity``: shape (g, kinds, cosines), flat; ``source`` [W m-2 sr-1]: shape (g, temperatures), flat.
    """

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
