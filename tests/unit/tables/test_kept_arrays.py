"""Parts of tables that are kept: read again, and made again where they are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.tables.modes import kept_arrays


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"\x93NUMPY"])
def test_damaged_parts_are_made_again(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "part.npz"
    made: list[int] = []

    def make() -> dict[str, FloatArray]:
        made.append(1)
        return {"a": np.arange(3.0), "b": np.ones((2, 2))}

    first = kept_arrays(path, make)
    again = kept_arrays(path, make)
    assert len(made) == 1
    assert set(again) == {"a", "b"}
    np.testing.assert_array_equal(again["b"], first["b"])
    path.write_bytes(damage)
    np.testing.assert_array_equal(kept_arrays(path, make)["a"], first["a"])
    assert len(made) == 2
    path.write_bytes(path.read_bytes()[:-40])
    kept_arrays(path, make)
    assert len(made) == 3
