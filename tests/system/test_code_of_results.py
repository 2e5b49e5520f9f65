"""What a process loads while it makes a result is what the result's identity counts."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, MINI_SUITE

import horizonval
from horizonval.core import code
from horizonval.suites.identity import FRAME_CODE, ROW_CODE, code_of

PACKAGE = Path(horizonval.__file__).parent
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


def _added(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def _add_constant(path: Path) -> None:
    with path.open("a") as file:
        file.write("\nADDED = 1\n")


@pytest.mark.slow
def test_only_what_flows_through_a_change_is_made_again(tmp_path: Path) -> None:
    """A run of a copy of the package that is changed between its calls."""
    package = tmp_path / "copy" / "horizonval"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    if not (package / "scenes").exists() and (PACKAGE.parent / "scenes").exists():
        (package.parent / "scenes").symlink_to(PACKAGE.parent / "scenes")
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    (tmp_path / "mini.toml").write_text(MINI_SUITE.partition('[[frame]]\nscene.name = "frame-1"')[0])
    start = "import sys; from horizonval.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "run", "mini.toml", "--out", "out", "--workers", "1"]

    def run() -> tuple[str, set[str]]:
        """Return what the run said, and its stages of the only frame."""
        (tmp_path / "out" / "timings.json").unlink(missing_ok=True)
        changed = os.environ | {"PYTHONPATH": str(package.parent)}
        done = subprocess.run(command, cwd=tmp_path, env=changed, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        cases = json.loads((tmp_path / "out" / "timings.json").read_text())["cases"]
        return done.stderr, set(cases.get("frame-0", {}))

    said, stages = run()
    assert "render" in stages
    record = tmp_path / "out" / "cases" / "frame-0.json"
    before = record.read_bytes()
    for path in ("sensor/observe.py", "renderer/scene/frame.py", "scoring/errors.py"):
        _added(package / path, '"""', '"""Better said: ')
    _added(package / "cli" / "campaign.py", 'help="', 'help="Better said: ')
    _add_constant(package / "report" / "wording.py")
    said, stages = run()
    assert "1 of 1 frames are finished already" in said
    assert stages == set()
    _add_constant(package / "sensor" / "observe.py")
    said, stages = run()
    assert "finished already" not in said
    assert {"read", "observe", "score"} <= stages
    assert "render" not in stages, "the frame is not rendered again"
    assert record.read_bytes() != before, "it says the identity of the new code"
