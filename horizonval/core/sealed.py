"""Files with a digest of themselves inside, so that an altered byte is noticed where they are read.

A sealed file holds the word ``horizonval:seal`` and soon after it 64 hexadecimal digits: the sha256 of all its bytes
with those digits blanked, and of its name where it must not lie under another one. JSON has it as a key, Parquet in the
metadata of its footer, and a file that may have anything after its end (``.npz``) there. Writers leave the digits blank
and have them filled in. Archived images have digests in their headers (:mod:`horizonval.store.header`).
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
TRAILER = f"{KEY}\n{BLANK}".encode()
"""Blank seal after the end of a file, of a format that allows it."""

# Between key and digits stand the signs of JSON (": ") or Parquet (type and length of the value).
_SEAL = re.compile(rb"horizonval:seal[^0-9a-z]{1,4}([0-9a-f]{64})")


def fill_in(data: bytes, name: str = "") -> bytes:
    """Return a file's bytes with the digest in place of the blank digits; ``name`` binds them to a file's name.

    Raises ``ValueError`` if there is no blank seal: a defect of the writer.
    """
    start = _place(data)
    if start is None:
        raise ValueError("no place for a seal")
    return data[:start] + _digest(data, start, name).encode() + data[start + len(BLANK) :]


def check(data: bytes, path: Path, name: str = "") -> None:
    """Raise ``DamagedFileError`` unless bytes are those that were sealed under a name; ``path`` is for the message."""
    start = _place(data)
    if start is None:
        raise DamagedFileError("has no seal: not written by horizonval, or altered", where=str(path))
    if data[start : start + len(BLANK)] != _digest(data, start, name).encode():
        raise DamagedFileError("altered since it was written: it does not match its seal", where=str(path))


def json_bytes(data: Mapping[str, Any], *, indent: int | None = 1, sort_keys: bool = True, name: str = "") -> bytes:
    """Return a JSON object as the bytes of a sealed file; equal data and name give equal bytes.

    Raises ``ValueError`` for a number that is not finite.
    """
    text = json.dumps({**data, KEY: BLANK}, indent=indent, sort_keys=sort_keys, allow_nan=False) + "\n"
    return fill_in(text.encode(), name)


def json_object(data: bytes, path: Path) -> dict[str, Any]:
    """Return the JSON object in bytes that were checked, without the seal; ``DamagedFileError`` if there is none."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise DamagedFileError("not JSON", where=str(path)) from None
    if not isinstance(content, dict):
        raise DamagedFileError("not a JSON object", where=str(path))
    content.pop(KEY, None)
    return content


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
