"""Mean and variance of a detector's image before it is quantised, and what its digital numbers stand for.

In digital numbers, with the gain ``g`` in electrons or in radiance per number::

    cmos       mean = black + (N + D) / g       variance = (N + D + read^2 + (prnu N)^2 + dsnu^2) / g^2 + 1/12
    thermal    mean = (L - L_low) / g           variance = (sigma^2 + offsets^2 + (rms L)^2) / g^2 + 1/12

``N`` and ``D`` are the expected photoelectrons and dark electrons, 1/12 the variance of rounding. Differences between
pixels count as noise, since a user of a single image cannot calibrate them.

Neglected: hot pixels, protons and blooming, which affect few pixels; and that rounding is not noise where a signal has
less noise than a third of a number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.estimation.observation import Lens
from horizonval.frame import DetectorImage, Hit, RadianceFrame
from horizonval.geometry.camera import camera_from_spec
from horizonval.sensor.detector import bayer, cmos, readout, thermal
from horizonval.sensor.lens import optics
from horizonval.sensor.lens.diffraction import mean_wavelength_m
from horizonval.sensor.observe import band_named, checked_radiance
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos, LinearArray, ThermalDetector

ROUNDING = 1.0 / 12.0
"""Variance of the error of rounding [DN^2]."""
FOREIGN = (Hit.SUN, Hit.MOON, Hit.PART)
"""Hits that are not the Earth."""


@dataclass(frozen=True, eq=False)
class ExpectedImage:
    """Statistics of an image, each of shape (H, W) but ``zero``.

    ``mean`` [DN], not clipped; ``variance`` [DN^2]; ``reads``: whether the pixel has the band's colour, is not
    saturated and sees neither Sun nor Moon nor a part of the spacecraft; ``zero``: mean of a pixel without light [DN];
    ``illumination``: relative illumination of an even scene, 1 on the axis.
    """

    mean: FloatArray
    variance: FloatArray
    reads: NDArray[np.bool_]
    zero: float
    illumination: FloatArray


def expected_image(frame: RadianceFrame, camera: CameraSpec, band: str | None = None) -> ExpectedImage:
    """Return the statistics of what :func:`horizonval.sensor.observe.observe` makes of one band of a frame.

    The band is the camera's first one by default. Errors are those of ``observe``.
    """
    spec = band_named(camera, band)
    if isinstance(camera.detector, Cmos):
        mean, variance, reads, zero = _of_charge(frame, camera, camera.detector, spec)
    elif isinstance(camera.detector, ThermalDetector):
        mean, variance, reads, zero = _of_warmth(frame, camera, camera.detector, spec)
    else:
        raise UserError("the camera has no detector", where="detector", expected="a [detector] table")
    full_scale = readout.full_scale(camera.detector.bits)
    reads &= (mean < full_scale) & (mean > -np.sqrt(variance))
    if "hit" in frame.maps:
        reads &= ~np.isin(frame.maps["hit"], FOREIGN)
    illumination = optics.relative_illumination(camera_from_spec(camera.camera), camera.optics)
    return ExpectedImage(mean, variance, reads & (illumination > 0.0), zero, illumination)


def _of_charge(
    frame: RadianceFrame, camera: CameraSpec, detector: Cmos, band: Band
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], float]:
    # Of a mosaic the whole image in the band's colour; ``reads`` then leaves out the other pixels.
    whole = detector.model_copy(update={"bayer": None})
    back = (lambda of: np.asarray(frame.behind[of.name], dtype=np.float64)) if frame.behind else None
    charge = cmos.expected_charge(
        lambda of: checked_radiance(frame, camera, of.name),
        frame.truth,
        camera_from_spec(camera.camera),
        camera,
        whole,
        band,
        False,
        back,
    )
    gain, collected = cmos.electrons_per_dn(detector), charge.electrons + charge.dark
    variance = collected + detector.read_noise_e**2 + (detector.prnu * charge.electrons) ** 2 + detector.dsnu_e**2
    reads = collected < detector.full_well_e
    if detector.bayer is not None:
        shape = (collected.shape[0], collected.shape[1])
        reads &= bayer.mask(detector.bayer, bayer.colour_of(band.name), shape)
    zero = detector.black_level_dn + float(np.mean(charge.dark)) / gain
    return detector.black_level_dn + collected / gain, variance / gain**2 + ROUNDING, reads, zero


def _of_warmth(
    frame: RadianceFrame, camera: CameraSpec, detector: ThermalDetector, band: Band
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], float]:
    radiance = checked_radiance(frame, camera, band.name)
    back = np.asarray(frame.behind[band.name], dtype=np.float64) if frame.behind else None
    geometry = camera_from_spec(camera.camera)
    signal = thermal.expected_signal(radiance, frame.truth, geometry, camera, detector, band, back)
    low, step = thermal.converter_range(detector, band)
    measured_in = thermal.measured_band(camera, detector, band)
    variance = thermal.noise_radiance(measured_in, detector, camera) ** 2 + (detector.responsivity_rms * signal) ** 2
    if not (isinstance(detector, LinearArray) and detector.sensing == "pyroelectric"):
        drift = detector.drift_pattern_k_per_min * detector.minutes_since_correction
        per_kelvin = thermal.radiance_per_kelvin(measured_in)
        variance = variance + (detector.residue_k**2 + drift**2) * per_kelvin**2
    return (signal - low) / step, variance / step**2 + ROUNDING, np.ones(signal.shape, dtype=bool), -low / step


def radiance_per_dn(image: DetectorImage) -> float | None:
    """Return the band radiance on the axis per digital number [W m-2 sr-1]; None without a calibration.

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
    """Return the black level of a photon counting detector; 0 where the image does not state it."""
    if "camera" not in image.observation:
        return 0.0
    detector = CameraSpec.model_validate(image.observation["camera"]).detector
    return detector.black_level_dn if isinstance(detector, Cmos) else 0.0


def stated_lens(camera: CameraSpec, band: Band | None) -> Lens | None:
    """Return the point-spread and diffraction data that estimators are given; None where the file states none.

    Diffraction needs the pitch of the detector's pixels.
    """
    optics, pitch_um = camera.optics, None if camera.detector is None else camera.detector.pixel_pitch_um
    stated = Lens()
    if any(optics.psf_field_sigma_px):
        sigmas = np.array(optics.psf_field_sigma_px)
        angles = np.array([math.radians(angle) for angle in optics.psf_field_deg])
        spread = math.sqrt(np.mean(sigmas**2))
        stated = Lens(angles, sigmas / spread, blur_px=spread)
    elif optics.psf_sigma_px > 0.0 and not optics.defocus_um:
        stated = Lens(blur_px=optics.psf_sigma_px)
    if optics.diffraction and band is not None and pitch_um is not None:
        spread_px = mean_wavelength_m(band) * optics.f_number / (1e-6 * pitch_um)
        stated = replace(stated, diffraction_px=spread_px)
    return None if stated.blur_px is None and not stated.diffraction_px else stated
