"""NumPy arrays (``.npy``, ``.npz``) and tables of numbers (CSV) as pictures.

An array of shape (H, W) or (H, W, 1) is grey, (H, W, 3) and (H, W, 4) are colours. Of any other with three dimensions
each plane is a picture. Pickled objects are not read.

A table has one line for each row of the image, upper row first; numbers are separated by commas, semicolons, tabs or
spaces, and lines of words may come first. Blank lines separate several images. Values are taken as they are: degrees
Celsius may be negative.
"""

from __future__ import annotations

import contextlib
import re
import zipfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files, memory
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.readers.part import EXPECTED, MAX_FILE_BYTES, Part, Pixels, full_scale_of, native

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
LARGEST_TABLE_BYTES = 256 * 1024**2

Opened = Callable[[], AbstractContextManager[IO[bytes]]]

_CHANNELS = (1, 3, 4)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"(^|[;\s])[+-]?\d+,\d+([;\s]+[+-]?\d+,\d+)+[;\s]*$")


def parts_of_npy(path: Path) -> list[Part]:
    """Return the pictures in a ``.npy`` file; ``UserError`` for an array that is no picture, or damage."""
    opened = partial(files.open_file, path, expected=EXPECTED, largest=MAX_FILE_BYTES)
    found, kind = _parts_of(opened, path.stat().st_size, "", path)
    if not found:
        expected = "real numbers of shape (H, W) or (H, W, 3)"
        raise UserError(f"its array of {kind} is no image", where=str(path), expected=expected)
    return found


def parts_of_npz(path: Path) -> list[Part]:
    """Return the pictures in a ``.npz`` file, named as its arrays; other arrays are left out."""
    with _archive(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
    if not members:
        raise UserError("is a ZIP archive without arrays", where=str(path), expected=EXPECTED)
    found = []
    for info in members:
        name = info.filename
        found += _parts_of(partial(_member, path, name), info.file_size, name.removesuffix(".npy"), path)[0]
    return found


@contextlib.contextmanager
def _member(path: Path, name: str) -> Iterator[IO[bytes]]:
    with _archive(path) as archive, archive.open(name) as file:
        yield file


@contextlib.contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with (
            files.open_file(path, expected=EXPECTED, largest=MAX_FILE_BYTES) as file,
            zipfile.ZipFile(file) as archive,
        ):
            yield archive
    except UserError:
        raise
    except (*files.UNREADABLE_ARRAYS, NotImplementedError):
        raise DamagedFileError("not arrays that can be read: damaged or encrypted", where=str(path)) from None


def _parts_of(opened: Opened, size: int, name: str, path: Path) -> tuple[list[Part], str]:
    """Return the pictures in one array by its head, none if it holds no image, and the array's kind in words."""
    with opened() as file:
        shape, _, dtype, head = _head(file, path)
    kind = f"{dtype.name} of shape {'x'.join(map(str, shape)) or '()'}"
    if dtype.kind not in "buif" or len(shape) not in (2, 3) or min(shape) < 1:
        return [], kind
    count = int(np.prod([float(n) for n in shape])) * dtype.itemsize
    if head + count > size:
        raise DamagedFileError(f"truncated: {size - head} of {count} bytes of an array", where=str(path))
    is_colour = len(shape) == 3 and shape[2] in _CHANNELS
    height, width = shape[-2:] if not is_colour else shape[:2]

    def part(plane: int | None) -> Part:
        named = name if plane is None else f"{name}:{plane + 1}".lstrip(":")
        return Part(width, height, kind, lambda: _load(opened, count, plane, path), named)

    return [part(plane) for plane in ([None] if len(shape) == 2 or is_colour else range(shape[0]))], kind


def _head(file: IO[bytes], path: Path) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return shape, order, type and the bytes of the head of an array."""
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, fortran, dtype = read(file)
        head = file.tell()
    except Exception:
        # The head is Python text, and a damaged one fails in any way.
        raise DamagedFileError("not an array that can be read: a damaged head", where=str(path)) from None
    if dtype.hasobject:
        raise UserError("holds Python objects, which are not read", where=str(path), expected="an array of numbers")
    return shape, fortran, dtype, head


def _load(opened: Opened, size: int, plane: int | None, path: Path) -> Pixels:
    memory.refuse_beyond(2.0 * size, "the whole array", where=str(path))
    with opened() as file:
        shape, fortran, dtype, _ = _head(file, path)
        data = file.read(size)
    if len(data) != size:
        raise DamagedFileError("truncated array", where=str(path))
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
    values = native(values if plane is None else values[plane])
    return Pixels(values, 1.0 if values.dtype.kind == "b" else full_scale_of(values.dtype))


def parts_of_table(path: Path) -> list[Part] | None:
    """Return the images in a table of numbers; None if a file is no such table."""
    if path.stat().st_size > LARGEST_TABLE_BYTES:
        return None
    try:
        lines = files.read_text(path, largest=LARGEST_TABLE_BYTES, expected=EXPECTED).splitlines()
    except files.UnfitFileError:
        return None
    memory.refuse_beyond(24.0 * path.stat().st_size, "reading a table of numbers", where=str(path))
    separator = next((s for s in (";", "\t", ",") if any(s in line for line in lines[-3:])), None)
    blocks: list[list[NDArray[np.float64]]] = [[]]
    for number, line in enumerate(lines, 1):
        text = line.partition("#")[0].strip()
        if not text:
            blocks += [[]] if blocks[-1] else []
            continue
        cells = [cell.strip().strip('"') for cell in text.split(separator)]
        if separator is not None and cells[-1] == "":
            cells.pop()
        numbers = [cell for cell in cells if _NUMBER.fullmatch(cell)]
        if len(numbers) == len(cells):
            if blocks[-1] and blocks[-1][0].size != len(cells):
                what, expected = f"{len(cells)} numbers", f"{blocks[-1][0].size}, as in the rows above"
                raise UserError(what, where=f"{path}: line {number}", expected=expected)
            blocks[-1].append(np.array(cells, dtype=np.float64))
        elif _DECIMAL_COMMA.search(text):
            where, what = f"{path}: line {number}", "numbers with a decimal comma"
            raise UserError(what, where=where, expected="a decimal point", fix="save the table with decimal points")
        elif any(blocks) or len(numbers) >= len(cells) / 2:
            what = "is no row of numbers alone"
            raise UserError(what, where=f"{path}: line {number}", expected="numbers in every cell")
    blocks = [block for block in blocks if block]
    if not blocks or max(len(block) * block[0].size for block in blocks) < 2:
        return None

    def part(block: list[NDArray[np.float64]]) -> Part:
        return Part(block[0].size, len(block), "numbers", lambda: Pixels(np.stack(block)))

    return [part(block) for block in blocks]
