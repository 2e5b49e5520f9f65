"""Files that appear whole or not at all, and sealed files that are known for altered whichever bit is another."""

from __future__ import annotations

import errno
import os
import pickle
import re
from pathlib import Path

import duckdb
import numpy as np
import pytest

import horizonval
from horizonval.core import atomic, sealed
from horizonval.core.cache import cached_arrays, cached_json, keep_arrays, keep_json
from horizonval.core.errors import DamagedFileError

PACKAGE = Path(horizonval.__file__).parent
ALONE = ("atomic.py", "program.py")
"""The writer itself, and a program's input in a folder that is thrown away."""


def test_a_file_is_written_as_it_is(tmp_path: Path) -> None:
    atomic.write_bytes(tmp_path / "a", b"\x00\r\n")
    atomic.write_text(tmp_path / "b", "ä\n")
    atomic.copy_file(tmp_path / "a", tmp_path / "c")
    assert [(tmp_path / name).read_bytes() for name in "abc"] == [b"\x00\r\n", "ä\n".encode(), b"\x00\r\n"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]


def test_an_interrupted_write_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_text("before")

    def interrupted() -> None:
        with atomic.replacing(path) as temporary:
            temporary.write_text("half")
            assert path.read_text() == "before"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_the_content_is_on_the_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = []
    sync, rename = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda descriptor: (order.append("fsync"), sync(descriptor))[1])
    monkeypatch.setattr(os, "replace", lambda *paths: (order.append("replace"), rename(*paths))[1])
    atomic.write_text(tmp_path / "a", "text")
    assert order == ["fsync", "replace", "fsync"]


def test_what_a_killed_writer_left_is_known_and_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / ".a.json.12.tmp").touch()
    (tmp_path / "below" / ".b.tmp").touch()
    for name in ("c.tmp", ".hidden", "d"):
        (tmp_path / name).touch()
    assert [path.name for path in atomic.leftovers(tmp_path)] == [".a.json.12.tmp", ".b.tmp"]
    assert [path.name for path in atomic.leftovers(tmp_path, below=False)] == [".a.json.12.tmp"]
    with pytest.raises(atomic.WriteError, match="none: no such folder; create it first"):
        atomic.write_text(tmp_path / "none" / "a", "text")


@pytest.mark.parametrize(
    "raised",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        RuntimeError('Failed to write pixel data to image file ".a.tmp". No space left on device.'),
        duckdb.IOException("IO Error: Could not write all bytes: No space left on device"),
        OSError(errno.EROFS, "Read-only file system"),
        PermissionError(errno.EACCES, "Permission denied"),
        OSError(errno.EMFILE, "Too many open files"),
    ],
)
def test_what_the_system_refuses_a_writer_names_the_path_in_one_line(tmp_path: Path, raised: Exception) -> None:
    (tmp_path / "a").write_text("before")
    reason = next(x for x in ("No space", "Read-only", "Permission", "Too many open") if x in str(raised))
    # Also where a temporary file is itself written like that, as entries of an archive are.
    for name, named in (("a", tmp_path / "a"), (".a.0.tmp", tmp_path)):
        with pytest.raises(atomic.WriteError) as refused, atomic.replacing(tmp_path / name):
            raise raised
        copy = pickle.loads(pickle.dumps(refused.value))
        assert copy.line() == refused.value.line() == f"{named}: cannot be written: {copy.reason}"
        assert copy.reason.startswith(reason)
    with pytest.raises(atomic.WriteError, match=f"{tmp_path}/a: is a file; expected a folder"):
        atomic.make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a").read_text() == "before"
    with pytest.raises(FileNotFoundError, match="other"), atomic.replacing(tmp_path / "a"):
        (tmp_path / "other").read_bytes()
    with pytest.raises(ZeroDivisionError), atomic.replacing(tmp_path / "a"):
        raise ZeroDivisionError


def test_nothing_else_in_the_package_writes_and_renames() -> None:
    """One writer: who renames a file, or writes to its own name, has not heard of it."""
    own = re.compile(
        r"os\.(replace|rename)\(|\.rename\(|shutil\.(copy(?!fileobj)|move)|(?<!atomic)\.write_(text|bytes)\("
    )
    found = [
        f"{path.relative_to(PACKAGE)}:{number}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name not in ALONE
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if own.search(line)
    ]
    assert not found


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
    back = cached_arrays(path, dict)
    assert back is not None
    assert all(np.array_equal(back[name], value) for name, value in arrays.items())
    assert not caplog.messages
    data = path.read_bytes()
    # The local header, its flags, the data, the central directory, the end, the seal: all of it, in fact.
    for position in range(len(data)):
        other = bytearray(data)
        other[position] ^= 1 << (position % 8)
        path.write_bytes(other)
        assert cached_arrays(path, dict) is None
    assert len(caplog.messages) == len(data)
    assert "it is made anew" in caplog.messages[0]
    path.unlink()
    caplog.clear()
    assert cached_arrays(path, dict) is None
    assert not caplog.messages, "a cache that is empty is not worth a word"
    path.mkdir()
    assert cached_arrays(path, dict) is None
    keep_arrays(path / "below", arrays)


def test_a_cache_that_cannot_be_written_costs_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    keep_json(tmp_path / "file" / "a.json", {"a": 1})
    assert cached_json(tmp_path / "file" / "a.json", dict) is None
    keep_json(tmp_path / "a.json", {"b": 1, "a": 1})
    assert cached_json(tmp_path / "a.json", dict) == {"b": 1, "a": 1}
    (tmp_path / "a.json").write_text('{"b": 1}')
    assert cached_json(tmp_path / "a.json", dict) is None
