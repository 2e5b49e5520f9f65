"""What the header of one of our files says, with units, as plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from horizonval.store import exr, seal
from horizonval.store.attributes import UNITS

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
    attributes = seal.read_header(path).attributes
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


def _value(attribute: seal.Attribute) -> Any:
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
