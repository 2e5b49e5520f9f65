"""The ``[camera]`` table of camera files: image size, projection and scale."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Finite, Positive
from horizonval.spec.sensor import fisheye
from horizonval.spec.units import unit

Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Of a distortion; those of real lenses are some thousand at most, where a long lens has the image's edge near 0.01."""


class CameraGeometry(Model):
    """Image size, projection and scale.

    The scale is given by `fov_deg` or `fx`, or by neither where `focal_length_mm` and the detector's pixel pitch say
    it.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"focal_length_mm", "image_circle_deg"})

    name: str = ""
    """Name of the camera; noise and fixed patterns are drawn from it."""
    source: str = ""
    """Where the figures come from, in words."""
    width: Annotated[int, Field(ge=1, le=16384), unit("px")]
    """Columns of the image."""
    height: Annotated[int, Field(ge=1, le=16384), unit("px")]
    """Rows of the image."""
    fov_deg: Annotated[float, Field(gt=0, lt=360)] | None = None
    """Horizontal full angle between the outer edges of the first and last column of a centred image: below 180 for a
    pinhole (its distortion left out), below 360 for the others.
    """
    fx: Annotated[Positive, unit("px")] | None = None
    """Focal length along the rows, in pixels; per radian for `equal_angle`."""
    fy: Annotated[Positive, unit("px")] | None = None
    """Focal length along the columns; without the key as `fx`."""
    cx: Annotated[Finite, unit("px")] | None = None
    """Column of the principal point, 0 at the centre of the first column; without the key `(width - 1) / 2`."""
    cy: Annotated[Finite, unit("px")] | None = None
    """Row of the principal point, 0 at the centre of the first row; without the key `(height - 1) / 2`."""
    distortion: Annotated[list[Coefficient], Field(max_length=5), unit("1")] = []
    """Coefficients: `k1 k2 p1 p2 k3` of a pinhole (OpenCV's Brown-Conrady), `k1 k2 k3 k4` of a fisheye (OpenCV's; none
    of them is an f-theta lens).
    """
    projection: Literal["pinhole", "fisheye", "equal_angle"] = "pinhole"
    """How directions become pixels. `equal_angle` is the fixed grid of geostationary imagers."""
    image_circle_deg: Annotated[float, Field(gt=0, lt=360)] | None = None
    """Full angle of the field that the lens fills. Pixels whose centre lies beyond it see nothing; without the key
    every pixel must see something.
    """
    focal_length_mm: Positive | None = None
    """Focal length of the lens. With `detector.pixel_pitch_um` it gives `fx`, and may not contradict it."""

    @model_validator(mode="after")
    def _one_scale(self) -> CameraGeometry:
        both = self.fov_deg is not None and self.fx is not None
        neither = self.fov_deg is None and self.fx is None
        if both or (neither and self.focal_length_mm is None):
            raise ValueError(f"give exactly one of fov_deg and fx, got fov_deg = {self.fov_deg} and fx = {self.fx}")
        return self

    @model_validator(mode="after")
    def _fits_the_projection(self) -> CameraGeometry:
        if self.projection == "equal_angle" and any(self.distortion):
            raise ValueError('distortion applies to projection = "pinhole" and "fisheye" only')
        if self.projection == "fisheye" and len(self.distortion) > 4:
            raise ValueError(
                f'distortion has {len(self.distortion)} numbers, but projection = "fisheye" takes k1 k2 k3 k4'
            )
        if self.projection == "pinhole":
            for key in ("fov_deg", "image_circle_deg"):
                value = getattr(self, key)
                if value is not None and value >= 180.0:
                    raise ValueError(
                        f'{key} = {value:g}, but projection = "pinhole" sees less than 180; wider is "fisheye"'
                    )
        return self

    @model_validator(mode="after")
    def _the_fisheye_turns_back_outside_its_field(self) -> CameraGeometry:
        if self.projection != "fisheye":
            return self
        limit_deg = 2.0 * math.degrees(fisheye.turning_angle(self.fisheye_coefficients))
        for key in ("fov_deg", "image_circle_deg"):
            value = getattr(self, key)
            if value is not None and value > limit_deg:
                raise ValueError(
                    f"{key} = {value:g}, but the lens with distortion = {self.distortion} folds back at a full angle "
                    f"of {limit_deg:.4g} deg; check the coefficients' order and sign"
                )
        return self

    @model_validator(mode="after")
    def _the_axis_is_near_the_image(self) -> CameraGeometry:
        for key, size, side in (("cx", "width", self.width), ("cy", "height", self.height)):
            value = getattr(self, key)
            if value is not None and not -side <= value <= 2 * side:
                raise ValueError(
                    f"{key} = {value:g} lies more than a whole image away from the image, which has {size} = {side}"
                )
        return self

    @property
    def fisheye_coefficients(self) -> tuple[float, float, float, float]:
        """``k1 k2 k3 k4`` with the missing ones 0."""
        k = [*self.distortion, 0.0, 0.0, 0.0, 0.0]
        return k[0], k[1], k[2], k[3]

    @property
    def focal_px(self) -> float:
        """Focal length in pixels (per radian on the axis): ``fx``, or what ``fov_deg`` makes it."""
        if self.fx is not None:
            return self.fx
        if self.fov_deg is None:
            raise ValueError("neither fx nor fov_deg: the focal length in mm needs the detector's pixel pitch")
        half = math.radians(self.fov_deg) / 2
        if self.projection == "pinhole":
            return self.width / 2 / math.tan(half)
        if self.projection == "fisheye":
            return self.width / 2 / float(fisheye.image_radius(half, self.fisheye_coefficients))
        return self.width / 2 / half
