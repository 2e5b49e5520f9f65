"""``import horizonval as hv`` is light; every public name has an example that runs, and the snippet runs too."""

from __future__ import annotations

import doctest
import json
import re
import subprocess
import sys
import textwrap

import pytest

import horizonval as hv

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
