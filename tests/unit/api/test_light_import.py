"""``import horizonval`` costs nothing: no renderer, no numpy, a fraction of a second."""

from __future__ import annotations

import json
import subprocess
import sys

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
    assert set(hv.__all__) <= set(dir(hv))
    assert hv.__all__ == sorted(hv.__all__, key=lambda name: (name.lower() == name, name))
    for name in hv.__all__:
        assert getattr(hv, name) is not None
    with pytest.raises(AttributeError, match="rendre"):
        hv.rendre  # noqa: B018


def test_a_function_is_not_hidden_by_a_room_of_its_name():
    import horizonval.renderer.frame  # noqa: F401

    assert all(callable(getattr(hv, name)) for name in hv.__all__ if name != "__version__")
