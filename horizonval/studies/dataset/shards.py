"""Shards of a data set: work for the engine, three file formats, and the numbers stored with each image.

A shard is a file with a record of its digest. Equal content gives equal bytes: no file holds its time of writing, and
none is compressed, since the bytes would depend on the compressor's version. Every image has its truth, and the
sensor's knowledge of its camera, as arrays of fixed shapes.
"""

from __future__ import annotations

import importlib.util
import io
import json
import tarfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import atomic, files
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError
from horizonval.frame import FrameTruth
from horizonval.jobs.engine import Done, Record, Recorded
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.frame_cost import shared_view
from horizonval.sensor.observe import observe
from horizonval.spec.suite import DatasetSpec
from horizonval.studies.dataset.scenes import FramesOfScene, turned_scenes

COLUMNS: dict[str, str] = {
    "nadir_cam": "unit vector to the Earth's centre, camera axes",
    "nadir_geodetic_cam": "unit vector along the geodetic vertical, camera axes",
    "q_cam_from_itrs": "quaternion, scalar last",
    "q_cam_from_body": "quaternion of the mounting, scalar last",
    "q_body_from_lvlh": "quaternion of the attitude, scalar last",
    "r_itrs": "position, m",
    "altitude_m": "geodetic height, m",
    "angular_radius_rad": "of the Earth, mean over the horizon",
    "sun_cam": "unit vector to the Sun, camera axes",
    "sun_visible_fraction": "share of the Sun's disc seen past the Earth",
    "epoch_unix_s": "instant, s since 1970 UTC",
    "camera": "fx, fy, cx, cy [px], then five numbers of distortion",
    "full_scale": "largest digital number",
    "scene": "number of the scene",
    "frame": "number of the frame in the data set",
}
"""Meaning of each column; ``image`` is separate: digital numbers, shape (bands, height, width)."""


@dataclass(frozen=True)
class ShardContent:
    """Frames in order: ``images`` uint16, shape (n, bands, height, width), and the :data:`COLUMNS`, first axis n.

    Columns are float64, integers int64.
    """

    images: NDArray[np.uint16]
    columns: Mapping[str, NDArray[Any]]


def row_of(truth: FrameTruth, full_scale: int, scene: int, frame: int) -> dict[str, Any]:
    camera = truth.camera_model
    distortion = [float(k) for k in camera.distortion][:5]
    return {
        "nadir_cam": truth.nadir_geocentric_cam,
        "nadir_geodetic_cam": truth.nadir_geodetic_cam,
        "q_cam_from_itrs": truth.q_cam_from_itrs,
        "q_cam_from_body": truth.q_cam_from_body,
        "q_body_from_lvlh": truth.q_body_from_lvlh,
        "r_itrs": truth.r_itrs,
        "altitude_m": truth.altitude_m,
        "angular_radius_rad": truth.angular_radius_rad,
        "sun_cam": truth.sun_cam,
        "sun_visible_fraction": truth.sun_visible_fraction,
        "epoch_unix_s": datetime.fromisoformat(truth.epoch_utc.replace("Z", "+00:00")).timestamp(),
        "camera": [camera.fx, camera.fy, camera.cx, camera.cy, *distortion, *[0.0] * (5 - len(distortion))],
        "full_scale": full_scale,
        "scene": scene,
        "frame": frame,
    }


def content_of(images: Sequence[NDArray[np.uint16]], rows: Sequence[Mapping[str, Any]]) -> ShardContent:
    return ShardContent(np.stack(images), {name: np.array([row[name] for row in rows]) for name in COLUMNS})


SUFFIXES = {"webdataset": ".tar", "hdf5": ".h5", "zarr": ".zarr.zip"}
_LIBRARIES = {"hdf5": "h5py", "zarr": "zarr"}
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)


def refuse_missing_library(format_name: str) -> None:
    """Raise ``UserError`` where the library that writes a format is not installed."""
    library = _LIBRARIES.get(format_name)
    if library is not None and importlib.util.find_spec(library) is None:
        raise UserError(
            f"{library} is not installed",
            where=f"--format {format_name}",
            fix="pip install 'horizonval[dataset]', or take --format webdataset",
        )


def write_shard(path: Path, content: ShardContent, format_name: str) -> None:
    """Write frames into a file of a format, replacing it."""
    _WRITERS[format_name](path, content)


def _write_webdataset(path: Path, content: ShardContent) -> None:
    """A tar archive of ``KEY.image.npy`` and ``KEY.truth.json`` for every frame, its number the key."""
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:
        for i, image in enumerate(content.images):
            key = f"{int(content.columns['frame'][i]):08d}"
            data = io.BytesIO()
            np.save(data, image)
            _add(tar, f"{key}.image.npy", data.getvalue())
            row = {name: values[i].tolist() for name, values in content.columns.items()}
            _add(tar, f"{key}.truth.json", json.dumps(row).encode())


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def _write_hdf5(path: Path, content: ShardContent) -> None:
    """One array ``image`` and one of every column, each with its meaning as the attribute ``text``."""
    import h5py

    # A narrow range of versions fixes the file's layout for future libraries.
    with h5py.File(path, "w", libver=("earliest", "v110")) as file:
        for name, values in _arrays(content).items():
            array = file.create_dataset(name, data=values, track_times=False)
            array.attrs["text"] = COLUMNS.get(name, "digital numbers (frame, band, row, column)")


def _write_zarr(path: Path, content: ShardContent) -> None:
    """A group of the same arrays in a zip archive; an image is a chunk."""
    import zarr

    entries: dict[str, Any] = {}
    store = zarr.storage.MemoryStore(entries)
    group = zarr.create_group(store)
    for name, values in _arrays(content).items():
        chunks = (1, *values.shape[1:]) if name == "image" else values.shape
        array = group.create_array(name, shape=values.shape, dtype=values.dtype, chunks=chunks, compressors=None)
        array[...] = values
        array.attrs["text"] = COLUMNS.get(name, "digital numbers (frame, band, row, column)")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for key in sorted(entries):
            archive.writestr(zipfile.ZipInfo(key, _FIRST_DAY), entries[key].to_bytes())


def _arrays(content: ShardContent) -> dict[str, Any]:
    return {"image": content.images, **content.columns}


_WRITERS: dict[str, Callable[[Path, ShardContent], None]] = {
    "webdataset": _write_webdataset,
    "hdf5": _write_hdf5,
    "zarr": _write_zarr,
}


@dataclass(frozen=True)
class Shard:
    """Frames of one file."""

    name: str
    parts: tuple[FramesOfScene, ...]

    @property
    def frames(self) -> int:
        return sum(part.last - part.first for part in self.parts)


@dataclass(frozen=True)
class Drawing:
    """Source of the frames of all shards.

    ``digest``: of the list of seeds and of the code. ``source``: the suite's file, for errors.
    """

    digest: str
    seed: int
    spec: DatasetSpec
    format: str
    source: str


class ShardWork(Recorded[Shard]):
    """Shards of a data set; records are in ``state``."""

    def __init__(self, drawing: Drawing, root: Path) -> None:
        self._drawing, self._root = drawing, root
        self.folder: Path | None = root

    def name(self, item: Shard) -> str:
        return item.name

    def group(self, item: Shard) -> str:
        """Return the key of shards whose first frames may share view tables."""
        case = item.parts[0].scene.case
        return shared_view(case.scene, case.camera)

    def path(self, item: Shard) -> Path:
        return self._root / "state" / f"{item.name}.json"

    def identity(self, item: Shard) -> str:
        return content_digest(self._drawing.digest, item.name)

    def file(self, item: Shard) -> Path:
        """Return the shard itself."""
        return self._root / f"{item.name}{SUFFIXES[self._drawing.format]}"

    def finished(self, item: Shard) -> Record | None:
        """Return the record of a shard whose file is undamaged."""
        record, path = super().finished(item), self.file(item)
        if record is None or files.kind_at(path) != "a file" or files.sha256_of(path) != record["sha256"]:
            return None
        return record

    def parts(self, item: Shard, done: Done[Record] | None) -> Mapping[str, str | None]:
        """Count frames."""
        error = None if done is None else done.error
        return {f"{item.name}/{i}": error for i in range(item.frames)}

    def record(self, item: Shard, watch: Stopwatch) -> Record:
        """Render, observe and write the frames of a shard; return its record."""
        # Only a process that renders loads the renderer.
        from horizonval.renderer.frame import render_in_turn

        drawing, images, rows = self._drawing, [], []
        for part in item.parts:
            camera = part.scene.case.camera
            scenes = turned_scenes(part.scene, drawing.spec, drawing.seed, drawing.source)
            for i in range(part.first, part.last):
                with watch.stage("render"):
                    frame = render_in_turn(scenes[i], camera, maps=False)
                with watch.stage("observe"):
                    seen = [observe(frame, camera, band.name, seed=i) for band in camera.band]
                images.append(np.stack([image.dn for image in seen]))
                rows.append(row_of(frame.truth, seen[0].full_scale, part.scene.number, part.number + i - part.first))
        path = self.file(item)
        with watch.stage("write"), atomic.replacing(path) as temporary:
            write_shard(temporary, content_of(images, rows), drawing.format)
        return {
            "file": path.name,
            "frames": item.frames,
            "bytes": path.stat().st_size,
            "sha256": files.sha256_of(path),
            "scenes": [part.scene.case.name for part in item.parts],
        }

    def lost(self, item: Shard, why: str) -> Done[Any]:
        return Done(None, why)
