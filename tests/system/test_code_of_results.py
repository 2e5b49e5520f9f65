"""What a process loads while it makes a result is what the result's identity counts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, MINI_SUITE

from horizonval.core import code
from horizonval.suites.identity import FRAME_CODE, ROW_CODE, code_of

FRAME = """
import sys
from pathlib import Path
from horizonval.renderer.scene.frame import render_frame
from horizonval.store.exr import write_frame
from horizonval.spec.load import load_scene
write_frame(Path("frame.exr"), render_frame(*load_scene("glint-mini.toml")))
"""
ROW = """
import sys
from pathlib import Path
from horizonval.spec.load import load_suite
from horizonval.store.folder import RunFolder
from horizonval.jobs.stopwatch import Stopwatch
from horizonval.suites.units.case import records_of
from horizonval.suites.plan import plan_of, units_of
suite = load_suite("mini.toml")
plan, folder = plan_of(suite), RunFolder(Path("out"))
folder.create()
made = records_of(units_of(suite.cases[:1], plan)[0], plan, folder, Stopwatch())
assert all(record["error"] is None for record in made.values())
"""
METHODS = code_of(["altitude-free", "ideal"])
TELL = "print(*sorted(name for name in sys.modules if name.startswith('horizonval.')))"
SCENE = """
[scene]
name = "mini"
[platform]
altitude_km = 500.0
[camera]
file = "mini-camera.toml"
"""
LOADS = {"horizonval.spec.load", "horizonval.spec.files", "horizonval.spec.suite"}
"""What reads the files of a scene or suite: that is before, and their content counts by itself."""


def _loaded(script: str, folder: Path) -> set[str]:
    (folder / "mini-camera.toml").write_text(MINI_CAMERA)
    (folder / "glint-mini.toml").write_text(SCENE)
    (folder / "mini.toml").write_text(MINI_SUITE)
    done = subprocess.run([sys.executable, "-c", script + TELL], cwd=folder, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("script", "modules"), [(FRAME, FRAME_CODE), (ROW, (*ROW_CODE, *METHODS))], ids=["frame", "row"]
)
def test_no_module_is_missed(script: str, modules: tuple[str, ...], tmp_path: Path) -> None:
    loaded = _loaded(script, tmp_path)
    counted = set(code.modules_of({"horizonval": code._root_of("horizonval")}, *modules))
    reading = set(code.modules_of({"horizonval": code._root_of("horizonval")}, *LOADS))
    assert loaded > {"horizonval.renderer.kernel.march", "horizonval.truth.frame_truth"}
    assert {name for name in loaded - counted if not code.MACHINERY.fullmatch(name)} <= reading
