"""``--dry-run`` says what would be made, and leaves the disk as it was."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from conftest import assert_one_line, outcome_of

from horizonval.jobs import engine


@pytest.fixture(autouse=True)
def nothing_is_made(monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("an item was made")

    monkeypatch.setattr(engine, "run_in_processes", refuse)


def files(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in sorted(folder.rglob("*"))}


def test_what_is_finished_is_told(horizonval, mini_suite, mini_run, tmp_path):
    out = shutil.copytree(mini_run, tmp_path / "out")
    (out / "cases" / "frame-3.json").unlink()
    digests, before = outcome_of(out), files(tmp_path)
    done = horizonval("run", mini_suite, "--out", "out", "--dry-run")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:2] == ["suite mini", "  frames: 6, of which 5 are finished in out"]
    assert lines[2].startswith("cost: 6 frames, about ")
    assert lines[2].endswith(" on disk")
    assert lines[-1] == "nothing was rendered or written"
    content = json.loads(horizonval("run", mini_suite, "--out", "out", "--shard", "1/2", "--dry-run", "--json").stdout)
    assert (content["total"], content["finished"]) == ({"frames": 3}, {"frames": 3})
    assert content["cost"]["frames"] == 6
    assert (outcome_of(out), files(tmp_path)) == (digests, before)


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (["run", "moon"], "suite moon"),
        (["study", "visible-against-infrared", "--frames", "4"], "study visible-against-infrared"),
        (["regress", "--night", "2026-11-01"], "night 2026-11-01 of suite nightly"),
        (["reproduce", "A"], "published systems"),
    ],
)
def test_nothing_is_written(horizonval, tmp_path, command, expected):
    done = horizonval(*command, "--out", "new", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == expected
    assert ", of which 0 are finished in new" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_what_a_run_would_refuse_a_dry_run_refuses(horizonval, mini_suite, tmp_path):
    text = mini_suite.read_text().replace('"ideal"', '"idael"')
    (tmp_path / "mini-camera.toml").write_bytes((mini_suite.parent / "mini-camera.toml").read_bytes())
    (tmp_path / "bad.toml").write_text(text)
    assert_one_line(horizonval("run", "bad.toml", "--out", "new", "--dry-run"), "idael", "ideal")
    assert_one_line(horizonval("study", ".", "--dry-run"), "--out")
