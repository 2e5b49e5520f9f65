"""The cache of expensive tables, and its sealed files.

Results do not depend on the cache: what cannot be written is computed again the next time, and a damaged file is
replaced, which is logged. A file of another form (keys, shapes or types of another version) counts as damaged.
"""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from horizonval.core import atomic, files, sealed
from horizonval.core.environment import warn_once
from horizonval.core.errors import DamagedFileError, UserError, misfit, printable

LARGEST = 1 << 34
"""Size of a file that is kept [bytes]."""

T = TypeVar("T")

_LOG = logging.getLogger("horizonval")


def log_damage(error: UserError) -> None:
    """Log that a file is not what was written, and is made anew."""
    where = f"{error.where}: " if error.where else ""
    _LOG.warning("horizonval: %s; it is made anew", printable(f"{where}{error.what}"))


def keep_json(path: Path, content: Mapping[str, Any]) -> None:
    """Keep a JSON object in a cache, if that is possible."""
    _keep(path, sealed.json_bytes(content, indent=None, sort_keys=False))


def cached_json(path: Path, build: Callable[[dict[str, Any]], T]) -> T | None:
    """Return what ``build`` makes of the JSON object in a cache; None if there is none, or a damaged one.

    ``build`` need not check: a key that is missing, or a type that it cannot use, is damage, which is logged.
    """
    return _built(path, sealed.json_object, build)


def keep_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Keep arrays by name in a cache, if that is possible."""
    _keep(path, _npz(arrays, compressed=False))


def cached_arrays(path: Path, build: Callable[[dict[str, np.ndarray]], T]) -> T | None:
    """Return what ``build`` makes of the arrays in a cache (:func:`array_of`); otherwise as :func:`cached_json`."""
    return _built(path, _arrays, build)


@contextlib.contextmanager
def making(path: Path) -> Iterator[None]:
    """Hold the making of a cache's file: other processes that want to make it wait, and then find it.

    They must look for the file again inside. Where locks do not work nobody waits, and several make the same file.
    """
    with contextlib.ExitStack() as held:
        with contextlib.suppress(ImportError, OSError, UserError):
            import fcntl

            atomic.make_folder(path.parent)
            lock = path.with_suffix(".lock")
            fcntl.flock(held.enter_context(lock.open("w")), fcntl.LOCK_EX)
            held.callback(lock.unlink, missing_ok=True)
        yield


def array_of(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], dtype: type = np.float64) -> Any:
    """Return an array by name; ``ValueError`` if it has another shape or type, ``KeyError`` if there is none."""
    found = arrays[name]
    if found.shape != shape or found.dtype != dtype:
        raise ValueError(f"its array {name} has shape {found.shape} and type {found.dtype}, not {shape}")
    return found


def keep_newest(folder: Path, count: int) -> None:
    """Remove all but the files of a cache's folder that were written last; what other processes removed is gone."""
    written: list[tuple[float, Path]] = []
    with contextlib.suppress(OSError):
        for path in folder.glob("*.npz"):
            with contextlib.suppress(OSError):
                written.append((path.stat().st_mtime, path))
    for _, path in sorted(written, reverse=True)[count:]:
        with contextlib.suppress(OSError):
            path.unlink()


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name to a sealed and compressed ``.npz`` file, whole or not at all."""
    atomic.write_bytes(path, _npz(arrays, compressed=True))


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a file that :func:`write_arrays` wrote.

    Raises ``DamagedFileError`` if the file was changed, ``UserError`` if it is missing or cannot be read.
    """
    return _arrays(_checked(path), path)


def is_intact(path: Path) -> bool:
    """Whether a file of arrays is there and is what was written; one that is damaged is logged."""
    return _cached(path) is not None


def _keep(path: Path, data: bytes) -> None:
    try:
        atomic.make_folder(path.parent)
        atomic.write_bytes(path, data)
    except atomic.WriteError as error:
        warn_once(f"{path.parent} cannot be written ({error.reason})")


def _built(path: Path, decode: Callable[[bytes, Path], Any], build: Callable[[Any], T]) -> T | None:
    data = _cached(path)
    if data is None:
        return None
    try:
        return build(decode(data, path))
    except DamagedFileError as error:
        log_damage(error)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
        log_damage(DamagedFileError("has the form of another version", where=str(path)))
    return None


def _cached(path: Path) -> bytes | None:
    try:
        return _checked(path)
    except files.MissingFileError:
        return None
    except UserError as error:
        log_damage(error)
        return None


def _checked(path: Path) -> bytes:
    data = files.read_bytes(path, largest=LARGEST)
    sealed.check(data, path)
    return data


def _npz(arrays: Mapping[str, np.ndarray], *, compressed: bool) -> bytes:
    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)  # type: ignore[arg-type]
    return sealed.fill_in(stream.getvalue() + sealed.TRAILER)


def _arrays(data: bytes, path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(io.BytesIO(data[: -len(sealed.TRAILER)]), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (ValueError, NotImplementedError) as error:  # Its bytes are those that were written, by another numpy.
        raise DamagedFileError(f"{misfit(error)}, and cannot be read as arrays", where=str(path)) from error
