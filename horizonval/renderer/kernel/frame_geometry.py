"""What is geometric about a frame: its rays, its lights, the planet, and how far directions lie from the limb."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.gap_map import GapMap
from horizonval.renderer.kernel.rays import RayCamera
from horizonval.renderer.kernel.surface import Ground
from horizonval.renderer.planet import Planet, dot
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.types import Vec, constant


@dataclass(frozen=True)
class MoonInFrame:
    """The Moon of a frame.

    Attributes
    ----------
    disc : Disc
        As the camera sees it.
    nearness : float
        Irradiance at the camera over that at the Earth's centre.
    light : Vec
        Unit vector from the Earth's centre to the Moon: where moonlight comes from.
    lights_earth : bool
        Whether ground and air are to be seen in its light.
    """

    disc: Disc
    nearness: float
    light: Vec
    lights_earth: bool


@dataclass(frozen=True)
class FrameGeometry:
    """Everything geometric about one frame. ``origin`` and ``sun`` hold size-1 arrays.

    ``ground`` is None for a Lambert ground without clouds.
    ``sunless``: all air and ground in view lie in the Earth's shadow. ``glow_top_m``: nothing shines above; at least
    ``top_m``.
    With refraction ``planet``, ``top_m`` and ``origin`` are apparent ones, among which light goes straight, and
    ``bending`` tells by how much it bends.
    ``gap_maps``: of the model's layers of thin cloud, None for one without gaps; empty where none has any.
    ``every_cell``: cut all pixels into cells, also those that one ray would serve (see ``whole_pixels``).
    """

    rays: RayCamera
    width: int
    height: int
    origin: Vec
    sun: Vec
    sun_radius: mi.Float64
    planet: Planet
    top_m: float
    subsamples: int
    ground: Ground | None = None
    moon: MoonInFrame | None = None
    sunless: bool = False
    glow_top_m: float = 0.0
    bending: BendingField | None = None
    gap_maps: tuple[GapMap | None, ...] = ()
    every_cell: bool = False

    def column_and_row(self, pixel: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        """Return where pixels lie, by their numbers in row order. The image's width is data: sizes share kernels.

        The quotient is half a pixel away from whole numbers, far more than it is rounded by.
        """
        number, width = mi.Float64(pixel), constant(self.width)
        row = dr.floor((number + 0.5) / width)
        return dr.fma(-row, width, number), row

    @property
    def highest_m(self) -> float:
        """Rays that stay above see space alone."""
        return max(self.top_m, self.glow_top_m)


def limb_function(view: FrameGeometry, d: Vec, height_m: float = 0.0) -> mi.Float64:
    """Return a smooth function of directions, positive inside the Earth, close to the angle from the limb [rad].

    ``height_m``: of the Earth raised by so much, for cameras above.
    """
    planet = view.planet
    o1, a = planet.stretch(view.origin, height_m), planet.a_m + height_m
    distance2 = dr.maximum(dot(o1, o1), a**2 * (1.0 + 1e-12))
    per_radian = dr.sqrt(distance2 - a**2) / a
    f = (1.0 - planet.miss_distance(view.origin, d, height_m)) / per_radian
    # the line's other half: behind the camera there is no Earth
    return dr.select(dot(o1, planet.stretch(d, height_m)) < 0.0, f, -1.0)
