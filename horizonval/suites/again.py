"""The command that makes a run again, to be given in the run's folder.

It is written down when the run begins, in ``run.json``, with paths from that folder on: the report then holds wherever
the folder and what it was made of are moved together.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from horizonval.spec.files import Kind, shipped_names, shipped_path
from horizonval.spec.load import Suite
from horizonval.store.index import Filter

HERE = ["--out", "."]


def command_of_suite(suite: Suite, root: Path) -> list[str]:
    """Return the words of ``run`` or ``study`` for a suite's run in the folder ``root``."""
    kind: Kind = "study" if suite.study else "suite"
    return ["horizonval", "study" if suite.study else "run", target_of(kind, suite.source, root), *suite.options, *HERE]


def command_of_rescoring(
    archive: Path, root: Path, estimators: Sequence[str], wanted: Filter | None, time_limit_s: float
) -> list[str]:
    """Return the words of ``archive rescore`` for images of an archive, scored again in the folder ``root``."""
    words = ["horizonval", "archive", "rescore", relative(archive, root)]
    words += [word for name in estimators for word in ("--estimator", name)]
    for field in fields(wanted or Filter()):
        value = getattr(wanted, field.name, None)
        if field.name != "kind" and value is not None:
            words += [f"--{field.name}", value]
    return [*words, "--time-limit", f"{time_limit_s:g}", *HERE]


def target_of(kind: Kind, source: str, root: Path) -> str:
    """Return a shipped file's name, or the path of a user's own file from a folder on."""
    path = Path(source).resolve()
    if path.stem in shipped_names(kind) and path == shipped_path(kind, path.stem).resolve():
        return path.stem
    return relative(path, root)


def relative(path: Path, root: Path) -> str:
    """Return a path from a folder on, or the absolute one where none leads there (another drive)."""
    try:
        text = Path(os.path.relpath(path.resolve(), root.resolve())).as_posix()
    except ValueError:
        return str(path.resolve())
    return f"./{text}" if text.startswith("-") else text
