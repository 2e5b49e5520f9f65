"""A camera on a ground mount: how it is pointed, what its detector makes of sky, stars and a satellite.

The mount rests during an exposure, so that stars are points (they move by 1.5 arcsec in 0.1 s) and a satellite is a
streak. Camera axes follow from the mount's azimuth and elevation: z along the boresight, x to the right (rising
azimuth), y down. The mount's reading differs from where the camera looks by a small rotation.

The detector's stages are those of :mod:`horizonval.sensor`; the point spread of the points is applied to them before
the pixels, in closed form, and that of the sky, which is smooth, is left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.geometry.camera import camera_from_spec
from horizonval.sensor.detector import exposure, fixed_pattern, readout
from horizonval.sensor.lens import optics
from horizonval.sensor.streams import stream
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos

TRACKER = {
    "camera": {"name": "ground-tracker", "width": 512, "height": 512, "focal_length_mm": 113.0},
    "optics": {"f_number": 2.8, "transmission": 0.8, "psf_sigma_px": 0.9},
    "band": [{"name": "visible", "kind": "solar", "lo_um": 0.5, "hi_um": 0.75, "nodes": 3}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 5.5,
        "exposure_s": 0.1,
        "quantum_efficiency": 0.6,
        "full_well_e": 13500.0,
        "read_noise_e": 6.0,
        "dark_current_e_per_s": 50.0,
        "prnu": 0.01,
        "bits": 12,
        "black_level_dn": 64.0,
    },
}
"""Pixels of 10 arcsec on 1.4 deg behind a pupil of 40 mm: a lens and a machine-vision array as amateurs use them."""


def tracker() -> CameraSpec:
    """Return the camera of both stations."""
    return CameraSpec.model_validate(TRACKER)


def cam_from_enu(azimuth_rad: float, elevation_rad: float) -> FloatArray:
    """Return the rotation from station axes (east, north, up) to those of a camera that looks there, shape (3, 3)."""
    sa, ca, se, ce = np.sin(azimuth_rad), np.cos(azimuth_rad), np.sin(elevation_rad), np.cos(elevation_rad)
    return np.array([[ca, -sa, 0.0], [se * sa, se * ca, -ce], [ce * sa, ce * ca, se]])


def detector_of(camera: CameraSpec) -> Cmos:
    """Return the camera's detector, which must be a visible array."""
    assert isinstance(camera.detector, Cmos)
    return camera.detector


def electrons_of_power(power_w: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons of an exposure from power on the detector [W] in the camera's first band."""
    detector = detector_of(camera)
    reference_m = bands.reference_wavelength_um(camera.band[0]) * 1e-6
    return exposure.photoelectrons(power_w, detector.exposure_s, detector.quantum_efficiency, reference_m)


def electrons_of_irradiance(irradiance: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons that points of some band irradiance [W m-2] at the pupil give in an exposure."""
    lens = camera.optics
    focal_m = camera.camera.focal_px * detector_of(camera).pixel_pitch_um * 1e-6
    area = optics.pupil_area_m2(focal_m, lens.f_number)
    return electrons_of_power(np.asarray(irradiance, float) * area * lens.transmission, camera)


def electrons_of_sky(radiance: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons of every pixel, shape (H, W), from band radiance [W m-2 sr-1]."""
    geometry = camera_from_spec(camera.camera)
    etendue = optics.etendue(geometry, detector_of(camera).pixel_pitch_um * 1e-6, camera.optics)
    return electrons_of_power(optics.pixel_power_w(radiance, etendue, camera.optics.transmission), camera)


def digital_numbers(
    photoelectrons: FloatArray, camera: CameraSpec, unit: str, exposure_name: str, seed: int
) -> NDArray[np.uint16]:
    """Return what the detector makes of expected photoelectrons, shape (H, W).

    ``unit`` names the station's camera, which has its pattern for life; ``exposure_name`` and ``seed`` the draw.
    """
    detector = detector_of(camera)
    shape = (photoelectrons.shape[0], photoelectrons.shape[1])

    def rng(stage: str) -> np.random.Generator:
        return stream(exposure_name, unit, camera.band[0].name, stage, seed)

    unequal = photoelectrons * fixed_pattern.response(unit, detector.serial, shape, detector.prnu)
    counted = exposure.count(unequal, detector.full_well_e, rng("photon"))
    dark = exposure.count(
        np.full(shape, detector.dark_current_e_per_s * detector.exposure_s), detector.full_well_e, rng("dark")
    )
    held = readout.add_read_noise(
        readout.saturate(counted + dark, detector.full_well_e), detector.read_noise_e, rng("read")
    )
    return readout.digitise(held, gain_e_per_dn(camera), detector.black_level_dn, detector.bits)


def gain_e_per_dn(camera: CameraSpec) -> float:
    """Return the converter's electrons per digital number."""
    detector = detector_of(camera)
    return detector.gain_e_per_dn or readout.default_gain(detector.full_well_e, detector.bits, detector.black_level_dn)


def electrons_of_dn(dn: NDArray[np.uint16], camera: CameraSpec) -> FloatArray:
    """Return digital numbers as electrons above the black level, shape (H, W)."""
    return (dn.astype(np.float64) - detector_of(camera).black_level_dn) * gain_e_per_dn(camera)
