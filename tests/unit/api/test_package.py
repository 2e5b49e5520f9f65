"""``import horizonval as hv`` is light, in any order; every public name has an example that runs."""

from __future__ import annotations

import doctest
import json
import os
import re
import subprocess
import sys
import textwrap

import pytest

import horizonval as hv
from horizonval.core.environment import LLVM_VARIABLE, OLDEST_LLVM, wheel_libraries

LIMIT_S = 0.3
HEAVY = {"mitsuba", "drjit", "scipy", "matplotlib", "duckdb", "numpy", "pydantic", "cv2", "OpenEXR", "erfa"}
RENDERER = {"mitsuba", "drjit"}


def loaded_by(statement: str) -> tuple[float, set[str]]:
    """Return the seconds that a statement takes in a fresh interpreter, and the packages it loads."""
    script = (
        "import json, sys, time\nstart = time.perf_counter()\n"
        f"{statement}\nspent = time.perf_counter() - start\nprint(json.dumps([spent, list(sys.modules)]))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    seconds, modules = json.loads(done.stdout)
    return seconds, {name.partition(".")[0] for name in modules}


def test_the_import_is_light():
    seconds, modules = min(loaded_by("import horizonval") for _ in range(3))
    assert seconds < LIMIT_S
    assert not modules & HEAVY


def test_nothing_before_a_frame_loads_the_renderer():
    _, modules = loaded_by(
        'import horizonval as hv\nscene = hv.Scene.from_file("limb-noon-vis")\nhv.check(scene)\n'
        "hv.list_estimators(), hv.estimate, hv.run, hv.render, hv.Frame"
    )
    assert "horizonval" in modules
    assert not modules & RENDERER


def test_names_are_listed_and_all_of_them_exist():
    import horizonval.renderer.frame  # noqa: F401

    assert set(hv.__all__) <= set(dir(hv))
    assert hv.__all__ == sorted(hv.__all__, key=lambda name: (name.lower() == name, name))
    for name in hv.__all__:
        assert callable(getattr(hv, name)) or name == "__version__", "a room of its name hides it"
    with pytest.raises(AttributeError, match="rendre"):
        hv.rendre  # noqa: B018


THINGS = {name: getattr(hv, name) for name in hv.__all__ if name != "__version__"}


@pytest.mark.parametrize("name", THINGS)
def test_a_public_name_has_an_example_that_runs(name, in_user_folder, capsys):
    thing = THINGS[name]
    module = sys.modules[thing.__module__]
    examples = doctest.DocTestFinder().find(thing, name, module)
    own = examples[0] if examples else None
    assert own is not None
    assert own.examples, f"{name} has no example in its docstring"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for example in examples:
        runner.run(example, clear_globs=False)
    assert not runner.failures, capsys.readouterr().out


WIDE = {
    "fov_deg = 60.0": 'projection = "fisheye"\nfov_deg = 160.0',
    "width = 64": "width = 128",
    "height = 64": "height = 128",
    "exposure_s = 2.0e-4": "exposure_s = 6e-5",
}
"""A camera that looks to the nadir and has the whole horizon in view."""


@pytest.fixture(scope="module")
def snippet(user_folder, tmp_path_factory):
    """The script, in a folder with the two files that it names."""
    folder = tmp_path_factory.mktemp("snippet")
    block = re.search(r"\n::\n\n(.*?)\n\n\S", hv.__doc__ or "", re.S)
    assert block is not None
    script = folder / "script.py"
    script.write_text(textwrap.dedent(block[1]) + "\nprint(run.rows().fetchall()[0][0])\n")
    camera = (user_folder / "mycam.toml").read_text()
    for old, new in WIDE.items():
        assert old in camera
        camera = camera.replace(old, new)
    (folder / "mycam.toml").write_text(camera)
    suite = (user_folder / "orbit.toml").read_text().replace("mount_roll_deg = 65.0", "mount_roll_deg = 0.0")
    (folder / "orbit.toml").write_text(suite)
    return script


def test_it_runs_as_a_plain_script(snippet):
    done = subprocess.run(
        [sys.executable, snippet.name], cwd=snippet.parent, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    *report, error, first_row = done.stdout.splitlines()
    assert report[0].startswith("scene scene")
    assert 0.0 < float(error) < 1.0
    assert first_row == "one"
    assert (snippet.parent / "out" / "report" / "index.html").is_file()


@pytest.mark.slow
def test_strict_types_find_nothing_in_it_and_wrong_use_elsewhere(snippet):
    """One run of the checker for both: without errors in a wrong script, silence would prove nothing."""
    wrong = snippet.with_name("wrong.py")
    wrong.write_text('import horizonval as hv\n\nhv.Scene(camera="x", altitude=550)\nhv.render(3)\n')
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", snippet.name, wrong.name],
        cwd=snippet.parent,
        capture_output=True,
        text=True,
        timeout=500,
    )
    errors = [line.split(":")[:2] for line in done.stdout.splitlines() if ": error:" in line]
    assert errors == [["wrong.py", "3"], ["wrong.py", "4"]], done.stdout + done.stderr


RENDER = """
import horizonval as hv
camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": 8, "height": 8})
scene = hv.Scene(camera=camera, altitude_km=500, mount_roll_deg=65, render={"orders": "single"})
try:
    print("rendered", hv.render(scene, progress=False))
except hv.UserError as e:
    print("refused", e)
"""


def run_script(text: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a script in an interpreter for which nobody has named a library."""
    clean = {key: value for key, value in os.environ.items() if key != LLVM_VARIABLE} | environment
    return subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, env=clean, timeout=300)


@pytest.mark.parametrize(
    "first",
    [
        "import drjit",
        pytest.param("import mitsuba; mitsuba.set_variant('scalar_rgb')", marks=pytest.mark.slow),
        pytest.param("import mitsuba as mi; mi.variant()", marks=pytest.mark.slow),
    ],
)
def test_drjit_first_renders_or_is_one_line(first):
    done = run_script(f"{first}\n{RENDER}")
    assert done.returncode == 0, done.stderr
    version = run_script("import drjit; print(drjit.detail.llvm_version()[0])").stdout
    if int(version) < OLDEST_LLVM and wheel_libraries():
        assert done.stdout.startswith("refused drjit was imported before horizonval and ")
        assert "import horizonval before drjit" in done.stdout
        assert len(done.stdout.strip().splitlines()) == 1
    else:
        assert done.stdout.startswith("rendered")


def test_horizonval_first_names_the_library_that_came_with_it():
    done = run_script(f"import horizonval, drjit\n{RENDER}\nprint(drjit.detail.llvm_version()[0])")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("rendered"), done.stderr
    assert int(lines[1]) >= OLDEST_LLVM


@pytest.mark.slow
@pytest.mark.skipif(not wheel_libraries(), reason="no library came as a wheel")
def test_a_library_that_was_named_serves_in_any_order():
    done = run_script(f"import drjit\n{RENDER}", **{LLVM_VARIABLE: wheel_libraries()[0]})
    assert done.stdout.startswith("rendered"), done.stderr
