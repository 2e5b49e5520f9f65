"""One place, instant and air, and as many frames as the camera has turns there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np

from horizonval import __version__
from horizonval.earth.optical import node_counts
from horizonval.frame import RadianceFrame
from horizonval.renderer.parts.compose import with_parts
from horizonval.renderer.parts.sky_light import SkyLight, sky_light
from horizonval.renderer.plugin.integrator import prepare
from horizonval.renderer.plugin.plugins import mitsuba_scene, mitsuba_sensor
from horizonval.renderer.scene.description import Described, turned
from horizonval.renderer.scene.truth_maps import truth_maps
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import with_infrared_horizon

if TYPE_CHECKING:
    from horizonval.core.progress import Progress


class Viewpoint:
    """What the frames of a place share, made once: Mitsuba's integrator, its tables, the infrared horizon.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    described : Described
        What they describe.
    progress : Progress, optional
        Told about tables of multiple scattering that must be solved first.
    """

    def __init__(
        self, scene: SceneSpec, camera: CameraSpec, described: Described, progress: Progress | None = None
    ) -> None:
        prepare(described.limb, progress)
        self._camera = camera
        self._described = replace(described, truth=with_infrared_horizon(described.truth, described.model))
        self._mi_scene = mitsuba_scene(described.limb, described.sensor)
        self._film = self._mi_scene.sensors()[0].film()
        self._sky: SkyLight | None = None
        self._settings: dict[str, Any] = {
            "version": __version__,
            "variant": described.variant,
            "method": scene.render.method,
            "subsamples": scene.render.subsamples,
            "nodes": scene.render.nodes,
            "orders": scene.render.orders,
            "spectral_nodes": node_counts(described.model),
        }

    def frame(self, scene: SceneSpec, *, maps: bool = True) -> RadianceFrame:
        """Return the frame of a scene; the same bytes whatever was rendered before.

        Parameters
        ----------
        scene : SceneSpec
            The viewpoint's own but for the attitude and the mounting.
        maps : bool
            Whether the frame has its truth maps.
        """
        described = turned(self._described, scene, self._camera)
        sensor, integrator = mitsuba_sensor(described.sensor, self._film), self._mi_scene.integrator()
        image = np.array(mi.render(self._mi_scene, sensor=sensor, spp=1))
        bands, solar = integrator.bands, integrator.solar_bands
        radiance = {band: np.ascontiguousarray(image[:, :, i]) for i, band in enumerate(bands)}
        energy = {band: np.ascontiguousarray(image[:, :, len(bands) + i]) for i, band in enumerate(solar)}
        frame = RadianceFrame(
            radiance=radiance,
            maps=truth_maps(integrator.view(sensor)) if maps else {},
            truth=described.truth,
            render=dict(self._settings),
            energy_radiance={band: energy.get(band, radiance[band]) for band in bands},
        )
        return self._with_parts(frame, scene, described) if scene.part else frame

    def _with_parts(self, frame: RadianceFrame, scene: SceneSpec, described: Described) -> RadianceFrame:
        if self._sky is None:
            self._sky = sky_light(self._mi_scene.integrator(), described.sensor.r_itrs, self._film)
        return with_parts(frame, scene, self._camera, described.camera, self._sky)
