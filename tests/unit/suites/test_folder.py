"""The folder of a run: atomic files, the lock, leftovers."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from horizonval.core.errors import UserError
from horizonval.store.folder import RunFolder, read_json, write_json


def test_equal_data_give_equal_bytes(tmp_path):
    write_json(tmp_path / "a.json", {"b": 1 / 3, "a": [1, None]})
    write_json(tmp_path / "b.json", {"a": [1, None], "b": 1 / 3})
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert read_json(tmp_path / "a.json") == {"b": 1 / 3, "a": [1, None]}


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "a.json", {"a": float("nan")})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff", b"[" * 100_000])
def test_unreadable_json_is_none(tmp_path, content):
    (tmp_path / "a.json").write_bytes(content)
    assert read_json(tmp_path / "a.json") is None
    assert read_json(tmp_path / "none.json") is None


def test_leftovers_go_and_nothing_else(tmp_path):
    folder = RunFolder(tmp_path / "run")
    folder.create()
    keep = [folder.case("a"), folder.archive / "x.exr", folder.root / ".hidden", folder.root / "mine.tmp"]
    drop = [folder.cases / ".a.json.12.tmp", folder.archive / ".0f.tmp", folder.root / ".results.parquet.part"]
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


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "run").write_text("")
    with pytest.raises(UserError, match="run"):
        RunFolder(tmp_path / "run").create()
