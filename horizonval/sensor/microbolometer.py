"""Uncooled infrared arrays: absorbed power to a signal in units of scene radiance.

A microbolometer warms up with the power it absorbs and reads the power's *difference* to that of a closed shutter. With
the shutter's own reading subtracted, what is left is proportional to the band radiance L of the scene::

    signal = L cos^4(theta)                                           [W m-2 sr-1, as seen on the axis]

Its noise is that of the resistor and the readout, hence independent of the scene. It is given as the temperature
difference NETD of a 300 K scene, seen through an ideal f/1 lens, that equals it. A slower or darker lens brings less
power per radiance to the detector::

    sigma_L = NETD * dL/dT(300 K) * N^2 / tau

The converter's ends are the band radiances of black bodies at ``scene_min_k`` and ``scene_max_k``.

Neglected: photon noise, two orders below; the slow drift of offsets between shutter closings and the pattern that is
left after flat-fielding; the lens's own glow, subtracted with the shutter's reading; the thermal time constant of some
10 ms, which smears a horizon at 0.1 deg/s by 0.001 deg.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.earth import bands, planck
from horizonval.geometry.camera import Camera
from horizonval.sensor import converter, image_plane
from horizonval.sensor.stray_light import Sun
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Microbolometer

FloatArray = NDArray[np.float64]

NETD_SCENE_K = 300.0
_STEP_K = 0.05


def respond(
    radiance: FloatArray,
    geometry: Camera,
    camera: CameraSpec,
    detector: Microbolometer,
    band: Band,
    rng: Callable[[str], np.random.Generator | None],
    sun: Sun | None = None,
) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Return digital numbers, shape (H, W), and the settings that an image carries."""
    lens = camera.optics
    signal = image_plane.radiance_on_axis(radiance, geometry, lens, detector.pixel_pitch_um * 1e-6, band, sun)
    sigma = noise_radiance(band, detector.netd_k, lens.f_number, lens.transmission)
    thermal_rng = rng("thermal")
    if thermal_rng is not None:
        signal = add_noise(signal, sigma, thermal_rng)
    low = blackbody_radiance(band, detector.scene_min_k)
    high = blackbody_radiance(band, detector.scene_max_k)
    step = (high - low) / converter.full_scale(detector.bits)
    settings = {"radiance_at_zero": low, "radiance_per_dn": step, "sigma_radiance": sigma}
    return converter.digitise(signal - low, step, 0.0, detector.bits), settings


def blackbody_radiance(band: Band, temperature_k: float) -> float:
    """Return the response-weighted radiance [W m-2 sr-1] of a black body; 0 at 0 K."""
    if temperature_k == 0:
        return 0.0
    wavelength_um, weight_um = bands.sampled(band)
    return float(np.sum(weight_um * planck.radiance_per_um(wavelength_um, temperature_k)))


def radiance_per_kelvin(band: Band, temperature_k: float = NETD_SCENE_K) -> float:
    """Return dL/dT [W m-2 sr-1 K-1]; the central difference is good to 1e-7."""
    upper, lower = (blackbody_radiance(band, temperature_k + step) for step in (_STEP_K, -_STEP_K))
    return (upper - lower) / (2 * _STEP_K)


def noise_radiance(band: Band, netd_k: float, f_number: float, transmission: float) -> float:
    """Return the standard deviation of the signal [W m-2 sr-1]."""
    return netd_k * radiance_per_kelvin(band) * f_number**2 / transmission


def add_noise(signal: FloatArray, sigma: float, rng: np.random.Generator) -> FloatArray:
    """Return the signal with white noise, shape and unit of ``signal``."""
    return signal + sigma * rng.standard_normal(signal.shape)
