"""Read camera, scene and suite files.

Values are checked strictly (``width = "512"`` and ``width = true`` are mistakes, not 512 and 1), and every mistake
ends in one line: file, key, what was found, what was expected.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from horizonval.errors import UserError
from horizonval.spec.base import Model
from horizonval.spec.camera import ALL_HEADS, CameraSpec
from horizonval.spec.explain import explain
from horizonval.spec.files import find
from horizonval.spec.scene import SceneSpec
from horizonval.spec.suite import SuiteSpec

M = TypeVar("M", bound=Model)

MAX_FILE_BYTES = 64 * 1024 * 1024
"""No specification is larger; refuses a disk image given by mistake before it is read into memory."""


@dataclass(frozen=True)
class Case:
    """One frame of a suite: everything a render needs, with every default filled in.

    ``name`` is the scene's own, followed by ``.<head>`` where a scene stands for a frame of every head. The scene keeps
    its name then: the heads look at the same clouds.
    """

    name: str
    scene: SceneSpec
    camera: CameraSpec


@dataclass(frozen=True)
class Suite:
    """A suite with its frames resolved, in the file's order."""

    name: str
    title: str
    estimators: tuple[str, ...]
    cases: tuple[Case, ...]
    source: str


def load_camera(path_or_name: str | Path, *, beside: Path | None = None, where: str = "") -> CameraSpec:
    """Read a camera file.

    Parameters
    ----------
    path_or_name : str or Path
        A path, or a shipped camera's name.
    beside, where
        See :func:`horizonval.spec.files.find`.
    """
    path = find("camera", path_or_name, beside=beside, where=where)
    return validate(CameraSpec, read_toml(path), str(path))


def load_scene(path_or_name: str | Path, head: str | None = None) -> tuple[SceneSpec, CameraSpec]:
    """Read a scene file and the camera it names.

    Parameters
    ----------
    path_or_name : str or Path
    head : str, optional
        In place of the scene's own ``camera.head``.

    Raises
    ------
    UserError
        Among other mistakes, if the camera has several heads and not exactly one is chosen.
    """
    path, scene, camera = _read_scene(path_or_name, head)
    camera.chosen_head(scene.camera.head, where=_head_key(path, head))
    return scene, camera


def load_frames(path_or_name: str | Path, head: str | None = None) -> tuple[Case, ...]:
    """Read a scene file and return its frames: one, or where ``camera.head`` is ``"all"`` one for every head.

    Parameters and errors as for :func:`load_scene`.
    """
    path, scene, camera = _read_scene(path_or_name, head)
    if scene.camera.head is None:
        camera.chosen_head(None, where=_head_key(path, head))
    return _one_per_head(scene, camera, _head_key(path, head))


def _read_scene(path_or_name: str | Path, head: str | None) -> tuple[Path, SceneSpec, CameraSpec]:
    path = find("scene", path_or_name)
    scene, camera = _resolve_scene(read_toml(path), path, inside="")
    return path, scene if head is None else _with_head(scene, head), camera


def _head_key(path: Path, head: str | None) -> str:
    return f"{path}: camera.head" if head is None else "--head"


def _with_head(scene: SceneSpec, head: str) -> SceneSpec:
    return scene.model_copy(update={"camera": scene.camera.model_copy(update={"head": head})})


def _one_per_head(scene: SceneSpec, camera: CameraSpec, where: str) -> tuple[Case, ...]:
    """Return one case, or one for each head where the scene asks for all of them or, of several, for none."""
    name, chosen = scene.scene.name, scene.camera.head
    if camera.head and chosen in (None, ALL_HEADS):
        return tuple(Case(f"{name}.{head.name}", _with_head(scene, head.name), camera) for head in camera.head)
    camera.chosen_head(chosen, where=where)
    return (Case(name, scene, camera),)


def load_suite(path_or_name: str | Path) -> Suite:
    """Read a suite file, lay every frame over the defaults, and load the cameras.

    A frame whose camera has several heads becomes one case for each of them unless it chooses one.

    The suite's seed is the default of every frame's ``scene.seed``. Estimators are checked by who runs them: names
    of plug-ins are not known here.
    """
    path = find("suite", path_or_name)
    spec = validate(SuiteSpec, read_toml(path), str(path))
    seeded = {"scene": {"seed": spec.suite.seed}}
    cases: list[Case] = []
    for i, frame in enumerate(spec.frame, start=1):
        merged = deep_merge(deep_merge(seeded, spec.defaults), frame)
        inside = f"frame[{i}] ({frame['scene']['name']})"
        scene, camera = _resolve_scene(merged, path, inside=inside)
        for case in _one_per_head(scene, camera, f"{path}: {inside}: camera.head"):
            if case.name in (other.name for other in cases):
                raise UserError(f"two frames are named {case.name!r}", where=f"{path}: {inside}", fix="rename one")
            cases.append(case)
    return Suite(spec.suite.name, spec.suite.title, tuple(spec.suite.estimators), tuple(cases), str(path))


def deep_merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``below`` with ``above`` laid over it: tables merge key by key, anything else is replaced."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = deep_merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged


def read_toml(path: Path) -> dict[str, Any]:
    """Return a TOML file's tables; a syntax error names file, line and column."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise UserError("too large for a specification", where=str(path), expected="a TOML file")
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise UserError(f"not text (byte {e.start} is not UTF-8)", where=str(path), expected="a TOML file") from e
    except OSError as e:
        raise UserError(e.strerror or "cannot be read", where=str(path), expected="a readable file") from e
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as e:
        raise UserError(
            f"not valid TOML: {e}", where=str(path), expected='lines such as key = 1.0 or key = "text"'
        ) from e


def validate(model: type[M], data: Mapping[str, Any], file: str, *, inside: str = "") -> M:
    """Return the model of plain data; a mistake becomes one line that names file and key."""
    try:
        return model.model_validate(data, strict=True)
    except ValidationError as e:
        raise explain(e, model, file, inside=inside) from e


def _resolve_scene(data: dict[str, Any], path: Path, *, inside: str) -> tuple[SceneSpec, CameraSpec]:
    scene = validate(SceneSpec, _with_datetime(data), str(path), inside=inside)
    prefix = f"{path}: {inside}: " if inside else f"{path}: "
    camera = load_camera(scene.camera.file, beside=path.parent, where=prefix + "camera.file")
    if not camera.band:
        raise UserError(
            f"camera {scene.camera.file!r} has no spectral band",
            where=prefix + "camera.file",
            expected="at least one [[band]] in the camera file",
        )
    if scene.atmosphere.file is not None:
        file = find("atmosphere", scene.atmosphere.file, beside=path.parent, where=prefix + "atmosphere.file")
        scene = _with_atmosphere(scene, file=str(file.resolve()))
    if scene.atmosphere.profile_file is not None:
        file = path.parent / Path(scene.atmosphere.profile_file).expanduser()
        if not file.is_file():
            raise UserError(
                f"no file {file}", where=prefix + "atmosphere.profile_file", expected="a profile (CSV or JSON)"
            )
        scene = _with_atmosphere(scene, profile_file=str(file.resolve()))
    return scene, camera


def _with_atmosphere(scene: SceneSpec, **changes: str) -> SceneSpec:
    return scene.model_copy(update={"atmosphere": scene.atmosphere.model_copy(update=changes)})


def _with_datetime(data: dict[str, Any]) -> dict[str, Any]:
    """Turn a quoted epoch into a date and time; strict validation accepts only the unquoted TOML form."""
    platform = data.get("platform")
    if isinstance(platform, Mapping) and isinstance(platform.get("epoch_utc"), str):
        try:
            epoch = datetime.fromisoformat(platform["epoch_utc"])
        except ValueError:
            return data
        return {**data, "platform": {**platform, "epoch_utc": epoch}}
    return data
