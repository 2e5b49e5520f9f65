"""Exported files read back: 16-bit PNG with its JSON file, and FITS.

Both carry the digest of their pixels and metadata (:func:`horizonval.store.exr.content_digest`), so that later changes
are detected.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, misfit
from horizonval.frame import MAP_UNITS, PART_MAP, DetectorImage, FrameTruth, RadianceFrame
from horizonval.store.exr import content_digest, with_thermal

FORMAT = "horizonval export 1"
"""Value of ``format`` in our JSON files and FITS tables."""
LARGEST_JSON_BYTES = 64 * 1024**2

T = TypeVar("T", bound=RadianceFrame | DetectorImage)


def text_of(content: dict[str, Any]) -> str:
    """Return the one text of plain data, which digests are made of."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)


def sealed(arrays: dict[str, NDArray[Any]], content: dict[str, Any]) -> dict[str, Any]:
    """Return what is said about arrays with the format and the digest of both."""
    content = content | {"format": FORMAT}
    return content | {"sha256": content_digest(arrays, {"json": text_of(content)})}


def check_sealed(arrays: dict[str, NDArray[Any]], content: dict[str, Any], where: str) -> None:
    """Raise ``DamagedFileError`` unless arrays and content are what was exported."""
    rest = {key: value for key, value in content.items() if key != "sha256"}
    try:
        digest = content_digest(arrays, {"json": text_of(rest)})
    except (ValueError, RecursionError):  # Numbers that no writer of ours writes: NaN, infinite.
        digest = ""
    if content.get("sha256") != digest:
        raise DamagedFileError(
            "pixels or truth were changed since they were exported",
            where=where,
            fix="export it again, or take away what says the truth and give the camera",
        )


def read_beside(path: Path, pixels: NDArray[Any]) -> DetectorImage | RadianceFrame | None:
    """Return the content of a PNG from its decoded pixels and its JSON file; None if there is no such file of ours.

    A frame has the one band of the PNG, to 1/65535 of its largest value, and no truth maps. Raises ``UserError`` if the
    JSON file cannot be read, or either file was changed after the export.
    """
    beside = path.with_suffix(".json")
    if beside == path or files.kind_at(beside, links=True) != "a file":
        return None
    data = files.read_bytes(beside, largest=LARGEST_JSON_BYTES, expected="a JSON file")
    if FORMAT.encode() not in data:
        return None
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        raise DamagedFileError("cannot be read as JSON", where=str(beside), fix="export it again") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        return None
    check_sealed({"png": pixels}, content, f"{path}, {beside}")
    return _made(lambda: _of_png(pixels, content), str(beside))


def _of_png(pixels: NDArray[Any], content: dict[str, Any]) -> DetectorImage | RadianceFrame:
    truth, band = FrameTruth.from_dict(content["truth"]), content["band"]
    if "full_scale" in content:
        return DetectorImage(pixels, band, truth, content["full_scale"], content["observation"])
    radiance = (pixels * float(content["scale"])).astype(np.float32)
    return RadianceFrame({band: radiance}, {}, truth, content["render"])


def of_fits(arrays: dict[str, NDArray[Any]], content: dict[str, Any], where: str) -> DetectorImage | RadianceFrame:
    """Return the content of a FITS file.

    ``arrays`` are named as the units: ``PRIMARY`` of an image; ``RADIANCE.<BAND>``, ``ENERGY.<BAND>`` and
    ``TRUTH.<MAP>`` of a frame. ``content`` is the JSON table, ``where`` the name for error messages.
    """
    check_sealed(arrays, content, where)
    return _made(lambda: _of_fits(arrays, content), where)


def _of_fits(arrays: dict[str, NDArray[Any]], content: dict[str, Any]) -> DetectorImage | RadianceFrame:
    truth = FrameTruth.from_dict(content["truth"])
    if "full_scale" in content:
        return DetectorImage(
            arrays["PRIMARY"], content["bands"][0], truth, content["full_scale"], content["observation"]
        )
    radiance = {band: arrays[f"RADIANCE.{band}".upper()] for band in content["bands"]}
    maps = {name: arrays[f"TRUTH.{name}".upper()] for name in MAP_UNITS}
    if (covered := f"TRUTH.{PART_MAP}".upper()) in arrays:
        maps[PART_MAP] = arrays[covered]
    behind = {band: arrays[name] for band in content["bands"] if (name := f"BEHIND.{band}".upper()) in arrays}
    solar = {band: arrays[name] for band in content["bands"] if (name := f"ENERGY.{band}".upper()) in arrays}
    return RadianceFrame(radiance, maps, truth, content["render"], with_thermal(truth, radiance, solar), behind)


def _made(make: Callable[[], T], where: str) -> T:
    """Return what is made of content whose digest is right, but which other code may have written."""
    try:
        source = make()
        size = source.truth.camera_model.height, source.truth.camera_model.width
    except (KeyError, TypeError, AttributeError, ValueError, IndexError) as error:
        raise DamagedFileError(f"what it says {misfit(error)}", where=where) from None
    shape = (source.dn if isinstance(source, DetectorImage) else next(iter(source.radiance.values()))).shape
    if shape != size:
        raise DamagedFileError(f"pixels of shape {shape}, but the camera has {size}", where=where)
    return source
