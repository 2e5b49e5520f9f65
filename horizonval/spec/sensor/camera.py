"""Camera files: geometry, optics, bands, heads and detector of one camera."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.core.errors import UserError
from horizonval.spec.base import Model
from horizonval.spec.numbers import Angle, Fraction, PlainName, Positive
from horizonval.spec.sensor.camera_geometry import CameraGeometry
from horizonval.spec.sensor.cmos import Cmos
from horizonval.spec.sensor.detector import Detector, ThermalDetector
from horizonval.spec.sensor.optics import Optics
from horizonval.spec.units import unit

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
    """Height of the orbit above the ellipsoid. A prior that has an altitude stands in its place."""
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
            object.__setattr__(self, "camera", geometry.model_copy(update={"fx": from_lens}))
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
        """Return the head of a name; None where the file has no heads and none is asked for.

        Raises
        ------
        UserError
            If the file has heads and this is none of them, or has none and one is asked for.
        """
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
