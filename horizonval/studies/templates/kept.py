"""Arrays that took long to make, kept in a folder so that what was cut off goes on there."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.arrays import FloatArray

LARGEST_BYTES = 1 << 28
"""Some ten times the largest part of a table."""


def kept_arrays(path: Path, make: Callable[[], dict[str, FloatArray]]) -> dict[str, FloatArray]:
    """Return the arrays of a file; what is not there, or damaged, is made and put there."""
    if path.exists():
        data = files.read_bytes(path, largest=LARGEST_BYTES, expected="a part of a table of templates")
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
                return {key: np.asarray(arrays[key]) for key in arrays.files}
        except files.UNREADABLE_ARRAYS:
            pass
    made = make()
    with atomic.replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **made)  # type: ignore[arg-type]  # names are not keywords of its own
    return made
