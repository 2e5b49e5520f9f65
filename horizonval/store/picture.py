"""Read any picture an estimator may be given; ours with its truth.

The content of a file decides its format. A reader of that format lists the parts by their heads
(:mod:`horizonval.store.readers`); the part, its orientation and its size are judged before a pixel is decoded, because
a few kilobytes can encode any number of pixels.

**Orientation.** A camera file describes the pixels as they are stored, and a tag that turns or mirrors them for viewers
leaves open which of the two it was made for. A picture with such a tag is refused unless ``orientation`` says which.

**Opacity.** An opaque picture's opacity is ignored. Premultiplied colours are those over a black background, and are
taken with a warning; pixels that are transparent in any other format have no stated value, and are refused.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files, memory
from horizonval.core.errors import UserError, printable
from horizonval.estimation.limb.picture import to_grey
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.spec.camera import LARGEST_SIDE_PX, CameraSpec
from horizonval.store.readers.part import EXPECTED, MAX_FILE_BYTES, Part, Pixels, chosen, turned

GZIP_MAGIC = b"\x1f\x8b"

BYTES_PER_PIXEL = 48.0
"""Memory of decoding, converting and estimating: 37 measured for 8 bit grey, up to 8 more for colour of 16 bit."""

_LOG = logging.getLogger("horizonval")

ORIENTATIONS = ("stored", "shown")
_TURNS = {
    2: "mirrored left to right",
    3: "turned by 180 deg",
    4: "mirrored top to bottom",
    5: "mirrored along the diagonal",
    6: "turned by 90 deg clockwise",
    7: "mirrored along the other diagonal",
    8: "turned by 90 deg counterclockwise",
}


@dataclass(frozen=True)
class GreyImage:
    """A grey image, shape (H, W), float64.

    ``full_scale`` is the largest value of the file's integers, None for floating point; ``source`` the whole content of
    a file of ours or of one exported from it.
    """

    grey: NDArray[np.float64]
    full_scale: float | None
    source: DetectorImage | RadianceFrame | None


def read_picture(
    path: Path,
    camera: CameraSpec | None = None,
    camera_file: str = "",
    *,
    part: str | None = None,
    orientation: str | None = None,
) -> GreyImage:
    """Read a picture; the content decides the format. The header's size is checked before decoding.

    ``camera``: whose size the picture must have; ``camera_file``: for messages; ``part``: name or number of the picture
    in a file of several; ``orientation``: how to take a picture whose tag turns it. Raises ``UserError``: missing,
    unreadable, several pictures, a tag without ``orientation``, of another size than the camera's, or larger than any
    camera or than memory.
    """
    if orientation not in (None, *ORIENTATIONS):
        raise UserError(f"found {orientation!r}", where="orientation", expected=" or ".join(ORIENTATIONS))
    size = None if camera is None else (camera.camera.width, camera.camera.height)
    parts = parts_of(path, size)
    found = chosen(parts, part, path)
    turn = _turn(found.orientation, orientation, path)
    width, height = (found.height, found.width) if turn >= 5 else (found.width, found.height)
    if camera is not None:
        refuse_other_size(width, height, camera, str(path), camera_file)
    refuse_too_large(width, height, path)
    pixels = found.load()
    if found.note and (part is None or isinstance(pixels, Pixels)):
        _warn(path, found.note)
    if not isinstance(pixels, Pixels):
        return picture_of_source(pixels)
    grey = _grey(pixels, str(path))
    return GreyImage(grey if turn == 1 else turned(grey, turn), pixels.full_scale, None)


def _turn(tag: int, orientation: str | None, path: Path) -> int:
    """Return the orientation that is applied; ``UserError`` if a tag needs a decision and there is none."""
    if tag not in _TURNS or orientation == "stored":
        return 1
    if orientation is None:
        raise UserError(
            f"its orientation tag ({tag}) says that viewers show the stored pixels {_TURNS[tag]}",
            where=str(path),
            fix="give --orientation stored if the camera file describes the stored pixels, --orientation shown if the "
            "picture as viewers show it",
        )
    return tag


def _grey(pixels: Pixels, where: str) -> NDArray[np.float64]:
    """Return grey levels; ``UserError`` for pixels that are transparent in a format where they have no stated value."""
    values = pixels.values
    if values.ndim == 3 and values.shape[2] in (2, 4):
        whole = np.iinfo(values.dtype).max if values.dtype.kind in "ui" else 1.0
        count = int(np.count_nonzero(~(values[..., -1] >= min(whole, pixels.full_scale or whole))))
        if count and pixels.opacity == "premultiplied":
            _warn(where, f"{count} pixels are transparent, and are taken as over a black background")
        elif count:
            what = f"{count} pixels are transparent, wholly or in part"
            raise UserError(
                what, where=where, expected="an opaque picture", fix="fill them and save it without opacity"
            )
    return to_grey(values)


def _warn(where: str | Path, what: str) -> None:
    _LOG.warning("horizonval: warning: %s", printable(f"{where}: {what}"))


def refuse_other_size(width: int, height: int, camera: CameraSpec, where: str, camera_file: str = "") -> None:
    """Raise ``UserError`` where an image has not the size of the camera that is said to have taken it."""
    if (width, height) != (camera.camera.width, camera.camera.height):
        raise UserError(
            f"the image is {width} x {height} pixels, the camera {camera.camera.width} x {camera.camera.height}",
            where=f"{where}, {camera_file}" if camera_file else where,
            expected="equal sizes",
        )


def picture_of_array(pixels: NDArray[Any]) -> GreyImage:
    """Return pixels, shape (H, W) or (H, W, channels), as a picture; the type of integers tells the full scale."""
    full_scale = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else None
    return GreyImage(_grey(Pixels(pixels, full_scale), "image"), full_scale, None)


def picture_of_source(source: DetectorImage | RadianceFrame) -> GreyImage:
    """Return a detector image, or the first band of a frame, as a picture."""
    if isinstance(source, DetectorImage):
        return GreyImage(source.dn.astype(np.float64), float(source.full_scale), source)
    return GreyImage(next(iter(source.radiance.values())).astype(np.float64), None, source)


def parts_of(path: Path, camera: tuple[int, int] | None = None) -> list[Part]:
    """Return the pictures of a file by their heads; ``camera``: size that decides between the windows of an EXR file.

    Raises ``UserError``: missing, unreadable, or of a format that is not read.
    """
    from horizonval.store.readers import arrays, exr, fits, raster, tiff

    head = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED, first=8)
    if not head:
        raise UserError("the file is empty", where=str(path), expected=EXPECTED)
    if head.startswith(GZIP_MAGIC):
        raise UserError("is packed with gzip", where=str(path), expected=EXPECTED, fix="unpack it with gunzip")
    if head.startswith(exr.MAGIC):
        return exr.parts(path, camera)
    for magic, parts in (
        (fits.MAGIC, fits.parts),
        (tiff.MAGIC, tiff.parts),
        (arrays.NPY_MAGIC, arrays.parts_of_npy),
        (arrays.ZIP_MAGIC, arrays.parts_of_npz),
    ):
        if head.startswith(magic):
            return parts(path)
    found = raster.parts(path)
    found = arrays.parts_of_table(path) if found is None else found
    if found is None:
        raise UserError("not an image that can be read", where=str(path), expected=EXPECTED)
    return found


def refuse_too_large(width: int, height: int, path: Path) -> None:
    """Raise ``UserError`` for a picture larger than any camera's, or than memory holds."""
    if max(width, height) > LARGEST_SIDE_PX:
        raise UserError(
            f"{width} x {height} pixels",
            where=str(path),
            expected=f"at most {LARGEST_SIDE_PX} x {LARGEST_SIDE_PX} pixels, as of a camera",
        )
    memory.refuse_beyond(BYTES_PER_PIXEL * width * height, f"an image of {width} x {height} pixels", where=str(path))
