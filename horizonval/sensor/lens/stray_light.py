"""Sunlight from outside the image that finds its way to the detector.

A camera with its baffle is described by its point-source transmittance against the angle between Sun and boresight::

    PST(theta) = irradiance on the detector / irradiance across the Sun's rays at the aperture
    E_detector = PST(theta) E_sun (share of the disc in view and outside the image)

(E. Fest, *Stray Light Analysis and Control*, SPIE 2013; the lens's transmission is in it.) It holds in the middle of
the image. What the wings of the lens do not explain of it is taken as even over the detector: it has been scattered
from baffle and barrel, far from any image (:mod:`horizonval.sensor.lens.image_plane`). The logarithm of the table is
linear in the angle.

While the Sun's disc crosses the border of the image, the part inside is rendered and scattered by the lens, and the
part outside goes through this table.

Neglected: sunlight on its way through the Earth's air keeps its full strength as long as the disc is seen past the
solid Earth; the share of the disc behind the Earth is taken as evenly spread over the parts inside and outside the
image; stray light of the Earth and the Moon outside the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands, sunlight
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.directions import GOLDEN_ANGLE_RAD, perpendicular
from horizonval.spec.camera import Band
from horizonval.spec.optics import Stray

_DISC_POINTS = 2048


@dataclass(frozen=True)
class Sun:
    """The Sun as a camera sees it: unit vector in camera axes, angular radius, share of the disc past the Earth."""

    direction_cam: tuple[float, float, float]
    angular_radius_rad: float
    visible_fraction: float

    @property
    def off_axis_rad(self) -> float:
        """Angle between the Sun's centre and the boresight."""
        x, y, z = self.direction_cam
        return math.atan2(math.hypot(x, y), z)


def sun_of(truth: FrameTruth) -> Sun:
    """Return the Sun's irradiance across its rays [W m-2], weighted by the band's response."""
    before_parts = 1.0 - truth.parts["hidden_sun"] if truth.parts else 1.0
    return Sun(truth.sun_cam, truth.sun_angular_radius_rad, truth.sun_visible_fraction * before_parts)


def band_irradiance(band: Band, angular_radius_rad: float) -> float:
    """Return the Sun's irradiance across its rays [W m-2], weighted by the band's response."""
    wavelength, weight = bands.sampled(band, sunlight.table_um())
    inside = (wavelength >= sunlight.MIN_UM) & (wavelength <= sunlight.MAX_UM)
    wavelength, weight = wavelength[inside], weight[inside]
    if band.kind == "solar":
        weight = weight * wavelength / bands.reference_wavelength_um(band)
    distance_au = sunlight.SOLAR_RADIUS_M / (math.sin(angular_radius_rad) * sunlight.ASTRONOMICAL_UNIT_M)
    return float(np.sum(weight * sunlight.irradiance(wavelength, distance_au)))


def outside_image(camera: CameraModel, sun: Sun) -> tuple[float, FloatArray]:
    """Return the share of the Sun's disc outside the image, and the unit vector to the middle of that share.

    Counted on 2048 points of equal area: to 0.3 % of the disc.
    """
    # Points of a sunflower: the square root makes areas equal, the golden angle spreads them.
    index = np.arange(_DISC_POINTS) + 0.5
    radius = np.sqrt(index / _DISC_POINTS) * math.tan(sun.angular_radius_rad)
    turn = index * GOLDEN_ANGLE_RAD
    centre = np.array(sun.direction_cam)
    side = perpendicular(centre)
    points = (
        centre + (radius * np.cos(turn))[:, None] * side + (radius * np.sin(turn))[:, None] * np.cross(centre, side)
    )
    uv, has_image = project(camera, points)
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        inside = has_image & ((uv >= -0.5) & (uv <= size - 0.5)).all(axis=-1)
    if inside.all():
        return 0.0, centre
    middle = points[~inside].mean(axis=0)
    return float(np.mean(~inside)), middle / np.linalg.norm(middle)


def transmittance(stray: Stray, off_axis_rad: float) -> float:
    """Return the point-source transmittance at an angle from the boresight."""
    angle_deg = math.degrees(off_axis_rad)
    if angle_deg >= stray.cutoff_deg:
        return 0.0
    return float(np.exp(np.interp(angle_deg, stray.angle_deg, np.log(stray.pst))))


def detector_irradiance(stray: Stray, camera: CameraModel, band: Band, sun: Sun) -> float:
    """Return the stray light's irradiance in the middle of the detector [W m-2]."""
    share, _ = outside_image(camera, sun)
    arriving = band_irradiance(band, sun.angular_radius_rad) * sun.visible_fraction * share
    return transmittance(stray, sun.off_axis_rad) * arriving
