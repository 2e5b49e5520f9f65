"""Render one frame of a scene: radiance per band, truth maps, and the exact truth beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval import __version__
from horizonval.earth.optical import OpticalModel, optical_model
from horizonval.frame import Frame, FrameTruth
from horizonval.geometry.camera import Camera, camera_from_spec
from horizonval.geometry.ephemeris import AU_M, sun_itrs
from horizonval.render.backend import activate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth import truth_of

if TYPE_CHECKING:
    from horizonval.render.chunks import TableProgress


@dataclass(frozen=True)
class Described:
    """A scene ready to be rendered: its exact truth, its optical properties and what goes into Mitsuba.

    ``itrs_from_cam`` is a rotation matrix, shape (3, 3).
    """

    truth: FrameTruth
    camera: Camera
    model: OpticalModel
    itrs_from_cam: NDArray[np.float64]
    mitsuba: dict[str, Any]
    variant: str


def describe(scene: SceneSpec, camera: CameraSpec) -> Described:
    """Return everything about a frame but its pixels, and select the back-end.

    Raises
    ------
    UserError
        As :func:`render_frame`.
    """
    truth = truth_of(scene, camera)
    _, sun_distance_m = sun_itrs(scene.platform.epoch_utc)
    model = optical_model(scene, camera, sun_distance_au=sun_distance_m / AU_M)
    variant = activate()
    from horizonval.render.camera_plugin import camera_properties
    from horizonval.render.integrator import limb_properties
    from horizonval.render.planet import Planet

    itrs_from_cam = Rotation.from_quat(truth.q_cam_from_itrs).inv().as_matrix()
    intrinsics = camera_from_spec(camera.camera)
    mitsuba = {
        "type": "scene",
        "integrator": limb_properties(
            model,
            Planet(truth.ellipsoid_a_m, truth.ellipsoid_b_m),
            truth.sun_itrs,
            truth.sun_angular_radius_rad,
            scene.render.subsamples,
            scene.render.nodes,
            scene.render.orders,
        ),
        "sensor": camera_properties(intrinsics, np.array(truth.r_itrs), itrs_from_cam),
    }
    return Described(truth, intrinsics, model, itrs_from_cam, mitsuba, variant)


def render_frame(scene: SceneSpec, camera: CameraSpec, progress: TableProgress | None = None) -> Frame:
    """Return the frame a scene's camera sees.

    Deterministic: the same scene gives the same bytes for any number of threads.

    Parameters
    ----------
    scene : SceneSpec
    camera : CameraSpec
    progress : callable, optional
        Told about tables of multiple scattering that must be solved first.

    Raises
    ------
    UserError
        For anything in the scene or camera that cannot be rendered (bands outside the tables, a camera below the
        ground), or when no back-end works here.
    """
    described = describe(scene, camera)
    import mitsuba as mi

    from horizonval.render.integrator import prepare
    from horizonval.render.truth_maps import truth_maps

    prepare(described.mitsuba["integrator"], progress)
    mi_scene = mi.load_dict(described.mitsuba)
    integrator, sensor = mi_scene.integrator(), mi_scene.sensors()[0]
    image = np.array(mi.render(mi_scene, spp=1))
    settings: dict[str, Any] = {
        "version": __version__,
        "variant": described.variant,
        "subsamples": scene.render.subsamples,
        "nodes": scene.render.nodes,
        "orders": scene.render.orders,
    }
    return Frame(
        radiance={band: np.ascontiguousarray(image[:, :, i]) for i, band in enumerate(integrator.bands)},
        maps=truth_maps(integrator.view(sensor)),
        truth=described.truth,
        render=settings,
    )
