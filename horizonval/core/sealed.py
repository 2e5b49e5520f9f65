"""Seal a file by a digest inside it, so that no altered byte goes unnoticed where it is read.

A sealed file holds, somewhere, the word ``horizonval:seal`` and soon after it 64 hexadecimal digits: the sha256 of all
its bytes with those digits blanked, and of its name where it must not lie under another one. JSON has it as a key,
Parquet in the metadata of its footer, and a file that may have anything after its end (``.npz``) there. Whoever writes
leaves the digits blank and has them filled in.

Archived images have a seal of their own kind, whose header can be trusted without the pixels
(:mod:`horizonval.store.seal`).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.core.errors import DamagedFileError

KEY = "horizonval:seal"
BLANK = "0" * 64

# Between key and digits stand the signs of JSON (": ") or Parquet (type and length of the value).
_SEAL = re.compile(rb"horizonval:seal[^0-9a-z]{1,4}([0-9a-f]{64})")


class UnsealedFileError(DamagedFileError):
    """A file that ought to be sealed has no seal: an earlier version wrote it, or it was altered just there."""


def fill_in(data: bytes, name: str = "") -> bytes:
    """Return a file's bytes with the digest in place of the blank digits; ``name`` binds them to a file's name.

    Raises
    ------
    ValueError
        There is no place for a seal: a defect of the writer.
    """
    start = _place(data)
    if start is None:
        raise ValueError("no place for a seal")
    return data[:start] + _digest(data, start, name).encode() + data[start + len(BLANK) :]


def check(data: bytes, path: Path, name: str = "") -> None:
    """Raise unless a file's bytes are those that were sealed under a name; ``path`` is for the message.

    Raises
    ------
    UnsealedFileError
        There is no seal.
    DamagedFileError
        The seal is of other bytes.
    """
    start = _place(data)
    if start is None:
        raise UnsealedFileError("has no seal: an earlier version wrote it, or it was altered", where=str(path))
    if data[start : start + len(BLANK)] != _digest(data, start, name).encode():
        raise DamagedFileError("altered since it was written: it does not match its seal", where=str(path))


def with_seal(data: bytes) -> bytes:
    """Return the bytes of a file with a seal after their end."""
    return fill_in(data + _trailer())


def without_seal(data: bytes) -> bytes:
    """Return what :func:`with_seal` was given."""
    return data[: -len(_trailer())]


def json_bytes(data: Mapping[str, Any], *, indent: int | None = 1, sort_keys: bool = True, name: str = "") -> bytes:
    """Return a JSON object as the bytes of a sealed file; equal data of one name give equal bytes.

    Raises
    ------
    ValueError
        A number that is not finite.
    """
    text = json.dumps({**data, KEY: BLANK}, indent=indent, sort_keys=sort_keys, allow_nan=False) + "\n"
    return fill_in(text.encode(), name)


def json_object(data: bytes, path: Path, name: str = "") -> dict[str, Any]:
    """Return the JSON object of a sealed file's bytes, without the seal; raise as :func:`check`."""
    check(data, path, name)
    return plain_json_object(data, path)


def plain_json_object(data: bytes, path: Path) -> dict[str, Any]:
    """Return the JSON object in some bytes, whatever they are sealed with; ``DamagedFileError`` if it is none."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise DamagedFileError("not JSON", where=str(path)) from None
    if not isinstance(content, dict):
        raise DamagedFileError("not a JSON object", where=str(path))
    content.pop(KEY, None)
    return content


def _trailer() -> bytes:
    return f"{KEY}\n{BLANK}".encode()


def _place(data: bytes) -> int | None:
    """Return where the digits of the last seal begin."""
    start = data.rfind(KEY.encode())
    while start >= 0:
        if match := _SEAL.match(data, start):
            return match.start(1)
        start = data.rfind(KEY.encode(), 0, start)
    return None


def _digest(data: bytes, start: int, name: str) -> str:
    digest = hashlib.sha256(f"{name}\n".encode() if name else b"")
    digest.update(memoryview(data)[:start])
    digest.update(BLANK.encode())
    digest.update(memoryview(data)[start + len(BLANK) :])
    return digest.hexdigest()
