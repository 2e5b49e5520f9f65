r"""Air with broken layers of thin cloud: pieces of rays with and without the cloud, mixed by its share.

Rays are cut where they cross the edges of layers, and long passages through a layer with gaps once more. The table has
for every piece the radiance L and the optical depth :math:`\tau` of the air without the cloud (0) and with the cloud
everywhere (1): both are smooth over the rays. A ray's piece with the mean share f of cloud has

    tau = (1 - f) tau_0 + f tau_1,      L = ((1 - f) L_0 / E(tau_0) + f L_1 / E(tau_1)) E(tau)

with :math:`E(x) = (1 - e^{-x}) / x`, which is exact where extinction and source do not vary within the piece.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import accumulate, pairwise
from operator import or_

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.clouds import GapMap
from horizonval.renderer.kernel.march import SunlitStations
from horizonval.renderer.planet import along, way_through
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable
from horizonval.renderer.view_table.sunlit_air import (
    IN_SHADOW_BEFORE,
    LEAST_BENDING_RAD,
    STEPS_BEFORE,
    Light,
    RayPlane,
    air_table,
)

STEPS_OUTSIDE, STEPS_INSIDE = 36, 12
"""Of the march: in a piece outside layers with gaps, and in one inside, at the usual accuracy."""
PIECE_OF_SCALE, MOST_PIECES = 0.4, 6
"""Length of pieces inside a layer, of the scale of its gaps, and how many there are at most in a passage."""
SAMPLES = 4
"""Of the share of cloud, in a piece."""
_EARTH_M = 6.371e6


@dataclass(frozen=True)
class BrokenAir:
    """The air of a light over a plane of rays; ``maps``: of the gaps, by the numbers of the layers."""

    light: Light
    plane: RayPlane
    maps: Sequence[GapMap | None]

    @cached_property
    def _edges_m(self) -> list[float]:
        """Heights of the layers' edges, falling."""
        return sorted(self.light.edges_m, reverse=True)

    @cached_property
    def _passages(self) -> list[tuple[int | None, int]]:
        """For every way between cuts the number of the layer with gaps there, and how many pieces it has."""
        down: list[tuple[int | None, int]] = []
        for (high, low), numbers in zip(pairwise(self._edges_m), self.light.gapped, strict=True):
            gaps = self.maps[numbers[0]] if numbers else None
            if gaps is None:
                down.append((None, 1))
                continue
            longest = math.sqrt(2.0 * _EARTH_M * (high - low))
            if self.plane.to_ground:
                longest = math.sqrt(2.0 * _EARTH_M * high) - math.sqrt(2.0 * _EARTH_M * low)
            down.append((numbers[0], min(max(math.ceil(longest / (PIECE_OF_SCALE * gaps.scale_m)), 1), MOST_PIECES)))
        return [*down, (None, 1), *([] if self.plane.to_ground else [*reversed(down), (None, 1)])]

    @cached_property
    def _pieces_of(self) -> dict[int, list[tuple[int, int]]]:
        """First pieces of passages through layers with gaps, and the pieces behind their last, by layer."""
        found: dict[int, list[tuple[int, int]]] = {}
        first = 1
        for layer, pieces in self._passages:
            if layer is not None:
                found.setdefault(layer, []).append((first, first + pieces))
            first += pieces
        return found

    def stations(self, o: Vec, d: Vec) -> SunlitStations:
        """Return the ends of pieces along rays."""
        light, coordinates, to_ground = self.light, self.plane.coordinates, self.plane.to_ground
        planet = coordinates.planet
        first, _ = way_through(planet, o, d, constant(self._edges_m[0]), to_ground)
        _, last = way_through(planet, o, d, constant(light.top_m), to_ground)
        down: list[mi.Float64] = []
        up: list[mi.Float64] = []
        for level in self._edges_m:
            mid, half, _ = planet.chord(o, d, constant(level))
            down.append(mid - half)
            up.insert(0, mid + half)
        cuts = [first]
        for t in [*down[1:], *([] if to_ground else up)]:
            cuts.append(dr.clip(t, cuts[-1], last))
        shadow = not light.shines_everywhere(coordinates)

        def steps(usual: int) -> int:
            return 3 * math.ceil(light.times_steps * usual / 3)

        each = [n * steps(STEPS_OUTSIDE if layer is None else STEPS_INSIDE) for layer, n in self._passages]
        numbers, taken = [0, *accumulate(n for _, n in self._passages)], [0, *accumulate(each)]
        before = steps(STEPS_BEFORE * (IN_SHADOW_BEFORE if shadow else 1))
        places = tuple(constant(n) for n in numbers), tuple(constant(n) for n in taken)
        return SunlitStations((*cuts, last), *places, numbers[-1] + 1, taken[-1], before, shadow)

    @property
    def pieces(self) -> int:
        """How many pieces rays have, the one before the first layer among them."""
        return 1 + sum(n for _, n in self._passages)

    @property
    def _packets(self) -> int:
        """Packets of a batch in a piece: radiance, optical depth, and what the ground adds."""
        return 3 if self.light.over_varied_ground else 2

    def table(self, bright: FloatArray) -> PatchTable:
        """Return an empty table; ``bright``: radiance of the bright limb, (batches * 4,)."""
        light, plane, count, packets = self.light, self.plane, len(self.light.batches), self._packets
        o = vectors(plane.coordinates.origin[None, :])
        # by packet: of every piece, of air without and with cloud, of every batch; the last is the bending angle
        shape = self.pieces, 2, count, packets, PACKET

        def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
            d = vectors(plane.directions(x, azimuth))
            stations = self.stations(o, d)
            out = np.zeros((len(x), *shape))
            bending = np.zeros((len(x), PACKET))
            for k, batch in enumerate(light.batches):
                for cloud in (0, 1):
                    if batch is None:
                        continue
                    air = batch.under([None if gaps is None else Everywhere.of(gaps, cloud) for gaps in self.maps])
                    parts = light.march_to_stations(air, plane.coordinates, o, d, plane.to_ground, stations)
                    dr.eval(parts)
                    for m, part in enumerate((parts[0], parts[2], parts[1])):
                        for n, value in enumerate(part):
                            out[:, :, cloud, k, m, n] = np.asarray(value).reshape(self.pieces, -1).T
                    if parts[3] is not None:
                        bending[:, 0] = np.asarray(parts[3])
            return np.concatenate([out.reshape(len(x), -1), bending], axis=1)

        scale = np.zeros(shape)
        scale[...] = bright.reshape(count, 1, PACKET)
        scale[:, :, :, 1] = 1.0
        own = np.zeros(shape, dtype=bool)
        own[:, :, :, 1] = True
        return air_table(
            light,
            values,
            np.concatenate([scale.ravel(), np.full(PACKET, LEAST_BENDING_RAD)]),
            np.concatenate([own.ravel(), np.full(PACKET, True)]),
            single=True,
        )

    def look(
        self, table: PatchTable, x: mi.Float64, azimuth: mi.Float64, o: Vec, d: Vec, batch: int, width: int
    ) -> tuple[Values, Values, Values, mi.Float64]:
        """Return radiance, transmittance and what the ground adds of a batch along rays, and the bending angle."""
        stations, planet = self.stations(o, d), self.plane.coordinates.planet
        packets, count = self._packets, len(self.light.batches)
        parts = [0, *([2] if packets == 3 else [])]

        def share_of_cloud(i: mi.UInt32) -> mi.Float64:
            station = mi.Float64(i) - 1.0
            low, high, number, following = stations.piece(lambda k: station >= stations.numbers[k])
            length = (high - low) / (following - number)
            begin = dr.fma(length, station - number, low)
            share = mi.Float64(0.0)
            for layer, numbers in self._pieces_of.items():
                gaps = self.maps[layer]
                assert gaps is not None
                mean = mi.Float64(0.0)
                for k in range(SAMPLES):
                    _, normal = planet.height_and_normal(along(o, d, begin + length * ((k + 0.5) / SAMPLES)))
                    mean += gaps.share(normal) * (1.0 / SAMPLES)
                here = reduce(or_, [(i >= first) & (i < last) for first, last in numbers])
                share = dr.select(here, mean, share)
            return share

        def body(i: mi.UInt32, depth: Values, sums: Values) -> tuple[mi.UInt32, Values, Values]:
            depth, sums = list(depth), list(sums)
            f = share_of_cloud(i)
            read = [((i * 2 + cloud) * count + batch) * packets + m for cloud in (0, 1) for m in range(packets)]
            found = table.look(x, azimuth, read)
            clear, cloudy = found[: packets * PACKET], found[packets * PACKET :]
            for n in range(width):
                tau_0, tau_1 = dr.maximum(clear[PACKET + n], 0.0), dr.maximum(cloudy[PACKET + n], 0.0)
                tau = dr.fma(f, tau_1 - tau_0, tau_0)
                before, escape = dr.exp(-depth[n]), _escape(tau)
                weight_0, weight_1 = (1.0 - f) * escape / _escape(tau_0), f * escape / _escape(tau_1)
                for k, m in enumerate(parts):
                    added = weight_0 * clear[m * PACKET + n] + weight_1 * cloudy[m * PACKET + n]
                    sums[k * width + n] = sums[k * width + n] + before * dr.maximum(added, 0.0)
                depth[n] = depth[n] + tau
            return i + 1, depth, sums

        zero = dr.zeros(mi.Float64, dr.width(x))
        start = mi.UInt32(0), [zero + 0.0] * width, [zero + 0.0] * (width * len(parts))
        last = dr.opaque(mi.UInt32, self.pieces, 1)
        _, depth, sums = dr.while_loop(
            start, lambda i, *_: i < last, body, labels=("i", "depth", "sums"), label="broken layers"
        )
        bending = table.look(x, azimuth, [self.pieces * 2 * count * packets])[0]
        return sums[:width], [dr.exp(-v) for v in depth], sums[width:], bending


@dataclass(frozen=True)
class Everywhere:
    """A map of gaps that is the same everywhere."""

    value: mi.Float64

    @classmethod
    def of(cls, gaps: GapMap, share: float) -> Everywhere:
        """Build from the share of cloud."""
        return cls(constant(share) / gaps.cover - 1.0)

    def excess(self, normal: Vec) -> mi.Float64:
        """Return by how much of the mean column a layer exceeds it."""
        return self.value


def _escape(x: mi.Float64) -> mi.Float64:
    """Return E of the module text."""
    return dr.select(x < 1e-4, 1.0 - 0.5 * x, (1.0 - dr.exp(-x)) / dr.maximum(x, 1e-4))
