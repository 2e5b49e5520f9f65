"""Scenes for users: one camera, one pose, one planet, one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from horizonval.api.camera import Camera, camera_of
from horizonval.core.errors import UserError, one_of
from horizonval.core.json_types import JsonObject
from horizonval.geometry.pose import scene_keys
from horizonval.spec.base import deep_merge
from horizonval.spec.load import Shelf, load_frames, load_scene, validate
from horizonval.spec.pose import TABLE_OF, VECTORS, PoseKeys, PoseKeywords
from horizonval.spec.scene import SceneName, SceneSpec

FLAT = TABLE_OF | dict.fromkeys(SceneName.model_fields, "scene")
"""Scene-file keys that are keywords of :class:`Scene` under the same name, with their tables."""
TABLES = tuple(key for key in SceneSpec.model_fields if key != "camera")
"""Keywords that are entire tables of a scene file."""


class SceneKeywords(PoseKeywords, total=False):
    """Keywords of :class:`Scene` for type checkers and editors."""

    name: str
    seed: int
    draw: str
    scene: Mapping[str, Any]
    platform: Mapping[str, Any]
    attitude: Mapping[str, Any]
    earth: Mapping[str, Any]
    atmosphere: Mapping[str, Any]
    surface: Mapping[str, Any]
    clouds: Mapping[str, Any]
    layer: Sequence[Mapping[str, Any]]
    sun: Mapping[str, Any]
    moon: Mapping[str, Any]
    night: Mapping[str, Any]
    part: Sequence[Mapping[str, Any]]
    render: Mapping[str, Any]
    prior: Mapping[str, Any]
    calibration: Mapping[str, Any]


class Scene:
    """The input of one frame: a camera on a satellite, the Earth and its air, an instant.

    The keywords are keys of a scene file; missing keywords have the file's defaults.

    Parameters
    ----------
    camera : Camera, str, Path or mapping
        A camera, its file or shipped name, or its plain data.
    epoch_utc : str or datetime
        For example ``"2026-03-20T12:00Z"``.
    latitude_deg, longitude_deg, altitude_km : float
        Geodetic position of the satellite; or ``position_itrs_km``, three numbers along Earth-fixed axes.
    heading_deg : float
        Azimuth of its velocity, from north over east, in the plane across the line to the Earth's centre; or
        ``velocity_itrs_km_s``, the rate of change of the Earth-fixed position.
    yaw_deg, pitch_deg, roll_deg : float
        Body against lvlh (x to the velocity, z to the nadir), in this order; or a quaternion, scalar last:
        ``q_body_from_lvlh`` or ``q_body_from_itrs``.
    rate_deg_s, hold : array_like, shape (3,), and str
        Angular velocity in body axes, and its reference: ``"lvlh"`` or ``"inertial"``.
    mount_yaw_deg, mount_pitch_deg, mount_roll_deg, head : float, and str
        Camera against body, in this order, and the head of a camera with several.
    name, seed, draw : str, int, and str
        Identity of the scene, from which all random numbers are drawn.
    earth, atmosphere, surface, clouds, layer, sun, moon, night, part, render, prior, calibration : mapping
        Tables of a scene file, such as ``surface={"kind": "earth"}``; ``layer`` and ``part`` are lists of tables.

    Attributes
    ----------
    spec : SceneSpec
        The validated scene with all defaults.
    camera : Camera

    Raises
    ------
    UserError
        An unknown keyword or an invalid value: one line with the key and what was expected.

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
        **keywords: Unpack[SceneKeywords],
    ) -> None:
        if camera is None:
            raise UserError("missing", where="Scene: camera", expected="a camera, its file, or a shipped name")
        self._set(*_with_keywords({"platform": {}}, keywords, camera_of(camera)))

    def _set(self, spec: SceneSpec, camera: Camera) -> None:
        self.spec, self.camera = spec, camera

    @classmethod
    def _of(cls, spec: SceneSpec, camera: Camera) -> Scene:
        scene = cls.__new__(cls)
        scene._set(spec, camera)
        return scene

    @classmethod
    def from_file(cls, path_or_name: str | Path, head: str | None = None) -> Scene:
        """Read a scene, a TOML file or a shipped name (:func:`horizonval.list_scenes`), and the camera that it names.

        ``head`` replaces the scene's ``camera.head``. Raises ``UserError``: no such file, a mistake in it or in the
        camera file, or a camera of several heads without a choice.

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
        """Read a scene file as :meth:`from_file`; with the head ``"all"`` return one scene for every head."""
        cases = load_frames(path_or_name, head)
        return tuple(cls._of(case.scene, Camera(case.camera, case.scene.camera.file)) for case in cases)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], camera: Camera | str | Path | Mapping[str, Any] | None = None) -> Scene:
        """Make a scene of plain data, with the tables and keys of a scene file.

        ``camera`` replaces the file that ``camera.file`` names. Raises as :meth:`from_file`.

        Examples
        --------
        >>> import horizonval as hv
        >>> hv.Scene.from_dict({"camera": {"file": "vis-cmos-512-60deg"}, "platform": {"altitude_km": 700.0}})
        <Scene scene: vis-cmos-512-60deg at 700 km, 0.00 deg N 0.00 deg E, 2026-03-20 12:00:00 UTC>
        """
        return cls._of(*_resolved(plain(data), None if camera is None else camera_of(camera)))

    def changed(self, **keywords: Any) -> Scene:
        """Return the scene with other values; all others stay.

        The keywords are those of :class:`Scene`. The keys of a table are merged into the table of the scene. Raises as
        :class:`Scene`.

        Examples
        --------
        >>> import horizonval as hv
        >>> scene = hv.Scene.from_file("limb-noon-vis")
        >>> [scene.changed(altitude_km=h).spec.platform.altitude_km for h in (500, 700)]
        [500.0, 700.0]
        """
        camera = camera_of(keywords.pop("camera", self.camera))
        return self._of(*_with_keywords(self.spec.model_dump(exclude_unset=True), keywords, camera))

    @property
    def name(self) -> str:
        """The scene's name, the source of all its random numbers."""
        return self.spec.scene.name

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain data for :meth:`from_dict`: the given values, not the defaults."""
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
    """Return a scene from a scene, a file, or a shipped name."""
    return scene if isinstance(scene, Scene) else Scene.from_file(scene)


def _with_keywords(data: JsonObject, keywords: Mapping[str, Any], camera: Camera) -> tuple[SceneSpec, Camera]:
    """Merge keywords into the plain data of a scene and return the scene; keywords that are None are ignored."""
    given = {key: plain(value) for key, value in keywords.items() if value is not None}
    known = (*FLAT, *VECTORS, *TABLES)
    for key in keywords:
        if key not in known:
            raise UserError("unknown keyword", where=f"Scene: {key}", expected=one_of(key, known))
    pose = validate(PoseKeys, {key: x for key, x in given.items() if key in PoseKeys.model_fields}, "Scene")
    data = deep_merge(data, {"camera": {"file": camera.source}})
    for key, value in given.items():
        if key not in VECTORS:
            data = deep_merge(data, {key: value} if key in TABLES else {FLAT[key]: {key: value}})
    if any(key in VECTORS for key in given):
        if "position_itrs_km" in given:
            # A scene needs an altitude; the value is not yet known.
            data = deep_merge(data, {"platform": {"altitude_km": pose.altitude_km}})
        for key, value in scene_keys(pose, _resolved(data, camera)[0], "Scene").items():
            data = deep_merge(data, {TABLE_OF[key]: {key: value}})
    return _resolved(data, camera)


def _resolved(data: JsonObject, camera: Camera | None) -> tuple[SceneSpec, Camera]:
    spec, camera_spec = Shelf(Path("Scene")).resolve(data, inside="", camera=None if camera is None else camera.spec)
    if spec.camera.head is not None or camera_spec.head:
        camera_spec.chosen_head(spec.camera.head, where="Scene: camera.head")
    return spec, camera if camera is not None else Camera(camera_spec, spec.camera.file)


def plain(value: Any) -> Any:
    """Return a value as plain Python data: numpy's numbers and arrays become numbers and lists."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, Path):
        return str(value)
    return [plain(item) for item in value] if isinstance(value, Sequence) and not isinstance(value, str) else value
