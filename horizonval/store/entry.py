"""Where an entry of an archive lies, and what its header says of it.

The address of an entry is the sha256 of its bytes; the file lies at ``ab/<address>.exr``, where ``ab`` are the first
two digits of the address.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store import exr
from horizonval.store.attributes import UNITS
from horizonval.store.header import Attribute, read_header

_ADDRESS = re.compile(r"[0-9a-f]{64}")
_FOLDER = re.compile(r"[0-9a-f]{2}")
INDEX_PREFIX = "index."
"""Files at the root with such names are made from the headers and may be made again."""


@dataclass(frozen=True)
class StoreEntry:
    """One stored file, described by its header.

    ``kind``: ``"frame"``, ``"image"``, ``"damaged"`` (with a size only) or ``"missing"`` (in the index only);
    ``scene``, ``camera``, ``head``: names, empty where there are none; ``scene_id``: digest that identifies the scene;
    ``schema``: version of the file's layout; ``epoch_utc``: ISO 8601; ``seed``: of an image's noise, as text for
    integers of any size; ``content``: digest of pixels and truth, independent of the compression.
    """

    address: str
    kind: Literal["frame", "image", "damaged", "missing"]
    size_bytes: int
    scene: str = ""
    scene_id: str = ""
    camera: str = ""
    bands: tuple[str, ...] = ()
    head: str = ""
    schema: int = 0
    width: int = 0
    height: int = 0
    epoch_utc: str = ""
    seed: str = ""
    content: str = ""


def is_address(text: str) -> bool:
    """Whether a text is an address: 64 lower-case hexadecimal digits."""
    return _ADDRESS.fullmatch(text) is not None


def place(root: Path, address: str) -> Path:
    """Return where the entry with this address lies (or would lie); raise ``UserError`` if it is none."""
    if not is_address(address):
        raise UserError(f"{address!r} is no address", where=str(root), expected="64 hexadecimal digits")
    return root / address[:2] / f"{address}.exr"


def places(root: Path) -> list[Path]:
    """Return regular files at the positions of entries, by address, unopened; links do not count."""
    addresses = []
    for folder in _scanned(root):
        if _FOLDER.fullmatch(folder.name) and folder.is_dir(follow_symlinks=False):
            for file in _scanned(folder.path):
                address, ending = os.path.splitext(file.name)
                if ending == ".exr" and is_address(address) and address[:2] == folder.name and _is_regular(file):
                    addresses.append(address)
    return [place(root, address) for address in sorted(addresses)]


def _scanned(folder: str | os.PathLike[str]) -> list[os.DirEntry[str]]:
    """Return what a folder holds; nothing if it is none, or may not be read."""
    try:
        with os.scandir(folder) as content:
            return list(content)
    except OSError:
        return []


def _is_regular(file: os.DirEntry[str]) -> bool:
    try:
        return file.is_file(follow_symlinks=False)
    except OSError:
        return False


def describe(path: Path) -> StoreEntry:
    """Return an entry from its header, also if damaged; ``UserError`` if the file is missing or unreadable."""
    with files.open_file(path, expected="an entry", links=False) as file:
        size = os.fstat(file.fileno()).st_size
    try:
        header = exr.read_header(path)
        return _entry(path.stem, size, header)
    except (DamagedFileError, AttributeError, KeyError, TypeError, ValueError, OverflowError):
        return StoreEntry(address=path.stem, kind="damaged", size_bytes=size)


def _entry(address: str, size: int, header: dict[str, Any]) -> StoreEntry:
    truth = header["truth"]
    scene, camera = truth.get("scene", {}), truth.get("camera", {})
    epoch = str(truth.get("epoch_utc", ""))
    entry = StoreEntry(
        address=address,
        kind=header["kind"],
        size_bytes=size,
        scene=scene.get("scene", {}).get("name", ""),
        scene_id=truth.get("scene_id", ""),
        camera=camera.get("camera", {}).get("name", ""),
        bands=tuple(header["bands"]),
        head=scene.get("camera", {}).get("head") or "",
        schema=header["schema"],
        width=header["width"],
        height=header["height"],
        epoch_utc=datetime.fromisoformat(epoch).astimezone(UTC).isoformat() if epoch else "",
        seed=str(header.get("observation", {}).get("seed", "")),
        content=header["sha256"],
    )
    for text in (entry.scene, entry.scene_id, entry.camera, entry.head, entry.seed):
        if not isinstance(text, str):
            raise TypeError(f"{type(text).__name__} where a name should be")
        text.encode()  # No table holds text without UTF-8; it raises.
    return entry


_NUMBERS = {
    "float": "<f4", "double": "<f8", "int": "<i4", "v2f": "<f4", "v3f": "<f4", "v2d": "<f8", "v3d": "<f8",
    "m44f": "<f4", "m44d": "<f8", "box2i": "<i4", "floatvector": "<f4",
}  # fmt: skip
_OWN = "horizonval:"
_LONG = ("horizonval:truth", "horizonval:render", "horizonval:observation")
_SEALS = ("horizonval:seal", "horizonval:body")
_FORMAT = ("channels", "compression", "dataWindow", "displayWindow", "lineOrder", "type")


def shown(path: Path) -> dict[str, Any]:
    """Return a verified header: ``file``, ``standard``, ``horizonval`` (each name to value and unit), ``channels``.

    ``truth`` and ``render`` or ``observation`` are what was stored. Raises as :func:`.exr.read_header`.
    """
    content = exr.read_header(path)
    attributes = read_header(path).attributes
    values = {name: [_value(attribute), UNITS.get(name, "")] for name, attribute in sorted(attributes.items())}
    kept = {name: value for name, value in values.items() if name not in (*_LONG, *_SEALS, *_FORMAT)}
    size = path.stat().st_size
    return {
        "file": {
            "path": [str(path), ""],
            "kind": [content["kind"], ""],
            "size": [f"{content['width']} x {content['height']}", "px"],
            "bytes": [size, ""],
        },
        "standard": {name: value for name, value in kept.items() if not name.startswith(_OWN)},
        "horizonval": {name: value for name, value in kept.items() if name.startswith(_OWN)},
        "channels": _channels(attributes["channels"].raw),
        "truth": content["truth"],
        **{key: content[key] for key in ("render", "observation") if key in content},
    }


def _value(attribute: Attribute) -> Any:
    if attribute.type in _NUMBERS:
        values = np.frombuffer(attribute.raw, dtype=_NUMBERS[attribute.type])
        # The shortest text that is the same number, in the attribute's own precision; JSON has no infinity.
        plain = [float(str(v)) if np.isfinite(v) else str(v) for v in values]
        numbers = [int(v) for v in values] if attribute.type in ("int", "box2i") else plain
        return numbers[0] if len(numbers) == 1 else numbers
    if attribute.type == "string":
        return attribute.text()
    if attribute.type == "stringvector":
        return _strings(attribute.raw)
    return f"({attribute.type}, {len(attribute.raw)} bytes)"


def _strings(raw: bytes) -> list[str]:
    found, position = [], 0
    while position + 4 <= len(raw):
        length = int.from_bytes(raw[position : position + 4], "little")
        found.append(raw[position + 4 : position + 4 + length].decode("utf-8", "replace"))
        position += 4 + length
    return found


def _channels(raw: bytes) -> list[str]:
    """Return the names in a channel list: each ends with a zero byte and 16 bytes of its properties."""
    found, position = [], 0
    while position < len(raw) and raw[position] != 0:
        end = raw.index(0, position)
        found.append(raw[position:end].decode("utf-8", "replace"))
        position = end + 17
    return found
