"""Both plugins in Mitsuba, made from settings for scenes in this process, and registered by name for scene files.

``horizon_limb`` is the deterministic limb march as an integrator. ``mi.render`` on a scene with this integrator and a
``horizon_camera`` returns a tensor (height, width, channels): the radiance of every band, then the energy radiance of
every solar band, in W m-2 sr-1 (:mod:`horizonval.earth.spectral.bands`). It makes Float64 rays and ignores sample count
and seed, because nothing is random.

``horizon_camera`` is the camera as a sensor. The limb integrator takes the intrinsics from it;
:meth:`HorizonCamera.sample_ray` serves stock integrators (single precision, same projection). In a scene file the
integrator has the specification of the scene and camera, the sensor the camera and its pose, each as JSON.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from typing import Any, NoReturn

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.surface.surface import GroundModel
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.image import render_bands
from horizonval.renderer.kernel.batching import IMAGE_TABLE, make_batches
from horizonval.renderer.kernel.clouds import GapMap, gap_map
from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, MoonInFrame, RayCamera
from horizonval.renderer.kernel.node_batches import SolarNodes
from horizonval.renderer.kernel.surface import make_ground
from horizonval.renderer.planet import Planet
from horizonval.renderer.refraction import ApparentRadiusAir, BendingField, to_apparent_radius
from horizonval.renderer.scattering.shells import for_images
from horizonval.renderer.thermal.emission_table import ThermalAir
from horizonval.renderer.types import PluginDict, constant, constant_vector

Direction = tuple[float, float, float]


@dataclass(frozen=True)
class MoonSettings:
    """The Moon of a frame, unit vectors in Earth-fixed axes.

    ``direction_itrs``, ``angular_radius_rad``: from the camera; ``to_sun_itrs``: from the Moon; ``light_itrs``: from
    the Earth's centre to the Moon; ``nearness``: irradiance at the camera over that at the Earth's centre;
    ``lights_earth``: whether ground and air are visible in its light.
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

    ``subsamples``, ``nodes``: cells per pixel and axis, evaluations along each ray; ``ground``: None if the model's
    albedo is all there is; ``sunless``: all air and ground in view lie in the Earth's shadow; ``method``: whether
    sunlight is interpolated between tabulated directions ("table") or marched cell by cell ("march"); ``accuracy``:
    error that tables may have, as a share of the radiance of the bright limb.
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
    accuracy: float = 1e-3

    @cached_property
    def tables_digest(self) -> str:
        """The digest of everything that the kernel's tables depend on: air, planet and orders.

        The same for every ``method`` and ``accuracy``.
        """
        return content_digest(self.model, self.planet, self.orders)


@dataclass(frozen=True)
class CameraSettings:
    """A camera and where it stands: ``r_itrs`` [m], shape (3,); ``itrs_from_cam``, a rotation matrix (3, 3)."""

    camera: CameraModel
    r_itrs: FloatArray
    itrs_from_cam: FloatArray


_KEPT_MODELS = 4


@dataclass(frozen=True)
class Prepared:
    """A model as the march takes it; with refraction over apparent heights, and its apparent planet."""

    model: OpticalModel
    planet: Planet
    batches: list[tuple[list[SpectralNode], SolarNodes]]
    thermal: list[ThermalAir]
    air: ApparentRadiusAir | None
    bending: BendingField | None


_prepared: OrderedDict[tuple[str, str | None], Prepared] = OrderedDict()
"""By digest of the settings and variant."""


def prepare(settings: LimbSettings, progress: Progress | None = None) -> Prepared:
    """Return a model and its kernel tables; those of the last few models are cached for suites that repeat them."""
    key = (settings.tables_digest, mi.variant())
    if key not in _prepared:
        _prepared[key] = _make_tables(settings, progress)
        if len(_prepared) > _KEPT_MODELS:
            _prepared.popitem(last=False)
    _prepared.move_to_end(key)
    return _prepared[key]


def _make_tables(settings: LimbSettings, progress: Progress | None) -> Prepared:
    model, planet, air, bending = settings.model, settings.planet, None, None
    if model.refractivity is not None:
        air = to_apparent_radius(model, planet)
        model, planet, bending = air.model, air.planet, BendingField.of(air)
    scattering = for_images(model) if settings.orders == "all" else None
    batches = list(make_batches(model, planet, IMAGE_TABLE, scattering, progress, air))
    thermal = [ThermalAir.of(b, model.emission, air, model.gaps) for b in model.thermal if model.emission]
    return Prepared(model, planet, batches, thermal, air, bending)


def _moon(moon: MoonSettings | None) -> MoonInFrame | None:
    if moon is None:
        return None
    radius = constant(moon.angular_radius_rad)
    disc = Disc(constant_vector(moon.direction_itrs), radius, constant_vector(moon.to_sun_itrs))
    return MoonInFrame(disc, moon.nearness, constant_vector(moon.light_itrs), moon.lights_earth)


def _gap_maps(model: OpticalModel, planet: Planet, origin: tuple[float, float, float]) -> tuple[GapMap | None, ...]:
    """Return the maps of a model's layers with gaps around the point below a camera."""
    if not model.has_gaps:
        return ()
    layers = zip(model.layers, model.gaps, strict=True)
    return tuple(None if gaps is None else gap_map(gaps, planet, origin, top) for (_, top), gaps in layers)


def make_plugin() -> type:
    """Return the integrator class for the active variant (its base class depends on the variant)."""

    class HorizonLimb(mi.SamplingIntegrator):
        def __init__(self, props: mi.Properties, settings: LimbSettings) -> None:
            super().__init__(props)
            self.settings = settings
            self.prepared = prepare(settings)
            self.bands = list(self.prepared.model.bands)
            thermal = {band.name for band in self.prepared.model.thermal}
            self.solar_bands = [band for band in self.bands if band not in thermal]

        def view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry of a frame taken by a ``horizon_camera``, refraction left out."""
            x, y, z = (float(v) for v in sensor.r_itrs)
            settings, model = self.settings, self.prepared.model
            return FrameGeometry(
                sensor.rays,
                sensor.camera.width,
                sensor.camera.height,
                constant_vector((x, y, z)),
                constant_vector(settings.sun_itrs),
                constant(settings.sun_angular_radius_rad),
                settings.planet,
                model.top_m,
                settings.subsamples,
                make_ground(settings.ground, settings.planet, (x, y, z)) if settings.ground else None,
                _moon(settings.moon),
                settings.sunless,
                model.glow_top_m,
                gap_maps=_gap_maps(model, settings.planet, (x, y, z)),
                every_cell=settings.method == "march",
            )

        def apparent_view(self, sensor: Any) -> FrameGeometry:
            """Return the geometry in which light goes straight."""
            view, air = self.view(sensor), self.prepared.air
            if air is None:
                return view
            origin = constant_vector(v[0] for v in air.apparent_position(view.origin))
            return replace(view, planet=air.planet, origin=origin, bending=self.prepared.bending)

        def radiance(self, sensor: Any) -> tuple[dict[str, mi.Float64], dict[str, mi.Float64]]:
            """Return radiance per band and energy radiance per solar band, pixels in row order."""
            prepared = self.prepared
            return render_bands(
                self.apparent_view(sensor),
                prepared.batches,
                self.bands,
                self.settings.nodes,
                prepared.thermal,
                prepared.model.emission,
                self.settings.tables_digest if self.settings.method == "table" else None,
                self.settings.accuracy,
            )

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            if isinstance(sensor, int):
                sensor = scene.sensors()[sensor]
            if not hasattr(sensor, "rays"):
                raise TypeError("horizon_limb needs a horizon_camera sensor")
            radiance, energy = self.radiance(sensor)
            channels = [radiance[band] for band in self.bands] + [energy[band] for band in self.solar_bands]
            stack = np.stack([np.array(channel, dtype=np.float32) for channel in channels], axis=-1)
            return mi.TensorXf(stack.reshape(sensor.camera.height, sensor.camera.width, len(channels)))

        def sample(self, *arguments: object, **named: object) -> NoReturn:
            raise NotImplementedError("horizon_limb renders whole frames; use mi.render")

        def aov_names(self) -> list[str]:
            return []

        def to_string(self) -> str:
            return (
                f"HorizonLimb[bands={self.bands}, method={self.settings.method}, nodes={self.settings.nodes}, "
                f"subsamples={self.settings.subsamples}]"
            )

    return HorizonLimb


def make_camera_plugin() -> type:
    """Return the sensor class for the active variant (its base class depends on the variant).

    Its methods take arguments as Mitsuba passes them, whatever the stub of ``mi.Sensor`` says.
    """

    class HorizonCamera(mi.Sensor):
        def __init__(self, props: mi.Properties, settings: CameraSettings) -> None:
            super().__init__(props)
            self.camera = settings.camera
            self.r_itrs = settings.r_itrs
            self.rays = RayCamera.of(settings.camera, settings.itrs_from_cam)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
            u = mi.Float64(sample2.x) * self.camera.width - 0.5
            v = mi.Float64(sample2.y) * self.camera.height - 0.5
            origin = mi.Point3f([float(c) for c in self.r_itrs])
            ray = mi.Ray3f(origin, mi.Vector3f([mi.Float(c) for c in self.rays.direction(u, v)]))
            ray.time = time
            if self.rays.circle is None:
                return ray, mi.Spectrum(1.0)
            # by the pixel's centre, as the limb integrator has it
            lit = self.rays.sees(dr.floor(u + 0.5), dr.floor(v + 0.5))
            return ray, mi.Spectrum(dr.select(lit, mi.Float(1.0), mi.Float(0.0)))

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*self.r_itrs))

        def to_string(self) -> str:
            return f"HorizonCamera[{self.camera}]"

    return HorizonCamera


INTEGRATOR, SENSOR = "horizon_limb", "horizon_camera"


def camera_properties(camera: CameraSettings) -> PluginDict:
    """Return the sensor's properties. JSON carries float64 exactly; Mitsuba's own vectors would not."""
    pose = {
        "r_itrs_m": [float(v) for v in camera.r_itrs],
        "itrs_from_cam": [float(v) for v in camera.itrs_from_cam.ravel()],
    }
    return {
        "type": SENSOR,
        "camera": json.dumps(asdict(camera.camera)),
        "pose": json.dumps(pose),
        "film": film_properties(camera.camera),
    }


def film_properties(camera: CameraModel) -> PluginDict:
    """Return the stock film behind a camera."""
    return {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "pixel_format": "luminance",
        "rfilter": {"type": "box"},
    }


def camera_settings(properties: Any) -> CameraSettings:
    """Return the settings written by :func:`camera_properties`; ``properties`` is Mitsuba's object."""
    pose = json.loads(properties.get("pose"))
    camera = CameraModel(**_with_tuples(json.loads(properties.get("camera"))))
    return CameraSettings(camera, np.array(pose["r_itrs_m"]), np.array(pose["itrs_from_cam"]).reshape(3, 3))


def _with_tuples(data: dict[str, Any]) -> dict[str, Any]:
    """Return the same with tuples for JSON's lists."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}


@cache
def _classes(variant: str | None) -> tuple[type, type]:
    return make_plugin(), make_camera_plugin()


def plugin_classes() -> tuple[type, type]:
    """Return the classes of integrator and sensor for the active variant."""
    return _classes(mi.variant())


def mitsuba_scene(limb: LimbSettings, camera: CameraSettings) -> Any:
    """Return a Mitsuba scene of both plugins, made from the settings themselves: nothing is written as text."""
    limb_class, _ = plugin_classes()
    film = mi.load_dict(film_properties(camera.camera))
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": limb_class(mi.Properties(INTEGRATOR), limb),
            "sensor": mitsuba_sensor(camera, film),
        }
    )


def mitsuba_sensor(camera: CameraSettings, film: Any) -> Any:
    """Return the camera's plugin before a film; cameras of one size may share it."""
    _, camera_class = plugin_classes()
    props = mi.Properties(SENSOR)
    props["film"] = film
    return camera_class(props, camera)
