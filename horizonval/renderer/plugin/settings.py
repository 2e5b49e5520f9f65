"""What the plugins are told: plain data, handed over as it is in process and as text in scene files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.surface import GroundModel
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.planet import Planet

Direction = tuple[float, float, float]


@dataclass(frozen=True)
class MoonSettings:
    """The Moon of a frame, Earth-fixed axes.

    Attributes
    ----------
    direction_itrs : tuple of float
        Unit vector from the camera.
    angular_radius_rad : float
        As the camera sees it.
    to_sun_itrs : tuple of float
        Unit vector from the Moon to the Sun.
    light_itrs : tuple of float
        Unit vector from the Earth's centre: where moonlight comes from.
    nearness : float
        Irradiance at the camera over that at the Earth's centre.
    lights_earth : bool
        Whether ground and air are to be seen in its light.
    """

    direction_itrs: Direction
    angular_radius_rad: float
    to_sun_itrs: Direction
    light_itrs: Direction
    nearness: float
    lights_earth: bool


@dataclass(frozen=True)
class LimbSettings:
    """What the limb integrator renders.

    Attributes
    ----------
    model : OpticalModel
    planet : Planet
    sun_itrs : tuple of float
        Unit vector towards the Sun.
    sun_angular_radius_rad : float
    subsamples, nodes : int
        Cells per pixel and axis; evaluations along each ray.
    orders : "single" or "all"
        Of scattering.
    ground : GroundModel or None
        None: the model's albedo is all there is.
    moon : MoonSettings or None
    sunless : bool
        Whether all air and ground in view lie in the Earth's shadow.
    method : "table" or "march"
        Whether sunlight is interpolated between tabulated directions, or marched cell by cell.
    """

    model: OpticalModel
    planet: Planet
    sun_itrs: Direction
    sun_angular_radius_rad: float
    subsamples: int = 2
    nodes: int = 64
    orders: str = "all"
    ground: GroundModel | None = None
    moon: MoonSettings | None = None
    sunless: bool = False
    method: str = "table"

    @cached_property
    def tables_digest(self) -> str:
        """The digest of everything that the kernel's tables depend on: air, planet and orders of scattering.

        They do not depend on ``method``: what the march looks up serves the view tables, too.
        """
        return content_digest(self.model, self.planet, self.orders)


@dataclass(frozen=True)
class CameraSettings:
    """A camera and where it stands: ``r_itrs`` [m], shape (3,); ``itrs_from_cam``, a rotation matrix (3, 3)."""

    camera: CameraModel
    r_itrs: FloatArray
    itrs_from_cam: FloatArray
