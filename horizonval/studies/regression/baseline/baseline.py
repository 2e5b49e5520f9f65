"""The accepted baseline: what a night is compared with, small enough to lie beside the code.

``NAME.json`` holds rows, digests, what each scene is like, where it came from and why it was accepted; ``NAME.npz`` the
frozen images (:mod:`horizonval.studies.regression.baseline.pack`); ``NAME.md`` the table of differences, for the one
who reviews the change. ``NAME.release.json`` and ``NAME.release.npz`` are the same of the last release, without
detector images: drift of one percent a night passes every comparison with yesterday.

A baseline is never changed but by ``horizonval baseline accept``, with a reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.folder import read_json, write_json
from horizonval.studies.regression.baseline.pack import FrozenFrame, Pack, read_pack, write_pack
from horizonval.studies.regression.row import COLUMNS, ReplicateRow
from horizonval.studies.regression.statistics.gates import GateInputs

BASELINE_SCHEMA = 1


@dataclass(frozen=True)
class Baseline:
    """A baseline in memory; ``pack`` is the file of its images.

    ``together`` tells of scenes with rows of methods that see all heads, by the scene's name: ``heads`` (name and
    scene of every head, in their order), ``table``, ``bands``. Baselines from before such methods have none.
    """

    path: Path
    head: Mapping[str, Any]
    results: GateInputs
    scenes: Mapping[str, Any]
    pack: Path
    together: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The night and version it was made by."""
        return f"{self.head['night']} ({self.head['version']})"

    @property
    def images(self) -> Pack:
        """The frozen images."""
        return read_pack(self.pack)


def pack_path(path: Path) -> Path:
    """Return the file of images that belongs to a baseline's JSON file."""
    return path.with_suffix(".npz")


def release_path(path: Path) -> Path:
    """Return the last release's file beside an accepted baseline's."""
    return path.with_name(f"{path.stem}.release.json")


def read_baseline(path: Path, suite: str) -> Baseline:
    """Read a baseline and check that its images are the ones that were accepted with it.

    Raises
    ------
    UserError
        No such file, or one of another suite.
    DamagedFileError
        It is not what ``baseline accept`` wrote.
    """
    if not path.is_file():
        raise UserError("no accepted baseline", where=str(path), fix="see `horizonval baseline accept --help`")
    data = read_json(path, bound=False, fix="take it from version control again")
    if data is None or data.get("schema") != BASELINE_SCHEMA:
        raise DamagedFileError("not a baseline of this version", where=str(path))
    if data["suite"] != suite:
        raise UserError(f"is the baseline of suite {data['suite']!r}", where=str(path), expected=f"that of {suite!r}")
    pack = pack_path(path)
    if not pack.is_file():
        raise UserError("no such file", where=str(pack), expected=f"the frozen images that belong to {path.name}")
    if files.sha256_of(pack) != data["pack_sha256"]:
        raise DamagedFileError("its bytes are not those that were accepted", where=str(pack))
    try:
        results = GateInputs(
            rows=from_columns(data["rows"]), fresh=from_columns(data["fresh"]), fresh_night=data["fresh_night"]
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DamagedFileError(f"its rows cannot be read ({error!r})", where=str(path)) from error
    head = {key: value for key, value in data.items() if key not in ("rows", "fresh", "scenes", "together")}
    return Baseline(path, head, results, data["scenes"], pack, data.get("together", {}))


def write_baseline(
    path: Path,
    head: Mapping[str, Any],
    results: GateInputs,
    scenes: Mapping[str, Any],
    pack: Pack,
    together: Mapping[str, Any] | None = None,
) -> None:
    """Write a baseline's two files, the one that names the other last."""
    path.parent.mkdir(parents=True, exist_ok=True)
    images = pack_path(path)
    write_pack(images, pack)
    content = {
        **head,
        "schema": BASELINE_SCHEMA,
        "scenes": scenes,
        "together": together or {},
        "rows": to_columns(results.rows),
        "fresh": to_columns(results.fresh),
        "fresh_night": results.fresh_night,
        "pack_sha256": files.sha256_of(images),
    }
    write_json(path, content, indent=None, bound=False)


def copy_as_release(path: Path) -> Path:
    """Write the last release's files from the accepted ones, without detector images; return the JSON's path."""
    data = read_json(path, bound=False) or {}
    accepted = read_pack(pack_path(path))
    target = release_path(path)
    write_pack(pack_path(target), Pack((), accepted.frames, {}))
    data["pack_sha256"] = files.sha256_of(pack_path(target))
    write_json(target, data, indent=None, bound=False)
    return target


def frames_of(pack: Pack) -> dict[tuple[str, str], FrozenFrame]:
    """Return the frames by scene and band."""
    return {(frame.scene, frame.band): frame for frame in pack.frames}


def to_columns(rows: Iterable[ReplicateRow]) -> dict[str, list[Any]]:
    """Return rows as columns; texts that repeat are numbered: a tenth of the size."""
    listed = list(rows)
    found: dict[str, Any] = {}
    for name in COLUMNS:
        values = [getattr(row, name) for row in listed]
        words = sorted({value for value in values if isinstance(value, str)})
        if words and len(words) * 2 < len(values):
            number = {word: i for i, word in enumerate(words)}
            found[name] = {"words": words, "at": [None if v is None else number[v] for v in values]}
        else:
            found[name] = values
    return found


def from_columns(columns: Mapping[str, Any]) -> list[ReplicateRow]:
    """Return the rows of :func:`to_columns`."""
    plain: dict[str, Sequence[Any]] = {}
    count = len(columns["replicate"])
    for name in COLUMNS:
        # Baselines from before there were bounds have no column of them.
        column = columns.get(name, [None] * count) if name == "bound_arcsec" else columns[name]
        if isinstance(column, dict):
            column = [None if i is None else column["words"][i] for i in column["at"]]
        plain[name] = column
    return [ReplicateRow(**dict(zip(COLUMNS, values, strict=True))) for values in zip(*plain.values(), strict=True)]
