"""The README tells the truth: every command in it runs as it stands there."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path

import pytest
from conftest import PROGRAM

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```sh\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line]

INSTALL_AND_TEST = {"pip install .", 'pip install ".[test]"', "pytest -n auto --dist loadfile"}
"""Run by ``.ci/run``; a test cannot install its own package or start itself."""

QUICK_SECONDS = 2 * 180
"""Of processor time: three minutes on two processors. By the clock it depends on what else the machine does."""


@pytest.fixture(scope="module")
def transcript(tmp_path_factory):
    """Run every command in order, in one empty folder; ``(folder, {command: (result, processor seconds)})``."""
    folder = tmp_path_factory.mktemp("readme")
    path = os.pathsep.join([str(PROGRAM.parent), os.environ["PATH"]])
    done = {}
    for command in COMMANDS:
        if command in INSTALL_AND_TEST:
            continue
        before = os.times()
        result = subprocess.run(
            command,
            shell=True,
            cwd=folder,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        after = os.times()
        spent = after.children_user + after.children_system - before.children_user - before.children_system
        done[command] = (result, spent)
    return folder, done


def test_the_commands_are_found():
    assert COMMANDS[:2] == ["pip install .", "horizonval run --out out"]
    assert set(COMMANDS) >= INSTALL_AND_TEST
    assert len(COMMANDS) >= 8


def test_every_command_succeeds(transcript):
    _, done = transcript
    for command, (result, _) in done.items():
        assert result.returncode == 0, (command, result.stderr)


def test_the_default_run_is_quick_and_makes_what_is_promised(transcript):
    folder, done = transcript
    assert done["horizonval run --out out"][1] < QUICK_SECONDS
    out = folder / "out"
    summary = json.loads((out / "summary.json").read_text())
    frames = int(re.search(r"(\d+) frames", README).group(1))
    assert (summary["suite"], summary["n_cases"], summary["failed"]) == ("quick", frames, {})
    assert (out / "results.parquet").stat().st_size > 0
    assert len(list((out / "archive").rglob("*.exr"))) == 2 * frames


def test_the_report_opens_from_the_disk(transcript):
    folder, _ = transcript
    report = folder / "out" / "report"
    page = (report / "index.html").read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html>")
    for reference in re.findall(r'(?:src|href)="([^"#]+)"', page):
        if reference.startswith("data:"):
            continue
        assert "://" not in reference, "no network is needed"
        assert (report / reference.split("#")[0]).exists(), reference


def test_files_named_in_the_readme_exist():
    for name in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in name:
            assert (ROOT / name).exists(), name
    for folder in ("scenes", "horizonval/spec", ".ci/run"):
        assert folder in README
        assert (ROOT / folder).exists()
