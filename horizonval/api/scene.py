"""A scene as users hold it: one camera, one pose, one planet, one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Never

import numpy as np

from horizonval.api.camera import Camera, camera_of
from horizonval.core.errors import UserError, nearest
from horizonval.core.json_types import JsonObject
from horizonval.spec.base import deep_merge
from horizonval.spec.load import Shelf, load_frames, load_scene
from horizonval.spec.scene import SceneSpec

FLAT = {
    "altitude_km": ("platform", "altitude_km"),
    "latitude_deg": ("platform", "latitude_deg"),
    "longitude_deg": ("platform", "longitude_deg"),
    "heading_deg": ("platform", "heading_deg"),
    "epoch": ("platform", "epoch_utc"),
    "yaw_deg": ("attitude", "yaw_deg"),
    "pitch_deg": ("attitude", "pitch_deg"),
    "roll_deg": ("attitude", "roll_deg"),
    "head": ("camera", "head"),
    "mount_yaw_deg": ("camera", "mount_yaw_deg"),
    "mount_pitch_deg": ("camera", "mount_pitch_deg"),
    "mount_roll_deg": ("camera", "mount_roll_deg"),
    "sun_zenith_deg": ("sun", "zenith_deg"),
    "sun_azimuth_deg": ("sun", "azimuth_deg"),
    "name": ("scene", "name"),
    "seed": ("scene", "seed"),
}
"""Keywords of :class:`Scene`, and the table and key of a scene file that each of them is."""
TABLES = (
    "attitude",
    "earth",
    "atmosphere",
    "surface",
    "clouds",
    "moon",
    "night",
    "part",
    "render",
    "prior",
    "calibration",
)
"""Keywords that are a whole table of a scene file."""


class Scene:
    """What one frame is rendered of: a camera on a satellite, the Earth and its air, an instant.

    The keywords are keys of a scene file; what is left out has the file's default. Angles in degrees.

    Parameters
    ----------
    camera : Camera, str, Path or mapping
        A camera, the file or shipped name of one, or its plain data.
    altitude_km : float
        Geodetic height.
    latitude_deg, longitude_deg : float
        Geodetic position of the satellite.
    heading_deg : float
        Azimuth of its velocity, from north over east, in the plane across the line to the Earth's centre.
    epoch : str or datetime
        UTC, such as ``"2026-03-20T12:00Z"``.
    yaw_deg, pitch_deg, roll_deg : float
        Body against lvlh (x to the velocity, z to the nadir), in this order.
    mount_yaw_deg, mount_pitch_deg, mount_roll_deg : float
        Camera against body, in this order.
    head : str
        Which one of a camera's several heads.
    sun_zenith_deg, sun_azimuth_deg : float
        The Sun placed by hand, seen from the point below the satellite.
    name : str
        Identity of the scene: everything random is drawn from a hash of it.
    seed : int
        Other draws of clouds and noise.
    attitude, earth, atmosphere, surface, clouds, moon, night, render, prior : mapping
        Tables of a scene file, as ``surface={"kind": "earth"}``.
    part : sequence of mapping
        Parts of the spacecraft in view, each a table ``[[part]]`` of a scene file.

    Attributes
    ----------
    spec : SceneSpec
        The validated scene, every default filled in.
    camera : Camera

    Raises
    ------
    UserError
        An unknown keyword, or a value that cannot be: one line with the key and what was expected.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.Scene(camera="vis-cmos-512-60deg", altitude_km=550, latitude_deg=10, mount_roll_deg=65)
    <Scene scene: vis-cmos-512-60deg at 550 km, 10.00 deg N 0.00 deg E, 2026-03-20 12:00:00 UTC>
    >>> hv.Scene(camera="vis-cmos-512-60deg", altitude_km=500, yaw_degrees=3)
    Traceback (most recent call last):
    horizonval.core.errors.UserError: Scene: yaw_degrees: unknown keyword; expected one of yaw_deg, ...
    """

    def __init__(
        self,
        camera: Camera | str | Path | Mapping[str, Any] | None = None,
        *,
        altitude_km: float | None = None,
        latitude_deg: float | None = None,
        longitude_deg: float | None = None,
        heading_deg: float | None = None,
        epoch: str | datetime | None = None,
        yaw_deg: float | None = None,
        pitch_deg: float | None = None,
        roll_deg: float | None = None,
        mount_yaw_deg: float | None = None,
        mount_pitch_deg: float | None = None,
        mount_roll_deg: float | None = None,
        head: str | None = None,
        sun_zenith_deg: float | None = None,
        sun_azimuth_deg: float | None = None,
        name: str | None = None,
        seed: int | None = None,
        attitude: Mapping[str, Any] | None = None,
        earth: Mapping[str, Any] | None = None,
        atmosphere: Mapping[str, Any] | None = None,
        surface: Mapping[str, Any] | None = None,
        clouds: Mapping[str, Any] | None = None,
        moon: Mapping[str, Any] | None = None,
        night: Mapping[str, Any] | None = None,
        part: Sequence[Mapping[str, Any]] | None = None,
        render: Mapping[str, Any] | None = None,
        prior: Mapping[str, Any] | None = None,
        **unknown: Never,
    ) -> None:
        keywords = {key: value for key, value in locals().items() if key in FLAT or key in TABLES}
        if camera is None:
            raise UserError("missing", where="Scene: camera", expected="a camera, its file, or a shipped name")
        camera_object = camera_of(camera)
        data = _tables({**keywords, **unknown})
        data["camera"] = {"file": camera_object.source, **data.get("camera", {})}
        self._set(*_resolved(data, camera_object))

    def _set(self, spec: SceneSpec, camera: Camera) -> None:
        self.spec, self.camera = spec, camera

    @classmethod
    def _of(cls, spec: SceneSpec, camera: Camera) -> Scene:
        scene = cls.__new__(cls)
        scene._set(spec, camera)
        return scene

    @classmethod
    def from_file(cls, path_or_name: str | Path, head: str | None = None) -> Scene:
        """Read a scene file and the camera that it names.

        Parameters
        ----------
        path_or_name : str or Path
            A TOML file, or the name of a shipped scene (:func:`horizonval.list_scenes`).
        head : str, optional
            In place of the scene's own ``camera.head``.

        Returns
        -------
        Scene

        Raises
        ------
        UserError
            No such file, a mistake in it or in the camera file, or a camera of several heads without a choice.

        Examples
        --------
        >>> import horizonval as hv
        >>> hv.Scene.from_file("limb-noon-vis").spec.atmosphere.profile
        'tropical'
        """
        spec, camera = load_scene(path_or_name, head)
        return cls._of(spec, Camera(camera, spec.camera.file))

    @classmethod
    def each_head(cls, path_or_name: str | Path, head: str | None = None) -> tuple[Scene, ...]:
        """Read a scene file as :meth:`from_file`; a scene with ``camera.head = "all"`` gives one scene for every head.

        Parameters
        ----------
        path_or_name : str or Path
        head : str, optional
            In place of the scene's own ``camera.head``; ``"all"`` for all of them.

        Returns
        -------
        tuple of Scene

        Raises
        ------
        UserError
            As :meth:`from_file`.

        Examples
        --------
        >>> import horizonval as hv
        >>> len(hv.Scene.each_head("limb-noon-vis"))
        1
        """
        cases = load_frames(path_or_name, head)
        return tuple(cls._of(case.scene, Camera(case.camera, case.scene.camera.file)) for case in cases)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], camera: Camera | str | Path | Mapping[str, Any] | None = None) -> Scene:
        """Make a scene of plain data, with the tables and keys of a scene file.

        Parameters
        ----------
        data : mapping
            ``{"camera": {"file": ...}, "platform": {"altitude_km": ...}, ...}``.
        camera : Camera, str, Path or mapping, optional
            In place of the file that ``camera.file`` names.

        Returns
        -------
        Scene

        Raises
        ------
        UserError
            A mistake in the data, told as for a file.

        Examples
        --------
        >>> import horizonval as hv
        >>> hv.Scene.from_dict({"camera": {"file": "vis-cmos-512-60deg"}, "platform": {"altitude_km": 700.0}})
        <Scene scene: vis-cmos-512-60deg at 700 km, 0.00 deg N 0.00 deg E, 2026-03-20 12:00:00 UTC>
        """
        return cls._of(*_resolved(plain(data), None if camera is None else camera_of(camera)))

    def changed(self, **keywords: Any) -> Scene:
        """Return the scene with other values; what is not named stays.

        Parameters
        ----------
        **keywords
            Those of :class:`Scene`; the keys of a table are laid over those that are there.

        Returns
        -------
        Scene

        Raises
        ------
        UserError
            As :class:`Scene`.

        Examples
        --------
        >>> import horizonval as hv
        >>> scene = hv.Scene.from_file("limb-noon-vis")
        >>> [scene.changed(altitude_km=h).spec.platform.altitude_km for h in (500, 700)]
        [500.0, 700.0]
        """
        camera = camera_of(keywords.pop("camera", self.camera))
        data = deep_merge(self.spec.model_dump(exclude_unset=True), _tables(keywords))
        data["camera"]["file"] = camera.source
        return self._of(*_resolved(data, camera))

    @property
    def name(self) -> str:
        """The scene's name, the identity of everything random in it."""
        return self.spec.scene.name

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain data that :meth:`from_dict` takes; only what was given, not the defaults."""
        return self.spec.model_dump(mode="json", exclude_unset=True)

    def __repr__(self) -> str:
        place = self.spec.platform
        return (
            f"<Scene {self.name}: {self.camera.name} at {place.altitude_km:g} km, {place.latitude_deg:.2f} deg N "
            f"{place.longitude_deg:.2f} deg E, {place.epoch_utc:%Y-%m-%d %H:%M:%S} UTC>"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self.spec == other.spec and self.camera == other.camera

    def __hash__(self) -> int:
        return hash((self.spec.model_dump_json(), self.camera))


def scene_of(scene: Scene | str | Path) -> Scene:
    """Return what was given as a scene: one already, a file, or a shipped name."""
    return scene if isinstance(scene, Scene) else Scene.from_file(scene)


def _tables(keywords: Mapping[str, Any]) -> JsonObject:
    """Return keywords as the tables of a scene file; those that are None are left out."""
    data: JsonObject = {"platform": {}}
    for key, value in keywords.items():
        if key not in FLAT and key not in TABLES:
            known = [*FLAT, *TABLES]
            raise UserError(
                "unknown keyword", where=f"Scene: {key}", expected=f"one of {', '.join(nearest(key, known))}"
            )
        if value is None:
            continue
        table = {key: plain(value)} if key in TABLES else {FLAT[key][0]: {FLAT[key][1]: plain(value)}}
        data = deep_merge(data, table)
    return data


def _resolved(data: JsonObject, camera: Camera | None) -> tuple[SceneSpec, Camera]:
    spec, camera_spec = Shelf(Path("Scene")).resolve(data, inside="", camera=None if camera is None else camera.spec)
    if spec.camera.head is not None or camera_spec.head:
        camera_spec.chosen_head(spec.camera.head, where="Scene: camera.head")
    return spec, camera if camera is not None else Camera(camera_spec, spec.camera.file)


def plain(value: Any) -> Any:
    """Return a value as a file would hold it: numpy's numbers and arrays as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    return [plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
