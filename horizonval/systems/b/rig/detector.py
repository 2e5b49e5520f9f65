"""The camera on the bench: the shipped detector behind its lens, exposed for the panel.

The stages are those of every other image (:func:`horizonval.sensor.observe.observe`); the radiance comes from the
bench. The exposure lays the panel's white on seven tenths of the full well, on the axis: the electrons of a pixel are
``pi L tau pitch^2 t QE lambda / (4 N^2 h c)``.

The lens is focused on the panel. Its blur is the camera file's, and has been at work before the pixels
(:mod:`horizonval.systems.b.rig.scene`), so that the file's is left out here. Vignetting is taken about the image's
middle, not about the optical centre, whose error shifts it by a few pixels.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.constants import c, h

from horizonval.earth.spectral.bands import reference_wavelength_um
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.spec.scene import SceneSpec
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
    """Return what the detector makes of the bench's radiance [W m-2 sr-1], shape (H, W).

    Parameters
    ----------
    shown : SceneSpec
        The scene on the panel; the image's truth is that of the scene before it was tilted.
    camera : CameraSpec
        As in its file.
    name : str
        Of the frame: noise belongs to it and to the seed.
    """
    truth = replace(_truth(shown.model_dump_json(), camera.model_dump_json()), scene_id=name)
    return observe(
        RadianceFrame({camera.band[0].name: radiance}, {}, truth), behind_lens(camera), seed=seed, noise=noise
    )


@lru_cache(maxsize=4)
def _truth(shown: str, camera: str) -> FrameTruth:
    return truth_of(SceneSpec.model_validate_json(shown), CameraSpec.model_validate_json(camera), infrared=False)
