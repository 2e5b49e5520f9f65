"""Render one frame of a scene: radiance per band, truth maps, and the exact truth beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from horizonval import __version__
from horizonval.earth.optical import node_counts
from horizonval.frame import RadianceFrame
from horizonval.renderer.scene.description import describe
from horizonval.renderer.scene.frame_memory import refuse_too_large
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec
from horizonval.truth.frame_truth import with_infrared_horizon

if TYPE_CHECKING:
    from horizonval.core.progress import Progress


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
    refuse_too_large(scene, camera)
    described = describe(scene, camera)
    import mitsuba as mi

    from horizonval.renderer.plugin.integrator import prepare
    from horizonval.renderer.plugin.plugins import mitsuba_scene
    from horizonval.renderer.scene.truth_maps import truth_maps

    prepare(described.limb, progress)
    mi_scene = mitsuba_scene(described.limb, described.sensor)
    integrator, sensor = mi_scene.integrator(), mi_scene.sensors()[0]
    image = np.array(mi.render(mi_scene, spp=1))
    settings: dict[str, Any] = {
        "version": __version__,
        "variant": described.variant,
        "method": scene.render.method,
        "subsamples": scene.render.subsamples,
        "nodes": scene.render.nodes,
        "orders": scene.render.orders,
        "spectral_nodes": node_counts(described.model),
    }
    bands, solar = integrator.bands, integrator.solar_bands
    radiance = {band: np.ascontiguousarray(image[:, :, i]) for i, band in enumerate(bands)}
    energy = {band: np.ascontiguousarray(image[:, :, len(bands) + i]) for i, band in enumerate(solar)}
    return RadianceFrame(
        radiance=radiance,
        maps=truth_maps(integrator.view(sensor)),
        truth=with_infrared_horizon(described.truth, described.model),
        render=settings,
        energy_radiance={band: energy.get(band, radiance[band]) for band in bands},
    )
