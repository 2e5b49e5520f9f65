"""What a view table of sunlight holds: for every spectral node the radiance of the air and its transmittance.

Rays of the table are marched once, with :data:`MORE_NODES` times the evaluations of the direct march. Whatever reflects
at the rays' ends is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.march import march_air
from horizonval.renderer.kernel.node_batches import GlowNodes, SolarNodes
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION
from horizonval.renderer.tables import vectors
from horizonval.renderer.types import Vec, constant_vector
from horizonval.renderer.view_table.patch_table import PACKET, PatchTable, Tabulated

MORE_NODES = 4
TOLERANCE = 1e-3
"""Of the foretelling (:mod:`horizonval.renderer.view_table.patch_table`), as a share of the radiance."""
FAINTEST = 1e-6
"""Radiances below this share of the brightest may have its error."""
OPAQUE = 0.05
"""Transmittances below this may have its error."""
SURVEY_ROWS, SURVEY_AZIMUTHS = 9, 12


def sunlit_air(
    batches: Sequence[SolarNodes | GlowNodes],
    coordinates: RayCoordinates,
    top_m: float,
    light: tuple[float, float, float],
    to_ground: bool,
    nodes: int,
) -> PatchTable:
    """Return an empty table of the rays to the ground, or of those past it.

    Quantities: for every batch a packet of radiances and one of transmittances.
    """
    o, sun = vectors(coordinates.origin[None, :]), constant_vector(light)
    axis = coordinates.ground if to_ground else coordinates.limb

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        d = vectors(coordinates.direction(axis.value(x), azimuth, to_ground))
        out = np.zeros((len(x), 2 * PACKET * len(batches)))
        for k, batch in enumerate(batches):
            air = march_air(
                coordinates.planet,
                top_m,
                batch,
                o,
                d,
                sun,
                mi.Bool(to_ground),
                MORE_NODES * nodes,
                SOLAR_CONCENTRATION,
                steady=True,
            )
            dr.eval(air.radiance, air.transmittance)
            for n, (r, t) in enumerate(zip(air.radiance, air.transmittance, strict=True)):
                out[:, 2 * PACKET * k + n] = r
                out[:, 2 * PACKET * k + PACKET + n] = t
        return out

    x, azimuth = np.meshgrid(
        np.linspace(0.0, 1.0, SURVEY_ROWS), np.arange(SURVEY_AZIMUTHS) * (2.0 * np.pi / SURVEY_AZIMUTHS)
    )
    floor = FAINTEST * values(x.ravel(), azimuth.ravel()).max(axis=0)
    is_radiance = np.arange(len(floor)) % (2 * PACKET) < PACKET
    floor = np.where(is_radiance, np.maximum(floor, 1e-30), OPAQUE)

    def allowed(known: FloatArray) -> FloatArray:
        return TOLERANCE * np.maximum(np.abs(known), floor)

    return PatchTable(Tabulated(values, allowed, 2 * PACKET * len(batches)))
