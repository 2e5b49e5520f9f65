"""Content-addressed folder of frames and detector images.

Equal content gives equal bytes (:mod:`horizonval.store.exr`), so a frame rendered twice is stored once, and two
processes that add at the same time can only write the same bytes to the same name: no lock is needed. Writing is
atomic: a crash leaves a temporary file, never a broken entry.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError, command_line
from horizonval.core.progress import Progress
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.store import exr
from horizonval.store.entry import StoreEntry, describe, place, places
from horizonval.store.index import Index
from horizonval.store.verify import Finding, verify_archive


class Store:
    """The archive in the folder ``root``, made on the first addition; ``read_only`` never writes its index."""

    def __init__(self, root: str | os.PathLike[str], *, read_only: bool = False) -> None:
        self.root = Path(root)
        self.index = Index(self.root, read_only=read_only)

    def add_frame(self, frame: RadianceFrame) -> str:
        """Store ``frame`` and return its address; an intact entry stays untouched, a damaged one is mended."""
        return self._add(lambda path: exr.write_frame(path, frame))

    def add_image(self, image: DetectorImage) -> str:
        """Store ``image`` and return its address; as :meth:`add_frame`."""
        return self._add(lambda path: exr.write_image(path, image))

    def _add(self, write: Callable[[Path], None]) -> str:
        atomic.make_folder(self.root)
        with atomic.temporary_in(self.root) as temporary:
            write(temporary)
            address = files.sha256_of(temporary, links=False)
            path = self.path(address)
            if not self.is_intact(address):
                self._make_way(path)
                atomic.move(temporary, path)
        return address

    def _make_way(self, path: Path) -> None:
        """Make an entry's folder; remove a file, FIFO or link (not its target) in the way, refuse a folder."""
        try:
            if files.kind_at(path.parent) not in ("a folder", ""):
                path.parent.unlink()
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise UserError(f"cannot be made: {error.strerror}", where=str(path.parent)) from None
        if files.kind_at(path) == "a folder" and any(path.iterdir()):
            raise UserError("is a folder", where=str(path), expected="an entry of the archive", fix="move it away")

    def path(self, address: str) -> Path:
        """Return where the entry with this address lies (or would lie)."""
        return place(self.root, address)

    def is_intact(self, address: str) -> bool:
        """Whether an entry is there and is what was added."""
        try:
            return self._digest(address) == address
        except UserError:
            return False

    def _digest(self, address: str) -> str:
        """Return the digest of the file at an entry's place; what lies beyond a link is none of ours."""
        path = self.path(address)
        if (kind := files.kind_at(path.parent)) not in ("a folder", ""):
            raise files.UnfitFileError(f"is {kind}", where=str(path.parent), expected="a folder of the archive")
        return files.sha256_of(path, links=False)

    def __contains__(self, address: str) -> bool:
        path = self.path(address)
        return files.kind_at(path.parent) == "a folder" and files.kind_at(path) == "a file"

    def read_frame(self, address: str) -> RadianceFrame:
        """Read and verify a frame; ``UserError`` if there is none, ``DamagedFileError`` if it is not what was added."""
        return exr.read_frame(self._verified(address))

    def read_image(self, address: str) -> DetectorImage:
        """Read and verify a detector image; errors as :meth:`read_frame`."""
        return exr.read_image(self._verified(address))

    def _verified(self, address: str) -> Path:
        try:
            digest = self._digest(address)
        except files.MissingFileError:
            raise UserError(
                f"no entry {address}", where=str(self.root), fix=f"see {command_line('archive', 'ls', self.root)}"
            ) from None
        path = self.path(address)
        if digest != address:
            raise DamagedFileError("its bytes are not those of its address", where=str(path))
        return path

    def is_one(self) -> bool:
        """Whether the folder looks like an archive: an entry's folder, an index, or nothing at all in it."""
        try:
            inside = os.listdir(self.root)
        except OSError as error:
            raise UserError(f"cannot be read: {error.strerror}", where=str(self.root)) from None
        hexadecimal = re.compile("[0-9a-f]{2}")
        return not inside or self.index.path.name in inside or any(hexadecimal.fullmatch(name) for name in inside)

    def find(self, start: str) -> str:
        """Return the one address that begins so; ``UserError`` if there is none, or several."""
        found = [path.stem for path in places(self.root) if path.stem.startswith(start.lower())]
        if len(found) != 1 or not start:
            what = (
                f"{len(found)} entries begin with {start!r}" if start and found else f"no entry begins with {start!r}"
            )
            raise UserError(what, where=str(self.root), fix=f"see {command_line('archive', 'ls', self.root)}")
        return found[0]

    def count(self) -> int:
        """Return how many files lie where an entry would."""
        return len(places(self.root))

    def entries(self) -> Iterator[StoreEntry]:
        """Yield every entry in the order of addresses, read from the headers alone."""
        for path in places(self.root):
            yield describe(path)

    def verify(self, named: Mapping[str, str] | None = None, progress: Progress | None = None) -> list[Finding]:
        """Read everything and return what is wrong; see :func:`horizonval.store.verify.verify_archive`."""
        return verify_archive(self.root, named, progress)
