"""A sealed file is known for altered whichever of its bits is another, and its seal for what it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from horizonval.core import sealed
from horizonval.core.cache import cached_arrays, cached_json, keep_arrays, keep_json
from horizonval.core.errors import DamagedFileError

CONTENT = {"b": [1.5, None, "ü"], "a": {"horizonval:seal": "no", "z": 1}}
HERE = Path("here.json")


@pytest.mark.parametrize(("indent", "sort_keys"), [(1, True), (None, False)])
def test_every_bit_of_a_json_file_counts(indent, sort_keys):
    data = sealed.json_bytes(CONTENT, indent=indent, sort_keys=sort_keys)
    sealed.check(data, HERE)
    assert sealed.json_object(data, HERE) == CONTENT
    for position in range(len(data)):
        for bit in range(8):
            other = bytearray(data)
            other[position] ^= 1 << bit
            with pytest.raises(DamagedFileError, match=r"here\.json"):
                sealed.check(bytes(other), HERE)


@pytest.mark.parametrize("change", [lambda d: d[:-1], lambda d: d + b"\n", lambda d: b"", lambda d: d + d])
def test_another_length_is_another_file(change):
    with pytest.raises(DamagedFileError):
        sealed.check(change(sealed.json_bytes(CONTENT)), HERE)


def test_the_seal_stands_wherever_a_format_has_it():
    assert list(sealed.json_object(sealed.json_bytes({"b": 1, "a": 2}, sort_keys=False), HERE)) == ["b", "a"]
    data = b"any bytes \x00\xff"
    sealed.check(sealed.fill_in(data + sealed.TRAILER), HERE)
    with pytest.raises(DamagedFileError, match="has no seal"):
        sealed.check(data, HERE)
    with pytest.raises(ValueError, match="no place"):
        sealed.fill_in(data)


def test_a_damaged_cache_is_none_and_that_is_logged(tmp_path, caplog):
    path = tmp_path / "deep" / "a.npz"
    arrays = {"a": np.arange(12.0).reshape(3, 4), "b": np.float64(3.0)}
    keep_arrays(path, arrays)
    back = cached_arrays(path)
    assert back is not None
    assert all(np.array_equal(back[name], value) for name, value in arrays.items())
    assert not caplog.messages
    data = path.read_bytes()
    # The local header, its flags, the data, the central directory, the end, the seal: all of it, in fact.
    for position in range(len(data)):
        other = bytearray(data)
        other[position] ^= 1 << (position % 8)
        path.write_bytes(other)
        assert cached_arrays(path) is None
    assert len(caplog.messages) == len(data)
    assert "it is made anew" in caplog.messages[0]
    path.unlink()
    caplog.clear()
    assert cached_arrays(path) is None
    assert not caplog.messages, "a cache that is empty is not worth a word"
    path.mkdir()
    assert cached_arrays(path) is None
    keep_arrays(path / "below", arrays)


def test_a_cache_that_cannot_be_written_costs_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    keep_json(tmp_path / "file" / "a.json", {"a": 1})
    assert cached_json(tmp_path / "file" / "a.json") is None
    keep_json(tmp_path / "a.json", {"b": 1, "a": 1})
    assert cached_json(tmp_path / "a.json") == {"b": 1, "a": 1}
    (tmp_path / "a.json").write_text('{"b": 1}')
    assert cached_json(tmp_path / "a.json") is None
