"""Parts laid over a frame: ``L = c L_part + (1 - c) L_earth``, with the exact covered share c of every pixel.

The share is that of the truth (:mod:`horizonval.geometry.part`) and not of the rays that lit the parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.frame import PART_MAP, FrameTruth, Hit, RadianceFrame
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.part import coverage
from horizonval.renderer.parts.part_light import PartScene
from horizonval.renderer.parts.sky_light import SkyLight
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import part_triangles


def with_parts(
    frame: RadianceFrame, scene: SceneSpec, camera: CameraSpec, model: CameraModel, sky: SkyLight
) -> RadianceFrame:
    """Return a frame with its scene's parts in it.

    Raises
    ------
    UserError
        For a BSDF that Mitsuba refuses.
    """
    truth = frame.truth
    assert truth.part_outline is not None
    share = coverage(truth.part_outline, model)
    parts = PartScene(
        scene.part,
        part_triangles(scene.part, truth.q_cam_from_body),
        model,
        share > 0.0,
        sky,
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.sun_itrs),
        truth.sun_angular_radius_rad,
        scene.render.part_samples,
        truth.scene_id,
    )
    light = parts.light([band for band in camera.band if band.name in frame.radiance])

    def laid_over(behind: dict[str, np.ndarray], before: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        mixed = {band: share * before[band] + (1.0 - share) * image for band, image in behind.items()}
        return {band: np.asarray(image, dtype=np.float32) for band, image in mixed.items()}

    radiance = laid_over(frame.radiance, light.radiance)
    energy = laid_over(frame.energy_radiance, light.energy)
    thermal = {band.name for band in camera.band if band.kind == "thermal"}
    energy = {band: radiance[band] if band in thermal else image for band, image in energy.items()}
    maps = frame.maps
    if maps:
        maps = _maps(frame.maps, truth, model, share, light.distance_m)
    render = frame.render | {"part_samples": scene.render.part_samples}
    return replace(
        frame, radiance=radiance, energy_radiance=energy, maps=maps, render=render, behind=dict(frame.radiance)
    )


def _maps(
    maps: dict[str, np.ndarray], truth: FrameTruth, model: CameraModel, share: np.ndarray, distance_m: np.ndarray
) -> dict[str, np.ndarray]:
    assert truth.part_outline is not None
    candidates = np.flatnonzero(share > 0.0)
    middle = np.zeros(share.size, dtype=bool)
    middle[candidates] = truth.part_outline.covers(unproject(model, pixel_grid(model).reshape(-1, 2)[candidates]))
    behind = middle.reshape(share.shape)
    hit = np.where(behind, np.float32(Hit.PART), maps["hit"])
    # where single precision just misses a part, its neighbours say how far it is
    near = np.where(np.isfinite(distance_m), distance_m, _nearest(distance_m))
    return maps | {
        "hit": hit,
        "distance": np.where(behind, near, maps["distance"]).astype(np.float32),
        PART_MAP: share.astype(np.float32),
    }


def _nearest(values: np.ndarray) -> np.ndarray:
    from scipy.ndimage import distance_transform_edt

    known = np.isfinite(values)
    if not known.any():
        return values
    index = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(index)])
