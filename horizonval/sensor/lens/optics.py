"""The lens as a light collector: scene radiance to power on each pixel.

A pixel sees the solid angle Omega of the scene through the entrance pupil of area A, foreshortened by the angle theta
to the axis::

    P = tau L A cos(theta) Omega,      A = pi (f / N)^2 / 4,      f = fx * pitch

For a pinhole ``Omega = cos^3(theta) / (fx fy)``, which makes the cosine-fourth law ``P = pi tau L pitch^2 cos^4(theta)
/ (4 N^2)``; on the axis that is exact for a lens that obeys Abbe's sine condition, at any f-number. Distortion changes
Omega, and so is carried by it. (Boyd, *Radiometry and the Detection of Optical Radiation*, 1983, chapter 6.)

A fisheye's front group tilts and swells the pupil towards the field, else it would not see past 90 deg: its
A cos(theta) is taken as A (``pupil = "constant"``, its default), and an f-theta lens, ``Omega = sin(theta) / (theta fx
fy)``, loses 36 % at 90 deg. Any other lens has a flat pupil if the camera file does not say.
Whatever the law leaves out (vignetting by the barrel, pupil aberration) is a factor ``V(theta)`` from the camera file,
linear between its entries and constant beyond the last.

Neglected: the colour of the transmission, which belongs into the band's response.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, field_angles, pixel_solid_angle
from horizonval.spec.optics import Optics


def pupil_area_m2(focal_length_m: float, f_number: float) -> float:
    """Return the area of the entrance pupil [m2]."""
    return math.pi / 4 * (focal_length_m / f_number) ** 2


def etendue(camera: CameraModel, pixel_pitch_m: float, lens: Optics) -> FloatArray:
    """Return every pixel's etendue ``A cos(theta) Omega V`` [m2 sr], shape (H, W); 0 where the lens gives no light."""
    area = pupil_area_m2(camera.fx * pixel_pitch_m, lens.f_number)
    return area * _foreshortened_solid_angle(camera, lens)


def relative_illumination(camera: CameraModel, lens: Optics) -> FloatArray:
    """Return the etendue relative to the axis, shape (H, W): ``cos^4(theta)`` for a pinhole without vignetting."""
    return _foreshortened_solid_angle(camera, lens) * camera.fx * camera.fy


def pixel_power_w(radiance: FloatArray, etendue_m2_sr: FloatArray, transmission: float) -> FloatArray:
    """Return the power on each pixel [W] from the band radiance [W m-2 sr-1], shape (H, W)."""
    return transmission * radiance * etendue_m2_sr


def pupil_share(camera: CameraModel, lens: Optics, off_axis_rad: FloatArray) -> FloatArray:
    """Return what the pupil shows of its area towards a direction, vignetting included: ``cos(theta) V(theta)``."""
    return _pupil_share(off_axis_rad, *_pupil(camera, lens))


def _pupil(camera: CameraModel, lens: Optics) -> tuple[str, tuple[float, ...], tuple[float, ...]]:
    """Return what a pupil's share depends on: its kind, and the table of the vignetting."""
    kind = lens.pupil or ("constant" if camera.wide else "flat")
    return kind, tuple(lens.vignetting_deg), tuple(lens.vignetting)


def _pupil_share(
    off_axis_rad: FloatArray, kind: str, vignetting_deg: tuple[float, ...], vignetting: tuple[float, ...]
) -> FloatArray:
    # Beyond 90 deg off axis a flat pupil is not seen at all.
    share = np.maximum(np.cos(off_axis_rad), 0.0) if kind == "flat" else np.ones_like(off_axis_rad)
    if not vignetting:
        return share
    return share * np.interp(np.degrees(off_axis_rad), vignetting_deg, vignetting)


def _foreshortened_solid_angle(camera: CameraModel, lens: Optics) -> FloatArray:
    return _solid_angle_through(camera, *_pupil(camera, lens))


@lru_cache(maxsize=4)
def _solid_angle_through(
    camera: CameraModel, kind: str, vignetting_deg: tuple[float, ...], vignetting: tuple[float, ...]
) -> FloatArray:
    """Return every pixel's solid angle through a pupil, read-only: a camera keeps it for life."""
    share = _pupil_share(field_angles(camera), kind, vignetting_deg, vignetting)
    foreshortened = share * pixel_solid_angle(camera)
    # Pixels outside the image circle have no direction.
    foreshortened = np.where(np.isnan(foreshortened), 0.0, foreshortened)
    foreshortened.flags.writeable = False
    return foreshortened
