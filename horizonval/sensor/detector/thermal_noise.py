"""Noise and scale of thermal detectors, in units of the scene's band radiance.

The noise is that of the resistor and the read-out, hence independent of the scene. It is given

- as the temperature difference NETD of a 300 K scene that equals it, seen through a loss-free lens of f-number N0. A
  slower or darker lens brings less power per radiance to the detector::

      sigma_L = NETD dL/dT(300 K) (N / N0)^2 / tau

- or as detectivity D* of an element of area A read with bandwidth B::

      NEP = sqrt(A B) / D*,      sigma_L = NEP / (tau A pi / (4 N^2))

(R. C. Jones's D*; the etendue of a pixel on the axis is that of :mod:`horizonval.sensor.lens.optics`.) Photon noise is
two orders below.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from horizonval.earth.spectral import bands, planck
from horizonval.spec.camera import Band

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
