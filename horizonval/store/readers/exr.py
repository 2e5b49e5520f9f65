"""EXR pictures of other programs: several parts, layers, windows.

The picture of a part is channel ``Y``, else ``R G B`` (their Rec. 709 luminance), else its only channel except ``A``.
Without layer names these are the part's picture, and what else it holds accompanies it (a depth, a mask); otherwise
every layer is a picture. Opacity is premultiplied in this format.

The display window is the camera's image, the data window what is stored of it. A data window that covers the display
window is cut to it. A smaller one is a crop, and is read if the camera file has its size.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from horizonval.core import memory
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store import exr
from horizonval.store import header as exr_header
from horizonval.store.readers.part import Part, Pixels, of_bands

Size = tuple[int, int]
Window = tuple[int, int, int, int]
"""First column and row, last column and row."""

MAGIC = exr_header.MAGIC

_NO_LIGHT = ("Z", "ZBACK", "DEPTH", "ID", "U", "V", "N", "P", "X")
"""Usual names of channels of geometry: depth, objects, texture, normals, positions."""


def parts(path: Path, camera: Size | None) -> list[Part]:
    """Return the pictures of an EXR file; of a part with a data window the one that fits the camera's size."""
    if exr.kind(path) != "foreign":
        own = exr.read_header(path)
        return of_bands(own["width"], own["height"], own["bands"], lambda: exr.read(path))
    stored = _stored(path)
    count = sum(math.prod(_size(one.data)) * len(one.channels) for one in stored)
    found = []
    for number, one in enumerate(stored):
        pictures = _pictures([*one.channels])
        others = [label for label, channels, main in pictures if not main and _is_light(channels)]
        note = f"its layer without a name is used, not {', '.join(others)}; --part takes another" if others else ""
        for label, channels, main in pictures:
            name = one.name if one.name and len(pictures) == 1 else ".".join(filter(None, (one.name, label)))
            load = partial(_load, path, number, channels, 8.0 * count)
            found.append(_part(path, one, name, channels, main, camera, note if main else "", load))
    return found


class _Stored(NamedTuple):
    """What the header of a part says; of its channels the sampling, one of so many columns and rows."""

    name: str
    channels: dict[str, Size]
    data: Window
    display: Window


def _stored(path: Path) -> list[_Stored]:
    """Return the headers of all parts; deep files are refused."""
    with exr.decoding(path, header_only=True) as file:
        deep = any(part.header["type"] in (OpenEXR.deepscanline, OpenEXR.deeptile) for part in file.parts)
        found = [
            _Stored(
                str(part.header.get("name", "")),
                {channel.name: (channel.xSampling, channel.ySampling) for channel in part.header["channels"]},
                _window(part.header["dataWindow"]),
                _window(part.header["displayWindow"]),
            )
            for part in file.parts
        ]
    if deep:
        what = "holds deep pixels, which have several samples each"
        raise UserError(what, where=str(path), fix="flatten it in the program that made it")
    return found


def _pictures(channels: Sequence[str]) -> list[tuple[str, list[str], bool]]:
    """Return label and channels of every picture, one for each layer, and whether it is the main one."""
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
    return [(label, names, not whole or not label) for label, names in found]


def _is_light(channels: Iterable[str]) -> bool:
    return any(_base(name) in ("Y", "R") for name in channels)


def _base(channel: str) -> str:
    return channel.rpartition(".")[2].upper()


def _part(
    path: Path,
    stored: _Stored,
    name: str,
    channels: list[str],
    main: bool,
    camera: Size | None,
    note: str,
    load: Callable[[Window, Window], Pixels],
) -> Part:
    data, display = stored.data, stored.display
    fits_data_only = camera == _size(data) != _size(display)
    view = display if _inside(display, data) and not fits_data_only else data
    is_missing = view != display and camera == _size(display)
    crop = "" if view == display else f"its pixels are {_crop_text(data, display)}; the camera file is taken for them"
    sparse = [channel for channel in channels if stored.channels[channel] != (1, 1)]

    def load_view() -> Pixels:
        if is_missing:
            what, fix = f"is a crop: {_crop_text(data, display)}", _crop_advice(data, display)
            raise UserError(what, where=str(path), fix=fix)
        if sparse:
            what = f"{', '.join(sparse)}: stored for a part of the pixels"
            raise UserError(what, where=str(path), expected="a value for every pixel")
        return load(data, view)

    is_light = not all(_base(channel) in _NO_LIGHT for channel in channels)
    words = " ".join(channel.rpartition(".")[2] for channel in channels)
    size, notes = _size(display if is_missing else view), "; ".join(filter(None, (note, crop)))
    return Part(*size, f"EXR, {words}", load_view, name, main, note=notes, is_light=is_light)


def _window(corners: Any) -> Window:
    (left, top), (right, bottom) = corners
    return int(left), int(top), int(right), int(bottom)


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


def _load(path: Path, number: int, names: list[str], whole_bytes: float, data: Window, view: Window) -> Pixels:
    # The library decodes all parts and channels at once.
    memory.refuse_beyond(whole_bytes, "its parts and channels together", where=str(path))
    with exr.decoding(path, separate_channels=True) as file:
        channels = file.parts[number].channels
        planes = [np.asarray(channels[name].pixels, dtype=np.float64) for name in names]
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
