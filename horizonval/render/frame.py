"""Render one frame of a scene: radiance per band, truth maps, and the exact truth beside them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval import __version__
from horizonval.earth.optical import node_counts, optical_model
from horizonval.earth.surface import ground_model, mean_albedo
from horizonval.frame import Frame
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.ephemeris import AU_M, sun_itrs
from horizonval.render.backend import activate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth import truth_of

if TYPE_CHECKING:
    from horizonval.render.chunks import TableProgress


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
    truth = truth_of(scene, camera)
    _, sun_distance_m = sun_itrs(scene.platform.epoch_utc)
    model = optical_model(scene, camera, sun_distance_au=sun_distance_m / AU_M)
    ground = ground_model(scene)
    if not ground.plain:
        model = replace(model, albedo_around=tuple(mean_albedo(scene, n.wavelength_um) for n in model.nodes))
    variant = activate()
    import mitsuba as mi

    from horizonval.render.camera_plugin import camera_properties
    from horizonval.render.integrator import limb_properties, prepare
    from horizonval.render.planet import Planet
    from horizonval.render.truth_maps import truth_maps

    itrs_from_cam = Rotation.from_quat(truth.q_cam_from_itrs).inv().as_matrix()
    integrator_properties = limb_properties(
        model,
        Planet(truth.ellipsoid_a_m, truth.ellipsoid_b_m),
        truth.sun_itrs,
        truth.sun_angular_radius_rad,
        scene.render.subsamples,
        scene.render.nodes,
        scene.render.orders,
        ground,
    )
    prepare(integrator_properties, progress)
    mi_scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator_properties,
            "sensor": camera_properties(camera_from_spec(camera.camera), np.array(truth.r_itrs), itrs_from_cam),
        }
    )
    integrator, sensor = mi_scene.integrator(), mi_scene.sensors()[0]
    image = np.array(mi.render(mi_scene, spp=1))
    settings: dict[str, Any] = {
        "version": __version__,
        "variant": variant,
        "subsamples": scene.render.subsamples,
        "nodes": scene.render.nodes,
        "orders": scene.render.orders,
        "spectral_nodes": node_counts(model),
    }
    return Frame(
        radiance={band: np.ascontiguousarray(image[:, :, i]) for i, band in enumerate(integrator.bands)},
        maps=truth_maps(integrator.view(sensor)),
        truth=truth,
        render=settings,
    )
