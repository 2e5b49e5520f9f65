"""Read tables that hold quantities at stations along every ray, by Lagrange's cubic through four stations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.types import Values
from horizonval.renderer.view_table.ray_table import PACKET, RayTable

LEAST_INTERVALS = 3
"""Smallest number of intervals of a piece: a cubic goes through four stations."""


@dataclass(frozen=True)
class StationPlace:
    """Places among the stations: the first of the four around, and how far from it, in stations."""

    lowest: mi.UInt32
    beyond: mi.Float64

    @classmethod
    def at(cls, number: mi.Float64, first: mi.Float64 | float, last: mi.Float64 | float) -> StationPlace:
        """Build from places counted in stations, in pieces from station ``first`` to ``last``."""
        number = dr.clip(number, first, last)
        lowest = dr.clip(dr.floor(number) - 1.0, first, last - LEAST_INTERVALS)
        return cls(mi.UInt32(lowest), number - lowest)


def look_at_stations(
    table: RayTable, x: mi.Float64, azimuth: mi.Float64, place: StationPlace, each: int, packets: Sequence[int]
) -> Values:
    """Return the quantities of some packets of a station at places along rays; ``each``: packets of a station."""
    w = place.beyond
    weights = [
        -(w - 1.0) * (w - 2.0) * (w - 3.0) * (1.0 / 6.0),
        w * (w - 2.0) * (w - 3.0) * 0.5,
        -w * (w - 1.0) * (w - 3.0) * 0.5,
        w * (w - 1.0) * (w - 2.0) * (1.0 / 6.0),
    ]
    read = [(place.lowest + k) * each + packet for k in range(4) for packet in packets]
    values = table.look(x, azimuth, read)
    width = PACKET * len(packets)
    total = [mi.Float64(0.0)] * width
    for k, weight in enumerate(weights):
        total = [dr.fma(weight, v, t) for v, t in zip(values[k * width : (k + 1) * width], total, strict=True)]
    return total
