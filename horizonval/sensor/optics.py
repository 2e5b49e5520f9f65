"""The lens as a light collector: scene radiance to power on each pixel.

A pixel sees the solid angle Omega of the scene through the entrance pupil of area A, foreshortened by the angle theta
to the axis::

    P = tau L A cos(theta) Omega,      A = pi (f / N)^2 / 4,      f = fx * pitch

For a pinhole ``Omega = cos^3(theta) / (fx fy)``, which makes the cosine-fourth law ``P = pi tau L pitch^2 cos^4(theta)
/ (4 N^2)``; on the axis that is exact for a lens that obeys Abbe's sine condition, at any f-number. Distortion changes
Omega, and so is carried by it. (Boyd, *Radiometry and the Detection of Optical Radiation*, 1983, chapter 6.)

A fisheye's front group tilts and swells the pupil towards the field, else it would not see past 90 deg: its A
cos(theta) is taken as that of the axis.

Neglected: vignetting by the lens barrel and pupil aberration, which cameras of this kind show beyond 30 deg off axis
and calibrate away; the colour of the transmission, which belongs into the band's response; stray light.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import Camera, off_axis_angle, pixel_solid_angle

FloatArray = NDArray[np.float64]


def pupil_area_m2(focal_length_m: float, f_number: float) -> float:
    """Return the area of the entrance pupil [m2]."""
    return math.pi / 4 * (focal_length_m / f_number) ** 2


def etendue(camera: Camera, pixel_pitch_m: float, f_number: float) -> FloatArray:
    """Return every pixel's etendue A cos(theta) Omega [m2 sr], shape (H, W)."""
    area = pupil_area_m2(camera.fx * pixel_pitch_m, f_number)
    return area * _foreshortened_solid_angle(camera)


def relative_illumination(camera: Camera) -> FloatArray:
    """Return the etendue relative to the axis, shape (H, W): ``cos^4(theta)`` for a pinhole."""
    return _foreshortened_solid_angle(camera) * camera.fx * camera.fy


def pixel_power_w(radiance: FloatArray, etendue_m2_sr: FloatArray, transmission: float) -> FloatArray:
    """Return the power on each pixel [W] from the band radiance [W m-2 sr-1], shape (H, W)."""
    return transmission * radiance * etendue_m2_sr


def _foreshortened_solid_angle(camera: Camera) -> FloatArray:
    if camera.projection == "fisheye":
        return pixel_solid_angle(camera)
    # Beyond 90 deg off axis a flat pupil is not seen at all.
    return np.maximum(np.cos(off_axis_angle(camera)), 0.0) * pixel_solid_angle(camera)
