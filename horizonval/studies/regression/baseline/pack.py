"""Frozen images in one small file: detector images, and the frames they were made of.

A NumPy archive (``.npz``) with LZMA instead of deflate. Detector numbers are kept bit by bit, high and low bytes apart,
because noise fills the low ones only: 6 kB for an image of 112 x 112 pixels. Frames are kept as the square root of
their radiance in 12 bits, 0.05 % of the brightest pixel and finer below: enough to tell where and by how much a new
frame differs, while their own digests tell whether it differs at all. Equal content gives equal bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError

PACK_SCHEMA = 2
UNCALIBRATED_SCHEMA = 1
"""Of packs from before images carried the calibration of their detector; they are read without one."""
CODES = 4095
Key = tuple[str, str]
"""Scene and band."""


@dataclass(frozen=True)
class FrozenImage:
    """A detector image, shape (H, W), uint16.

    ``replicate`` is the seed of its noise; ``radiance_per_dn`` [W m-2 sr-1] the calibration of its detector, which an
    estimator is given beside the pixels, None where there is none.
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
    """``truths``: by scene, the plain truth without infrared horizon, which scoring again does not need."""

    images: tuple[FrozenImage, ...] = ()
    frames: tuple[FrozenFrame, ...] = ()
    truths: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def frame(self, key: Key) -> FrozenFrame | None:
        """Return the frame of a scene and band."""
        return next((f for f in self.frames if (f.scene, f.band) == key), None)


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
        # Neighbours are alike: their differences, modulo 2^16, compress to a third.
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


@lru_cache(maxsize=4)
def read_pack(path: Path) -> Pack:
    """Read a pack and check every image against its digest.

    Raises
    ------
    UserError
        There is no such file.
    DamagedFileError
        It is not what was written.
    """
    if not path.is_file():
        raise UserError("no such file", where=str(path), expected="the frozen images of a baseline")
    try:
        with files.open_file(path) as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(arrays["head"].tobytes())
        if head["schema"] not in (UNCALIBRATED_SCHEMA, PACK_SCHEMA):
            raise DamagedFileError(f"schema {head['schema']}", where=str(path), expected=f"schema {PACK_SCHEMA}")
        calibrated = head["schema"] == PACK_SCHEMA
        images = []
        for scene, band, replicate, full_scale, sha, name, k, *calibration in head["images"]:
            dn = _from_planes(arrays[f"{name}_high"][k], arrays[f"{name}_low"][k])
            (radiance_per_dn,) = calibration if calibrated else (None,)
            image = FrozenImage(scene, band, replicate, full_scale, dn, radiance_per_dn)
            if image.sha256 != sha:
                raise DamagedFileError(f"the image {scene} {band} {replicate} is not what was frozen", where=str(path))
            images.append(image)
        frames = []
        for scene, band, sha, name, k, scale in head["frames"]:
            differences = _from_planes(arrays[f"{name}_high"][k], arrays[f"{name}_low"][k])
            codes = np.cumsum(differences, axis=1, dtype=np.uint16)
            frames.append(FrozenFrame(scene, band, sha, _decode(codes, scale), arrays[f"{name}_regions"][k]))
    except UserError:
        raise
    except Exception as error:
        raise DamagedFileError(f"cannot be read ({type(error).__name__})", where=str(path)) from error
    return Pack(tuple(images), tuple(frames), head["truths"])


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
