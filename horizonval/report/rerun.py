"""How to repeat one frame exactly: the scene as a file, and the commands.

The scene in a frame's truth is complete, and its hash is the seed of the detector noise. Written to a file it gives the
same frame and image, bit by bit, with the same version.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from horizonval.frame import FrameTruth
from horizonval.report.load import CaseView, ReportRun
from horizonval.spec.files import shipped_names, shipped_path
from horizonval.spec.load import load_camera

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Rerun:
    """Files to save (name and content) and the commands."""

    files: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]


def rerun_of(view: CaseView, run: ReportRun) -> Rerun:
    """Return the files and commands that repeat an image (or all heads') and its results, or use the archived one.

    The files and commands belong in an empty folder inside the run's folder, because two frames may have different
    cameras of the same name.
    """
    assert view.image is not None
    truth, band = view.image.truth, view.band
    case = view.scene or view.case
    suites = run.suite_of_programs
    # A word with a leading hyphen would be parsed as an option.
    stem = f"./{case}" if case.startswith("-") else case
    files = [(f"{case}.toml", toml(truth.scene))]
    camera_file = truth.camera_file
    if not _is_shipped(camera_file, truth):
        # Under the name that the scene has for it, which is part of the seed; a file beside a scene wins over a shipped
        # one of that name.
        files.append((camera_file, toml(truth.camera)))
    quoted, word = shlex.quote(stem), shlex.quote(band)
    # Archived images by head, empty where one is missing; a rendered head's file is named by its target:
    # FRAME.<head>.exr.
    paths = {f".{head}": path for head, path in view.head_paths.items()} or {"": view.image_path}
    commands = [f"horizonval render {quoted}.toml -o {quoted}.frame.exr{' --head all' if view.head_paths else ''}"]
    commands += [
        f"horizonval observe {quoted}.frame{end}.exr -o {quoted}{end}.image.exr --band {word}" for end in paths
    ]
    estimators = [name for name in run.estimators if name in view.rows] or list(run.estimators)
    together = [name for name in estimators if name in view.rows and view.rows[name].case == view.scene]
    for name in estimators:
        made = " ".join(f"{quoted}{end}.image.exr" for end in (paths if name in together else list(paths)[:1]))
        commands.append(f"horizonval estimate {made} {_estimator(name, suites)}")
    for name in (together or estimators)[:1]:
        stored = list(paths.values()) if name in together else list(paths.values())[:1]
        if all(stored):
            commands.append(f"horizonval estimate {shlex.join(map(_from_inside, stored))} {_estimator(name, suites)}")
    return Rerun(tuple(files), tuple(commands))


def _estimator(name: str, suites: Mapping[str, str]) -> str:
    words = ["--estimator", name]
    return shlex.join([*words, "--suite", _from_inside(suites[name])] if name in suites else words)


def _from_inside(path: str) -> str:
    """Return a path relative to a subfolder of the run's folder; shipped names are unchanged."""
    is_name = path in shipped_names("suite") or path in shipped_names("study")
    return path if is_name or Path(path).is_absolute() else f"../{path.removeprefix('./')}"


def _is_shipped(name: str, truth: FrameTruth) -> bool:
    """Whether a frame's camera is an unmodified shipped one; a suite may change its keys."""
    if name not in shipped_names("camera"):
        return False
    return load_camera(shipped_path("camera", name)) == truth.camera_spec


def toml(data: Mapping[str, Any]) -> str:
    """Return JSON-like data as a TOML document; None, which TOML lacks, is left out."""
    return "\n\n".join(_tables(data, ())) + "\n"


def _tables(data: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    plain = {k: v for k, v in data.items() if v is not None and not isinstance(v, Mapping) and not _is_array(v)}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    tables = []
    if lines or not data:
        head = [f"[{'.'.join(map(_key, path))}]"] if path else []
        tables.append("\n".join(head + lines))
    for key, value in data.items():
        if isinstance(value, Mapping):
            tables += _tables(value, (*path, key))
        elif _is_array(value):
            name = ".".join(map(_key, (*path, key)))
            for item in value:
                inner = [f"{_key(k)} = {_value(v)}" for k, v in item.items() if v is not None]
                tables.append("\n".join([f"[[{name}]]", *inner]))
    return tables


def _is_array(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, Mapping) for item in value)


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    # JSON's strings and numbers are TOML's, but for DEL and a float that repr writes as 1e-05: valid in both.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
