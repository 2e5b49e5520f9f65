"""Camera files: image size, projection and scale, bands, heads; what lens and detector have to agree with.

A fisheye images the angle ``theta`` from the boresight, with coefficients ``k1 k2 k3 k4`` (OpenCV's model; J. Kannala
and S. S. Brandt, IEEE Trans. Pattern Analysis and Machine Intelligence 28, 1335, 2006, equation 6), at the distance ::

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)     in focal lengths

from the principal point. The curve is followed up to where it turns back, and never beyond half a turn.

The unified projection holds the omnidirectional camera (C. Mei and P. Rives, ICRA 2007, with ``xi``), the double sphere
(V. Usenko et al., 3DV 2018, with ``xi`` and ``alpha``) and the extended unified camera (B. Khomutenko et al., IEEE
Robotics and Automation Letters 1, 137, 2016, with ``alpha`` and ``beta``). Of a unit vector ``(X, Y, Z)``::

    W = xi + Z,   D = alpha sqrt(beta (X^2 + Y^2) + W^2) + (1 - alpha) W,   x = X / D,   y = Y / D

followed by the pinhole's distortion. It is followed up to where the image's radius turns back, or D reaches 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.spec.base import Angle, Finite, Fraction, Model, NonNegative, PlainName, Positive, unit
from horizonval.spec.detector import Cmos, Detector, ThermalDetector
from horizonval.spec.optics import Optics

LARGEST_SIDE_PX = 16384
"""Largest number of columns and of rows of an image."""
FARTHEST_TANGENT = 6.0
"""Distance of a pinhole's image from its optical axis, in focal lengths: 80 deg off axis."""


def image_radius(theta_rad: ArrayLike, k: Sequence[float]) -> FloatArray:
    """Return ``theta_d``, in focal lengths, of off-axis angles."""
    theta = np.asarray(theta_rad, float)
    t2 = theta * theta
    k1, k2, k3, k4 = k
    return np.asarray(theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


def image_radius_slope(theta_rad: ArrayLike, k: Sequence[float]) -> FloatArray:
    """Return ``d theta_d / d theta``."""
    t2 = np.asarray(theta_rad, float) ** 2
    k1, k2, k3, k4 = k
    return np.asarray(1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4))))


def turning_angle(k: Sequence[float]) -> float:
    """Return the angle [rad], at most pi, up to which ``theta_d`` grows: every smaller one has an image of its own."""
    k1, k2, k3, k4 = k
    roots = np.roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])
    # A double zero can hide as a slightly complex pair; there the curve stands still.
    squares = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)]
    return min(math.pi, math.sqrt(float(squares.min()))) if squares.size else math.pi


Projection = Literal["pinhole", "fisheye", "unified", "equal_angle"]

WIDE = ("fisheye", "unified")
"""Projections of lenses that may see 90 deg off the boresight and more."""
SHAPE = {"xi": 0.0, "alpha": 0.0, "beta": 1.0}
"""Keys of the unified projection with their defaults, which make a pinhole of it."""
_ANGLES = 4097


def unified_radius(theta_rad: ArrayLike, shape: Sequence[float]) -> FloatArray:
    """Return the distance from the principal point [focal lengths] of off-axis angles; shape: ``xi alpha beta``."""
    xi, alpha, beta = shape
    theta = np.asarray(theta_rad, float)
    s, w = np.sin(theta), xi + np.cos(theta)
    return np.asarray(s / (alpha * np.sqrt(beta * s * s + w * w) + (1.0 - alpha) * w))


@lru_cache(maxsize=256)
def unified_turning_angle(shape: tuple[float, float, float]) -> float:
    """Return the angle [rad], at most pi, up to which the image's radius grows: smaller ones have their own image."""
    xi, alpha, beta = shape

    def grows(theta: FloatArray) -> Any:
        s, c = np.sin(theta), np.cos(theta)
        w = xi + c
        root = np.sqrt(beta * s * s + w * w)
        d = alpha * root + (1.0 - alpha) * w
        slope = alpha * s * (beta * c - w) / np.maximum(root, 1e-300) - (1.0 - alpha) * s
        return (d > 0.0) & (c * d - s * slope > 0.0)

    theta = np.linspace(0.0, math.pi, _ANGLES)
    bad = np.flatnonzero(~grows(theta))
    if not bad.size:
        return math.pi
    if bad[0] == 0:
        return 0.0
    low, high = float(theta[bad[0] - 1]), float(theta[bad[0]])
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if grows(np.asarray(middle)) else (low, middle)
    return low


Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Of a distortion; those of real lenses are some thousand at most, where a long lens has the image's edge near 0.01."""


class CameraUncertainty(Model):
    """Standard deviations of a camera's calibration, which add to what methods claim.

    Without the table a picture of another program has these defaults, those of a careful calibration with a target. The
    camera of a scene is exact without the table; with it, these are the scene's `[calibration]` sigmas, unless the
    scene states others.
    """

    focal_length_sigma_percent: Annotated[float, Field(ge=0, le=20)] = 0.05
    """Of both focal lengths, of a fisheye of its scale."""
    principal_point_sigma_px: NonNegative = 0.2
    """Of the principal point's column and row, each."""
    distortion_sigma_px: NonNegative = 0.1
    """Of the radial distortion at the image's farthest corner, as a change of `k1`. `equal_angle` has none."""


class CameraGeometry(Model):
    """Image size, projection and scale.

    The scale is given by `fov_deg` or `fx`, or by neither where `focal_length_mm` and the detector's pixel pitch say
    it.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset(
        {"focal_length_mm", "image_circle_deg", "skew", "uncertainty", *SHAPE}
    )

    name: str = ""
    """Name of the camera; noise and fixed patterns are drawn from it."""
    source: str = ""
    """Where the figures come from, in words."""
    width: Annotated[int, Field(ge=1, le=LARGEST_SIDE_PX), unit("px")]
    """Columns of the image."""
    height: Annotated[int, Field(ge=1, le=LARGEST_SIDE_PX), unit("px")]
    """Rows of the image."""
    fov_deg: Annotated[float, Field(gt=0, lt=360)] | None = None
    """Horizontal full angle between the outer edges of the first and last column of a centred image: below 180 for a
    pinhole (its distortion left out), below 360 for the others.
    """
    fx: Annotated[Positive, unit("px")] | None = None
    """Focal length along the rows, in pixels; per radian for `equal_angle`. For `unified` as OpenCV and Kalibr write
    it: 1 + `xi` times the pixels per radian on the axis.
    """
    fy: Annotated[Positive, unit("px")] | None = None
    """Focal length along the columns; without the key as `fx`."""
    cx: Annotated[Finite, unit("px")] | None = None
    """Column of the principal point, 0 at the centre of the first column; without the key `(width - 1) / 2`. It may
    lie outside the image, as of a window or a strip.
    """
    cy: Annotated[Finite, unit("px")] | None = None
    """Row of the principal point, 0 at the centre of the first row; without the key `(height - 1) / 2`."""
    skew: Annotated[float, Field(ge=-1, le=1), unit("1")] = 0.0
    """Skew of the pixel axes: the column is `fx (x + skew y) + cx`. OpenCV's fisheye calls it alpha; it is the second
    number of a camera matrix over the first.
    """
    distortion: Annotated[list[Coefficient], Field(max_length=12), unit("1")] = []
    """Coefficients: `k1 k2 p1 p2 k3` of a pinhole or unified lens (OpenCV's Brown-Conrady), which may continue with
    `k4 k5 k6` (rational) and `s1 s2 s3 s4` (thin prism); `k1 k2 k3 k4` of a fisheye (OpenCV's; none of them is an
    f-theta lens).
    """
    projection: Projection = "pinhole"
    """How directions become pixels. `unified` is the omnidirectional, double-sphere and extended unified camera, by
    `xi`, `alpha` and `beta`; `equal_angle` is the fixed grid of geostationary imagers.
    """
    xi: Annotated[float, Field(gt=-1, le=100), unit("1")] = 0.0
    """Shift of the centre of a `unified` projection: the only one of its numbers for an omnidirectional camera."""
    alpha: Fraction = 0.0
    """Second number of a `unified` projection, for a double sphere."""
    beta: Annotated[float, Field(gt=0, le=100), unit("1")] = 1.0
    """Third number of a `unified` projection, with `alpha` for an extended unified camera."""
    image_circle_deg: Annotated[float, Field(gt=0, lt=360)] | None = None
    """Full angle of the field that the lens fills. Pixels whose centre lies beyond it see nothing; without the key
    every pixel must see something.
    """
    focal_length_mm: Positive | None = None
    """Focal length of the lens. With `detector.pixel_pitch_um` it gives `fx`, and may not contradict it."""
    uncertainty: CameraUncertainty | None = None
    """How well the calibration is known."""

    @model_validator(mode="after")
    def _one_scale(self) -> CameraGeometry:
        both = self.fov_deg is not None and self.fx is not None
        neither = self.fov_deg is None and self.fx is None
        if both or (neither and self.focal_length_mm is None):
            raise ValueError(f"give exactly one of fov_deg and fx, got {'neither' if self.fx is None else 'both'}")
        return self

    @model_validator(mode="after")
    def _fits_the_projection(self) -> CameraGeometry:
        if self.projection == "equal_angle" and any(self.distortion):
            raise ValueError('distortion applies to projection = "pinhole", "fisheye" and "unified" only')
        if self.projection == "equal_angle" and self.skew:
            raise ValueError('skew does not apply to projection = "equal_angle"')
        for key, default in SHAPE.items():
            if self.projection != "unified" and getattr(self, key) != default:
                raise ValueError(f'{key} applies to projection = "unified" only, found "{self.projection}"')
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
    def _the_lens_turns_back_outside_its_field(self) -> CameraGeometry:
        if self.projection == "fisheye":
            limit_deg = 2.0 * math.degrees(turning_angle(self.fisheye_coefficients))
            lens = f"distortion = {self.distortion}"
        elif self.projection == "unified":
            limit_deg = 2.0 * math.degrees(unified_turning_angle(self.shape))
            lens = ", ".join(f"{key} = {value:g}" for key, value in zip(SHAPE, self.shape, strict=True))
        else:
            return self
        for key in ("fov_deg", "image_circle_deg"):
            value = getattr(self, key)
            if value is not None and value > limit_deg:
                raise ValueError(
                    f"{key} = {value:g}, but the lens with {lens} folds back at a full angle "
                    f"of {limit_deg:.4g} deg; check the coefficients' order and sign"
                )
        return self

    @model_validator(mode="after")
    def _the_image_is_near_the_axis(self) -> CameraGeometry:
        """An image may be a window or a strip far from the axis of its lens, but not where no lens has a field."""
        focal_px = self.focal_px if self.fx is not None or self.fov_deg is not None else math.inf
        by_angle = self.projection in ("fisheye", "equal_angle")
        farthest_px = min(LARGEST_SIDE_PX, focal_px * (math.pi if by_angle else FARTHEST_TANGENT))
        for key, size, side in (("cx", "width", self.width), ("cy", "height", self.height)):
            value = getattr(self, key)
            if value is not None and not -farthest_px <= value <= side + farthest_px:
                raise ValueError(
                    f"{key} = {value:g} puts the optical axis more than {farthest_px:.0f} pixels outside the image, "
                    f"which has {size} = {side}"
                )
        return self

    @property
    def fisheye_coefficients(self) -> tuple[float, float, float, float]:
        """``k1 k2 k3 k4`` with the missing ones 0."""
        k = [*self.distortion, 0.0, 0.0, 0.0, 0.0]
        return k[0], k[1], k[2], k[3]

    @property
    def shape(self) -> tuple[float, float, float]:
        """``xi alpha beta`` of a unified projection."""
        return self.xi, self.alpha, self.beta

    @property
    def focal_px(self) -> float:
        """Focal length in pixels (per radian on the axis): from ``fx``, or what ``fov_deg`` makes it."""
        if self.fx is not None:
            return self.fx / (1.0 + self.xi) if self.xi else self.fx
        if self.fov_deg is None:
            raise ValueError("neither fx nor fov_deg: the focal length in mm needs the detector's pixel pitch")
        half = math.radians(self.fov_deg) / 2
        if self.projection == "pinhole":
            return self.width / 2 / math.tan(half)
        if self.projection == "fisheye":
            return self.width / 2 / float(image_radius(half, self.fisheye_coefficients))
        if self.projection == "unified":
            return self.width / 2 / float(unified_radius(half, self.shape)) / (1.0 + self.xi)
        return self.width / 2 / half


ALL_HEADS = "all"
"""In place of a head's name: every head, one frame each."""
FOCAL_LENGTH_TOLERANCE = 0.01
"""Data sheets round focal lengths and fields of view to two digits and a half."""
F_NUMBER_TOLERANCE = 0.03
"""F-numbers are named after whole stops: f/5.6 is 5.66."""


class PlatformPrior(Model):
    """What is known of every platform that carries the camera; a prior, never the truth."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"altitude_sigma_km"})

    altitude_km: Positive | None = None
    """Height of the orbit above the ellipsoid. A prior with an altitude replaces it."""
    altitude_sigma_km: Positive | None = None
    """Standard deviation of its error."""

    @model_validator(mode="after")
    def _value_with_sigma(self) -> PlatformPrior:
        if (self.altitude_km is None) != (self.altitude_sigma_km is None):
            raise ValueError("give altitude_km and altitude_sigma_km, or neither")
        return self


class Band(Model):
    """One spectral band: a top hat (`lo_um`, `hi_um`) or a table (`wavelength_um`, `response`)."""

    name: PlainName
    """Name of the band; the camera's bands have different names."""
    kind: Literal["solar", "thermal"]
    """`solar`: scattered sunlight, the response is a quantum efficiency (electrons per photon). `thermal`: emission,
    the response is per unit power.
    """
    lo_um: Positive | None = None
    """Lower end of a top hat."""
    hi_um: Positive | None = None
    """Upper end of a top hat."""
    wavelength_um: list[Positive] = []
    """Wavelengths of the table, rising."""
    response: list[Fraction] = []
    """Relative response at these wavelengths; linear between them, zero outside, scaled to a peak of 1."""
    nodes: Annotated[int, Field(ge=1, le=64), unit("1")] | None = None
    """Wavelengths at which a solar band is computed; without the key the fewest that keep the scene's
    `render.band_error`.
    """

    @model_validator(mode="after")
    def _one_shape(self) -> Band:
        table = bool(self.wavelength_um or self.response)
        hat = self.lo_um is not None or self.hi_um is not None
        if table == hat:
            raise ValueError("give either lo_um and hi_um, or wavelength_um and response")
        if hat and (self.lo_um is None or self.hi_um is None or self.hi_um <= self.lo_um):
            raise ValueError("lo_um must be below hi_um")
        if table:
            if len(self.wavelength_um) != len(self.response) or len(self.response) < 2:
                raise ValueError("wavelength_um and response must have the same length, at least 2")
            if any(b <= a for a, b in zip(self.wavelength_um, self.wavelength_um[1:], strict=False)):
                raise ValueError("wavelength_um must rise")
            if max(self.response) <= 0:
                raise ValueError("response must be above 0 somewhere")
        return self


class Head(Model):
    """One of several equal cameras in a housing, and how it is turned in it.

    The angles turn the housing's axes into those of the head's camera: yaw about z, then pitch about y, then roll about
    x. The scene's `camera.mount_*` angles turn the satellite's body axes into those of the housing; they come first.
    """

    name: PlainName
    """Name of the head, anything but `all`."""
    mount_yaw_deg: Angle = 0.0
    """Yaw in the housing, about z."""
    mount_pitch_deg: Angle = 0.0
    """Pitch in the housing, about y."""
    mount_roll_deg: Angle = 0.0
    """Roll in the housing, about x."""

    @model_validator(mode="after")
    def _all_is_all_of_them(self) -> Head:
        if self.name == ALL_HEADS:
            raise ValueError(f'a head cannot be named "{ALL_HEADS}", which means every head')
        return self


class CameraSpec(Model):
    """One camera file. `horizonval estimate` needs only `[camera]`; rendering also `[[band]]`; observing also
    `[detector]`.

    A detector sees either solar or thermal bands. Without one, a camera may have both.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"head"})

    camera: CameraGeometry
    """Image size, projection and scale."""
    platform: PlatformPrior = PlatformPrior()
    """What is known of the platform."""
    optics: Optics = Optics()
    """The lens."""
    band: list[Band] = []
    """Spectral bands; rendering needs at least one."""
    head: list[Head] = []
    """Several cameras that differ in nothing but how they are turned; a scene chooses one with `camera.head`."""
    detector: Detector | None = None
    """What becomes of the light; its `kind` is `cmos`, `microbolometer`, `thermopile` or `linear`."""

    @model_validator(mode="after")
    def _consistent(self) -> CameraSpec:
        names = [b.name for b in self.band]
        if len(set(names)) != len(names):
            raise ValueError(f"band names must differ, got {names}")
        if isinstance(self.detector, ThermalDetector) and self.detector.netd_band not in (None, *names):
            raise ValueError(f"detector.netd_band = {self.detector.netd_band!r} is none of the bands {names}")
        if self.detector is not None and len({b.kind for b in self.band}) > 1:
            kinds = ", ".join(f"{b.name} ({b.kind})" for b in self.band)
            raise ValueError(f"one [detector] cannot see solar and thermal bands, got {kinds}; make two camera files")
        heads = [h.name for h in self.head]
        if len(set(heads)) != len(heads):
            raise ValueError(f"head names must differ, got {heads}")
        return self

    @model_validator(mode="after")
    def _mosaic_of_three_colours(self) -> CameraSpec:
        if not isinstance(self.detector, Cmos) or self.detector.bayer is None:
            return self
        names = [b.name for b in self.band]
        if names and sorted(name[0].lower() for name in names) != ["b", "g", "r"]:
            raise ValueError(
                f'detector.bayer = "{self.detector.bayer}" takes three bands whose names begin with r, g and b, '
                f"the camera has {names}"
            )
        size = self.camera.width, self.camera.height
        if min(size) < 2:
            raise ValueError(
                f'detector.bayer = "{self.detector.bayer}" needs 2 x 2 pixels at least, '
                f"the camera has width = {size[0]}, height = {size[1]}"
            )
        return self

    @model_validator(mode="after")
    def _one_focal_length(self) -> CameraSpec:
        geometry = self.camera
        if geometry.focal_length_mm is None:
            return self
        if self.detector is None:
            if geometry.fx is None and geometry.fov_deg is None:
                raise ValueError(
                    "camera.focal_length_mm alone gives no scale in pixels; add detector.pixel_pitch_um, or fov_deg"
                )
            return self
        pitch_um = self.detector.pixel_pitch_um
        from_lens = geometry.focal_length_mm * 1e3 / pitch_um
        if geometry.fx is None and geometry.fov_deg is None:
            # Frozen for everybody else: here the object is still being made.
            object.__setattr__(self, "camera", geometry.model_copy(update={"fx": from_lens * (1.0 + geometry.xi)}))
            return self
        stated = geometry.focal_px
        if abs(from_lens - stated) > FOCAL_LENGTH_TOLERANCE * stated:
            key = f"fx = {geometry.fx:g}" if geometry.fx is not None else f"fov_deg = {geometry.fov_deg:g}"
            raise ValueError(
                f"camera.{key} is a focal length of {stated * pitch_um * 1e-3:.4g} mm with detector.pixel_pitch_um = "
                f"{pitch_um:g}, but camera.focal_length_mm = {geometry.focal_length_mm:g}; mend one of the three"
            )
        return self

    @model_validator(mode="after")
    def _one_aperture(self) -> CameraSpec:
        aperture = self.optics.aperture_mm
        focal = self.camera.focal_length_mm
        if focal is None and self.detector is not None:
            focal = self.camera.focal_px * self.detector.pixel_pitch_um * 1e-3
        if aperture is None or focal is None:
            return self
        if abs(focal / aperture / self.optics.f_number - 1) > F_NUMBER_TOLERANCE:
            raise ValueError(
                f"optics.aperture_mm = {aperture:g} and a focal length of {focal:.4g} mm make "
                f"f/{focal / aperture:.4g}, but optics.f_number = {self.optics.f_number:g}"
            )
        return self

    def chosen_head(self, name: str | None, where: str = "camera.head") -> Head | None:
        """Return the head of a name, None for a camera without heads; UserError where the name fits no head."""
        if not self.head:
            if name is None:
                return None
            raise UserError(f"found {name!r}, but the camera has no [[head]]", where=where, fix="leave the key out")
        for head in self.head:
            if head.name == name:
                return head
        raise UserError(
            "missing" if name is None else f"found {name!r}",
            where=where,
            expected="the name of one of the camera's heads: " + ", ".join(head.name for head in self.head),
            fix=f'set camera.head in the scene, or use --head ("{ALL_HEADS}" makes a frame of each)',
        )
