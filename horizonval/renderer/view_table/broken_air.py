r"""Air with broken layers of thin cloud: pieces of rays with and without the cloud, mixed by its share.

Rays are cut where they cross the edges of layers, and passages through a layer with gaps once more. For every piece
the table has the radiance L and the optical depth :math:`\tau_0` of the air without the cloud; and with the cloud
everywhere its emission :math:`J_1` along the piece, of which nothing is absorbed, the optical depth :math:`\tau_1`, and
how the source changes, :math:`H_1 = \tau_1 \Delta (J_1 / \tau_1)` from the beginning to the end of the piece. All are
smooth over the rays. The n-th part of a piece, u from its middle, with the share f of cloud has

    tau = ((1 - f) tau_0 + f tau_1) / n,    L = ((1 - f) L_0 / E(tau_0) + f (J_1 + u H_1)) / n E(tau)

with :math:`E(x) = (1 - e^{-x}) / x`.
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
from horizonval.renderer.kernel.node_batches import Place
from horizonval.renderer.planet import way_through
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.ray_table import PACKET, RayPlane, RayTable
from horizonval.renderer.view_table.sunlit_air import (
    Light,
    air_table,
    stations_between,
)

STEPS_OUTSIDE, STEPS_INSIDE = 36, 12
"""Steps of the march in a piece outside layers with gaps, and in one inside, at the usual accuracy."""
PIECE_OF_SCALE, LEAST_PIECES, MOST_PIECES = 0.4, 3, 6
"""Length of pieces inside a layer, of the scale of its gaps, and bounds of their number in a passage."""
SAMPLES = 4
"""Places in a piece at which the share of cloud is read."""
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
        """Layer with gaps (None for none) and number of pieces of every way between two cuts."""
        down: list[tuple[int | None, int]] = []
        for (high, low), numbers in zip(pairwise(self._edges_m), self.light.gapped, strict=True):
            gaps = self.maps[numbers[0]] if numbers else None
            if gaps is None:
                down.append((None, 1))
                continue
            longest = math.sqrt(2.0 * _EARTH_M * (high - low))
            if self.plane.to_ground:
                longest = math.sqrt(2.0 * _EARTH_M * high) - math.sqrt(2.0 * _EARTH_M * low)
            pieces = math.ceil(longest / (PIECE_OF_SCALE * gaps.scale_m))
            down.append((numbers[0], min(max(pieces, LEAST_PIECES), MOST_PIECES)))
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
        planet, to_ground, edges = self.plane.coordinates.planet, self.plane.to_ground, self._edges_m
        first, _ = way_through(planet, o, d, constant(edges[0]), to_ground)
        _, last = way_through(planet, o, d, constant(self.light.top_m), to_ground)
        steps = [STEPS_OUTSIDE if layer is None else STEPS_INSIDE for layer, _ in self._passages]
        numbers = [0, *accumulate(n for _, n in self._passages)]
        up = [] if to_ground else edges[::-1]
        return stations_between(self.light, self.plane.coordinates, o, d, (first, last), edges[1:], up, numbers, steps)

    @property
    def pieces(self) -> int:
        """How many pieces rays have, the one before the first layer among them."""
        return 1 + sum(n for _, n in self._passages)

    @property
    def _packets(self) -> int:
        """Packets of a batch in a piece: optical depths without and with cloud, then L, J and H, and of the ground."""
        return 8 if self.light.over_varied_ground else 5

    def table(self, bright: FloatArray) -> RayTable:
        """Return an empty table; ``bright``: radiance of the bright limb, (batches * 4,)."""
        light, plane, count, packets = self.light, self.plane, len(self.light.batches), self._packets
        o = plane.camera
        shape = self.pieces, count, packets, PACKET

        def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
            d = plane.directions(x, azimuth)
            stations = self.stations(o, d)
            out = np.zeros((len(x), *shape))
            for k, batch in enumerate(light.batches):
                for cloud in (0, 1):
                    if batch is None:
                        continue
                    air = batch.under([None if gaps is None else Everywhere.of(gaps, cloud) for gaps in self.maps])
                    *parts, _ = light.march_to_stations(
                        air, plane.coordinates, o, d, plane.to_ground, stations, attenuated=not cloud
                    )
                    dr.eval(parts)
                    for first, part in zip((2, 5, 0), parts, strict=True):
                        for n, value in enumerate(part):
                            out[:, :, k, first + cloud, n] = np.asarray(value).reshape(self.pieces, -1).T
            for first, behind in (span for spans in self._pieces_of.values() for span in spans):
                depth = out[:, first:behind, :, 1]
                for m in range(3, packets, 3):
                    source = out[:, first:behind, :, m] / np.maximum(depth, 1e-12)
                    out[:, first:behind, :, m + 1] = depth * np.gradient(source, axis=1)
            return out.reshape(len(x), -1)

        scale = np.broadcast_to(bright.reshape(count, 1, PACKET), shape).copy()
        scale[:, :, :2] = 1.0
        own = np.full(shape, True)
        # radiances without cloud are smaller than the limb's
        own[:, :, 2::3] = False
        return air_table(light, values, scale.ravel(), own.ravel(), single=True)

    def look(
        self, table: RayTable, x: mi.Float64, azimuth: mi.Float64, o: Vec, d: Vec, batch: int, width: int
    ) -> tuple[Values, Values, Values]:
        """Return radiance, transmittance and what the ground adds of a batch along rays."""
        stations, planet = self.stations(o, d), self.plane.coordinates.planet
        packets, count = self._packets, len(self.light.batches)
        parts = range(2, packets, 3)

        nodes = self.light.batches[batch]
        assert nodes is not None
        from_middle = [(k + 0.5) / SAMPLES - 0.5 for k in range(SAMPLES)]
        layers = {layer.number: layer for layer in nodes.gapped}

        def samples_of_cloud(i: mi.UInt32) -> tuple[Values, Values]:
            """Return the shares of cloud in parts of a piece, and the parts of the whole cloud's optical depth."""
            station = mi.Float64(i) - 1.0
            low, high, number, following = stations.piece(lambda k: station >= stations.numbers[k])
            length = (high - low) / (following - number)
            begin = dr.fma(length, station - number, low)
            shares, depths = [mi.Float64(0.0)] * SAMPLES, [mi.Float64(1.0)] * SAMPLES
            for layer, numbers in self._pieces_of.items():
                gaps = self.maps[layer]
                assert gaps is not None
                here = reduce(or_, [(i >= first) & (i < last) for first, last in numbers])
                for k in range(SAMPLES):
                    place = Place.of(planet, nodes.grid, o, d, begin + length * ((k + 0.5) / SAMPLES))
                    shares[k] = dr.select(here, gaps.share(place.normal), shares[k])
                    depth = place.read(layers[layer].extinction, width)[0]
                    depths[k] = dr.select(here, depth + 1e-12, depths[k])
            scale = 1.0 / sum(depths, start=mi.Float64(0.0))
            return shares, [depth * scale for depth in depths]

        def body(i: mi.UInt32, depth: Values, sums: Values) -> tuple[mi.UInt32, Values, Values]:
            depth, sums = list(depth), list(sums)
            shares, depths = samples_of_cloud(i)
            middle = sum((u * depth for u, depth in zip(from_middle, depths, strict=True)), start=mi.Float64(0.0))
            found = table.look(x, azimuth, [(i * count + batch) * packets + m for m in range(packets)])
            for n in range(width):
                tau_0, tau_1 = dr.maximum(found[n], 0.0), dr.maximum(found[PACKET + n], 0.0)
                free = [found[m * PACKET + n] / _escape(tau_0) for m in parts]
                for g, (f, of_cloud) in enumerate(zip(shares, depths, strict=True)):
                    clear = (1.0 - f) * (1.0 / SAMPLES)
                    covered = f * of_cloud
                    tau = dr.fma(clear, tau_0, covered * tau_1)
                    seen = dr.exp(-depth[n]) * _escape(tau)
                    for k, m in enumerate(parts):
                        emission, change = (found[(m + j) * PACKET + n] for j in (1, 2))
                        cloudy = dr.fma(from_middle[g] - middle, change, emission)
                        added = dr.fma(clear, free[k], covered * cloudy)
                        sums[k * width + n] = sums[k * width + n] + seen * dr.maximum(added, 0.0)
                    depth[n] = depth[n] + tau
            return i + 1, depth, sums

        zero = dr.zeros(mi.Float64, dr.width(x))
        start = mi.UInt32(0), [zero + 0.0] * width, [zero + 0.0] * (width * len(parts))
        last = dr.opaque(mi.UInt32, self.pieces, 1)
        _, depth, sums = dr.while_loop(
            start, lambda i, *_: i < last, body, labels=("i", "depth", "sums"), label="broken layers"
        )
        return sums[:width], [dr.exp(-v) for v in depth], sums[width:]


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
