"""Dr.Jit and Mitsuba before horizonval: the right library, or one line that says what to do; never an abort."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from horizonval.core.environment import LLVM_VARIABLE, OLDEST_LLVM, wheel_libraries

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
