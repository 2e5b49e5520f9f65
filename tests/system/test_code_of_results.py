"""The digest of the code counts every room that a result flows through, and the packages of users' estimators."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, MINI_SUITE

import horizonval
from horizonval.core import code

PACKAGE = Path(horizonval.__file__).parent
FRAME = """
from pathlib import Path
from horizonval.renderer.frame import render_frame
from horizonval.store.exr import write_frame
write_frame(Path("frame.exr"), render_frame(suite.cases[0].scene, suite.cases[0].camera))
"""
ROW = """
from pathlib import Path
from horizonval.store.folder import RunFolder
from horizonval.jobs.progress import Stopwatch
from horizonval.suites.units.case import records_of
from horizonval.suites.plan import plan_of, units_of
plan, folder = plan_of(suite), RunFolder(Path("out"))
folder.create()
made = records_of(units_of(suite.cases[:1], plan)[0], plan, folder, Stopwatch())
assert all(record["error"] is None for record in made.values())
"""
LOAD = """
import sys
from horizonval.spec.load import load_suite
suite = load_suite("mini.toml")
before = {*sys.modules}
"""
TELL = "print(*sorted(name for name in sys.modules if name.startswith('horizonval.') and name not in before))"


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    def clear() -> None:
        for cached in (code.code_version, code.code_digest, code._of_path):
            cached.cache_clear()

    clear()
    yield
    clear()


@pytest.mark.parametrize("script", [FRAME, ROW], ids=["frame", "row"])
def test_no_room_is_missed(script: str, tmp_path: Path) -> None:
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    (tmp_path / "mini.toml").write_text(MINI_SUITE)
    command = [sys.executable, "-c", LOAD + script + TELL]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = {name.split(".")[1] for name in done.stdout.split()}
    assert loaded > {"renderer", "truth"}
    if script == FRAME:
        assert loaded - {"estimation"} <= {*code.FRAME_ROOMS}, "estimation: the header's ideal sensor, see FRAME_ROOMS"
    else:
        assert loaded & code._WITHOUT_RESULTS <= {"jobs"}, "jobs carries results and has no part in them"


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the package's sources, to change."""
    root = tmp_path / "horizonval"
    shutil.copytree(PACKAGE, root, ignore=shutil.ignore_patterns("__pycache__", "scenes"))
    monkeypatch.setattr(horizonval, "__file__", str(root / "__init__.py"))
    return root


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("renderer/frame.py", {"version", "frame", "row"}),
        ("earth/data/solar_spectrum.csv", {"version", "frame", "row"}),
        ("frame.py", {"version", "frame", "row"}),
        ("sensor/observe.py", {"version", "row"}),
        ("cli/run.py", {"version"}),
    ],
)
def test_a_changed_file_makes_again_what_flows_through_its_room(copy: Path, name: str, changed: set[str]) -> None:
    def digests() -> dict[str, str]:
        return {
            "version": code.code_version(),
            "frame": code.code_digest(rooms=code.FRAME_ROOMS),
            "row": code.code_digest(),
        }

    before = digests()
    with (copy / name).open("a") as file:
        file.write("# one word more\n")
    for cached in (code.code_version, code.code_digest, code._of_path):
        cached.cache_clear()
    assert {kind for kind, digest in digests().items() if digest != before[kind]} == changed


def test_the_digest_is_the_same_in_every_process_and_the_version_begins_with_the_release() -> None:
    text = "from horizonval.core.code import code_digest as d; print(d('horizonval.studies'))"
    made = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert made.stdout.strip() == code.code_digest("horizonval.studies") != code.code_digest()
    release, _, digest = code.code_version().partition("+")
    assert (release, len(digest)) == (horizonval.__version__, 12)


@pytest.mark.parametrize(
    "name", ["own_package/fast.cpython-311-x86_64-linux-gnu.so", "own_package/limits.csv", "own.py"]
)
def test_packages_of_users_count_as_files_and_are_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "own_package").mkdir()
    (tmp_path / "own_package" / "__init__.py").write_text("raise SystemExit(0)")
    monkeypatch.syspath_prepend(str(tmp_path))
    module = "own" if name == "own.py" else "own_package.fast"
    digests = {code.code_digest(), code.code_digest("no_such_package.method"), code.code_digest("_bisect")}
    for content in (b"LIMIT = 1", b"LIMIT = 2"):
        (tmp_path / name).write_bytes(content)
        code.code_digest.cache_clear()
        code._of_path.cache_clear()
        digests.add(code.code_digest(module))
    assert len(digests) == 5
