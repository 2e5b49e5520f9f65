"""One position, instant and air, and as many frames as the camera has attitudes there.

Truth maps say what the ray through the centre of each pixel meets, where, and under which Sun. They describe the
picture for a reader; the truth that scores an estimator is analytic and never comes from here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval import __version__
from horizonval.earth.optical import node_counts
from horizonval.frame import Hit, RadianceFrame
from horizonval.renderer.description import Described, turned
from horizonval.renderer.kernel.clouds import first_cloud
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.parts import SkyLight, sky_light, with_parts
from horizonval.renderer.planet import along, dot
from horizonval.renderer.plugins import mitsuba_scene, mitsuba_sensor, prepare
from horizonval.renderer.types import Vec
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import with_infrared_horizon

if TYPE_CHECKING:
    from horizonval.core.progress import Progress


def truth_maps(view: FrameGeometry) -> dict[str, NDArray[np.float32]]:
    """Return the maps of :data:`horizonval.frame.MAP_UNITS`, each of shape (H, W), float32.

    The tangent height of a ray that hits the surface is minus the depth of its chord below it, measured at the point
    of the line nearest to the stretched sphere's centre; within 1e-3 of the depth for the Earth's flattening. Clouds
    appear in ``hit`` and ``distance``; the other maps are those of the bare ellipsoid. Pixels beyond the lens's image
    circle see nothing: ``hit`` is space there, distance and tangent height are infinite, and the Sun is at 180 deg.
    """
    pixel = dr.arange(mi.UInt32, view.width * view.height)
    u, v = view.column_and_row(pixel)
    d = view.rays.direction(u, v)
    mid, half, meets = view.planet.chord(view.origin, d)
    ahead = mid > 0.0
    hits = meets & ahead
    distance = dr.select(hits, mid - half, dr.inf)
    lowest = along(view.origin, d, dr.maximum(mid, 0.0))
    tangent_height, normal = view.planet.height_and_normal(lowest)
    _, ground_normal = view.planet.height_and_normal(along(view.origin, d, dr.select(hits, distance, 0.0)))
    cosine = dr.select(hits, dot(ground_normal, view.sun), dot(normal, view.sun))
    zenith = dr.rad2deg(dr.acos(dr.clip(cosine, -1.0, 1.0)))

    def on_disc(direction: Vec, radius: mi.Float64) -> mi.Bool:
        chord = [a - b for a, b in zip(d, direction, strict=True)]
        return dr.sqrt(chord[0] ** 2 + chord[1] ** 2 + chord[2] ** 2) < radius

    sky = dr.select(tangent_height < view.top_m, mi.Float64(float(Hit.ATMOSPHERE)), 0.0)
    if view.moon is not None:
        sky = dr.select(on_disc(view.moon.disc.direction, view.moon.disc.radius), mi.Float64(float(Hit.MOON)), sky)
    sky = dr.select(on_disc(view.sun, view.sun_radius), mi.Float64(float(Hit.SUN)), sky)
    hit = dr.select(hits, mi.Float64(float(Hit.SURFACE)), sky)
    if view.ground is not None and view.ground.clouds is not None:
        clouded, at = first_cloud(view.ground.clouds, view.planet, view.origin, d, to_ground=hits)
        clouded &= at < distance
        hit = dr.select(clouded, mi.Float64(float(Hit.CLOUD)), hit)
        distance = dr.select(clouded, at, distance)
    shape = (view.height, view.width)
    maps = {"distance": distance, "tangent_height": tangent_height, "solar_zenith": zenith, "hit": hit}
    if view.rays.circle is not None:
        lit, nothing = view.rays.sees(u, v), {"hit": float(Hit.SPACE), "solar_zenith": 180.0}
        maps = {name: dr.select(lit, value, nothing.get(name, math.inf)) for name, value in maps.items()}
    dr.eval(maps)
    return {name: np.array(value, dtype=np.float32).reshape(shape) for name, value in maps.items()}


class Viewpoint:
    """What the frames of a place share, made once: Mitsuba's integrator, its tables, the infrared horizon."""

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
            "accuracy": scene.render.accuracy,
            "subsamples": scene.render.subsamples,
            "nodes": scene.render.nodes,
            "orders": scene.render.orders,
            "spectral_nodes": node_counts(described.model),
        }

    def frame(self, scene: SceneSpec, *, maps: bool = True) -> RadianceFrame:
        """Return the frame of a scene, the viewpoint's own but for attitude and mounting; ``maps``.

        With its truth maps.
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
