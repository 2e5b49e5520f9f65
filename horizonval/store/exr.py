"""The one module that reads and writes EXR files.

A file holds a frame or a detector image with its truth; it is sufficient to score again. Channels (float32 unless
stated otherwise)::

    Y                   copy of the first band, for viewers
    radiance.<band>     W m-2 sr-1; of solar bands counted by photons, see horizonval.earth.spectral.bands
    energy_radiance.<band>  W m-2 sr-1, of solar bands: the plain integral over wavelength
    behind.<band>       W m-2 sr-1, as radiance, without parts of the spacecraft; in frames that have some
    truth.<map>         see horizonval.frame.MAP_UNITS and PART_MAP
    mask.<name>         0 or 1, float16: earth and sunlit, of an image saturated (horizonval.store.attributes)
    dn.<band>           digital numbers

``horizonval:unit.<channel>`` is the unit of a channel. Digital numbers are floating point, float16 up to a full scale
of 2048 and float32 above: both hold these integers exactly, and every reader shows them unchanged, while many divide
the format's 32-bit integers by 2^32.

All codecs are lossless. Frames are HTJ2K256, a third of the size of ZIP for sunlit bands and two thirds for thermal
ones; it needs OpenEXR 3.4 (OpenImageIO 3.1, Blender 5), older readers need ``codec="zip"``. Detector images are ZIP,
which every reader supports, and which is a third of HTJ2K's size for digital numbers.

Header keys are the standard ones and ours, named ``horizonval:*`` (:mod:`horizonval.store.attributes`). Data that is
read back is in JSON strings, because the format's attributes turn Python floats into float32 and integers from 2^31
into 0; typed keys and masks are derived from it for other programs.

The seal (:mod:`horizonval.store.header`) covers the file's bytes, against damage on the disk. ``horizonval:sha256`` is
the digest of the arrays and JSON before they enter the library: it detects damage by the library (which scrambles
non-contiguous arrays, for example), and identifies the content after recompression.

Writing is atomic. Equal content gives equal bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from horizonval.core import atomic, files, memory
from horizonval.core.errors import DamagedFileError, UserError, excerpt, misfit
from horizonval.earth.spectral.bands import reference_wavelength_um
from horizonval.frame import MAP_UNITS, PART_MAP, PART_MAP_UNIT, DetectorImage, FrameTruth, RadianceFrame
from horizonval.spec.camera import Band, CameraSpec
from horizonval.store import header as exr_header
from horizonval.store.attributes import (
    camera_of,
    earth_mask,
    own_attributes,
    saturated_mask,
    standard_attributes,
    sunlit_mask,
)
from horizonval.store.quiet import silenced

FILE_SCHEMA = 5
"""Version of the files' layout. 1 to 3 followed the truth's schema (:data:`horizonval.frame.FRAME_SCHEMA`). 4: masks,
typed keys, an image's camera in its standard attributes. 5: digital numbers as floating point, units of channels,
HTJ2K."""
READABLE_SCHEMAS = (1, 2, 3, 4, 5)

Kind = Literal["frame", "image", "foreign"]
Codec = Literal["zip", "htj2k256"]

RADIANCE_UNIT = "W m-2 sr-1"
DN_UNIT = "DN"
ENERGY = "energy_radiance."
"""Prefix of channels of energy radiance, before the band's name."""
BEHIND = "behind."
"""Prefix of channels of radiance without parts of the spacecraft, before the band's name."""
UNIT_KEY = "unit."
"""Prefix of keys with a channel's unit, before the channel's name."""

_PREFIX = "horizonval:"
_COMMON = ("schema", "kind", "bands", "truth", "sha256", "body", "seal")
_KEYS = {"frame": (*_COMMON, "render"), "image": (*_COMMON, "observation", "full_scale")}
_BAND = re.compile(r"[A-Za-z0-9_-]+")
_COMPRESSION = {"zip": OpenEXR.ZIP_COMPRESSION, "htj2k256": OpenEXR.HTJ2K256_COMPRESSION}
_FLOAT16_INTEGERS = 2048
"""Up to here float16 holds every integer."""
_FLOAT32_MAX = float(np.finfo(np.float32).max)

Channels = dict[str, NDArray[Any]]


def write_frame(path: str | os.PathLike[str], frame: RadianceFrame, *, codec: Codec = "htj2k256") -> None:
    """Write ``frame`` to ``path``, replacing an existing file; the codec ``zip`` serves programs before OpenEXR 3.4.

    Raises ``UserError``: the file cannot be written. Raises ``ValueError``: an invalid frame: no band, shapes that
    differ, a truth map missing, radiance that is not finite.
    """
    if not frame.radiance:
        raise ValueError("a frame needs at least one band")
    if missing := sorted(set(MAP_UNITS) - set(frame.maps)):
        raise ValueError(f"truth maps missing: {missing}")
    bands = list(frame.radiance)
    channels: Channels = {
        f"radiance.{band}": _float32(values, f"radiance.{band}") for band, values in frame.radiance.items()
    }
    for band, values in frame.radiance.items():
        if not np.isfinite(values).all():
            raise ValueError(f"radiance of band {band!r} is not finite everywhere")
    solar = {band.name: band for band in frame.truth.camera_spec.band if band.kind == "solar" and band.name in bands}
    for band, values in frame.energy_radiance.items():
        if not np.isfinite(values).all():
            raise ValueError(f"energy radiance of band {band!r} is not finite everywhere")
        if band in solar:
            channels[f"{ENERGY}{band}"] = _float32(values, f"{ENERGY}{band}")
    channels |= {f"truth.{name}": _float32(values, f"truth.{name}") for name, values in frame.maps.items()}
    channels["Y"] = channels[f"radiance.{bands[0]}"]
    channels |= {"mask.earth": earth_mask(frame.maps), "mask.sunlit": sunlit_mask(frame.maps, frame.truth)}
    own = {"kind": "frame", "bands": ",".join(bands), "truth": _dumps(frame.truth.to_dict())}
    own |= {"render": _dumps(frame.render)}
    own |= {"renderer": _words(frame.render.get(key) for key in ("kind", "version", "variant"))}
    units = {f"radiance.{band}": radiance_unit(solar.get(band)) for band in bands}
    units |= {name: RADIANCE_UNIT for name in channels if name.startswith(ENERGY)}
    units |= {f"truth.{name}": unit for name, unit in MAP_UNITS.items()} | {"Y": units[f"radiance.{bands[0]}"]}
    if frame.behind:
        behind = {f"{BEHIND}{band}": _float32(values, f"{BEHIND}{band}") for band, values in frame.behind.items()}
        channels |= behind
        units |= {f"{BEHIND}{band}": units[f"radiance.{band}"] for band in frame.behind}
        units |= {f"truth.{PART_MAP}": PART_MAP_UNIT, "truth.hit": MAP_UNITS["hit"] + ", 6 part of the spacecraft"}
    _write(Path(path), channels, own, units, frame.truth, camera_of(frame.truth), codec=codec)


def with_thermal(
    truth: FrameTruth, radiance: dict[str, NDArray[np.float32]], solar: dict[str, NDArray[np.float32]]
) -> dict[str, NDArray[np.float32]]:
    """Return the energy radiance of all bands in order; thermal radiance is energy. Old files lack solar bands."""
    thermal = {band.name for band in truth.camera_spec.band if band.kind == "thermal"}
    energy = {band: radiance[band] for band in radiance if band in thermal} | solar
    return {band: energy[band] for band in radiance if band in energy}


def radiance_unit(band: Band | None) -> str:
    """Return the unit of a band's radiance; a solar band's says at which wavelength its photons are counted."""
    if band is None or band.kind == "thermal":
        return RADIANCE_UNIT
    return f"{RADIANCE_UNIT} of as many photons of {reference_wavelength_um(band):.4f} um"


def write_image(path: str | os.PathLike[str], image: DetectorImage) -> None:
    """Write ``image`` to ``path``, replacing what is there; errors as :func:`write_frame`."""
    dn = np.asarray(image.dn)
    if dn.dtype.kind not in "ui":
        raise ValueError(f"digital numbers must be integers, got {dn.dtype}")
    if dn.size and (dn.min() < 0 or dn.max() > image.full_scale):
        raise ValueError(f"digital numbers outside 0..{image.full_scale}")
    dtype = np.float16 if image.full_scale <= _FLOAT16_INTEGERS else np.float32
    name = f"dn.{image.band}"
    values = np.ascontiguousarray(dn, dtype=dtype)
    channels: Channels = {name: values, "Y": values, "mask.saturated": saturated_mask(dn, image.full_scale)}
    own: dict[str, Any] = {"kind": "image", "bands": image.band, "truth": _dumps(image.truth.to_dict())}
    own |= {"observation": _dumps(image.observation), "full_scale": image.full_scale}
    own |= {"seed": str(image.observation.get("seed", ""))}
    camera = camera_of(image.truth, image.observation)
    units = dict.fromkeys((name, "Y"), DN_UNIT)
    _write(Path(path), channels, own, units, image.truth, camera, image.observation.get("exposure_s"))


def read_frame(path: str | os.PathLike[str]) -> RadianceFrame:
    """Read and verify a frame.

    Raises ``UserError``: no such file, or a detector image; ``DamagedFileError``: changed, or not ours.
    """
    path = Path(path)
    header, channels = _read(path, "frame")
    try:
        radiance = {band: channels[f"radiance.{band}"] for band in header["bands"]}
    except KeyError as error:
        raise DamagedFileError(f"no channel {error.args[0]!r}", where=str(path)) from None
    for band, values in radiance.items():
        if not np.isfinite(values).all():
            count = int((~np.isfinite(values)).sum())
            raise DamagedFileError(f"radiance of band {band!r} is not finite in {count} pixels", where=str(path))
    maps = {name.removeprefix("truth."): values for name, values in channels.items() if name.startswith("truth.")}
    if missing := sorted(set(MAP_UNITS) - set(maps)):
        raise DamagedFileError(f"no truth map {missing[0]!r}", where=str(path))
    truth = _truth(header, path)
    solar = {band: channels[f"{ENERGY}{band}"] for band in radiance if f"{ENERGY}{band}" in channels}
    for band, values in solar.items():
        if not np.isfinite(values).all():
            raise DamagedFileError(f"energy radiance of band {band!r} is not finite everywhere", where=str(path))
    behind = {band: channels[f"{BEHIND}{band}"] for band in radiance if f"{BEHIND}{band}" in channels}
    return RadianceFrame(radiance, maps, truth, header["render"], with_thermal(truth, radiance, solar), behind)


def read_image(path: str | os.PathLike[str]) -> DetectorImage:
    """Read and verify a detector image; errors as :func:`read_frame`."""
    path = Path(path)
    header, channels = _read(path, "image")
    band, full_scale = header["bands"][0], header["full_scale"]
    if f"dn.{band}" not in channels:
        raise DamagedFileError(f"no channel 'dn.{band}'", where=str(path))
    dn = channels[f"dn.{band}"]
    if (
        not 0 < full_scale <= np.iinfo(np.uint16).max
        or not ((dn >= 0) & (dn <= full_scale) & (dn == np.rint(dn))).all()
    ):
        raise DamagedFileError(f"digital numbers outside 0..{full_scale}", where=str(path))
    return DetectorImage(
        dn=dn.astype(np.uint16),
        band=band,
        truth=_truth(header, path),
        full_scale=full_scale,
        observation=header["observation"],
    )


def read(path: str | os.PathLike[str]) -> RadianceFrame | DetectorImage:
    """Read and verify a frame or an image, whichever it is; errors as :func:`read_frame`."""
    path = Path(path)
    return read_frame(path) if _own_kind(exr_header.read_header(path), path) == "frame" else read_image(path)


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read and verify the header of one of our files, without its pixels.

    Returns plain data: ``kind``, ``schema``, ``bands`` (list), ``width``, ``height``, ``truth`` (see
    ``FrameTruth.from_dict``), ``sha256``, and ``render`` or ``observation`` and ``full_scale``.
    """
    path = Path(path)
    header = exr_header.read_header(path)
    return _decode(header, _own_kind(header, path), path)


def kind(path: str | os.PathLike[str]) -> Kind:
    """Return what an EXR file holds, by its header: ``frame``, ``image`` or, if it is not ours, ``foreign``.

    Raises ``UserError`` without a file, ``DamagedFileError`` if it is no EXR file or our header is incomplete.
    """
    path = Path(path)
    header = exr_header.read_header(path)
    if not any(name.startswith(_PREFIX) for name in header.attributes):
        return "foreign"
    return _own_kind(header, path)


def content_digest(channels: Channels, own: dict[str, Any]) -> str:
    """Return the sha256 of every channel's name, type, shape and bytes, and of every text and integer of ours."""
    digest = hashlib.sha256()
    for name in sorted(channels):
        values = channels[name]
        digest.update(f"{name}\0{values.dtype.str}\0{values.shape}\0".encode())
        digest.update(np.ascontiguousarray(values).data)
    for key in sorted(set(own) - {"sha256", "body", "seal"}):
        digest.update(f"{key}\0{own[key]}\0".encode())
    return digest.hexdigest()


def _dumps(value: dict[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))


def _float32(values: NDArray[Any], name: str) -> NDArray[np.float32]:
    """Return a contiguous float32 copy: the library writes the bytes of a non-contiguous array in the wrong order."""
    values = np.asarray(values)
    if values.ndim != 2:
        raise ValueError(f"{name}: expected shape (H, W), got {values.shape}")
    finite = np.isfinite(values)
    if np.abs(values, where=finite, out=np.zeros(values.shape)).max(initial=0.0) > _FLOAT32_MAX:
        raise ValueError(f"{name}: values too large for float32")
    return np.ascontiguousarray(values, dtype=np.float32)


def _write(
    path: Path,
    channels: Channels,
    own: dict[str, Any],
    units: Mapping[str, str],
    truth: FrameTruth,
    spec: CameraSpec,
    exposure_s: float | None = None,
    codec: Codec = "zip",
) -> None:
    expected = (spec.camera.height, spec.camera.width)
    for name, values in channels.items():
        if values.shape != expected:
            raise ValueError(f"{name}: shape {values.shape}, but the camera has {expected}")
    for band in own["bands"].split(","):
        if not _BAND.fullmatch(band):
            raise ValueError(f"band name {band!r}: letters, digits, _ and - only")
    own = {"schema": FILE_SCHEMA, **own, "scene_id": truth.scene_id, "epoch_utc": truth.epoch_utc}
    own |= {"scene": truth.scene_name, "world_frame": "ITRS"}
    own |= {"projection": spec.camera.projection}
    own |= {f"{UNIT_KEY}{name}": unit for name, unit in units.items()}
    typed = {_PREFIX + key: value for key, value in own_attributes(truth, spec, exposure_s).items()}
    _write_sealed(path, channels, own, standard_attributes(truth, spec, exposure_s) | typed, codec)


def _words(parts: Iterable[Any]) -> str:
    return " ".join(str(part) for part in parts if part is not None)


def _write_sealed(
    path: Path, channels: Channels, own: dict[str, Any], standard: dict[str, Any], codec: Codec = "zip"
) -> None:
    own = own | {"sha256": content_digest(channels, own), "body": exr_header.BODY_BLANK, "seal": exr_header.SEAL_BLANK}
    header = standard | {_PREFIX + key: value for key, value in own.items()}
    for key, value in header.items():
        if isinstance(value, int) and not -(2**31) <= value < 2**31:
            raise ValueError(f"{key} = {value} does not fit the format's 32-bit integers")
    header |= {"compression": _COMPRESSION[codec], "type": OpenEXR.scanlineimage}
    with atomic.replacing(path) as temporary:
        with silenced():
            OpenEXR.File(header, dict(channels)).write(str(temporary))
        exr_header.seal_file(temporary)


def _own_kind(header: exr_header.Header, path: Path) -> Literal["frame", "image"]:
    attributes = header.attributes
    if not any(name.startswith(_PREFIX) for name in attributes):
        raise DamagedFileError("an EXR file, but not written by horizonval", where=str(path))
    if _PREFIX + "kind" not in attributes:
        raise DamagedFileError(f"no header key '{_PREFIX}kind'", where=str(path))
    value = attributes[_PREFIX + "kind"].text()
    if value == "frame":
        return "frame"
    if value == "image":
        return "image"
    what = f"header key '{_PREFIX}kind' is {excerpt(value)!r}"
    raise DamagedFileError(what, where=str(path), expected="frame or image")


def _decode(header: exr_header.Header, kind: Literal["frame", "image"], path: Path) -> dict[str, Any]:
    """Check the header against its seal and return its content as plain data."""
    attributes = header.attributes
    for key in _KEYS[kind]:
        if _PREFIX + key not in attributes:
            raise DamagedFileError(f"no header key '{_PREFIX}{key}'", where=str(path))
    schema = attributes[_PREFIX + "schema"].integer()
    if schema not in READABLE_SCHEMAS:
        expected = " or ".join(str(s) for s in READABLE_SCHEMAS)
        raise DamagedFileError(f"schema {schema}", where=str(path), expected=f"schema {expected}")
    exr_header.check_header(header, path)
    width, height = header.size(path)
    bands = attributes[_PREFIX + "bands"].text().split(",")
    if not all(_BAND.fullmatch(band) for band in bands):
        # They become names of files.
        raise DamagedFileError(f"header key '{_PREFIX}bands' holds {excerpt(bands[0])!r}", where=str(path))
    content: dict[str, Any] = {
        "kind": kind,
        "schema": schema,
        "bands": bands,
        "width": width,
        "height": height,
        "sha256": attributes[_PREFIX + "sha256"].text(),
    }
    for key in ("truth", "render" if kind == "frame" else "observation"):
        try:
            content[key] = json.loads(attributes[_PREFIX + key].text())
        except (ValueError, RecursionError):
            content[key] = None
        if not isinstance(content[key], dict):
            raise DamagedFileError(f"header key '{_PREFIX}{key}' is no JSON object", where=str(path))
    if kind == "image":
        content["full_scale"] = attributes[_PREFIX + "full_scale"].integer()
    return content


def _read(path: Path, wanted: Literal["frame", "image"]) -> tuple[dict[str, Any], Channels]:
    data = exr_header.read_bytes(path)
    header = exr_header.parse_header(data, path)
    kind = _own_kind(header, path)
    if kind != wanted:
        names = {"frame": "a frame (radiance)", "image": "a detector image"}
        raise UserError(f"holds {names[kind]}", where=str(path), expected=names[wanted])
    content = _decode(header, kind, path)
    exr_header.check_body(data, header, path)
    _refuse_too_large(header, path)
    channels = _decode_pixels(path)
    own = {
        name.removeprefix(_PREFIX): attribute.integer() if attribute.type == "int" else attribute.text()
        for name, attribute in header.attributes.items()
        if name.startswith(_PREFIX) and attribute.type in ("int", "string")
    }
    if content_digest(channels, own) != content["sha256"]:
        raise DamagedFileError("the pixels or the truth do not match their sha256", where=str(path))
    return content, channels


def _truth(header: dict[str, Any], path: Path) -> FrameTruth:
    try:
        return FrameTruth.from_dict(header["truth"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DamagedFileError(f"the truth {misfit(error)}", where=str(path)) from None


def _refuse_too_large(header: exr_header.Header, path: Path) -> None:
    """Raise ``UserError`` where memory does not hold the pixels that a header speaks of: a few bytes can be many."""
    width, height = header.size(path)
    if (channels := header.attributes.get("channels")) is None:
        raise DamagedFileError("the header has no channels", where=str(path))
    # Each channel has 16 bytes after its name, which takes two at least; a pixel has four at most, and is copied once.
    count = len(channels.raw) // 18 + 1
    what = f"an image of {width} x {height} pixels in {count} channels or fewer"
    memory.refuse_beyond(8.0 * width * height * count, what, where=str(path))


def _decode_pixels(path: Path) -> Channels:
    """Return the separate channels of the first part."""
    with decoding(path, separate_channels=True) as file:
        return {name: np.ascontiguousarray(channel.pixels) for name, channel in file.channels().items()}


@contextlib.contextmanager
def decoding(path: Path, **options: bool) -> Iterator[OpenEXR.File]:
    """Open a file with the library, which reads it by its path and prints what it finds damaged."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise files.UnreadableFileError(
            "cannot be read by OpenEXR: its path is not UTF-8", where=str(path), fix="give the folder another name"
        ) from None
    try:
        with silenced(), OpenEXR.File(str(path), **options) as file:
            yield file
    except Exception:
        raise DamagedFileError("cannot be read: damaged or truncated", where=str(path)) from None
