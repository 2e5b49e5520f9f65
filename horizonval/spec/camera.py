"""Camera files: geometry, optics, bands and detector of one camera."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.detector import Detector, Microbolometer
from horizonval.spec.numbers import Finite, Fraction, Positive
from horizonval.spec.optics import Optics


class CameraGeometry(Model):
    """Intrinsics. Either ``fov_deg`` (horizontal, between the outer edges of the first and last column) or ``fx``."""

    name: str = ""
    source: str = ""
    width: Annotated[int, Field(ge=1, le=16384)]
    height: Annotated[int, Field(ge=1, le=16384)]
    fov_deg: Annotated[float, Field(gt=0, lt=180)] | None = None
    fx: Positive | None = None
    fy: Positive | None = None
    cx: Finite | None = None
    cy: Finite | None = None
    distortion: Annotated[list[Finite], Field(max_length=5)] = []
    projection: Literal["pinhole", "equal_angle"] = "pinhole"

    @model_validator(mode="after")
    def _one_scale(self) -> CameraGeometry:
        if (self.fov_deg is None) == (self.fx is None):
            raise ValueError("give exactly one of fov_deg and fx")
        if self.projection == "equal_angle" and any(self.distortion):
            raise ValueError('distortion applies to projection = "pinhole" only')
        return self


class PlatformPrior(Model):
    """What a user knows of the platform; a prior, never the truth."""

    altitude_km: Positive | None = None


class Band(Model):
    """Spectral response, relative, as a top hat (``lo_um``, ``hi_um``) or a table.

    ``kind = "solar"``: scattered sunlight; the table is a quantum efficiency (electrons per photon).
    ``kind = "thermal"``: emission; the table is a response per unit power.
    ``nodes``: spectral nodes of the solar quadrature; left out, the fewest that keep the scene's ``render.band_error``.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    kind: Literal["solar", "thermal"]
    lo_um: Positive | None = None
    hi_um: Positive | None = None
    wavelength_um: list[Positive] = []
    response: list[Fraction] = []
    nodes: Annotated[int, Field(ge=1, le=64)] | None = None

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


class CameraSpec(Model):
    """One camera file. ``estimate`` needs only ``[camera]``; rendering also ``[[band]]``; observing ``[detector]``.

    A detector sees either solar or thermal bands. Without one, a camera may have both.
    """

    camera: CameraGeometry
    platform: PlatformPrior = PlatformPrior()
    optics: Optics = Optics()
    band: list[Band] = []
    detector: Detector | None = None

    @model_validator(mode="after")
    def _consistent(self) -> CameraSpec:
        names = [b.name for b in self.band]
        if len(set(names)) != len(names):
            raise ValueError(f"band names must differ, got {names}")
        if isinstance(self.detector, Microbolometer) and self.detector.netd_band not in (None, *names):
            raise ValueError(f"detector.netd_band = {self.detector.netd_band!r} is none of the bands {names}")
        if self.detector is not None and len({b.kind for b in self.band}) > 1:
            kinds = ", ".join(f"{b.name} ({b.kind})" for b in self.band)
            raise ValueError(f"one [detector] cannot see solar and thermal bands, got {kinds}; make two camera files")
        return self
