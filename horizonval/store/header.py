"""Headers of EXR files: parsed without the library, and with digests of the file, so that an altered byte is noticed.

The format does not detect a flipped byte in a header, or in pixels under most codecs, and opens truncated files. Two
digests in the header close these gaps::

    horizonval:body = "<length of the file>:<sha256 of every byte after the header>"
    horizonval:seal = "<sha256 of the header, the seal's own 64 characters blanked>"

The seal covers the header and, through ``horizonval:body`` in it, the rest, so that a header can be verified without
the pixels. Both are written as placeholders of the right length and filled in afterwards.

OpenEXR does not parse these headers, because it prints to the terminal on damage, opens some broken files without an
error, and must not process damaged bytes. The layout (magic number, version, then ``name NUL type NUL size value``
until an empty name) is that of *OpenEXR File Layout*, https://openexr.com/en/latest/OpenEXRFileLayout.html.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from pathlib import Path

from horizonval.core import files
from horizonval.core.errors import DamagedFileError

MAGIC = b"\x76\x2f\x31\x01"
SEAL = "horizonval:seal"
BODY = "horizonval:body"
SEAL_BLANK = "0" * 64
BODY_BLANK = "0" * 20 + ":" + "0" * 64

LARGEST = 32 * 1024**3
"""Size [bytes] of a file that is read: twenty float32 channels of the largest camera (16384 x 16384) are 21 GB."""

_HEADER_GUESS = 1 << 17  # Headers are some 10 kB; longer ones cost a second read.


class _ShortError(Exception):
    """The bytes end before the header does."""


@dataclass(frozen=True)
class Attribute:
    """One header attribute: its type, where its value starts in the file, and the value's bytes."""

    type: str
    start: int
    raw: bytes

    def text(self) -> str:
        """Return a string attribute; bytes that are no UTF-8 show as replacement signs."""
        return self.raw.decode("utf-8", "replace")

    def integer(self) -> int:
        """Return an int attribute; -1 if its size is not that of an int."""
        return int.from_bytes(self.raw, "little", signed=True) if len(self.raw) == 4 else -1


@dataclass(frozen=True)
class Header:
    """The attributes of a file's (first) header, and the header's bytes."""

    attributes: dict[str, Attribute]
    data: bytes

    def size(self, path: Path) -> tuple[int, int]:
        """Return width and height of the image [px]; ``DamagedFileError`` if the header does not say them."""
        window = self.attributes.get("dataWindow")
        if window is None or len(window.raw) != 16:
            raise DamagedFileError("the header has no data window", where=str(path))
        x_min, y_min, x_max, y_max = struct.unpack("<4i", window.raw)
        if x_max < x_min or y_max < y_min:
            raise DamagedFileError(f"the data window {x_min} {y_min} {x_max} {y_max} is empty", where=str(path))
        return x_max - x_min + 1, y_max - y_min + 1


def read_bytes(path: Path, limit: int | None = None) -> bytes:
    """Return the file's first ``limit`` bytes, all of them without a limit; ``UserError`` if it is no regular file."""
    return files.read_bytes(path, largest=LARGEST, expected="an EXR file", first=limit)


def read_header(path: Path) -> Header:
    """Parse the first header of ``path`` without its pixels; raise ``DamagedFileError`` if it is not an EXR header."""
    start = read_bytes(path, _HEADER_GUESS)
    try:
        return _parse(start, path)
    except _ShortError:
        if len(start) < _HEADER_GUESS:
            raise _short(path, len(start)) from None
    return parse_header(read_bytes(path), path)


def parse_header(data: bytes, path: Path) -> Header:
    """Parse the header at the start of ``data``; ``path`` is for the message."""
    try:
        return _parse(data, path)
    except _ShortError:
        raise _short(path, len(data)) from None


def _short(path: Path, size: int) -> DamagedFileError:
    return DamagedFileError(f"truncated: it ends inside the header, after {size} bytes", where=str(path))


def _parse(data: bytes, path: Path) -> Header:
    if not data:
        raise DamagedFileError("the file is empty", where=str(path), expected="an OpenEXR file")
    if data[:4] != MAGIC:
        raise DamagedFileError(f"not an OpenEXR file{_looks_like(data)}", where=str(path))
    attributes: dict[str, Attribute] = {}
    position = 8
    while True:
        name, position = _word(data, position, path)
        if not name:
            return Header(attributes, data[:position])
        type_, position = _word(data, position, path)
        if position + 4 > len(data):
            raise _ShortError
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        if size < 0:
            raise DamagedFileError(f"the header is damaged at attribute {name!r}", where=str(path))
        if position + size > len(data):
            raise _ShortError
        attributes[name] = Attribute(type_, position, bytes(data[position : position + size]))
        position += size


def _word(data: bytes, position: int, path: Path) -> tuple[str, int]:
    """Return the NUL-terminated word (at most 255 bytes) at ``position`` and where it ends."""
    end = data.find(b"\0", position, position + 256)
    if end < 0:
        if len(data) - position < 256:
            raise _ShortError
        raise DamagedFileError(f"the header is damaged at byte {position}", where=str(path))
    return data[position:end].decode("utf-8", "replace"), end + 1


def _looks_like(data: bytes) -> str:
    known = {b"\x89PNG": "PNG", b"\xff\xd8\xff": "JPEG", b"II*\0": "TIFF", b"MM\0*": "TIFF", b"SIMPLE": "FITS"}
    return next((f" but a {name} image" for sign, name in known.items() if data.startswith(sign)), "")


def seal_file(path: Path) -> None:
    """Fill in both placeholders of a freshly written file."""
    data = path.read_bytes()
    header = parse_header(data, path)
    body, seal = header.attributes[BODY], header.attributes[SEAL]
    start = len(header.data)
    text = f"{len(data):020d}:{hashlib.sha256(memoryview(data)[start:]).hexdigest()}".encode()
    sealed = header.data[: body.start] + text + header.data[body.start + len(text) :]
    with path.open("r+b") as file:
        for attribute, value in ((body, text), (seal, hashlib.sha256(sealed).hexdigest().encode())):
            assert len(value) == len(attribute.raw)
            file.seek(attribute.start)
            file.write(value)


def check_header(header: Header, path: Path) -> None:
    """Raise ``DamagedFileError`` unless the header is byte for byte what was written."""
    seal = header.attributes[SEAL]
    blanked = bytearray(header.data)
    blanked[seal.start : seal.start + len(seal.raw)] = SEAL_BLANK.encode()
    if seal.text() != hashlib.sha256(blanked).hexdigest():
        raise DamagedFileError("altered since it was written: the header does not match its seal", where=str(path))


def check_body(data: bytes, header: Header, path: Path) -> None:
    """Raise ``DamagedFileError`` unless everything after the (already checked) header is what was written."""
    length, _, digest = header.attributes[BODY].text().partition(":")
    if len(data) < int(length):
        raise DamagedFileError(f"truncated: {len(data)} of {int(length)} bytes", where=str(path))
    if len(data) > int(length):
        raise DamagedFileError(f"{len(data) - int(length)} foreign bytes after its end", where=str(path))
    if hashlib.sha256(memoryview(data)[len(header.data) :]).hexdigest() != digest:
        raise DamagedFileError("altered since it was written: the pixels do not match their seal", where=str(path))
