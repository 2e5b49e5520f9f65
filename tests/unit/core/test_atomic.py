"""Files that appear whole or not at all: what is there before stays until the new one is complete and on the disk."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

import horizonval
from horizonval.core import atomic

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


def test_what_a_killed_writer_left_is_known(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    (tmp_path / ".a.json.12.tmp").touch()
    (tmp_path / "below" / ".b.tmp").touch()
    for name in ("c.tmp", ".hidden", "d"):
        (tmp_path / name).touch()
    assert [path.name for path in atomic.leftovers(tmp_path)] == [".a.json.12.tmp", ".b.tmp"]
    assert [path.name for path in atomic.leftovers(tmp_path, below=False)] == [".a.json.12.tmp"]


def test_a_missing_folder_is_the_callers_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        atomic.write_text(tmp_path / "none" / "a", "text")


def test_nothing_else_in_the_package_writes_and_renames() -> None:
    """One writer: who renames a file, or writes to its own name, has not heard of it."""
    own = re.compile(r"os\.(replace|rename)\(|\.rename\(|shutil\.(copy|move)|(?<!atomic)\.write_(text|bytes)\(")
    found = [
        f"{path.relative_to(PACKAGE)}:{number}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name not in ALONE
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if own.search(line)
    ]
    assert not found
