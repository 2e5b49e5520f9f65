"""The local light of a frame: what its rays' air and the sky at their ends have seen of the ground, table by table.

Tables are found again by what they depend on: the columns of air, the ground, the camera's place and the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.kernel.node_batches import SolarNodes
from horizonval.renderer.kernel.ray_coordinates import RayCoordinates
from horizonval.renderer.local_light.ground_light import GroundCells, GroundLight, ground_cells, ground_light
from horizonval.renderer.local_light.ray_factors import RayFactors, ray_factors
from horizonval.renderer.planet import along
from horizonval.renderer.ray_path import find_path
from horizonval.renderer.table_store import TABLES
from horizonval.renderer.types import Values, Vec


@dataclass(frozen=True)
class GroundFactors:
    """By how much the ground counts, per node: for the air along rays, and for the sky at their ends."""

    air: Values
    sky: Values | None


@dataclass(frozen=True)
class LocalLight:
    """The local light of a frame's rays; ``origin``: the camera [m]."""

    view: FrameGeometry
    origin: FloatArray

    @classmethod
    def of(cls, view: FrameGeometry) -> LocalLight:
        """Build for a frame."""
        return cls(view, np.array([float(c[0]) for c in view.origin]))

    def factors(
        self,
        batch: SolarNodes,
        light: Vec,
        direction: Vec,
        to_ground: bool,
        cloud: tuple[mi.Bool, mi.Float64] | None,
    ) -> GroundFactors | None:
        """Return the factors of rays; None over a uniform ground without clouds.

        ``cloud``: whether and where clouds end the rays.
        """
        if batch.bounce is None:
            return None
        view = self.view
        coordinates = RayCoordinates.of(view.planet, self.origin, view.top_m)
        axis = coordinates.ground if to_ground else coordinates.limb
        place, azimuth = coordinates.place(view.origin, direction, to_ground)
        table = self._rays(batch, coordinates, light, to_ground)
        air = table.look(place * (1.0 / (axis.count - 1)), azimuth)
        if not to_ground and cloud is None:
            return GroundFactors(air, None)
        path = find_path(view.planet, view.top_m, view.origin, direction, mi.Bool(to_ground), cloud)
        _, normal = view.planet.height_and_normal(along(view.origin, direction, path.t_low + path.length_after))
        sky = [mi.Float64(v) for v in self._ground(batch).in_sky(normal)]
        return GroundFactors(air, sky)

    def _key(self, name: str, *more: object) -> str:
        assert self.view.ground is not None
        planet = self.view.planet.a_m, self.view.planet.b_m
        origin = tuple(float(v) for v in self.origin)
        return content_digest(name, self.view.ground.model, planet, origin, mi.variant(), *more)

    def _ground(self, batch: SolarNodes) -> GroundLight:
        bounce, ground = batch.bounce, self.view.ground
        assert bounce is not None
        assert ground is not None

        def look() -> GroundCells:
            return ground_cells(ground, self.view.planet, self.origin)

        def make() -> GroundLight:
            cells = TABLES.get_or_make(self._key("ground cells"), look, lambda table: table.size_bytes)
            return ground_light(cells, bounce)

        return TABLES.get_or_make(
            self._key("ground light", bounce.digest, bounce.width), make, lambda table: table.size_bytes
        )

    def _rays(self, batch: SolarNodes, coordinates: RayCoordinates, light: Vec, to_ground: bool) -> RayFactors:
        def make() -> RayFactors:
            return ray_factors(batch, coordinates, self._ground(batch), light, self.view.top_m, to_ground)

        assert batch.bounce is not None
        sun = tuple(float(c[0]) for c in light)
        key = self._key("ray factors", batch.bounce.digest, batch.width, sun, self.view.top_m, to_ground)
        return TABLES.get_or_make(key, make, lambda table: table.size_bytes)
