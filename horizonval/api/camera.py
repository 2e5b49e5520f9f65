"""Cameras for users: a camera file, a shipped name, or plain data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import find
from horizonval.spec.load import changed_camera, read_camera_tables, validate


class Camera:
    """A camera: geometry, lens, spectral bands, detector.

    Made by :meth:`from_file` or :meth:`from_dict`. Immutable: :meth:`changed` returns another camera.

    Attributes
    ----------
    spec : CameraSpec
        The validated camera file with all defaults.
    source : str
        The file or shipped name; the camera's name where it was made of plain data.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.Camera.from_file("vis-cmos-512-60deg")
    <Camera vis-cmos-512-60deg: 512 x 512 px, band vis>
    """

    def __init__(self, spec: CameraSpec, source: str = "", *, data: Mapping[str, Any] | None = None) -> None:
        self.spec = spec
        self.source = source or spec.camera.name or "camera"
        self._data = dict(data) if data is not None else spec.model_dump(mode="json", exclude_unset=True)

    @classmethod
    def from_file(cls, path_or_name: str | Path) -> Camera:
        """Read a camera: a TOML file, or the name of a shipped camera (:func:`horizonval.list_cameras`).

        Raises ``UserError``: no such file, or a mistake in it: one line with file, key, and the expected value.

        Examples
        --------
        >>> import horizonval as hv
        >>> hv.Camera.from_file("ir-four-band-320-24deg").bands
        ('co2', 'co2-narrow', 'lwir', 'window')
        """
        path = find("camera", path_or_name)
        data = read_camera_tables(path)
        return cls(validate(CameraSpec, data, str(path)), str(path_or_name), data=data)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], name: str = "") -> Camera:
        """Make a camera of plain data, with the tables and keys of a camera file.

        ``name`` replaces ``camera.name`` in messages. Raises as :meth:`from_file`.

        Examples
        --------
        >>> import horizonval as hv
        >>> band = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}
        >>> hv.Camera.from_dict({"camera": {"width": 64, "height": 48, "fov_deg": 20.0}, "band": [band]})
        <Camera camera: 64 x 48 px, band vis>
        """
        spec = validate(CameraSpec, data, name or "Camera")
        return cls(spec, name, data=data)

    def changed(self, **tables: Mapping[str, Any]) -> Camera:
        """Return the camera with other values; all others stay.

        Raises ``UserError``: an unknown table or key, or an invalid value.

        Parameters
        ----------
        **tables : mapping
            Tables of a camera file with the keys that change: ``camera``, ``platform``, ``optics``, ``detector``,
            and ``band``, whose keys are the bands' names.

        Examples
        --------
        >>> import horizonval as hv
        >>> camera = hv.Camera.from_file("vis-cmos-512-60deg")
        >>> camera.changed(detector={"exposure_s": 1e-3}, camera={"width": 64, "height": 64})
        <Camera vis-cmos-512-60deg: 64 x 64 px, band vis>
        """
        data = changed_camera(self._data, tables, "Camera: ")
        return Camera(validate(CameraSpec, data, "Camera"), self.source, data=data)

    @property
    def name(self) -> str:
        """The camera's name, or else its source."""
        return self.spec.camera.name or self.source

    @property
    def width(self) -> int:
        """Columns of the image."""
        return self.spec.camera.width

    @property
    def height(self) -> int:
        """Rows of the image."""
        return self.spec.camera.height

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of the spectral bands."""
        return tuple(band.name for band in self.spec.band)

    @property
    def heads(self) -> tuple[str, ...]:
        """Names of the heads of one housing; empty for a single camera."""
        return tuple(head.name for head in self.spec.head)

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as plain data for :meth:`from_dict`, with all defaults."""
        return self.spec.model_dump(mode="json")

    def __repr__(self) -> str:
        bands = f"band{'s' if len(self.bands) > 1 else ''} {', '.join(self.bands)}" if self.bands else "no band"
        heads = f", heads {', '.join(self.heads)}" if self.heads else ""
        return f"<Camera {self.name}: {self.width} x {self.height} px, {bands}{heads}>"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Camera) and self.spec == other.spec

    def __hash__(self) -> int:
        return hash(self.spec.model_dump_json())


def camera_of(camera: Camera | str | Path | Mapping[str, Any]) -> Camera:
    """Return a camera from a camera, a file, a shipped name, or plain data."""
    if isinstance(camera, Camera):
        return camera
    return Camera.from_dict(camera) if isinstance(camera, Mapping) else Camera.from_file(camera)
