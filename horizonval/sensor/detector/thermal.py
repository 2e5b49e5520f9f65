"""Thermal detectors: microbolometers, thermopiles, linear arrays. Radiance to digital numbers.

Such a detector reads the *difference* of the absorbed power to that of a closed shutter or chopper. With that reading
subtracted the signal is proportional to the band radiance of the scene, and everything is in units of the radiance on
the axis that gives as much power::

    signal = response * (lens of L, dragged by the time constant)  +  offsets  +  noise

A pixel follows with the time constant tau: a turning camera's image is the mean over the past with weight
``exp(-s / tau) / tau``. Offsets are the residue of the last correction and the drift since, as temperature differences
of a 300 K scene. A chopped (pyroelectric) element reads the difference of two samples: its noise is sqrt(2) larger, and
it has no offsets. The converter's ends are the band radiances of black bodies.

The noise of resistor and read-out is independent of the scene. It is given either as the temperature difference NETD of
a 300 K scene that equals it through a loss-free lens of f-number N0 (a slower or darker lens brings less power per
radiance to the detector), or as detectivity D* (R. C. Jones) of an element of area A read with bandwidth B, with the
etendue of :mod:`horizonval.sensor.lens.optics`::

    sigma_L = NETD dL/dT(300 K) (N / N0)^2 / tau
    NEP = sqrt(A B) / D*,      sigma_L = NEP / (tau A pi / (4 N^2))

Neglected: the change of the lens's own emission since the shutter's reading, which is part of the drift; heat between
pixels; the bend of the response over the converter's range; photon noise, two orders below.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands, planck
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel
from horizonval.sensor import motion
from horizonval.sensor.detector import fixed_pattern, readout
from horizonval.sensor.lens import image_plane, lens_spread
from horizonval.sensor.lens.stray_light import sun_of
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import LinearArray, Microbolometer, ThermalDetector, Thermopile

NETD_SCENE_K = 300.0
_STEP_K = 0.05


def blackbody_radiance(band: Band, temperature_k: float) -> float:
    """Return the response-weighted radiance [W m-2 sr-1] of a black body; 0 at 0 K."""
    # Bands hold lists and cannot be keys of a cache; their text can.
    return 0.0 if temperature_k == 0 else _blackbody_radiance(band.model_dump_json(), temperature_k)


@lru_cache(maxsize=64)
def _blackbody_radiance(band_text: str, temperature_k: float) -> float:
    wavelength_um, weight_um = bands.sampled(Band.model_validate_json(band_text))
    return float(np.sum(weight_um * planck.radiance_per_um(wavelength_um, temperature_k)))


def radiance_per_kelvin(band: Band, temperature_k: float = NETD_SCENE_K) -> float:
    """Return dL/dT [W m-2 sr-1 K-1]; the central difference is good to 1e-7."""
    upper, lower = (blackbody_radiance(band, temperature_k + step) for step in (_STEP_K, -_STEP_K))
    return (upper - lower) / (2 * _STEP_K)


def from_netd(band: Band, netd_k: float, relative_f_number: float, transmission: float) -> float:
    """Return the standard deviation of the signal [W m-2 sr-1]; f-number relative to that of the NETD."""
    return netd_k * radiance_per_kelvin(band) * relative_f_number**2 / transmission


def from_detectivity(
    d_star_cm_rthz_per_w: float, bandwidth_hz: float, pitch_um: float, f_number: float, transmission: float
) -> float:
    """Return the same from the detectivity of a square element."""
    area_m2 = (pitch_um * 1e-6) ** 2
    nep_w = math.sqrt(area_m2 * bandwidth_hz) / (d_star_cm_rthz_per_w * 1e-2)
    return nep_w / (transmission * area_m2 * math.pi / (4.0 * f_number**2))


SIGMA_PER_FWHM = 1.0 / np.sqrt(8.0 * np.log(2.0))
LAGUERRE_POINTS = 16
LAGUERRE_PX = 4.0
SLICE = 2.5e-3
"""Of an edge's contrast: the largest step of a dragged edge, unless a pixel's share of the drag is larger."""


def respond(
    radiance: FloatArray,
    truth: FrameTruth,
    geometry: CameraModel,
    camera: CameraSpec,
    detector: ThermalDetector,
    band: Band,
    rng: Callable[[str], np.random.Generator | None],
    behind: FloatArray | None = None,
) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Return digital numbers, shape (H, W), and the settings that an image carries.

    ``behind``: the radiance without parts of the spacecraft, where the frame has some.
    """
    signal = expected_signal(radiance, truth, geometry, camera, detector, band, behind)
    measured_in = measured_band(camera, detector, band)
    sigma = noise_radiance(measured_in, detector, camera)
    thermal_rng, residue_rng, drift_rng = rng("thermal"), rng("residue"), rng("drift")
    if thermal_rng is not None and residue_rng is not None and drift_rng is not None:
        unit, shape = fixed_pattern.unit(camera.camera.name, truth), (geometry.height, geometry.width)
        if detector.responsivity_rms > 0.0:
            signal = signal * fixed_pattern.response(unit, detector.serial, shape, detector.responsivity_rms)
        per_kelvin = radiance_per_kelvin(measured_in)
        signal = signal + offsets_k(detector, shape, residue_rng, drift_rng) * per_kelvin
        signal = signal + sigma * thermal_rng.standard_normal(shape)
    low, step = converter_range(detector, band)
    settings = {"radiance_at_zero": low, "radiance_per_dn": step, "sigma_radiance": sigma}
    return readout.digitise(signal - low, step, 0.0, detector.bits), settings


def expected_signal(
    radiance: FloatArray,
    truth: FrameTruth,
    geometry: CameraModel,
    camera: CameraSpec,
    detector: ThermalDetector,
    band: Band,
    behind: FloatArray | None = None,
) -> FloatArray:
    """Return the noise-free signal of equal pixels [W m-2 sr-1], shape (H, W); parameters as in :func:`respond`."""
    pitch_m = detector.pixel_pitch_um * 1e-6
    signal = image_plane.radiance_on_axis(radiance, geometry, camera.optics, pitch_m, band, sun_of(truth))
    turn = motion.rate_cam_rad_s(truth)
    motion.check_turn(turn, camera)
    if behind is None or not turn.any():
        signal = lag_by_time_constant(signal, geometry, turn, detector.time_constant_s)
    else:
        still = image_plane.radiance_on_axis(behind, geometry, camera.optics, pitch_m, band, sun_of(truth))
        dragged = lag_by_time_constant(still, geometry, turn, detector.time_constant_s)
        signal = motion.behind_still_parts(signal, still, dragged, truth, geometry)
    return lens_spread.blur(signal, detector.response_fwhm_px * SIGMA_PER_FWHM)


def measured_band(camera: CameraSpec, detector: ThermalDetector, band: Band) -> Band:
    """Return the band in which the noise is stated: the detector's ``netd_band``, else the one that is read."""
    return next((one for one in camera.band if one.name == detector.netd_band), band)


def converter_range(detector: ThermalDetector, band: Band) -> tuple[float, float]:
    """Return the radiance of the digital number 0, and that of one step [W m-2 sr-1]."""
    low = blackbody_radiance(band, detector.scene_min_k)
    high = blackbody_radiance(band, detector.scene_max_k)
    return low, (high - low) / readout.full_scale(detector.bits)


def noise_radiance(band: Band, detector: ThermalDetector, camera: CameraSpec) -> float:
    """Return the standard deviation of the temporal noise [W m-2 sr-1]; ``band`` is that of the NETD."""
    lens = camera.optics
    if isinstance(detector, Thermopile):
        return from_netd(band, detector.netd_k, 1.0, 1.0)
    if isinstance(detector, Microbolometer):
        speed = lens.f_number / detector.netd_f_number
        return from_netd(band, detector.netd_k, speed, lens.transmission)
    if not isinstance(detector, LinearArray):
        raise TypeError(f"no noise model for {type(detector).__name__}")
    looks = np.sqrt(2.0) if detector.sensing == "pyroelectric" else 1.0
    if detector.netd_k is not None:
        speed = lens.f_number / detector.netd_f_number
        return float(looks * from_netd(band, detector.netd_k, speed, lens.transmission))
    assert detector.d_star_cm_rthz_per_w is not None
    assert detector.bandwidth_hz is not None
    return float(
        looks
        * from_detectivity(
            detector.d_star_cm_rthz_per_w,
            detector.bandwidth_hz,
            detector.pixel_pitch_um,
            lens.f_number,
            lens.transmission,
        )
    )


def offsets_k(
    detector: ThermalDetector,
    shape: tuple[int, int],
    residue_rng: np.random.Generator,
    drift_rng: np.random.Generator,
) -> FloatArray | float:
    """Return the pixels' offsets as temperature differences of a 300 K scene, shape (H, W)."""
    if isinstance(detector, LinearArray) and detector.sensing == "pyroelectric":
        return 0.0
    offset: FloatArray | float = 0.0
    if detector.residue_k > 0.0:
        offset = detector.residue_k * residue_rng.standard_normal(shape)
    minutes = detector.minutes_since_correction
    if minutes > 0.0:
        common = detector.drift_k_per_min * minutes * drift_rng.standard_normal()
        offset = offset + common + detector.drift_pattern_k_per_min * minutes * drift_rng.standard_normal(shape)
    return offset


def lag_by_time_constant(
    image: FloatArray, geometry: CameraModel, rate_cam_rad_s: FloatArray, time_constant_s: float
) -> FloatArray:
    """Return the image of a turning camera whose pixels follow with a time constant, shape (H, W)."""
    if time_constant_s == 0.0:
        return image
    drag_px = float(np.linalg.norm(rate_cam_rad_s)) * time_constant_s * max(geometry.fx, geometry.fy)
    age, weight = lag_quadrature(drag_px)
    return motion.mean_over_instants(image, geometry, rate_cam_rad_s, -time_constant_s * age, weight)


def lag_quadrature(drag_px: float) -> tuple[FloatArray, FloatArray]:
    """Return ages, in time constants, and weights of sum 1 that stand for ``exp(-age)``.

    A short drag uses Gauss-Laguerre points. For edges dragged over many pixels they are too far apart; then slices of a
    pixel of the way are used, later slices of equal weight, each at its mean age.
    """
    if drag_px < LAGUERRE_PX:
        return np.polynomial.laguerre.laggauss(LAGUERRE_POINTS)
    even_to = max(0.0, np.log(1.0 / (drag_px * SLICE)))
    even = np.linspace(0.0, even_to, int(np.ceil(even_to * drag_px)), endpoint=False)
    left = np.exp(-even_to) * np.linspace(1.0, 0.0, int(np.ceil(np.exp(-even_to) / SLICE)) + 1)
    start = np.concatenate([np.exp(-even), left[:-1]])
    end = np.append(start[1:], 0.0)
    age = -np.log(start)
    older = np.append(age[1:], 0.0)
    weight = start - end
    return ((1.0 + age) * start - (1.0 + older) * end) / weight, weight
