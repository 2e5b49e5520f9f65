"""The lens: from the radiance of the scene to what falls on the pixels.

Cameras that count photons want the power on each pixel; those that warm up want the radiance that would give the same
power on the axis. Both go through the same stages, in the order of the light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import Camera
from horizonval.sensor import optics, point_spread
from horizonval.spec.optics import Optics

FloatArray = NDArray[np.float64]


def radiance_on_axis(radiance: FloatArray, geometry: Camera, lens: Optics) -> FloatArray:
    """Return the radiance [W m-2 sr-1] that on the axis would give every pixel the power it gets, shape (H, W).

    The transmission is not in it.
    """
    return point_spread.blur(radiance * optics.relative_illumination(geometry), lens.psf_sigma_px)


def pixel_power_w(radiance: FloatArray, geometry: Camera, lens: Optics, pixel_pitch_m: float) -> FloatArray:
    """Return the power on each pixel [W], shape (H, W)."""
    etendue = optics.etendue(geometry, pixel_pitch_m, lens.f_number)
    return point_spread.blur(optics.pixel_power_w(radiance, etendue, lens.transmission), lens.psf_sigma_px)
