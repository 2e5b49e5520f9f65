"""Frames and detector images as files that other programs open: FITS, 16-bit PNG with a JSON file, EXR with ZIP."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.store import exr
from horizonval.store.attributes import camera_of
from horizonval.store.entry import is_address
from horizonval.store.exported import sealed, text_of
from horizonval.store.fits import fits_bytes

PNG_MAX = 65535
_UNFIT = re.compile(r"[^A-Za-z0-9._-]+")


def export_file(path: Path, out: Path, *, fits: bool = False, png: bool = False, zipped: bool = False) -> list[Path]:
    """Write one of our EXR files in other formats into the folder ``out``, and return the paths.

    ``png``: digital numbers as they are, in 16 bits; of a frame each band's radiance, the largest value being 65535.
    The JSON file beside it has unit, scale, camera and truth, so that `estimate` takes both for the EXR file.
    ``zipped``: EXR that programs with an OpenEXR before 3.4 read. What has the same name is replaced: it is the same
    content.

    Raises
    ------
    UserError
        Not one of our files, damaged, no astropy for ``fits``, a folder that cannot be written, or an EXR file that
        would replace the one it is made of.
    """
    kind = exr.kind(path)
    if kind == "foreign":
        raise UserError("an EXR file, but not written by horizonval", where=str(path))
    source = exr.read_frame(path) if kind == "frame" else exr.read_image(path)
    address = path.stem if is_address(path.stem) else ""
    name = _name(source, path, address)
    written = []
    if zipped:
        target = out / f"{name}.exr"
        if target.exists() and target.samefile(path):
            raise UserError("input and output are the same file", where=str(target), fix="name another folder")
        if isinstance(source, DetectorImage):
            exr.write_image(target, source)
        else:
            exr.write_frame(target, source, codec="zip")
        written.append(target)
    try:
        for file, data in _files(source, name, address, fits, png):
            _write(out / file, data)
            written.append(out / file)
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        what = f"its header says what no writer of ours writes ({type(error).__name__})"
        raise DamagedFileError(what, where=str(path)) from error
    return written


def _files(
    source: RadianceFrame | DetectorImage, name: str, address: str, fits: bool, png: bool
) -> Iterator[tuple[str, bytes]]:
    if fits:
        yield f"{name}.fits", fits_bytes(source, address)
    if not png:
        return
    if isinstance(source, DetectorImage):
        about: dict[str, Any] = {"address": address, "band": source.band, "unit": exr.DN_UNIT, "scale": 1.0}
        pixels = np.ascontiguousarray(source.dn, dtype=np.uint16)
        yield f"{name}.png", _png(pixels)
        yield f"{name}.json", _json(source, pixels, about)
        return
    for band, radiance in source.radiance.items():
        # In double precision: a float32 times 65535 may round above it.
        scale = max(float(radiance.max()), 0.0) / PNG_MAX or 1.0
        counts = np.clip(np.rint(radiance.astype(np.float64) / scale), 0, PNG_MAX).astype(np.uint16)
        yield f"{name}-{band}.png", _png(counts)
        about = {"address": address, "band": band, "unit": exr.RADIANCE_UNIT, "scale": scale}
        yield f"{name}-{band}.json", _json(source, counts, about)


def _name(source: RadianceFrame | DetectorImage, path: Path, address: str) -> str:
    """Return a name that says what it is; of an archived file with the beginning of its address, which is unique."""
    if not address:
        return path.stem
    parts = [source.truth.scene_name, source.truth.head or ""]
    parts += [source.band if isinstance(source, DetectorImage) else "frame", address[:12]]
    return "-".join(_UNFIT.sub("_", part) for part in parts if part)


def _png(pixels: NDArray[np.uint16]) -> bytes:
    done, data = cv2.imencode(".png", pixels)
    if not done:
        raise UserError("cannot be made a PNG", expected="an image of at most 65535 x 65535 pixels")
    return data.tobytes()


def _json(source: RadianceFrame | DetectorImage, pixels: NDArray[np.uint16], about: dict[str, Any]) -> bytes:
    """Return what a PNG cannot say: ``value = scale * count`` in ``unit``, camera, and the truth.

    :func:`horizonval.store.exported.read_beside` reads it back.
    """
    if isinstance(source, DetectorImage):
        observation = source.observation
        about = about | {"full_scale": source.full_scale, "observation": observation}
    else:
        observation = {}
        about = about | {"render": source.render}
    about = about | {
        "camera": camera_of(source.truth, observation).model_dump(mode="json"),
        "truth": source.truth.to_dict(),
    }
    # Tuples of the truth become lists on the way; the digest is of what is read back.
    content = json.loads(text_of(about))
    return (json.dumps(sealed({"png": pixels}, content), indent=1, sort_keys=True, allow_nan=False) + "\n").encode()


def _write(path: Path, data: bytes) -> None:
    try:
        atomic.write_bytes(path, data)
    except OSError as error:
        raise UserError(f"cannot be written: {error.strerror}", where=str(path)) from None
