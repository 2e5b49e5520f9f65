"""Shipped tables of :mod:`horizonval.earth.data`, read once and write-protected."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import as_file, files
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray


@cache
def npz(name: str) -> MappingProxyType[str, NDArray[np.generic]]:
    """Return the arrays of ``data/<name>``, floats as float64, all write-protected."""
    with as_file(files("horizonval.earth") / "data" / name) as path, np.load(path, allow_pickle=False) as archive:
        arrays = {
            key: value.astype(np.float64) if np.issubdtype(value.dtype, np.floating) else value
            for key, value in archive.items()
        }
    for array in arrays.values():
        array.setflags(write=False)
    return MappingProxyType(arrays)


@cache
def csv(name: str) -> NDArray[np.float64]:
    """Return the numbers of ``data/<name>`` (one heading line), shape (columns, rows), write-protected."""
    with as_file(files("horizonval.earth") / "data" / name) as path:
        table = np.loadtxt(path, delimiter=",", skiprows=1, dtype=np.float64).T.copy()
    table.setflags(write=False)
    return table


@cache
def json_object(name: str) -> MappingProxyType[str, Any]:
    """Return the object of ``data/<name>``."""
    return MappingProxyType(json.loads((files("horizonval.earth") / "data" / name).read_text(encoding="utf-8")))
