"""Content-addressed folder of frames and detector images.

The address of an entry is the sha256 of its file's bytes; the file lies at ``ab/<address>.exr``, where ``ab`` are the
address's first two digits. Because equal content gives equal bytes (:mod:`horizonval.archive.exr`), a frame rendered
twice is stored once, and two processes that add at the same time can only write the same bytes to the same name: no
lock is needed. Everything is written beside its place and renamed, so that a crash leaves a temporary file, never a
broken entry.

Files at the root named ``index.*`` are tolerated: they are made from the headers and may be made again.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from horizonval.archive import exr
from horizonval.errors import DamagedFileError, UserError
from horizonval.frame import DetectorImage, Frame

_ADDRESS = re.compile(r"[0-9a-f]{64}")
_TEMPORARY = ".tmp"


@dataclass(frozen=True)
class Entry:
    """One stored file, described by its header. ``kind = "damaged"`` leaves the rest empty."""

    address: str
    kind: Literal["frame", "image", "damaged"]
    size_bytes: int
    scene: str = ""
    scene_id: str = ""
    camera: str = ""
    bands: tuple[str, ...] = ()


@dataclass(frozen=True)
class Finding:
    """One thing in the folder that should not be so; ``message`` is one line."""

    path: Path
    problem: Literal["damaged", "misplaced", "leftover", "foreign"]
    message: str


class Store:
    """The folder ``root``; made on the first addition."""

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(root)

    def add_frame(self, frame: Frame) -> str:
        """Store ``frame`` and return its address; an intact entry stays untouched, a damaged one is mended."""
        return self._add(lambda path: exr.write_frame(path, frame))

    def add_image(self, image: DetectorImage) -> str:
        """Store ``image`` and return its address; as :meth:`add_frame`."""
        return self._add(lambda path: exr.write_image(path, image))

    def _add(self, write: Callable[[Path], None]) -> str:
        try:
            self.root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot be made: {error.strerror}", where=str(self.root)) from None
        temporary = self.root / f".{secrets.token_hex(8)}{_TEMPORARY}"
        try:
            write(temporary)
            address = _sha256(temporary)
            place = self.path(address)
            if not place.is_file() or _sha256(place) != address:
                place.parent.mkdir(exist_ok=True)
                temporary.replace(place)
        finally:
            temporary.unlink(missing_ok=True)
        return address

    def path(self, address: str) -> Path:
        """Return where the entry with this address lies (or would lie)."""
        if not _ADDRESS.fullmatch(address):
            raise UserError(f"{address!r} is no address", where=str(self.root), expected="64 hexadecimal digits")
        return self.root / address[:2] / f"{address}.exr"

    def __contains__(self, address: str) -> bool:
        return self.path(address).is_file()

    def read_frame(self, address: str) -> Frame:
        """Read and verify a frame; ``UserError`` if there is none, ``DamagedFileError`` if it is not what was added."""
        return exr.read_frame(self._verified(address))

    def read_image(self, address: str) -> DetectorImage:
        """Read and verify a detector image; errors as :meth:`read_frame`."""
        return exr.read_image(self._verified(address))

    def _verified(self, address: str) -> Path:
        path = self.path(address)
        if not path.is_file():
            raise UserError(f"no entry {address}", where=str(self.root), fix="see `horizonval archive ls`")
        if _sha256(path) != address:
            raise DamagedFileError("its bytes are not those of its address", where=str(path))
        return path

    def entries(self) -> Iterator[Entry]:
        """Yield every entry in the order of addresses, read from the headers alone."""
        for path in self._places():
            yield _describe(path)

    def verify(self) -> list[Finding]:
        """Read everything and return what is wrong, in the order of paths; nothing is changed."""
        findings = []
        for path in sorted(p for p in self.root.rglob("*") if not p.is_dir()):
            if finding := self._examine(path):
                findings.append(finding)
        return findings

    def _places(self) -> list[Path]:
        return sorted(p for p in self.root.glob("??/*.exr") if _ADDRESS.fullmatch(p.stem) and p == self.path(p.stem))

    def _examine(self, path: Path) -> Finding | None:
        shown = path.relative_to(self.root)
        if path.name.endswith(_TEMPORARY):
            return Finding(path, "leftover", f"{shown}: left by an interrupted write; delete it")
        if path.parent == self.root and path.name.startswith("index."):
            return None
        if path.suffix != ".exr" or not _ADDRESS.fullmatch(path.stem) or not path.is_file():
            return Finding(path, "foreign", f"{shown}: does not belong here")
        if (place := self.path(path.stem)) != path:
            return Finding(path, "misplaced", f"{shown}: belongs at {place.relative_to(self.root)}")
        try:
            reason = _damage(path)
        except UserError as error:
            reason = error.what
        return Finding(path, "damaged", f"{shown}: {reason}") if reason else None


def _damage(path: Path) -> str:
    """Return why the file is not what was added, or nothing; a reading error says more and goes first."""
    if exr.kind(path) == "image":
        exr.read_image(path)
    else:
        exr.read_frame(path)
    return "" if _sha256(path) == path.stem else "its bytes are not those of its address"


def _describe(path: Path) -> Entry:
    size = path.stat().st_size
    try:
        header = exr.read_header(path)
    except DamagedFileError:
        return Entry(address=path.stem, kind="damaged", size_bytes=size)
    truth = header["truth"]
    return Entry(
        address=path.stem,
        kind=header["kind"],
        size_bytes=size,
        scene=truth.get("scene", {}).get("scene", {}).get("name", ""),
        scene_id=truth.get("scene_id", ""),
        camera=truth.get("camera", {}).get("camera", {}).get("name", ""),
        bands=tuple(header["bands"]),
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
