"""The folder of a run: its files, the lock, and what a killed run leaves behind.

::

    run.json           which suite this is
    archive/           frames and detector images, content-addressed
    cases/<name>.json  results of one frame
    state/<name>.json  address of a frame that is rendered, whether or not it is scored yet
    stability/         the study of the infrared horizon, where the suite asks for one
    results.parquet, summary.json, report/     made of the cases at the end
    requirements.*     verdicts on the suite's or study's requirements, where it has some
    timings*.json      seconds; with the manifest, and with requirements on latency, the only files that two equal runs
                       do not share
    manifest.json      digest of every file, written last

Every JSON file and the table hold a seal (:mod:`horizonval.core.sealed`), which is checked where they are read.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from horizonval.core import atomic, files, sealed
from horizonval.core.cache import log_damage
from horizonval.core.errors import DamagedFileError, UserError

LARGEST_RECORD = 1024**3
LOCK = ".lock"
OWN = (
    "run.json", "summary.json", "results.parquet", "timings.json", "manifest.json", "cases", "state", "stability",
    "report", "study.json", "study-plan.json", "study-costs.json", "designs.csv", "requirements.json",
    "requirements.md", "requirements.xml",
)  # fmt: skip
"""What a run or a study writes into its folder and may replace there; the archive replaces nothing."""

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

    def stability_case(self, name: str) -> Path:
        return _record(self.stability, name)

    def case(self, name: str) -> Path:
        return _record(self.cases, name)

    def frame_pointer(self, name: str) -> Path:
        return _record(self.state, name)

    def create(self, *, stability: bool = False) -> None:
        """Make the folders; ``UserError`` if that fails, or a link leads out (only the archive may be shared)."""
        self.refuse_files_of_others()
        self.refuse_links()
        extra = (self.stability,) if stability else ()
        for folder in (self.root, self.archive, self.cases, self.state, *extra):
            atomic.make_folder(folder)

    def refuse_files_of_others(self, names: Iterable[str] = OWN) -> None:
        """Raise ``UserError`` where a command would replace files of a folder that is not its own.

        A folder of ours has the lock, which is made before anything else, or a sealed file among ``names``. Other files
        in it are nobody's concern, and so are folders with nothing in them.
        """
        if files.kind_at(self.root / LOCK) == "a file":
            return
        found = [path for path in (self.root / name for name in names) if _holds_something(path)]
        if found and not any(_is_sealed(path) for path in found):
            what = f"holds {found[0].name}, which no command of horizonval wrote"
            expected = "a new or empty folder, or one of the same command"
            raise UserError(what, where=str(self.root), expected=expected, fix="choose another --out")

    def refuse_links(self) -> None:
        """Raise ``UserError`` if a link replaces one of the folders that a run writes into and cleans."""
        for folder in (self.cases, self.state, self.stability, self.root / "report"):
            if folder.is_symlink():
                raise UserError("is a link", where=str(folder), expected="a folder of the run", fix="remove the link")

    def remove_temporary_files(self) -> None:
        """Delete what a killed run was writing; nothing where a link leads. Call only with the lock held."""
        folders = (self.archive, self.cases, self.state, self.stability, self.root / "report")
        below = [path for folder in folders for path in atomic.leftovers(folder)]
        for path in (*below, *atomic.leftovers(self.root, below=False)):
            path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def locked(self, shard: tuple[int, int] | None = None) -> Iterator[None]:
        """Lock the folder against a second run, not other shards; the system drops the lock of a killed process."""
        try:
            import fcntl
        except ImportError:  # Windows: two runs in one folder are then the user's care.
            yield
            return
        wanted = [(LOCK, fcntl.LOCK_EX if shard is None else fcntl.LOCK_SH)]
        if shard is not None:
            wanted.append((f".lock-{shard[0]}-of-{shard[1]}", fcntl.LOCK_EX))
        with contextlib.ExitStack() as opened:
            for name, kind in wanted:
                file = opened.enter_context(_lock_file(self.root / name))
                try:
                    fcntl.flock(file, kind | fcntl.LOCK_NB)
                except OSError as e:
                    raise UserError(
                        "another run is working in this folder",
                        where=str(self.root),
                        fix="wait until it ends, or choose another --out",
                    ) from e
                # It is empty, whatever was written into it: who holds it may set it right.
                file.truncate(0)
            yield


def _holds_something(path: Path) -> bool:
    kind = files.kind_at(path)
    return any(path.iterdir()) if kind == "a folder" else kind not in ("", "a link")


def _is_sealed(path: Path) -> bool:
    """Whether a file is one of ours, or a folder holds one."""
    if path.is_dir():
        return any(_is_sealed(inside) for inside in path.glob("*.json"))
    try:
        return sealed.KEY.encode() in files.read_bytes(path, largest=LARGEST_RECORD, links=False)
    except UserError:
        return False


def _record(room: Path, name: str) -> Path:
    """Return where the record of a name lies, which may be a damaged file's or a stranger's."""
    if not files.is_name(name):
        raise UserError(f"{name!r} is no name of a record", where=str(room), expected="letters, digits, . _ and -")
    return room / f"{name}.json"


def _lock_file(path: Path) -> IO[bytes]:
    """Open the file of a lock, and make it where something else lies: a folder with nothing in it, a FIFO, a link."""
    if files.kind_at(path) == "a folder":
        path.rmdir()
    elif files.kind_at(path) not in ("a file", ""):
        path.unlink()
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    return os.fdopen(os.open(path, flags, 0o666), "r+b")


def write_json(
    path: Path, data: Mapping[str, Any], *, indent: int | None = 1, sort_keys: bool = True, bound: bool = True
) -> None:
    """Write a JSON object with its seal, completely or not at all; equal data and name give equal bytes.

    A file that is not ``bound`` may be renamed; a bound one is damaged under another name.
    """
    name = path.name if bound else ""
    atomic.write_bytes(path, sealed.json_bytes(data, indent=indent, sort_keys=sort_keys, name=name))


def read_json(path: Path, *, bound: bool = True, fix: str = "run it again, and it is made anew") -> Any:
    """Return the object in a sealed JSON file, without its seal; None if there is no such file.

    ``bound``: whether the seal includes the file's name. A document that is not bound may be a link, and may have no
    seal; ``fix``: advice of the error.
    Raises ``DamagedFileError``: the file was changed. Raises ``UserError``: it is no regular file, or cannot be read.
    """
    try:
        data = files.read_bytes(path, largest=LARGEST_RECORD, expected="a JSON file", links=not bound)
    except files.MissingFileError:
        return None
    try:
        if bound or sealed.KEY.encode() in data:
            sealed.check(data, path, path.name if bound else "")
        return sealed.json_object(data, path)
    except DamagedFileError as error:
        raise DamagedFileError(error.what, where=error.where, fix=fix) from None


def intact_json(path: Path) -> Any:
    """Return the object in a sealed JSON file; None if there is none, or a damaged one, which is logged."""
    try:
        return read_json(path)
    except UserError as error:
        log_damage(error)
        return None
