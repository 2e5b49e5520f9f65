"""The accepted baseline of the nightly comparison, small enough for the repository.

``NAME.json`` holds rows, digests, properties of the scenes, provenance and reason; ``NAME.npz`` the frozen images;
``NAME.md`` the table of differences for review. ``NAME.release.json`` and ``NAME.release.npz`` are the same of the last
release, without detector images: they show slow drift. Only ``horizonval baseline accept`` changes a baseline.

The images are a NumPy archive with LZMA instead of deflate. High and low bytes of detector numbers are stored apart,
because noise fills the low ones only. Frames are stored as the square root of their radiance in 12 bits, 0.05 % of the
brightest pixel and finer below: enough to locate a difference, which their digests detect exactly. Equal content gives
equal bytes.

The files of an acceptance are written to a folder of their own and move from there together: an acceptance that was
killed either never happened, or whoever reads the baseline next finishes it.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from horizonval.core import atomic, files, sealed
from horizonval.core.errors import DamagedFileError, UserError, misfit
from horizonval.core.outcome import Outcome
from horizonval.spec.base import Model
from horizonval.spec.explain import explain
from horizonval.store.folder import LARGEST_RECORD, read_json, write_json
from horizonval.studies.regression.gates import GateInputs
from horizonval.studies.regression.row import LARGEST_ARCSEC, ReplicateRow, from_columns, to_columns

BASELINE_SCHEMA = 1
PACK_SCHEMA = 2
CODES = 4095
FROM_GIT = "take it from version control again"
MOST_UNPACKED_BYTES = 64 * 1024**2
MOST_EXPANSION = 50
"""Most bytes of a pack's arrays, and how many times its size comes on top: images of noise compress to a sixth."""
LARGEST_RADIANCE = 1e12
"""Of a frozen frame [W m-2 sr-1]; the Sun has 2e7 in all its bands."""
FullScale = Annotated[int, Field(gt=0, lt=1 << 16, strict=True)]
RadiancePerDn = Annotated[float, Field(gt=0, le=LARGEST_RADIANCE, strict=True)] | None
_FROZEN = TypeAdapter(tuple[FullScale, RadiancePerDn])
"""Numbers that an image has of its own in a pack."""


@dataclass(frozen=True)
class FrozenImage:
    """A detector image, shape (H, W), uint16.

    ``replicate``: seed of its noise. ``radiance_per_dn`` [W m-2 sr-1]: calibration given to estimators, or None.
    """

    scene: str
    band: str
    replicate: int
    full_scale: int
    dn: NDArray[np.uint16]
    radiance_per_dn: float | None = None

    @property
    def sha256(self) -> str:
        """Digest of size and numbers."""
        return digest(self.dn)


@dataclass(frozen=True)
class FrozenFrame:
    """Radiance (H, W) to 12 bits, the regions of the image, the digest of the float32."""

    scene: str
    band: str
    sha256: str
    radiance: NDArray[np.float64]
    regions: NDArray[np.uint8]


@dataclass(frozen=True)
class Pack:
    """``truths``: by scene, plain, without the infrared horizon, which rescoring does not need."""

    images: tuple[FrozenImage, ...] = ()
    frames: tuple[FrozenFrame, ...] = ()
    truths: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def digest(values: NDArray[Any]) -> str:
    """Return the sha256 of an array's type, shape and bytes in little-endian order."""
    data = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    head = f"{data.dtype.str} {data.shape}\0".encode()
    return hashlib.sha256(head + data.tobytes()).hexdigest()


def write_pack(path: Path, pack: Pack) -> None:
    """Write a pack, whole or not at all."""
    arrays: dict[str, NDArray[Any]] = {}
    images, frames = [], []
    for shape, group in _by_shape([image.dn for image in pack.images]):
        stack = np.stack([pack.images[i].dn for i in group])
        name = f"dn_{shape}"
        arrays[f"{name}_high"], arrays[f"{name}_low"] = _planes(stack)
        images += [(i, name, k) for k, i in enumerate(group)]
    for shape, group in _by_shape([frame.radiance for frame in pack.frames]):
        scales = [float(pack.frames[i].radiance.max(initial=0.0)) for i in group]
        codes = np.stack([_encode(pack.frames[i].radiance, s) for i, s in zip(group, scales, strict=True)])
        name = f"frame_{shape}"
        # Neighbouring pixels are correlated: their differences, modulo 2^16, compress to a third.
        arrays[f"{name}_high"], arrays[f"{name}_low"] = _planes(np.diff(codes, axis=2, prepend=np.uint16(0)))
        arrays[f"{name}_regions"] = np.stack([pack.frames[i].regions for i in group])
        frames += [(i, name, k, s) for (k, i), s in zip(enumerate(group), scales, strict=True)]
    head = {
        "schema": PACK_SCHEMA,
        "truths": pack.truths,
        "images": [
            [m.scene, m.band, m.replicate, m.full_scale, m.sha256, name, k, m.radiance_per_dn]
            for (_, name, k), m in ((entry, pack.images[entry[0]]) for entry in sorted(images))
        ],
        "frames": [
            [f.scene, f.band, f.sha256, name, k, scale]
            for (_, name, k, scale), f in ((entry, pack.frames[entry[0]]) for entry in sorted(frames))
        ],
    }
    text = json.dumps(head, sort_keys=True, separators=(",", ":")).encode()
    arrays["head"] = np.frombuffer(text, dtype=np.uint8)
    with atomic.replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_LZMA) as file:
        for name in sorted(arrays):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.ascontiguousarray(arrays[name]), allow_pickle=False)
            # A fixed date: equal content, equal bytes.
            info = zipfile.ZipInfo(f"{name}.npy", (2000, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_LZMA
            file.writestr(info, buffer.getvalue())


def read_pack(path: Path) -> Pack:
    """Read a pack and check every image against its digest.

    Raises ``UserError``: no such file. Raises ``DamagedFileError``: the content was changed, or unpacks to more than
    such a file can hold.
    """
    if not path.is_file():
        raise UserError("no such file", where=str(path), expected="the frozen images of a baseline")
    return _read_pack(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_pack(path: Path, _changed_ns: int) -> Pack:
    try:
        arrays = _arrays_of(path)
        head = json.loads(arrays["head"].tobytes())
        if head["schema"] != PACK_SCHEMA:
            raise DamagedFileError(f"schema {head['schema']}", where=str(path), expected=f"schema {PACK_SCHEMA}")
        images: dict[tuple[str, str, int], FrozenImage] = {}
        for scene, band, replicate, full_scale, sha, name, k, radiance_per_dn in head["images"]:
            dn = _from_planes(_member(arrays, f"{name}_high", k), _member(arrays, f"{name}_low", k))
            _FROZEN.validate_python((full_scale, radiance_per_dn))
            image = FrozenImage(scene, band, replicate, full_scale, dn, radiance_per_dn)
            if image.sha256 != sha:
                raise DamagedFileError(f"the image {scene} {band} {replicate} is not what was frozen", where=str(path))
            if (scene, band, replicate) in images:
                raise DamagedFileError(f"two images of {scene} {band} {replicate}", where=str(path))
            images[scene, band, replicate] = image
        frames: dict[tuple[str, str], FrozenFrame] = {}
        for scene, band, sha, name, k, scale in head["frames"]:
            differences = _from_planes(_member(arrays, f"{name}_high", k), _member(arrays, f"{name}_low", k))
            codes = np.cumsum(differences, axis=1, dtype=np.uint16)
            regions = _member(arrays, f"{name}_regions", k)
            if (scene, band) in frames or not 0.0 <= scale < LARGEST_RADIANCE:
                raise DamagedFileError(f"two frames of {scene} {band}, or none", where=str(path))
            frames[scene, band] = FrozenFrame(scene, band, sha, _decode(codes, scale), regions)
        truths = dict(head["truths"])
    except UserError:
        raise
    except Exception as error:
        raise DamagedFileError("cannot be read as frozen images", where=str(path)) from error
    return Pack(tuple(images.values()), tuple(frames.values()), truths)


def _arrays_of(path: Path) -> dict[str, NDArray[Any]]:
    """Return the arrays of a pack, bounded by what their heads say before any is read."""
    arrays: dict[str, NDArray[Any]] = {}
    with files.open_file(path) as stream, zipfile.ZipFile(stream) as archive:
        left = MOST_UNPACKED_BYTES + MOST_EXPANSION * path.stat().st_size
        for member in archive.namelist():
            with archive.open(member) as file:
                version = np.lib.format.read_magic(file)
                read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
                shape, _, dtype = read[version](file)
            left -= math.prod(shape) * dtype.itemsize
            if dtype != np.uint8 or left < 0 or member.removesuffix(".npy") in arrays:
                raise DamagedFileError("unpacks to more than frozen images, or to other numbers", where=str(path))
            with archive.open(member) as file:
                arrays[member.removesuffix(".npy")] = np.lib.format.read_array(file, allow_pickle=False)
    return arrays


def _member(arrays: Mapping[str, NDArray[Any]], name: str, k: int) -> NDArray[np.uint8]:
    """Return an image of a stack. Raises ``IndexError``: no such number."""
    stack = arrays[name]
    if type(k) is not int or not 0 <= k < len(stack):
        raise IndexError(k)
    member: NDArray[np.uint8] = stack[k]
    return member


def _by_shape(arrays: Sequence[NDArray[Any]]) -> list[tuple[str, list[int]]]:
    groups: dict[str, list[int]] = {}
    for i, array in enumerate(arrays):
        groups.setdefault(f"{array.shape[0]}x{array.shape[1]}", []).append(i)
    return sorted(groups.items())


def _planes(values: NDArray[np.uint16]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return (values >> 8).astype(np.uint8), (values & 255).astype(np.uint8)


def _from_planes(high: NDArray[np.uint8], low: NDArray[np.uint8]) -> NDArray[np.uint16]:
    joined: NDArray[np.uint16] = high.astype(np.uint16) * np.uint16(256) + low
    return joined


def _encode(radiance: NDArray[np.floating], scale: float) -> NDArray[np.uint16]:
    share = np.clip(np.asarray(radiance, dtype=np.float64) / (scale or 1.0), 0.0, 1.0)
    return np.rint(np.sqrt(share) * CODES).astype(np.uint16)


def _decode(codes: NDArray[np.uint16], scale: float) -> NDArray[np.float64]:
    return (codes.astype(np.float64) / CODES) ** 2 * scale


@dataclass(frozen=True)
class Baseline:
    """A baseline in memory; ``pack`` is the file of its images.

    ``together`` describes scenes with rows of methods that see all heads, by scene: ``heads`` (name and scene of every
    head, in order), ``table``, ``bands``.
    """

    path: Path
    head: Mapping[str, Any]
    results: GateInputs
    scenes: Mapping[str, Any]
    pack: Path
    together: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Night and version of its creation."""
        return f"{self.head['night']} ({self.head['version']})"

    @property
    def images(self) -> Pack:
        """The frozen images."""
        return read_pack(self.pack)


def pack_path(path: Path) -> Path:
    """Return the image file of a baseline's JSON file."""
    return path.with_suffix(".npz")


def release_path(path: Path) -> Path:
    """Return the last release's file for an accepted baseline's."""
    return path.with_name(f"{path.stem}.release.json")


class _Answerable(Model):
    expected: Outcome
    borderline: bool | None
    bound_arcsec: Annotated[float, Field(gt=0, le=LARGEST_ARCSEC, strict=True)] | None
    images: list[str]


class _Band(_Answerable):
    radiance_sha256: str
    full_scale: FullScale
    radiance_per_dn: list[RadiancePerDn]
    noise_dn: Annotated[float, Field(ge=0, le=2**31, strict=True)] | None


class _Scene(Model):
    table: str
    camera: str
    bands: dict[str, _Band]


class _Together(Model):
    table: str
    heads: Annotated[list[tuple[str, str]], Field(min_length=1)]
    bands: dict[str, _Answerable]


class _Past(Model):
    night: str
    version: str
    accepted_utc: str
    reason: str


class _File(_Past):
    """The file of a baseline; rows are columns of values."""

    schema_number: Annotated[int, Field(alias="schema")]
    suite: str
    environment: dict[str, Any]
    replicates: Annotated[int, Field(ge=1, strict=True)]
    gates: list[Any]
    covers: list[str] = []
    past: list[_Past]
    scenes: dict[str, _Scene]
    together: dict[str, _Together]
    rows: dict[str, Any]
    fresh: dict[str, Any]
    fresh_night: str
    pack_sha256: str


def baseline_at(path: Path, suite: str) -> Baseline | None:
    """Return :func:`read_baseline`; None where nothing is."""
    finish_acceptance(path)
    return read_baseline(path, suite) if files.kind_at(path) else None


def read_baseline(path: Path, suite: str) -> Baseline:
    """Read a baseline and check that its images are the ones that were accepted with it.

    An acceptance that was killed while its files moved is finished first. Raises ``UserError``: no such file, or one of
    another suite. Raises ``DamagedFileError``: it is not what ``baseline accept`` wrote.
    """
    finish_acceptance(path)
    if not files.kind_at(path):
        raise UserError("no accepted baseline", where=str(path), fix="see `horizonval baseline accept --help`")
    data = _sealed(path)
    if data.get("schema") != BASELINE_SCHEMA:
        raise DamagedFileError("not a baseline of this version", where=str(path))
    try:
        _File.model_validate(data)
    except ValidationError as error:
        mistake = explain(error, _File, str(path))
        raise DamagedFileError(mistake.what, where=mistake.where, expected=mistake.expected, fix=FROM_GIT) from None
    if data["suite"] != suite:
        raise UserError(f"is the baseline of suite {data['suite']!r}", where=str(path), expected=f"that of {suite!r}")
    pack = pack_path(path)
    if not files.kind_at(pack):
        raise UserError("no such file", where=str(pack), expected=f"the frozen images that belong to {path.name}")
    if files.sha256_of(pack, expected="the frozen images of a baseline") != data["pack_sha256"]:
        raise DamagedFileError("its bytes are not those that were accepted", where=str(pack), fix=FROM_GIT)
    try:
        results = GateInputs(
            rows=from_columns(data["rows"]), fresh=from_columns(data["fresh"]), fresh_night=data["fresh_night"]
        )
        _check_scenes(data, results.rows)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        why = str(error) if isinstance(error, ValueError) else misfit(error)
        raise DamagedFileError(f"its rows cannot be used: {why}", where=str(path), fix=FROM_GIT) from None
    head = {key: value for key, value in data.items() if key not in ("rows", "fresh", "scenes", "together")}
    return Baseline(path, head, results, data["scenes"], pack, data["together"])


def _sealed(path: Path) -> dict[str, Any]:
    """Return the object in a JSON file, which must hold its seal; it may be renamed."""
    data = files.read_bytes(path, largest=LARGEST_RECORD, expected="a baseline")
    try:
        sealed.check(data, path)
        return sealed.json_object(data, path)
    except DamagedFileError as error:
        raise DamagedFileError(error.what, where=error.where, fix=FROM_GIT) from None


def _check_scenes(data: Mapping[str, Any], rows: Sequence[ReplicateRow]) -> None:
    """Raise ``ValueError`` if rows are of scenes, bands or replicates that the baseline does not have."""
    for row in rows:
        about = data["together"].get(row.case) or data["scenes"].get(row.case) or {"bands": {}}
        band = about["bands"].get(row.band, {"images": []})
        images = band["images"]
        if row.replicate >= len(images) or images[row.replicate] != row.image_address:
            raise ValueError(f"no image of {row.case}, {row.band}, replicate {row.replicate}")
        is_due = band["expected"] == Outcome.VALID and not band["borderline"]
        if (band["bound_arcsec"], is_due) != (row.bound_arcsec, row.is_due):
            raise ValueError(f"bound or expected outcome of {row.case}, {row.band} is not that of its rows")
    for scene, about in data["scenes"].items():
        for name, band in about["bands"].items():
            if len(band["radiance_per_dn"]) != len(band["images"]):
                raise ValueError(f"radiance_per_dn of {scene}, {name} is not one number an image")
    for scene, about in data["together"].items():
        if unknown := [case for _, case in about["heads"] if case not in data["scenes"]]:
            raise ValueError(f"no scene {unknown[0]}, a head of {scene}")


@contextlib.contextmanager
def accepting(path: Path) -> Iterator[Path]:
    """Give a folder for the new files of a baseline; they get to ``path`` and beside it when the block ends."""
    finish_acceptance(path)
    folder = path.with_name(f".{path.stem}.accepting")
    shutil.rmtree(folder, ignore_errors=True)
    atomic.make_folder(folder)
    try:
        yield folder
        # From here on the acceptance holds, whatever happens.
        atomic.move(folder, _moving(path))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    finish_acceptance(path)


def finish_acceptance(path: Path) -> None:
    """Move the files of an acceptance to their places, all that are not there yet."""
    folder = _moving(path)
    if folder.is_symlink() or not folder.is_dir():
        return
    for file in sorted(folder.iterdir()):
        atomic.move(file, path.with_name(file.name))
    folder.rmdir()


def _moving(path: Path) -> Path:
    return path.with_name(f".{path.stem}.accepted")


def write_baseline(
    path: Path,
    head: Mapping[str, Any],
    results: GateInputs,
    scenes: Mapping[str, Any],
    pack: Pack,
    together: Mapping[str, Any],
) -> None:
    """Write a baseline's two files to a folder of :func:`accepting`."""
    images = pack_path(path)
    write_pack(images, pack)
    content = {
        **head,
        "schema": BASELINE_SCHEMA,
        "scenes": scenes,
        "together": together,
        "rows": to_columns(results.rows),
        "fresh": to_columns(results.fresh),
        "fresh_night": results.fresh_night,
        "pack_sha256": files.sha256_of(images),
    }
    write_json(path, content, indent=None, bound=False)


def copy_as_release(path: Path) -> Path:
    """Write the last release's files from the accepted ones, without detector images; return the JSON's path."""
    data = read_json(path, bound=False) or {}
    accepted = read_pack(pack_path(path))
    target = release_path(path)
    write_pack(pack_path(target), Pack((), accepted.frames, {}))
    data["pack_sha256"] = files.sha256_of(pack_path(target))
    write_json(target, data, indent=None, bound=False)
    return target
