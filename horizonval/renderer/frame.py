"""Frames of scenes: what a scene is before it has pixels, and its radiance, truth maps and exact truth."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air import AS_IT_IS, AirChange
from horizonval.earth.light import moonlight, sky
from horizonval.earth.optical import NO_ATMOSPHERE, OpticalModel, optical_model
from horizonval.earth.surface.surface import ground_model
from horizonval.frame import FrameTruth, RadianceFrame
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.ellipsoid import surface_normal
from horizonval.geometry.sun_and_moon import AU_M, phase_angle, sun_itrs
from horizonval.renderer.backend import activate
from horizonval.renderer.frame_cost import refuse_too_large, shared_view, viewpoint_key
from horizonval.renderer.table_store import TABLES
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import moon_place, truth_of, truth_turned

if TYPE_CHECKING:
    from horizonval.core.progress import Progress
    from horizonval.renderer.plugins import CameraSettings, LimbSettings, MoonSettings
    from horizonval.renderer.viewpoint import Viewpoint

FAINTEST_MOON = -6.0
"""V of a crescent that gives less light than a sky without a Moon (0.6 mlx): ground and air are not marched for it."""


@dataclass(frozen=True)
class Described:
    """A scene ready to be rendered: its exact truth, its optical properties and what Mitsuba's plugins are told.

    ``itrs_from_cam`` is a rotation matrix, shape (3, 3).
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

    ``change``: how its air differs from the scene's.

    Raises
    ------
    UserError
        As :func:`horizonval.renderer.frame.render_frame`.
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
        here = moonlight.magnitude(truth.moon_phase_angle_rad, sun_moon_au, float(np.linalg.norm(line)) / AU_M)
        there = moonlight.magnitude(light.phase_rad, sun_moon_au, light.moon_au)
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

    So it is if the light is lower than the air's top can see even from where the best lit rays leave the air. A degree
    to spare takes the flattening in.
    """
    zenith, horizon = _zenith_and_horizon(truth, direction)
    air = math.acos(truth.ellipsoid_b_m / (truth.ellipsoid_b_m + top_m))
    return zenith - horizon - air > math.pi / 2 + air + math.radians(1.0)


_last: dict[str, Viewpoint] = {}
"""The viewpoint of a campaign's frame before, by its key."""
_place: dict[str, str] = {}
"""Whose tables are in memory."""


def render_frame(scene: SceneSpec, camera: CameraSpec, progress: Progress | None = None) -> RadianceFrame:
    """Return the frame a scene's camera sees.

    Deterministic: the same scene gives the same bytes for any number of threads.

    Parameters
    ----------
    scene : SceneSpec
    camera : CameraSpec
    progress : Progress, optional
        Told about tables of multiple scattering that must be solved first.

    Raises
    ------
    UserError
        For anything in the scene or camera that cannot be rendered (bands outside the tables, a camera below the
        ground), a frame that memory does not hold, or when no back-end works here.
    """
    return viewpoint_of(scene, camera, progress).frame(scene)


def render_in_turn(scene: SceneSpec, camera: CameraSpec, *, maps: bool = True) -> RadianceFrame:
    """Return the frame a scene's camera sees, and keep its place for the next one, which may be taken there too.

    The same bytes as :func:`render_frame`; for campaigns, whose files do not change under them. Errors as there.
    Without ``maps`` the frame has no truth maps, which a detector does not need: quicker.
    """
    refuse_too_large(scene, camera)
    key, place = viewpoint_key(scene, camera), shared_view(scene, camera)
    if key not in _last:
        # What was before goes first: memory need not hold both. Frames of one place come one after another.
        _last.clear()
        if place != _place.get("tables"):
            TABLES.clear()
            _flush_allocator()
        _place["tables"] = place
        _last[key] = viewpoint_of(scene, camera)
    return _last[key].frame(scene, maps=maps)


def _flush_allocator() -> None:
    """Give back memory that Dr.Jit keeps for arrays of the sizes that it had."""
    drjit = sys.modules.get("drjit")
    if drjit is not None:
        drjit.flush_malloc_cache()


def viewpoint_of(scene: SceneSpec, camera: CameraSpec, progress: Progress | None = None) -> Viewpoint:
    """Return the place of a scene, from which frames of any attitude are rendered; arguments and errors as above."""
    refuse_too_large(scene, camera)
    described = describe(scene, camera)
    # Nothing that imports Mitsuba is loaded before its back-end is chosen.
    from horizonval.renderer.viewpoint import Viewpoint

    return Viewpoint(scene, camera, described, progress)
