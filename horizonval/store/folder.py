"""The folder of a run: its files, the lock, and what a killed run leaves behind.

::

    run.json           which suite this is
    archive/           frames and detector images, content-addressed
    cases/<name>.json  results of one frame
    state/<name>.json  address of a frame that is rendered, whether or not it is scored yet
    stability/, stability.csv   the study of the infrared horizon, where the suite asks for one
    results.parquet, summary.json, report/     made of the cases at the end
    timings*.json      seconds; with the archive's index the only files that two equal runs do not share
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.errors import UserError

LARGEST_RECORD = 1024**3
"""Size [bytes] of a JSON file of a run: a case holds some kilobytes of each estimator and draw."""


@dataclass(frozen=True)
class RunFolder:
    """Paths inside the folder of a run."""

    root: Path

    @property
    def archive(self) -> Path:
        return self.root / "archive"

    @property
    def cases(self) -> Path:
        return self.root / "cases"

    @property
    def state(self) -> Path:
        return self.root / "state"

    @property
    def suite(self) -> Path:
        return self.root / "run.json"

    @property
    def summary(self) -> Path:
        return self.root / "summary.json"

    @property
    def results(self) -> Path:
        return self.root / "results.parquet"

    @property
    def timings(self) -> Path:
        return self.root / "timings.json"

    def shard_timings(self, shard: tuple[int, int]) -> Path:
        return self.root / f"timings-{shard[0]}-of-{shard[1]}.json"

    @property
    def stability(self) -> Path:
        return self.root / "stability"

    @property
    def stability_table(self) -> Path:
        return self.root / "stability.csv"

    def stability_case(self, name: str) -> Path:
        return self.stability / f"{name}.json"

    def case(self, name: str) -> Path:
        return self.cases / f"{name}.json"

    def frame_pointer(self, name: str) -> Path:
        return self.state / f"{name}.json"

    def create(self, *, stability: bool = False) -> None:
        """Make the folders; raise ``UserError`` where that is impossible."""
        extra = (self.stability,) if stability else ()
        for folder in (self.root, self.archive, self.cases, self.state, *extra):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as e:
                raise UserError(
                    e.strerror or "cannot be created", where=str(folder), expected="a folder that can be written"
                ) from e

    def remove_temporary_files(self) -> None:
        """Delete what a killed run was writing. Call only with the lock held."""
        folders = (self.archive, self.cases, self.state, self.stability)
        below = [path for folder in folders for path in atomic.leftovers(folder)]
        for path in (*below, *atomic.leftovers(self.root, below=False)):
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def locked(self, shard: tuple[int, int] | None = None) -> Iterator[None]:
        """Keep a second run out. The system drops the lock with the process, so a killed run leaves none.

        Different shards work beside each other; none of them does beside a run of the whole.
        """
        try:
            import fcntl
        except ImportError:  # Windows: two runs in one folder are then the user's care.
            yield
            return
        wanted = [(".lock", fcntl.LOCK_EX if shard is None else fcntl.LOCK_SH)]
        if shard is not None:
            wanted.append((f".lock-{shard[0]}-of-{shard[1]}", fcntl.LOCK_EX))
        with contextlib.ExitStack() as files:
            for name, kind in wanted:
                file = files.enter_context(open(self.root / name, "w"))
                try:
                    fcntl.flock(file, kind | fcntl.LOCK_NB)
                except OSError as e:
                    raise UserError(
                        "another run is working in this folder",
                        where=str(self.root),
                        fix="wait until it ends, or choose another --out",
                    ) from e
            yield


def write_json(path: Path, data: Mapping[str, Any], *, indent: int | None = 1, sort_keys: bool = True) -> None:
    """Write JSON, whole or not at all; equal data give equal bytes."""
    text = json.dumps(data, indent=indent, sort_keys=sort_keys, allow_nan=False) + "\n"
    atomic.write_text(path, text)


def read_json(path: Path) -> dict[str, Any] | None:
    """Return a JSON object, or ``None`` if there is no such file or it is not one; no link is followed."""
    try:
        data = json.loads(files.read_text(path, largest=LARGEST_RECORD, links=False, encoding="utf-8"))
    except (UserError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) else None
