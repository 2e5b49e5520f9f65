"""Digital numbers as radiances, as far as a detector states it or its data sheet tells."""

from __future__ import annotations

from horizonval.frame import DetectorImage
from horizonval.sensor.detector import cmos
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos


def radiance_per_dn(image: DetectorImage) -> float | None:
    """Return the band radiance on the axis that a digital number stands for [W m-2 sr-1]; None without a calibration.

    A thermal detector states it. A photon counting one is taken as calibrated to its data sheet.
    """
    stated = image.observation.get("radiance_per_dn")
    if stated is not None or "camera" not in image.observation:
        return None if stated is None else float(stated)
    camera = CameraSpec.model_validate(image.observation["camera"])
    if not isinstance(camera.detector, Cmos):
        return None
    band = next(one for one in camera.band if one.name == image.band)
    seconds = float(image.observation.get("exposure_s", camera.detector.exposure_s))
    return cmos.radiance_per_dn(camera, camera.detector, band, seconds)


def black_level_dn(image: DetectorImage) -> float:
    """Return the number that the converter of a photon counting detector adds; 0 where the image does not tell."""
    if "camera" not in image.observation:
        return 0.0
    detector = CameraSpec.model_validate(image.observation["camera"]).detector
    return detector.black_level_dn if isinstance(detector, Cmos) else 0.0
