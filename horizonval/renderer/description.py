"""What a scene is before it has pixels: its exact truth, its optical properties, its lights and its plugins."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air import AS_IT_IS, AirChange
from horizonval.earth.light import sky
from horizonval.earth.optical import NO_ATMOSPHERE, OpticalModel, optical_model
from horizonval.earth.surface.surface import ground_model
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.ellipsoid import surface_normal
from horizonval.geometry.sun_and_moon import AU_M, phase_angle, sun_itrs
from horizonval.renderer.backend import activate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import moon_place, truth_of, truth_turned

if TYPE_CHECKING:
    from horizonval.renderer.plugins import CameraSettings, LimbSettings, MoonSettings

FAINTEST_MOON = -6.0
"""V of a crescent that gives less light than a sky without a Moon (0.6 mlx): ground and air are not marched for it."""


@dataclass(frozen=True)
class Described:
    """A scene ready to be rendered: truth, optical properties and plugin settings.

    ``itrs_from_cam`` is a (3, 3) matrix.
    """

    truth: FrameTruth
    camera: CameraModel
    model: OpticalModel
    itrs_from_cam: NDArray[np.float64]
    limb: LimbSettings
    sensor: CameraSettings
    variant: str


def describe(scene: SceneSpec, camera: CameraSpec, change: AirChange = AS_IT_IS) -> Described:
    """Return everything about a frame but its pixels and its infrared horizon, and select the back-end.

    ``change``: how its air differs from the scene's. Errors as of :func:`horizonval.renderer.frame.render_frame`.
    """
    truth = truth_of(scene, camera, infrared=False)
    _, sun_distance_m = sun_itrs(scene.platform.epoch_utc)
    clear = optical_model(scene, camera, sun_distance_au=sun_distance_m / AU_M, change=change)
    # The back-end is chosen before anything below imports Dr.Jit.
    variant = activate()
    model, moon = _with_sky(clear, scene, camera, truth, sun_distance_m)
    ground = ground_model(scene)
    if not ground.plain:
        model = replace(model, ground_varies=True)
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.plugins import CameraSettings, LimbSettings

    itrs_from_cam = _itrs_from_cam(truth)
    intrinsics = camera_from_spec(camera.camera)
    limb = LimbSettings(
        model,
        Planet(truth.ellipsoid_a_m, truth.ellipsoid_b_m),
        truth.sun_itrs,
        truth.sun_angular_radius_rad,
        scene.render.subsamples,
        scene.render.nodes,
        scene.render.orders,
        ground,
        moon,
        _lights_nothing(truth, truth.sun_itrs, model.glow_top_m),
        scene.render.method,
        scene.render.accuracy,
    )
    sensor = CameraSettings(intrinsics, np.array(truth.r_itrs), itrs_from_cam)
    return Described(truth, intrinsics, model, itrs_from_cam, limb, sensor, variant)


def turned(described: Described, scene: SceneSpec, camera: CameraSpec) -> Described:
    """Return the description of a scene that differs in the attitude and the mounting alone."""
    truth = truth_turned(described.truth, scene, camera)
    itrs_from_cam = _itrs_from_cam(truth)
    sensor = replace(described.sensor, itrs_from_cam=itrs_from_cam)
    return replace(described, truth=truth, itrs_from_cam=itrs_from_cam, sensor=sensor)


def _itrs_from_cam(truth: FrameTruth) -> NDArray[np.float64]:
    return Rotation.from_quat(truth.q_cam_from_itrs).inv().as_matrix()


def _with_sky(
    model: OpticalModel, scene: SceneSpec, camera: CameraSpec, truth: FrameTruth, sun_distance_m: float
) -> tuple[OpticalModel, MoonSettings | None]:
    """Return the model with all that is in the sky, and the Moon as the integrator is told."""
    from horizonval.renderer.plugins import MoonSettings

    r, sun = np.array(truth.r_itrs), np.array(truth.sun_itrs)
    night = sky.night_in_view(*_zenith_and_horizon(truth, sun))
    place = moon_place(scene)
    light, moon = None, None
    if place is not None:
        distance, line = float(np.linalg.norm(place)), place - r
        to_sun = sun * sun_distance_m - place
        sun_moon_au, sun_au = float(np.linalg.norm(to_sun)) / AU_M, sun_distance_m / AU_M
        light = sky.Moonlight(phase_angle(to_sun, -place), sun_moon_au, distance / AU_M, sun_au)
        here = sky.moon_magnitude(truth.moon_phase_angle_rad, sun_moon_au, float(np.linalg.norm(line)) / AU_M)
        there = sky.moon_magnitude(light.phase_rad, sun_moon_au, light.moon_au)
        assert truth.moon_itrs is not None
        moon = MoonSettings(
            truth.moon_itrs,
            truth.moon_angular_radius_rad,
            _components(to_sun / np.linalg.norm(to_sun)),
            _components(place / distance),
            float(10.0 ** (0.4 * (there - here))),
            bool(
                night
                and scene.night.moonlight
                and there < FAINTEST_MOON
                and not _lights_nothing(truth, place / distance, model.glow_top_m)
            ),
        )
    air = scene.atmosphere.profile != NO_ATMOSPHERE or scene.atmosphere.file is not None
    model = sky.with_sky(
        model,
        camera.band,
        sun_distance_au=sun_distance_m / AU_M,
        moon=light,
        airglow=night and scene.night.airglow and air,
        background=night and scene.night.sky_background,
    )
    return model, moon


def _components(v: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in v)
    return x, y, z


def _zenith_and_horizon(truth: FrameTruth, direction: ArrayLike) -> tuple[float, float]:
    """Return a light's zenith angle below the camera, and the angle at the Earth's centre to the farthest horizon."""
    r = np.array(truth.r_itrs)
    up = surface_normal(r, truth.ellipsoid)
    cosine = float(np.clip(up @ np.asarray(direction), -1.0, 1.0))
    return math.acos(cosine), math.acos(min(truth.ellipsoid_b_m / float(np.linalg.norm(r)), 1.0))


def _lights_nothing(truth: FrameTruth, direction: ArrayLike, top_m: float) -> bool:
    """Return whether every ray stays in the umbra of a light in this direction.

    That is so if the light is lower than the air's top can see even from where the best lit rays leave the air; a
    margin of one degree covers the flattening.
    """
    zenith, horizon = _zenith_and_horizon(truth, direction)
    air = math.acos(truth.ellipsoid_b_m / (truth.ellipsoid_b_m + top_m))
    return zenith - horizon - air > math.pi / 2 + air + math.radians(1.0)
