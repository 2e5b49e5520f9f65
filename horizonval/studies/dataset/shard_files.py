"""Shards as files of three kinds, each readable by that kind's own library; equal content gives equal bytes.

Nothing is compressed: bytes would hang on the version of a compressor, and the noise of a detector hardly shrinks.
No file holds the time when it was written.
"""

from __future__ import annotations

import importlib.util
import io
import json
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.errors import UserError
from horizonval.studies.dataset.columns import COLUMNS, ShardContent

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
    """Write frames into a file of a format; what is there is replaced."""
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
    """One array ``image`` and one of every column, each with what it is as the attribute ``text``."""
    import h5py

    # A narrow range of versions keeps the layout of the file the same whatever library comes next.
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
