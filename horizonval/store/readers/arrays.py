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
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files, memory
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.readers.part import EXPECTED, MAX_FILE_BYTES, Part, Pixels, full_scale_of, native

NPY_MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
LARGEST_TABLE_BYTES = 256 * 1024**2

_CHANNELS = (1, 3, 4)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"(^|[;\s])[+-]?\d+,\d+([;\s]+[+-]?\d+,\d+)+[;\s]*$")


def parts_of_npy(path: Path) -> list[Part]:
    """Return the pictures in a ``.npy`` file; ``UserError`` for an array that is no picture, or damage."""
    size = path.stat().st_size

    @contextlib.contextmanager
    def opened() -> Iterator[IO[bytes]]:
        with files.open_file(path, expected=EXPECTED, largest=MAX_FILE_BYTES) as file:
            yield file

    found = _parts_of(opened, size, "", path)
    if not found:
        with opened() as file:
            shape, _, dtype, _ = _head(file, path)
        what = f"its array of {dtype.name} and of shape {shape} is no image"
        raise UserError(what, where=str(path), expected="real numbers of shape (H, W) or (H, W, 3)")
    return found


def parts_of_npz(path: Path) -> list[Part]:
    """Return the pictures in a ``.npz`` file, named as its arrays; other arrays are left out."""
    found = []
    with _archive(path) as archive:
        members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
        if not members:
            raise UserError("is a ZIP archive without arrays", where=str(path), expected=EXPECTED)
        for info in members:

            @contextlib.contextmanager
            def opened(name: str = info.filename) -> Iterator[IO[bytes]]:
                with _archive(path) as again, again.open(name) as file:
                    yield file

            found += _parts_of(opened, info.file_size, info.filename.removesuffix(".npy"), path)
    return found


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


def _parts_of(opened: Any, size: int, name: str, path: Path) -> list[Part]:
    """Return the pictures in one array by its head, or nothing if it holds none."""
    with opened() as file:
        shape, _, dtype, head = _head(file, path)
    if dtype.kind not in "buif" or len(shape) not in (2, 3) or min(shape) < 1:
        return []
    count = int(np.prod([float(n) for n in shape])) * dtype.itemsize
    if head + count > size:
        raise DamagedFileError(f"truncated: {size - head} of {count} bytes of an array", where=str(path))
    is_colour = len(shape) == 3 and shape[2] in _CHANNELS
    height, width = shape[-2:] if not is_colour else shape[:2]
    kind = f"{dtype.name} of shape {'x'.join(str(n) for n in shape)}"

    def part(plane: int | None) -> Part:
        named = name if plane is None else f"{name}:{plane + 1}".lstrip(":")
        return Part(width, height, kind, lambda: _load(opened, count, plane, path), named)

    return [part(None)] if len(shape) == 2 or is_colour else [part(plane) for plane in range(shape[0])]


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


def _load(opened: Any, size: int, plane: int | None, path: Path) -> Pixels:
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
