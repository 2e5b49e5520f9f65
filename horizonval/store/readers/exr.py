"""EXR pictures of other programs: several parts, layers, windows.

The picture of a part is channel ``Y``, else ``R G B`` (their Rec. 709 luminance), else its only channel except ``A``.
Without layer names these are the part's picture, and what else it holds accompanies it (a depth, a mask); otherwise
every layer is a picture. Opacity is premultiplied in this format.

The display window is the camera's image, the data window what is stored of it. A data window that covers the display
window is cut to it. A smaller one is a crop, and is read if the camera file has its size.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from horizonval.core import memory
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store import exr
from horizonval.store import header as exr_header
from horizonval.store.quiet import silenced
from horizonval.store.readers.part import Part, Pixels, of_bands

Size = tuple[int, int]
Window = tuple[int, int, int, int]
"""First column and row, last column and row."""

MAGIC = exr_header.MAGIC

_NO_LIGHT = ("Z", "ZBACK", "DEPTH", "ID", "U", "V", "N", "P", "X")
"""Usual names of channels of geometry: depth, objects, texture, normals, positions."""
_DEEP = 0x800
_DEEP_TYPES = ("deepscanline", "deeptile")


def parts(path: Path, camera: Size | None) -> list[Part]:
    """Return the pictures of an EXR file; of a part with a data window the one that fits the camera's size."""
    if exr.kind(path) != "foreign":
        own = exr.read_header(path)
        return of_bands(own["width"], own["height"], own["bands"], lambda: exr.read(path))
    found = []
    for number, header in enumerate(_headers(path)):
        name = header.attributes["name"].text() if "name" in header.attributes else ""
        pictures = _pictures(_channels(header, path))
        others = [label for label, channels, main in pictures if not main and _is_light(channels)]
        note = f"its layer without a name is used, not {', '.join(others)}; --part takes another" if others else ""
        for label, channels, main in pictures:
            whole = name if name and len(pictures) == 1 else ".".join(word for word in (name, label) if word)
            found.append(_part(path, number, header, whole, channels, main, camera, note if main else ""))
    return found


def _headers(path: Path) -> list[exr_header.Header]:
    """Return the headers of all parts; deep files are refused."""
    headers, flags = exr_header.read_headers(path)
    for header in headers:
        kind = header.attributes["type"].text() if "type" in header.attributes else ""
        if flags & _DEEP or kind in _DEEP_TYPES:
            what = "holds deep pixels, which have several samples each"
            raise UserError(what, where=str(path), fix="flatten it in the program that made it")
    return headers


def _channels(header: exr_header.Header, path: Path) -> dict[str, Size]:
    """Return the channels of a part with their sampling, one of so many columns and rows."""
    if (attribute := header.attributes.get("channels")) is None:
        raise DamagedFileError("the header has no channels", where=str(path))
    found, raw, position = {}, attribute.raw, 0
    while position < len(raw) and raw[position]:
        end = raw.find(b"\0", position)
        if end < 0 or end + 17 > len(raw):
            raise DamagedFileError("the list of channels is damaged", where=str(path))
        found[raw[position:end].decode("utf-8", "replace")] = struct.unpack_from("<ii", raw, end + 9)
        position = end + 17
    return found


def _pictures(channels: dict[str, Size]) -> list[tuple[str, dict[str, Size], bool]]:
    """Return label, channels and rank of every picture that channels hold, one for each layer."""
    layers: dict[str, dict[str, str]] = defaultdict(dict)
    for name in channels:
        layer, _, channel = name.rpartition(".")
        layers[layer][channel] = name
    found = []
    for layer, names in layers.items():
        upper = {channel.upper(): name for channel, name in names.items()}
        opacity = [upper["A"]] if "A" in upper else []
        colours = ["Y"] if "Y" in upper else [*"RGB"] if {*"RGB"} <= set(upper) else []
        if colours:
            found.append((layer, [upper[colour] for colour in colours] + opacity))
        single = [name for channel, name in names.items() if channel.upper() not in (*colours, "A")]
        chroma = {"RY", "BY"} if colours == ["Y"] else set()
        found += [(name, [name]) for name in single if name.upper() not in chroma]
    whole = [names for label, names in found if not label]
    return [(label, {name: channels[name] for name in names}, not whole or not label) for label, names in found]


def _is_light(channels: Iterable[str]) -> bool:
    return any(_base(name) in ("Y", "R") for name in channels)


def _base(channel: str) -> str:
    return channel.rpartition(".")[2].upper()


def _part(
    path: Path,
    number: int,
    header: exr_header.Header,
    name: str,
    channels: dict[str, Size],
    main: bool,
    camera: Size | None,
    note: str,
) -> Part:
    data, display = _window(header, "dataWindow", path), _window(header, "displayWindow", path)
    fits_data_only = camera == _size(data) != _size(display)
    view = display if _inside(display, data) and not fits_data_only else data
    is_missing = view != display and camera == _size(display)
    crop = "" if view == display else f"its pixels are {_crop_text(data, display)}; the camera file is taken for them"

    def load() -> Pixels:
        if is_missing:
            what, fix = f"is a crop: {_crop_text(data, display)}", _crop_advice(data, display)
            raise UserError(what, where=str(path), fix=fix)
        return _load(path, number, channels, data, view)

    is_light = not all(_base(channel) in _NO_LIGHT for channel in channels)
    words = " ".join(channel.rpartition(".")[2] for channel in channels)
    size, notes = _size(display if is_missing else view), "; ".join(filter(None, (note, crop)))
    return Part(*size, f"EXR, {words}", load, name, main, note=notes, is_light=is_light)


def _window(header: exr_header.Header, key: str, path: Path) -> Window:
    attribute = header.attributes.get(key)
    if attribute is None or len(attribute.raw) != 16:
        raise DamagedFileError(f"the header has no {key}", where=str(path))
    left, top, right, bottom = struct.unpack("<4i", attribute.raw)
    if right < left or bottom < top:
        raise DamagedFileError(f"the {key} {left} {top} {right} {bottom} is empty", where=str(path))
    return left, top, right, bottom


def _size(window: Window) -> Size:
    return window[2] - window[0] + 1, window[3] - window[1] + 1


def _inside(inner: Window, outer: Window) -> bool:
    return outer[0] <= inner[0] and outer[1] <= inner[1] and inner[2] <= outer[2] and inner[3] <= outer[3]


def _crop_text(data: Window, display: Window) -> str:
    width, height = _size(display)
    left, top = data[0] - display[0], data[1] - display[1]
    right, bottom = data[2] - display[0], data[3] - display[1]
    return f"columns {left} to {right} and rows {top} to {bottom} of an image of {width} x {height}"


def _crop_advice(data: Window, display: Window) -> str:
    width, height = _size(data)
    left, top = data[0] - display[0], data[1] - display[1]
    if (width, height) == _size(display):
        return "save the whole image"
    return f"give a camera file of the crop: {width} x {height}, with {left} less in cx and {top} less in cy"


def _load(path: Path, number: int, channels: dict[str, Size], data: Window, view: Window) -> Pixels:
    if any(sampling != (1, 1) for sampling in channels.values()):
        names = ", ".join(channels)
        raise UserError(
            f"{names}: stored for a part of the pixels", where=str(path), expected="a value for every pixel"
        )
    planes = [values.astype(np.float64) for values in _decoded(path, number, [*channels])]
    if any(plane.shape != _size(data)[::-1] for plane in planes):
        raise DamagedFileError("its pixels cannot be read", where=str(path))
    if len(planes) >= 3:
        red, green, blue, *opacity = planes
        grey = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    else:
        grey, *opacity = planes
    values: NDArray[Any] = np.stack([grey, *opacity], axis=-1) if opacity else grey
    left, top = view[0] - data[0], view[1] - data[1]
    width, height = _size(view)
    return Pixels(values[top : top + height, left : left + width], None, "premultiplied")


def _decoded(path: Path, number: int, names: list[str]) -> list[NDArray[Any]]:
    """Return channels of a part; the library decodes all parts at once, so that memory must hold them."""
    count = 0
    for header in _headers(path):
        width, height = header.size(path)
        count += width * height * len(_channels(header, path))
    memory.refuse_beyond(8.0 * count, "its parts and channels together", where=str(path))
    try:
        with silenced(), OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.parts[number].channels
            return [np.ascontiguousarray(channels[name].pixels) for name in names]
    except Exception:
        raise DamagedFileError("its pixels cannot be read: damaged or truncated", where=str(path)) from None
