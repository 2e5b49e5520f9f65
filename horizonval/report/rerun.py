"""How to make one frame again, exactly: the scene as a file, and the commands.

The scene in a frame's truth is complete, and its hash is the seed of the detector noise: written out as it is, it gives
the same frame and the same image, bit by bit, on a machine with the same version.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from horizonval.frame import FrameTruth

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


@dataclass(frozen=True)
class Rerun:
    """Files to save (name and content) and the commands to give."""

    files: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]


def rerun_of(truth: FrameTruth, case: str, band: str, image_path: str, estimators: Sequence[str]) -> Rerun:
    """Return how to render, observe and estimate one image again, and how to estimate the archived one."""
    files = [(f"{case}.toml", toml(truth.scene))]
    camera_file = str(truth.scene.get("camera", {}).get("file", ""))
    if camera_file.endswith(".toml"):
        files.append((camera_file, toml(truth.camera)))
    quoted = shlex.quote(case)
    commands = [
        f"horizonval render {quoted}.toml -o {quoted}.frame.exr",
        f"horizonval observe {quoted}.frame.exr -o {quoted}.image.exr --band {shlex.quote(band)}",
    ]
    commands += [f"horizonval estimate {quoted}.image.exr --estimator {shlex.quote(name)}" for name in estimators]
    if image_path:
        commands += [f"horizonval estimate RUN/{image_path} --estimator {shlex.quote(name)}" for name in estimators[:1]]
    return Rerun(tuple(files), tuple(commands))


def toml(data: Mapping[str, Any]) -> str:
    """Return plain data (as JSON has it) as a TOML document; ``None``, which TOML lacks, is left out."""
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
