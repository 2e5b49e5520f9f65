"""The folder of a run: atomic files, the lock, leftovers."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.folder import RunFolder, intact_json, read_json, write_json


def test_equal_data_give_equal_bytes(tmp_path):
    write_json(tmp_path / "a.json", {"b": 1 / 3, "a": [1, None]})
    first = (tmp_path / "a.json").read_bytes()
    write_json(tmp_path / "a.json", {"a": [1, None], "b": 1 / 3})
    assert (tmp_path / "a.json").read_bytes() == first
    assert read_json(tmp_path / "a.json") == {"b": 1 / 3, "a": [1, None]}


def test_a_file_is_bound_to_its_name_unless_it_is_a_document(tmp_path):
    """Two files of a folder that were swapped are both good JSON with a seal."""
    write_json(tmp_path / "a.json", {"x": 1})
    (tmp_path / "a.json").rename(tmp_path / "b.json")
    with pytest.raises(DamagedFileError, match="does not match its seal"):
        read_json(tmp_path / "b.json")
    write_json(tmp_path / "a.json", {"x": 1}, bound=False)
    (tmp_path / "a.json").rename(tmp_path / "b.json")
    assert read_json(tmp_path / "b.json", bound=False) == {"x": 1}


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert read_json(tmp_path / "a.json") == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff", b"[" * 100_000])
def test_unreadable_json_is_told(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    with pytest.raises(DamagedFileError):
        read_json(tmp_path / "a.json")
    with pytest.raises(DamagedFileError):
        read_json(tmp_path / "a.json", bound=False)
    assert intact_json(tmp_path / "a.json") is None
    assert read_json(tmp_path / "none.json") is None


def test_what_is_no_file_is_not_waited_for(tmp_path, caplog):
    os.mkfifo(tmp_path / "a.json")
    (tmp_path / "b.json").mkdir()
    for name in ("a", "b"):
        with pytest.raises(UserError, match="is a"):
            read_json(tmp_path / f"{name}.json")
        assert intact_json(tmp_path / f"{name}.json") is None
        assert f"{name}.json: is a" in caplog.messages[-1]
        write_json(tmp_path / f"{name}.json", {"x": 1})
        assert read_json(tmp_path / f"{name}.json") == {"x": 1}


def test_a_file_without_a_seal_is_damaged_or_taken(tmp_path):
    (tmp_path / "a.json").write_text('{"x": 1}')
    with pytest.raises(DamagedFileError, match="has no seal"):
        read_json(tmp_path / "a.json")
    assert read_json(tmp_path / "a.json", bound=False) == {"x": 1}


@pytest.mark.parametrize("kind", ["folder", "FIFO", "link"])
def test_a_lock_is_had_whatever_lies_in_its_place(tmp_path, kind):
    path = tmp_path / ".lock"
    {"folder": path.mkdir, "FIFO": lambda: os.mkfifo(path), "link": lambda: path.symlink_to(tmp_path / "other")}[kind]()
    with RunFolder(tmp_path).locked():
        assert path.is_file()
        assert not path.is_symlink()
    assert [p.name for p in tmp_path.iterdir()] == [".lock"]


def test_leftovers_go_and_nothing_else(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.create()
    keep = [folder.case("a"), folder.archive / "x.exr", folder.root / ".hidden", folder.root / "mine.tmp"]
    drop = [folder.cases / ".a.json.12.tmp", folder.archive / ".0f.tmp", folder.root / ".results.parquet.12.tmp"]
    for path in keep + drop:
        path.touch()
    folder.remove_temporary_files()
    assert all(path.exists() for path in keep)
    assert not any(path.exists() for path in drop)


def test_one_run_at_a_time_and_no_lock_outlives_its_process(tmp_path):
    folder = RunFolder(tmp_path)
    code = (
        "import sys, pathlib, os\n"
        "from horizonval.store.folder import RunFolder\n"
        "with RunFolder(pathlib.Path(sys.argv[1])).locked():\n"
        "    print('locked', flush=True); sys.stdin.read()\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout.readline() == "locked\n"
    with pytest.raises(UserError, match="another run"), folder.locked():
        pass
    other.kill()
    other.communicate()
    with folder.locked():
        pass
