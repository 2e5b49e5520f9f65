"""A frame's pixels marched one by one: what its tables must say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.earth.optical import optical_model
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec, pixel_grid, unproject
from horizonval.renderer.frame import render_frame
from horizonval.renderer.rays import NODES, thermal_radiance
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

BANDS: dict[str, dict[str, Any]] = {
    "co2": {"lo_um": 14.0, "hi_um": 16.3},
    "window": {"lo_um": 10.5, "hi_um": 12.5},
}


@dataclass(frozen=True)
class Marched:
    """A frame, and the direct march along the middle of every pixel; ``clear``: a pixel away from the hard limb."""

    frame: RadianceFrame
    radiance: dict[str, np.ndarray]
    height_m: np.ndarray
    clear: np.ndarray

    def error(self, band: str) -> np.ndarray:
        """Return the relative difference where both see something, else 0; nan on the hard limb."""
        ours, theirs = self.frame.radiance[band].astype(np.float64), self.radiance[band]
        floor = 1e-6 * theirs.max()
        error = np.where(theirs > floor, np.abs(ours / np.maximum(theirs, floor) - 1.0), np.abs(ours - theirs) / floor)
        return np.where(self.clear, error, np.nan)

    def worst(self, band: str, above: float = 0.0) -> str:
        """Say how large the largest difference is, and where, among pixels above a share of the brightest."""
        error = np.where(self.radiance[band] > above * self.radiance[band].max(), self.error(band), np.nan)
        row, column = np.unravel_index(np.nanargmax(error), error.shape)
        height = self.height_m[row, column] / 1e3
        return f"{band}: {error[row, column]:.2e} at pixel ({row}, {column}), lowest height {height:.2f} km"


def scene_of(**tables: Any) -> SceneSpec:
    """Return a scene of one subsample per pixel and as many nodes as the direct march has."""
    defaults: dict[str, Any] = {
        "camera": {"file": "test"},
        "render": {"subsamples": 1, "nodes": NODES},
        "platform": {"altitude_km": 500.0},
    }
    return SceneSpec.model_validate(defaults | tables)


def camera_of(width: int, height: int, fov_deg: float, bands: dict[str, dict[str, Any]] | None = None) -> CameraSpec:
    """Return a pinhole camera with thermal bands."""
    listed = [{"name": name, "kind": "thermal"} | shape for name, shape in (bands or BANDS).items()]
    geometry = {"width": width, "height": height, "fov_deg": fov_deg}
    return CameraSpec.model_validate({"camera": geometry, "band": listed})


def directions(frame: RadianceFrame, camera: CameraSpec) -> np.ndarray:
    """Return the direction of every pixel's middle in Earth-fixed axes, shape (rows, columns, 3)."""
    pinhole = camera_from_spec(camera.camera)
    cam = unproject(pinhole, pixel_grid(pinhole))
    turned = Rotation.from_quat(frame.truth.q_cam_from_itrs).inv().apply(cam.reshape(-1, 3))
    return np.asarray(turned).reshape(cam.shape)


def march_frame(scene: SceneSpec, camera: CameraSpec, nodes: int = NODES) -> Marched:
    """Render a frame and march its pixels. For a ground of one kind, without clouds."""
    frame = render_frame(scene, camera)
    truth = frame.truth
    d = directions(frame, camera)
    flat = d.reshape(-1, 3)
    model = optical_model(scene, camera, 1.0)
    observer = np.tile(np.array(truth.r_itrs), (len(flat), 1))
    found = thermal_radiance(
        model,
        truth.ellipsoid_a_m,
        observer,
        flat,
        sun_itrs=truth.sun_itrs,
        polar_radius_m=truth.ellipsoid_b_m,
        nodes=nodes,
    )
    height = frame.maps["tangent_height"].astype(np.float64)
    # the hard limb's pixels are mixtures; bent rays see it some 2 km higher
    ground = height < (2e3 if scene.atmosphere.refraction else 0.0)
    edge = np.zeros(ground.shape, dtype=bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            edge |= np.roll(ground, (down, right), (0, 1)) != ground
    return Marched(frame, {name: v.reshape(height.shape) for name, v in found.items()}, height, ~edge)
