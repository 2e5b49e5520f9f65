"""The ``[optics]`` table of camera files: what the lens does to the light.

Every key has a default that switches its stage off, except ``f_number`` and ``transmission``.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Finite, Fraction, Model, Positive, unit

FieldAngles = list[Annotated[float, Field(ge=0, le=180)]]
FNumber = Annotated[float, Field(ge=0.5, le=1000), unit("1")]
"""In air no lens is faster than f/0.5 (the sine condition)."""
Blur = Annotated[float, Field(ge=0, le=100)]
"""Standard deviation in pixels."""


class Scatter(Model):
    """Scatter of the whole lens, ``BSDF = b0 (1 + (x / l_rad)^2)^(s / 2)`` [1/sr] with ``x = |beta - beta0|``.

    Either ``b0`` or ``tis`` fixes the level.
    """

    b0: Annotated[Positive, unit("1/sr")] | None = None
    """Level of the BSDF towards the mirror direction."""
    tis: Annotated[float, Field(gt=0), unit("1")] | None = None
    """Share of the light that is scattered."""
    l_rad: Annotated[float, Field(gt=0, le=1), unit("1")]
    """Width of the core, in direction cosines."""
    s: Annotated[float, Field(ge=-4, lt=0), unit("1")]
    """Slope of the wings."""

    @model_validator(mode="after")
    def _below_one(self) -> Scatter:
        if (self.b0 is None) == (self.tis is None):
            raise ValueError(f"give exactly one of b0 and tis, got {'neither' if self.b0 is None else 'both'}")
        total = self.total
        if total >= 1:
            if self.tis is not None:
                raise ValueError(f"tis = {self.tis} must be below 1, the light there is")
            raise ValueError(
                f"b0 = {self.b0} with l_rad = {self.l_rad} and s = {self.s} scatters {total:.4g} of the light, "
                "must be below 1"
            )
        return self

    @property
    def total(self) -> float:
        """Total integrated scatter, over the unit disc of direction cosines."""
        if self.tis is not None:
            return self.tis
        assert self.b0 is not None
        return self.b0 * scatter_integral(self.l_rad, self.s, 1.0)

    @property
    def level(self) -> float:
        """``b0`` [1/sr], given or from ``tis``."""
        if self.b0 is not None:
            return self.b0
        assert self.tis is not None
        return self.tis / scatter_integral(self.l_rad, self.s, 1.0)


def scatter_integral(l_rad: float, s: float, x: float) -> float:
    """Return the integral of ``(1 + (x / l)^2)^(s / 2)`` over the disc up to ``x`` in direction cosines."""
    grown = math.log1p((x / l_rad) ** 2)
    power = s / 2 + 1
    return math.pi * l_rad**2 * (grown if power == 0 else math.expm1(power * grown) / power)


class Stray(Model):
    """Point-source transmittance of the camera with its baffle against the angle between the Sun and the boresight.

    Irradiance in the middle of the image over that across the Sun's rays at the aperture; with the transmission. Its
    logarithm is linear in the angle between entries; the first and the last entry hold outside the table, but from
    ``cutoff_deg`` on the baffle lets nothing through.
    """

    angle_deg: Annotated[FieldAngles, Field(min_length=1)]
    """Angles between the Sun and the boresight, rising."""
    pst: Annotated[list[Positive], Field(min_length=1), unit("1")]
    """Point-source transmittance at these angles."""
    cutoff_deg: Annotated[float, Field(gt=0, le=180)] = 180.0
    """Angle from which nothing comes in."""

    @model_validator(mode="after")
    def _table(self) -> Stray:
        _check_table("angle_deg", self.angle_deg, "pst", self.pst)
        for angle, pst in zip(self.angle_deg, self.pst, strict=True):
            if pst > 1:
                raise ValueError(f"pst = {pst} at angle_deg = {angle} must not be above 1")
        if self.angle_deg[-1] > self.cutoff_deg:
            raise ValueError(
                f"angle_deg ends at {self.angle_deg[-1]}, beyond cutoff_deg = {self.cutoff_deg} where nothing comes in"
            )
        return self


class Ghost(Model):
    """One image of the scene by two reflections inside the lens."""

    ratio: Annotated[float, Field(gt=0, lt=1), unit("1")]
    """Its light over the scene's."""
    scale: Annotated[Finite, unit("1")] = -1.0
    """Its size and sense about the principal point, 0.01 to 100 in size; -1 is mirrored through it."""
    blur_px: Blur = 0.0
    """Standard deviation of its Gaussian blur."""

    @model_validator(mode="after")
    def _some_size(self) -> Ghost:
        if not 0.01 <= abs(self.scale) <= 100:
            raise ValueError(f"scale = {self.scale} must be between 0.01 and 100 in size")
        return self


class Optics(Model):
    """The lens. Every key has a default that switches its stage off, except `f_number` and `transmission`."""

    later_keys: ClassVar[frozenset[str]] = frozenset(
        {
            "aperture_mm",
            "pupil",
            "vignetting_deg",
            "vignetting",
            "psf_field_deg",
            "psf_field_sigma_px",
            "diffraction",
            "defocus_um",
            "scatter",
            "stray",
            "ghost",
        }
    )

    f_number: FNumber = 2.8
    """Focal length over the diameter of the entrance pupil."""
    transmission: Annotated[float, Field(gt=0, le=1), unit("1")] = 1.0
    """Share of the light that comes through."""
    psf_sigma_px: Blur = 0.0
    """Standard deviation of the Gaussian point spread, pixel integration not included."""
    aperture_mm: Positive | None = None
    """Diameter of the entrance pupil, only to check `f_number` and the focal length against it."""
    pupil: Literal["flat", "constant"] | None = None
    """How much of the entrance pupil is seen from off the axis: `flat` as the cosine, `constant` as in fisheye lenses;
    without the key as the projection.
    """
    vignetting_deg: FieldAngles = []
    """Field angles of `vignetting`, rising."""
    vignetting: list[Fraction] = []
    """Illumination at these field angles, beyond the law of the pupil."""
    psf_field_deg: FieldAngles = []
    """Field angles of `psf_field_sigma_px`, rising."""
    psf_field_sigma_px: list[Blur] = []
    """Standard deviation of the point spread at these field angles, in place of `psf_sigma_px`."""
    diffraction: bool = False
    """Whether the aperture diffracts, by the f-number and the band."""
    defocus_um: Finite = 0.0
    """Distance of the detector from the focus, along the axis."""
    scatter: Scatter | None = None
    """Scatter; none without this table."""
    stray: Stray | None = None
    """Sunlight from outside the field; none without this table."""
    ghost: list[Ghost] = []
    """Ghost images."""

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Optics:
        _check_table("vignetting_deg", self.vignetting_deg, "vignetting", self.vignetting)
        _check_table("psf_field_deg", self.psf_field_deg, "psf_field_sigma_px", self.psf_field_sigma_px)
        if self.psf_field_sigma_px and self.psf_sigma_px:
            raise ValueError(
                f"psf_field_sigma_px = {self.psf_field_sigma_px} stands in place of psf_sigma_px = "
                f"{self.psf_sigma_px}: give one of them"
            )
        ghosts = sum(ghost.ratio for ghost in self.ghost)
        if ghosts >= 1:
            raise ValueError(f"the ghosts' ratio add up to {ghosts:.4g}, must be below 1")
        return self


def _check_table(x_name: str, x: list[float], y_name: str, y: list[float]) -> None:
    if len(x) != len(y):
        raise ValueError(f"{x_name} has {len(x)} values, {y_name} has {len(y)}: must be equal")
    for before, after in pairwise(x):
        if after <= before:
            raise ValueError(f"{x_name} must rise, got {before} before {after}")
