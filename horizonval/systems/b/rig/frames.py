"""What worker processes do for the bench: the picture for the panel, and sweeps of one bench through its tilts.

The camera is the shipped detector behind its lens, exposed for the panel. The stages are those of every other image
(:func:`horizonval.sensor.observe.observe`); the radiance comes from the bench. The exposure lays the panel's white on
seven tenths of the full well, on the axis: the electrons of a pixel are ``pi L tau pitch^2 t QE lambda / (4 N^2 h c)``.

The lens is focused on the panel. Its blur is the camera file's, and has been at work before the pixels
(:mod:`horizonval.systems.b.rig.scene`), so that the file's is left out here. Vignetting is taken about the image's
middle, not about the optical centre, whose error shifts it by a few pixels.
"""

from __future__ import annotations

import base64
import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.constants import c, h

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.earth.spectral.bands import reference_wavelength_um
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.systems.b.pair import frames
from horizonval.systems.b.rig import bench, picture, scene
from horizonval.systems.b.rig.bench import BenchErrors
from horizonval.truth.frame_truth import truth_of

FILL = 0.7


def exposed_for(camera: CameraSpec, white_w_m2_sr: float) -> CameraSpec:
    """Return the camera with the exposure that lays a radiance on seven tenths of the full well."""
    detector = camera.detector
    if not isinstance(detector, Cmos):
        raise ValueError("the bench's camera counts photons")
    pixel_w = math.pi * white_w_m2_sr * camera.optics.transmission * (detector.pixel_pitch_um * 1e-6) ** 2
    pixel_w /= 4.0 * camera.optics.f_number**2
    photon_j = h * c / (reference_wavelength_um(camera.band[0]) * 1e-6)
    seconds = FILL * detector.full_well_e * photon_j / (pixel_w * detector.quantum_efficiency)
    return camera.model_copy(update={"detector": detector.model_copy(update={"exposure_s": seconds})})


def behind_lens(camera: CameraSpec) -> CameraSpec:
    """Return the camera without its lens's blur."""
    return camera.model_copy(update={"optics": camera.optics.model_copy(update={"psf_sigma_px": 0.0})})


def built(camera: CameraSpec, errors: BenchErrors) -> CameraModel:
    """Return the lens as it was built: its optical centre off by the bench's errors."""
    ideal = camera_from_spec(camera.camera)
    return replace(ideal, cx=ideal.cx + errors.centre_x_px, cy=ideal.cy + errors.centre_y_px)


def photograph(
    radiance: NDArray[np.float32], camera: CameraSpec, shown: SceneSpec, name: str, seed: int, *, noise: bool
) -> DetectorImage:
    """Return the detector's image of the bench's radiance [W m-2 sr-1], shape (H, W).

    ``shown``: the scene on the panel, whose truth, before its tilt, the image has; ``name``: of the frame, for its
    noise.
    """
    truth = replace(_truth(shown.model_dump_json(), camera.model_dump_json()), scene_id=name)
    return observe(
        RadianceFrame({camera.band[0].name: radiance}, {}, truth), behind_lens(camera), seed=seed, noise=noise
    )


@lru_cache(maxsize=4)
def _truth(shown: str, camera: str) -> FrameTruth:
    return truth_of(SceneSpec.model_validate_json(shown), CameraSpec.model_validate_json(camera), infrared=False)


CAMERA = "vis-cmos-512-60deg"
DISTANCE_MM = 200.0
"""Distance at which the panel fills the camera's field at every tilt."""
MAGNIFIER = 32.0
SPAN = 3.0
"""Full scale over white: the open part of a stripe is up to twice as bright as a white area."""


def make_picture(_item: JsonObject) -> JsonObject:
    """Return the picture for the panel, packed."""
    return {"png": picture.packed(picture.picture(scene.Panel(), DISTANCE_MM, load_camera(CAMERA)))}


def sweep(item: JsonObject) -> JsonObject:
    """Return the estimated tilts [rad] of one bench, None where there is no arc.

    ``item``: ``picture`` (path), ``panel`` and ``errors`` (fields), ``tilts_deg``, ``noise``, ``name``, ``seed``.
    """
    camera = camera_from_spec(_camera().camera)
    found: list[float | None] = []
    for tilt_deg in item["tilts_deg"]:
        image = _photograph(item, tilt_deg)
        found.append(frames.tilt_rad(image.dn.astype(np.float64), camera, image.full_scale))
    return {"tilt_rad": found}


def show(item: JsonObject) -> JsonObject:
    """Return one frame of a bench for viewing: PNGs of 16 bits.

    ``item`` as for :func:`sweep`, with one tilt. ``dn``: digital numbers of ``full_scale``; ``bare``, ``blurred``:
    radiance without and with the lens's blur; ``magnified``: through a lens of ``MAGNIFIER`` times the focal length;
    all as shares of 65535 for ``SPAN`` times the panel's white. ``limb``: pixel of the magnified picture where the
    middle column crosses half of its maximum.
    """
    tilt_deg = item["tilts_deg"][0]
    image = _photograph(item, tilt_deg)
    blurred, bare = (_render(item, tilt_deg, blur) for blur in (item["blur_px"], 0.0))
    column = blurred.shape[1] // 2
    across = blurred[:, column]
    limb = (column, int(np.argmax(across > 0.5 * across.max())))
    magnified = _render(item, tilt_deg, 0.0, limb)
    pictures = {"bare": bare, "blurred": blurred, "magnified": magnified}
    return {name: _png(_share(picture)) for name, picture in pictures.items()} | {
        "dn": _png(image.dn),
        "full_scale": image.full_scale,
        "limb": list(limb),
    }


def read_png(text: str) -> NDArray[Any]:
    """Return the array of :func:`show`'s pictures."""
    return np.asarray(cv2.imdecode(np.frombuffer(base64.b64decode(text), dtype=np.uint8), cv2.IMREAD_UNCHANGED))


def _photograph(item: JsonObject, tilt_deg: float) -> DetectorImage:
    return photograph(
        _render(item, tilt_deg, item["blur_px"]),
        _camera(),
        picture.scene_shown(),
        f"{item['name']} {tilt_deg:g}",
        item["seed"],
        noise=item["noise"],
    )


def _render(
    item: JsonObject, tilt_deg: float, blur_px: float, magnify_at: tuple[int, int] | None = None
) -> NDArray[np.float32]:
    screen, errors = scene.Panel(**_tuples(item["panel"])), bench.BenchErrors(**item["errors"])
    return _radiance(item["picture"], screen, errors, tilt_deg, blur_px, magnify_at)


@lru_cache(maxsize=8)
def _radiance(
    path: str,
    screen: scene.Panel,
    errors: bench.BenchErrors,
    tilt_deg: float,
    blur_px: float,
    magnify_at: tuple[int, int] | None,
) -> NDArray[np.float32]:
    """Return the radiance on the camera's pixels, cached for benches that differ in their noise only."""
    from horizonval.renderer.backend import activate

    activate()
    from horizonval.systems.b.rig import scene

    lens = built(_camera(), errors)
    if magnify_at is not None:
        middle = (lens.width - 1) / 2
        lens = replace(
            lens,
            fx=lens.fx * MAGNIFIER,
            fy=lens.fy * MAGNIFIER,
            cx=middle + (lens.cx - magnify_at[0]) * MAGNIFIER,
            cy=middle + (lens.cy - magnify_at[1]) * MAGNIFIER,
        )
    loaded = scene.bench_scene(
        screen,
        _shining(path, screen),
        bench.panel_pose(DISTANCE_MM, errors),
        lens,
        bench.camera_pose(math.radians(tilt_deg), errors),
    )
    return scene.render(loaded, blur_px)


@lru_cache(maxsize=1)
def _camera() -> CameraSpec:
    return exposed_for(load_camera(CAMERA), scene.Panel().white_w_m2_sr)


@lru_cache(maxsize=2)
def _shining(path: str, screen: scene.Panel) -> FloatArray:
    share = picture.unpacked(Path(path).read_text(encoding="ascii")).share
    return share if screen.smooth else scene.share_shown(scene.levels(share, screen.gamma), screen)


def _share(radiance: NDArray[np.float32]) -> NDArray[np.uint16]:
    share = radiance / (SPAN * scene.Panel().white_w_m2_sr)
    return np.rint(65535.0 * np.clip(share, 0.0, 1.0)).astype(np.uint16)


def _tuples(values: JsonObject) -> JsonObject:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}


def _png(array: NDArray[np.uint16]) -> str:
    done, data = cv2.imencode(".png", array)
    if not done:
        raise RuntimeError("the picture could not be packed")
    return base64.b64encode(data.tobytes()).decode("ascii")
