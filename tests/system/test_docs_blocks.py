"""Every code block of the documentation runs as it stands there, and so do the examples."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from blocks import blocks, run_page
from conftest import PROGRAM

ROOT = Path(__file__).parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): text
    for path in [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "CONTRIBUTING.md"]
    if not {"generated", "results"} & set(path.relative_to(ROOT).parts)
    and any(blocks(text := path.read_text(encoding="utf-8")))
}
DONE_ELSEWHERE = frozenset(
    [
        "pip install .",
        "pip install 'horizonval[serve]'",
        "pip install 'horizonval[basilisk,serve]'",
        "python examples/basilisk/closed_loop.py results/in-the-loop",
        'pip install -e ".[test,docs]"',
        "ruff check .",
        "ruff format --check .",
        "mypy",
        "pytest -n auto --dist loadfile",
        "pytest -m slow",
        "pytest -m benchmark",
        "sphinx-build -W docs docs/_build",
        ".ci/run",
    ]
)
"""Run by ``.ci/run``; a test cannot install its own package or start itself. The loop needs Basilisk and minutes."""

SLOW = {
    "docs/howto/archive.md",
    "docs/howto/budget.md",
    "docs/howto/camera-and-orbit.md",
    "docs/howto/dataset.md",
    "docs/howto/estimator-program.md",
    "docs/howto/estimator-python.md",
    "docs/howto/formats.md",
    "docs/howto/in-the-loop.md",
    "docs/howto/nightly.md",
    "docs/howto/prior.md",
    "docs/howto/reproduce.md",
    "docs/howto/calibration.md",
    "docs/howto/trade-study.md",
    "docs/quickstart.md",
}
"""Pages that take minutes: ``pytest -m slow``."""


@pytest.mark.parametrize(
    "page", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in PAGES]
)
def test_every_block_of_the_page_runs(page, tmp_path):
    if "\ncc " in PAGES[page] and shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    if " examples/" in PAGES[page]:
        (tmp_path / "examples").symlink_to(ROOT / "examples")
    for done in run_page(PAGES[page], tmp_path, PROGRAM, DONE_ELSEWHERE):
        assert done.result.returncode == 0, (done.command, done.result.stdout, done.result.stderr)


def test_the_pages_are_found():
    assert len([name for name in PAGES if name.startswith("docs/howto/")]) == 15
    assert "docs/quickstart.md" in PAGES
    assert set(PAGES) > SLOW


EXAMPLES = [path.name for path in sorted((ROOT / "examples").glob("*.py"))]
NEEDED = {"load_dataset.py": ("torch", "webdataset")}
SLOW_EXAMPLES = {"right_air.py", "calibration_sensitivity.py", "calibration_bound.py"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW_EXAMPLES else name for name in EXAMPLES]
)
def test_every_example_runs(name, tmp_path):
    for library in NEEDED.get(name, ()):
        if importlib.util.find_spec(library) is None:
            pytest.skip(f"needs {library}")
    path = os.pathsep.join([str(PROGRAM.parent), os.environ["PATH"]])
    result = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name), "made"],
        cwd=tmp_path,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert any(word in result.stdout for word in ("deg off", "guarded", "NEES", "Cramer"))
    assert any((tmp_path / "made").iterdir())
