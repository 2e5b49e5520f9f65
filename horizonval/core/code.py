"""The code that a result depends on, as one digest of files.

A result stays valid while the files that it was made with are the same, byte for byte: the rooms (top-level folders and
modules) of this package, and the packages of users' estimators. A changed word in a docstring makes results again.
Other installed packages and their versions do not count.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import horizonval

OWN = "horizonval"
FRAME_ROOMS = ("core", "earth", "frame", "geometry", "renderer", "spec", "store", "truth")
"""Rooms that a frame and its file are made with. The header's reading of an ideal sensor, which `estimation` computes,
is for other programs and is never read back, so that work on an estimator does not render frames again."""
_WITHOUT_RESULTS = {
    "__init__", "__main__", "api", "bridges", "cli", "jobs", "report", "scenes", "serve",
    "studies", "systems", "tables", "wire",
}  # fmt: skip
"""Rooms that no row of results flows through: they ask for results, or show them."""


@cache
def code_version() -> str:
    """Return the version of this package with the beginning of the digest of all its rooms."""
    return f"{horizonval.__version__}+{_of_rooms(sorted({*_rooms()} - {'scenes'}))[:12]}"


@cache
def code_digest(*modules: str, rooms: tuple[str, ...] | None = None) -> str:
    """Return the digest of the files that a result depends on.

    Parameters
    ----------
    *modules : str
        Dotted names of further modules: of this package, whose rooms are added, or of users' packages, which count
        completely. A module that is not installed counts by its name.
    rooms : tuple of str, optional
        Rooms of this package; by default all that a row of results depends on.
    """
    counted = {*_rooms()} - _WITHOUT_RESULTS if rooms is None else {*rooms}
    own = {module.split(".")[1] for module in modules if module.startswith(f"{OWN}.")}
    others = sorted({module.partition(".")[0] for module in modules} - {OWN})
    if not others:
        return _of_rooms(sorted(counted | own))
    content = [_of_rooms(sorted(counted | own)), [[name, _of_package(name)] for name in others]]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _rooms() -> dict[str, Path]:
    """Return the top-level folders and modules of this package by name."""
    root = Path(horizonval.__file__).parent
    folders = {path.name: path for path in root.iterdir() if path.is_dir() and path.name[0] not in "._"}
    return folders | {path.stem: path for path in root.glob("*.py")}


def _of_rooms(names: Iterable[str]) -> str:
    rooms = _rooms()
    return hashlib.sha256(json.dumps([[name, _of_path(rooms[name])] for name in names]).encode()).hexdigest()


def _of_package(name: str) -> list[str]:
    """Return the digests of a package's folders, or of the one file of a module; nothing of it is imported."""
    try:
        spec = importlib.util.find_spec(name)
    except ValueError:
        return []
    if spec is None:
        return []
    places = spec.submodule_search_locations or [spec.origin or ""]
    return [_of_path(Path(place)) for place in places]


@cache
def _of_path(path: Path) -> str:
    """Return the digest of a file, or of every file below a folder with its name."""
    digest = hashlib.sha256()
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    for file in files:
        if file.is_file() and file.suffix != ".pyc":
            digest.update(f"{file.relative_to(path).as_posix()}\0".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
