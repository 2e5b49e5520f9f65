"""Frames and detector images as files that other programs open.

FITS; PNG of 16 bits with a JSON file; TIFF of 16 bits, of radiances of 32; NumPy's ``.npz``; EXR with ZIP; masks as one
file of COCO, for programs that learn; and labelled arrays of ``xarray``, which writes NetCDF and Zarr.

COCO's categories are made of the exact truth maps: ``earth`` (ground or cloud), ``sunlit_earth`` (the part of it on
which the Sun shines), ``limb`` (air without ground behind it). A mask is a run-length code down the columns,
uncompressed, which ``pycocotools`` reads; it marks a crowd (``iscrowd = 1``), as COCO wants of such codes.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError, misfit
from horizonval.frame import MAP_UNITS, DetectorImage, FrameTruth, Hit, RadianceFrame
from horizonval.store import exr
from horizonval.store.attributes import camera_of, earth_mask, sunlit_mask
from horizonval.store.entry import is_address
from horizonval.store.exported import sealed, text_of
from horizonval.store.fits import fits_bytes

if TYPE_CHECKING:
    import xarray

CATEGORIES = ("earth", "sunlit_earth", "limb")


def masks_of(frame: RadianceFrame) -> dict[str, NDArray[np.bool_]]:
    """Return the masks of a frame by the names of their categories, shape (H, W) each."""
    earth = earth_mask(frame.maps) > 0
    return {
        "earth": earth,
        "sunlit_earth": earth & (sunlit_mask(frame.maps, frame.truth) > 0),
        "limb": frame.maps["hit"] == Hit.ATMOSPHERE,
    }


def coco_text(frames: Sequence[tuple[str, RadianceFrame]]) -> str:
    """Return the COCO file of frames, given as pairs of the name that their pictures begin with and the frame."""
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for name, frame in frames:
        marked = masks_of(frame)
        for band in frame.radiance:
            height, width = frame.radiance[band].shape
            number = len(images) + 1
            images.append({"id": number, "file_name": f"{name}-{band}.png", "width": width, "height": height})
            for category, label in enumerate(CATEGORIES, 1):
                mask = marked[label]
                if mask.any():
                    annotations.append(_annotation(len(annotations) + 1, number, category, mask))
    content = {
        "info": {"description": "Masks of the exact truth of rendered frames, by horizonval", "version": "1"},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": k, "name": name, "supercategory": "scene"} for k, name in enumerate(CATEGORIES, 1)],
    }
    return json.dumps(content, separators=(",", ":")) + "\n"


def _annotation(number: int, image: int, category: int, mask: NDArray[np.bool_]) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return {
        "id": number,
        "image_id": image,
        "category_id": category,
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
        "area": int(mask.sum()),
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "iscrowd": 1,
    }


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return how many pixels in turn are outside and inside, down the columns, outside first."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat)) + 1
    lengths = np.diff(np.concatenate([[0], changes, [flat.size]])).tolist()
    return [0, *lengths] if flat[0] else lengths


PNG_MAX = 65535
_DESCRIPTION, _SOFTWARE = 270, 305
"""Tags of TIFF 6.0."""
_UNFIT = re.compile(r"[^A-Za-z0-9._-]+")


Format = Literal["fits", "png", "tiff", "npz"]


def export_file(path: Path, out: Path, formats: Collection[Format] = (), *, zipped: bool = False) -> list[Path]:
    """Write one of our EXR files in other formats into the folder ``out``, and return the paths.

    ``png``: digital numbers in 16 bits; of a frame each band's radiance, scaled to 65535. A JSON file has unit, scale,
    camera and truth, so that `estimate` accepts both instead of the EXR file. ``tiff``: digital numbers in 16 bits, of
    a frame each band's radiance as floats; camera and truth are its description. ``npz``: the arrays by name, with
    camera and truth as text (``about``). ``zipped``: EXR for programs with an OpenEXR before 3.4. Existing files of
    these names are replaced.

    Raises ``UserError``: not one of our files, damaged, no astropy for ``fits``, a folder that cannot be written, or an
    EXR file that would replace its source.
    """
    source = exr.read(path)
    address = path.stem if is_address(path.stem) else ""
    name = name_of(source, path, address)
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
        for file, data in _files(source, name, address, formats):
            atomic.write_bytes(out / file, data)
            written.append(out / file)
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        what = f"its header {misfit(error)}"
        raise DamagedFileError(what, where=str(path)) from error
    return written


def write_masks(path: Path, frames: Iterable[Path]) -> None:
    """Write one COCO file of the masks of all frames in some files; ``UserError`` if none is a frame."""
    read = []
    for one in frames:
        if exr.kind(one) == "frame":
            frame = exr.read_frame(one)
            read.append((name_of(frame, one, one.stem if is_address(one.stem) else ""), frame))
    if not read:
        raise UserError("no frame among the files", where="--coco", expected="frames, which have the truth's maps")
    atomic.write_text(path, coco_text(read))


def _files(
    source: RadianceFrame | DetectorImage, name: str, address: str, formats: Collection[Format]
) -> Iterator[tuple[str, bytes]]:
    if "fits" in formats:
        yield f"{name}.fits", fits_bytes(source, address)
    if "npz" in formats:
        yield f"{name}.npz", _npz(source, address)
    if "tiff" in formats:
        yield from _tiffs(source, name, address)
    if "png" in formats:
        yield from _pngs(source, name, address)


def _npz(source: RadianceFrame | DetectorImage, address: str) -> bytes:
    if isinstance(source, DetectorImage):
        arrays: dict[str, NDArray[Any]] = {"dn": source.dn}
    else:
        arrays = {f"radiance.{band}": values for band, values in source.radiance.items()} | source.maps
    buffer = io.BytesIO()
    np.savez_compressed(buffer, about=np.array(_about(source, address)), **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _tiffs(source: RadianceFrame | DetectorImage, name: str, address: str) -> Iterator[tuple[str, bytes]]:
    if isinstance(source, DetectorImage):
        pictures = {f"{name}.tif": np.ascontiguousarray(source.dn, dtype=np.uint16)}
    else:
        pictures = {f"{name}-{band}.tif": np.asarray(v, dtype=np.float32) for band, v in source.radiance.items()}
    for file, pixels in pictures.items():
        buffer = io.BytesIO()
        tags = {_DESCRIPTION: _about(source, address), _SOFTWARE: "horizonval"}
        Image.fromarray(pixels).save(buffer, format="TIFF", compression="tiff_adobe_deflate", tiffinfo=tags)
        yield file, buffer.getvalue()


def _about(source: RadianceFrame | DetectorImage, address: str) -> str:
    """Return camera and truth as ASCII for TIFF; tifffile requires ``shape`` in descriptions with that word."""
    pixels = source.dn if isinstance(source, DetectorImage) else next(iter(source.radiance.values()))
    about: dict[str, Any] = {"address": address, "shape": list(pixels.shape), "truth": source.truth.to_dict()}
    if isinstance(source, DetectorImage):
        about |= {"band": source.band, "unit": exr.DN_UNIT, "full_scale": source.full_scale}
        about["camera"] = camera_of(source.truth, source.observation).model_dump(mode="json")
    else:
        about |= {"bands": list(source.radiance), "unit": exr.RADIANCE_UNIT}
        about["camera"] = camera_of(source.truth, {}).model_dump(mode="json")
    return json.dumps(json.loads(text_of(about)), sort_keys=True)


def _pngs(source: RadianceFrame | DetectorImage, name: str, address: str) -> Iterator[tuple[str, bytes]]:
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


def name_of(source: RadianceFrame | DetectorImage, path: Path, address: str) -> str:
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
    """Return what a PNG cannot hold: ``value = scale * count`` in ``unit``, camera, and the truth."""
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


def dataset_of(source: RadianceFrame | DetectorImage) -> xarray.Dataset:
    """Return a frame or an image with coordinates and metadata; ``UserError`` if xarray is not installed.

    Dimensions are ``row`` and ``column``, counted from the centre of the upper left pixel, and ``band`` of a frame.
    Attributes hold scene, camera, epoch, and the nadir and the Sun in camera axes.
    """
    try:
        import xarray
    except ImportError:
        raise UserError("xarray is not installed", fix='run `pip install "horizonval[xarray]"`') from None
    about = _attributes(source.truth)
    variables: dict[str, tuple[tuple[str, ...], NDArray[Any], dict[str, str]]]
    coordinates: dict[str, object]
    if isinstance(source, DetectorImage):
        about |= {"band": source.band, "full_scale": int(source.full_scale)}
        variables = {"dn": (("row", "column"), source.dn, {"units": "1", "long_name": "digital number"})}
        coordinates = _places(source.dn.shape)
    else:
        bands = list(source.radiance)
        radiance = np.stack([source.radiance[band] for band in bands])
        variables = {"radiance": (("band", "row", "column"), radiance, {"units": "W m-2 sr-1"})}
        for name, values in source.maps.items():
            variables[name] = (("row", "column"), values, {"units": MAP_UNITS.get(name, "1")})
        coordinates = {"band": bands, **_places(radiance.shape[1:])}
    return xarray.Dataset(variables, coordinates, about)


def _places(shape: tuple[int, ...]) -> dict[str, object]:
    return {
        "row": ("row", np.arange(shape[0]), {"units": "px"}),
        "column": ("column", np.arange(shape[1]), {"units": "px"}),
    }


def _attributes(truth: FrameTruth) -> dict[str, object]:
    """Return what NetCDF can hold as attributes: texts and rows of numbers."""
    return {
        "scene": truth.scene_name,
        "camera": truth.camera_name,
        "epoch_utc": truth.epoch_utc,
        "r_itrs_m": list(truth.r_itrs),
        "q_cam_from_itrs": list(truth.q_cam_from_itrs),
        "nadir_geocentric_cam": list(truth.nadir_geocentric_cam),
        "sun_cam": list(truth.sun_cam),
    }
