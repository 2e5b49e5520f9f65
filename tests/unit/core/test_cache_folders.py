"""A cache folder that cannot be used stops no work, and is told once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from horizonval.core import environment
from horizonval.core.atomic import WriteError
from horizonval.core.cache import cached_json, keep_json
from horizonval.core.environment import cache_folder, configured_folder, is_usable

SCENE = """
[camera]
file = "small.toml"
[platform]
altitude_km = 500.0
[attitude]
roll_deg = 60
[render]
subsamples = 1
nodes = 8
"""
CAMERA = """
[camera]
width = 8
height = 8
fov_deg = 40
[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.51
nodes = 1
"""

WORK = """
import logging, os, subprocess, sys
from horizonval.core.environment import cache_folder, settle_libraries
settle_libraries()
from horizonval.core.cache import cached_json, keep_json
path = cache_folder() / "a" / "b.json"
keep_json(path, {"x": 1})
assert cached_json(path, dict) == {"x": 1}
import matplotlib.font_manager, drjit
child = "from horizonval.core.environment import cache_folder as f; print(f())"
assert subprocess.check_output([sys.executable, "-c", child], text=True).strip() == str(cache_folder())
print(cache_folder())
"""

UNUSABLE = {
    "a device as the cache": {"XDG_CACHE_HOME": "/dev/null/x"},
    "a device as the home": {"HOME": "/dev/null", "XDG_CACHE_HOME": "", "XDG_CONFIG_HOME": ""},
    "a cache that is no absolute path": {"XDG_CACHE_HOME": "relative"},
}

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="folders as of POSIX")


def _run(code: list[str], changes: dict[str, str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("MPLCONFIGDIR", "DRJIT_CACHE_DIR")}
    environment |= {"TMPDIR": str(folder)} | changes
    return subprocess.run(
        [sys.executable, *code], env=environment, cwd=folder, capture_output=True, text=True, timeout=240
    )


@pytest.mark.parametrize("changes", UNUSABLE.values(), ids=list(UNUSABLE))
def test_a_temporary_folder_stands_in(changes, tmp_path):
    run = _run(["-c", WORK], changes, tmp_path)
    assert run.returncode == 0, run.stderr
    assert run.stderr.count("\n") == 1, run.stderr
    assert run.stderr.startswith("horizonval: warning: the folder ")
    assert run.stdout.startswith(str(tmp_path / "horizonval-cache-"))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_rendering_goes_on_without_any_folder(tmp_path):
    (tmp_path / "small.toml").write_text(CAMERA)
    (tmp_path / "scene.toml").write_text(SCENE)
    (tmp_path / "tmp").mkdir()
    changes = UNUSABLE["a device as the home"] | {"TMPDIR": str(tmp_path / "tmp")}
    command = "import sys; from horizonval.cli import main; sys.argv[1:] = 'render scene.toml -o a.exr'.split(); main()"
    run = _run(["-c", command], changes, tmp_path)
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "a.exr").is_file()
    warnings = [line for line in run.stderr.splitlines() if "warning" in line or "jit" in line]
    assert len(warnings) == 1
    assert "the folder /dev/null/.config/matplotlib cannot be used, a temporary one replaces it" in warnings[0]


def test_a_folder_that_can_be_made_is_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a" / "b"))
    assert cache_folder() == configured_folder() == tmp_path / "a" / "b" / "horizonval"
    assert not (tmp_path / "a").exists()
    (tmp_path / "file").touch()
    assert is_usable(tmp_path / "a")
    assert not is_usable(tmp_path / "file" / "a")
    assert not is_usable(Path("relative"))


def test_a_full_disk_is_told_once(tmp_path, monkeypatch, caplog):
    def full(path, data):
        raise WriteError.of(OSError(28, "No space left on device"), path)

    monkeypatch.setattr("horizonval.core.atomic.write_bytes", full)
    monkeypatch.setattr(environment, "_warned", set())
    for name in "ab":
        keep_json(tmp_path / name, {"x": 1})
        assert cached_json(tmp_path / name, dict) is None
    assert [record.getMessage() for record in caplog.records] == [
        f"horizonval: warning: {tmp_path} cannot be written (No space left on device); "
        "nothing is stored for the next run"
    ]
