"""How well the camera that an estimator is told is known: standard deviations, each of them 0 where it is exact.

The camera itself stands in the observation as it is told. What a sigma says of the mounting and of the time is in the
prior's sigmas of attitude and position as well, which are those of what a platform would say of itself.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Calibration:
    """Standard deviations of the errors of a camera's calibration.

    Attributes
    ----------
    focal_length_sigma : float
        Of both focal lengths together, as a share of them.
    principal_point_sigma_px : float
        Of column and row.
    distortion_sigma_px : float
        Of the radial distortion, as it moves the image's farthest corner.
    mounting_sigma_rad : tuple of 3 floats
        Of a turn about the body's x, y and z.
    exposure_offset_sigma_s, clock_sigma_s : float
        Of the time by which an image is later than its stamp, and of the clock.
    """

    focal_length_sigma: float = 0.0
    principal_point_sigma_px: float = 0.0
    distortion_sigma_px: float = 0.0
    mounting_sigma_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exposure_offset_sigma_s: float = 0.0
    clock_sigma_s: float = 0.0
