"""Sunlight from outside the image that reaches the detector, and ghosts.

**Stray light.** A camera with its baffle has a point-source transmittance against the angle between Sun and boresight::

    PST(theta) = irradiance on the detector / irradiance across the Sun's rays at the aperture
    E_detector = PST(theta) E_sun (share of the disc in view and outside the image)

(E. Fest, *Stray Light Analysis and Control*, SPIE 2013; the lens's transmission is in it.) It holds in the middle of
the image. What the wings of the lens do not explain of it is even over the detector: it was scattered by baffle and
barrel (:mod:`horizonval.sensor.lens.image_plane`). The logarithm of the table is linear in the angle. While the Sun's
disc crosses the border of the image, the part inside is rendered and the part outside uses this table.

Neglected: attenuation of the sunlight by the Earth's air; the part of the disc behind the Earth is taken as evenly
spread over the parts inside and outside the image; stray light of Earth and Moon outside the image.

**Ghosts** are images by two reflections in the lens, scaled about the principal point c and then blurred::

    ghost(p) = ratio / scale^2 * image(c + (p - c) / scale)

Every pixel is evenly lit, and its light is shared among the pixels that its scaled square covers, so that the ghost of
what stays in the image holds exactly ``ratio`` times its light. The light is added: what reflections take from the
image is in the lens's measured transmission. Neglected: change over the field, and ghosts of what is outside the image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands, sunlight
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import GOLDEN_ANGLE_RAD, perpendicular
from horizonval.spec.camera import Band
from horizonval.spec.optics import Ghost, Stray

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
    """Return the Sun of a truth, less the share of its disc behind parts of the spacecraft."""
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
    """Return the share of the Sun's disc outside the image, to 0.3 %, and the unit vector to the middle of it."""
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


_CUT_SIGMA = 5.0


def ghost_image(image: FloatArray, camera: CameraModel, ghost: Ghost) -> FloatArray:
    """Return what the ghost adds to the image, shape (H, W)."""
    rows = _axis_map(camera.height, camera.cy, ghost.scale)
    columns = _axis_map(camera.width, camera.cx, ghost.scale)
    out = np.asarray((columns @ (rows @ image).T).T) * ghost.ratio
    if ghost.blur_px > 0:
        out = gaussian_filter(out, ghost.blur_px, mode="constant", truncate=_CUT_SIGMA)
    return out


def _axis_map(size: int, centre: float, scale: float) -> csr_array:
    """Return the matrix that moves light along one axis to the ghost; columns sum to 1 or less."""
    source = np.arange(size)
    ends = centre + (np.stack([source - 0.5, source + 0.5]) - centre) * scale
    low, high = ends.min(axis=0), ends.max(axis=0)
    first = np.floor(low + 0.5).astype(np.intp)
    entries = []
    for step in range(int(np.ceil(abs(scale))) + 1):
        target = first + step
        overlap = np.minimum(high, target + 0.5) - np.maximum(low, target - 0.5)
        good = (overlap > 0) & (target >= 0) & (target < size)
        entries.append((overlap[good] / abs(scale), target[good], source[good]))
    values, to, origin = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return csr_array((values, (to, origin)), shape=(size, size))
