"""What a view table holds of the air before clouds: radiance and transmittance from the camera to stations along rays.

The stations lie evenly between where a ray enters the layer of the cloud tops and where it leaves it or meets the
ground. A ray that ends on a cloud reads those beside its end, by Lagrange's cubic through four.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.march import SunlitStations
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.ray_path import way_through
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Values, Vec, constant
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable
from horizonval.renderer.view_table.sunlit_air import Light, air_table, bounce_packet, packets_of

STATIONS = 48
STEPS, STEPS_BEFORE = 2, 128
"""Of the march: from one station to the next, and up to the first; for each of three pieces where the Earth's shadow
may cut rays."""
ABOVE_TOPS_M = 3000.0
"""The stations begin this much above the highest cloud: at the very edge of a layer a ray's way through it has a square
root in its height."""


def cloudy_air(light: Light, coordinates: RayCoordinates, to_ground: bool, top_m: float) -> PatchTable:
    """Return an empty table of a light's air before clouds whose highest top is at ``top_m``; as :func:`sunlit_air`."""
    o = vectors(coordinates.origin[None, :])
    axis = coordinates.ground if to_ground else coordinates.limb
    packets, count = packets_of(light, bends=False), len(light.batches)
    shadow = not light.shines_everywhere(coordinates)
    pieces = 3 if shadow else 1

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = vectors(coordinates.directions(axis.value(x), azimuth, to_ground))
        first, last = way_through(coordinates.planet, o, d, constant(top_m + ABOVE_TOPS_M), to_ground)
        out = np.zeros((len(x), STATIONS, packets, PACKET))
        for k, batch in enumerate(light.batches):
            if batch is None:
                continue
            stations = SunlitStations(first, last, STATIONS, pieces * STEPS, pieces * STEPS_BEFORE, shadow)
            radiance, bounce, transmittance = light.march_to_stations(batch, coordinates, o, d, to_ground, stations)
            dr.eval(radiance, bounce, transmittance)
            for n, (r, t) in enumerate(zip(radiance, transmittance, strict=True)):
                out[:, :, 2 * k, n] = np.array(r).reshape(STATIONS, -1).T
                out[:, :, 2 * k + 1, n] = np.array(t).reshape(STATIONS, -1).T
            for n, b in enumerate(bounce):
                out[:, :, bounce_packet(count, False, k), n] = np.array(b).reshape(STATIONS, -1).T
        return out.reshape(len(x), -1)

    return air_table(light, coordinates, values, stations=STATIONS)


def station_of(coordinates: RayCoordinates, o: Vec, d: Vec, to_ground: bool, top_m: float, t: mi.Float64) -> mi.Float64:
    """Return the place of cloud tops at ray parameters ``t`` in stations from the first."""
    first, last = way_through(coordinates.planet, o, d, constant(top_m + ABOVE_TOPS_M), to_ground)
    return dr.clip((t - first) / dr.maximum(last - first, 1e-3), 0.0, 1.0) * (STATIONS - 1.0)


def look_at_stations(
    table: PatchTable, x: mi.Float64, azimuth: mi.Float64, station: mi.Float64, packets: Sequence[int]
) -> Values:
    """Return the quantities of some packets of a station at places along rays."""
    each = table.tabulated.quantities // (PACKET * STATIONS)
    lowest = mi.UInt32(dr.clip(dr.floor(station) - 1.0, 0.0, STATIONS - 4.0))
    w = station - mi.Float64(lowest)
    weights = [
        -(w - 1.0) * (w - 2.0) * (w - 3.0) * (1.0 / 6.0),
        w * (w - 2.0) * (w - 3.0) * 0.5,
        -w * (w - 1.0) * (w - 3.0) * 0.5,
        w * (w - 1.0) * (w - 2.0) * (1.0 / 6.0),
    ]
    read = [(lowest + k) * each + packet for k in range(4) for packet in packets]
    values = table.look(x, azimuth, read)
    width = PACKET * len(packets)
    total = [mi.Float64(0.0)] * width
    for k, weight in enumerate(weights):
        total = [dr.fma(weight, v, t) for v, t in zip(values[k * width : (k + 1) * width], total, strict=True)]
    return total
