"""The README tells the truth: everything in it runs as it stands there, and its figures are those of the results."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from blocks import blocks, commands, run_page
from conftest import PROGRAM

import horizonval

ROOT = Path(__file__).parents[2]
PACKAGE = Path(horizonval.__file__).parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [line for block in blocks(README) if block.kind == "sh" for line in commands(block)]

INSTALL_AND_TEST = frozenset({"pip install .", 'pip install ".[test]"', "pytest -n auto --dist loadfile"})
"""Run by ``.ci/run``; a test cannot install its own package or start itself."""

QUICK_SECONDS = 2 * 30
"""Of processor time: half a minute on two processors. By the clock it depends on what else the machine does."""

ROW = re.compile(
    r"^\| (?P<question>[^|]+\?) \| (?P<answer>[^|]+) \| \[[^]]+\]\((?P<file>[^)]+)\) \|$", flags=re.MULTILINE
)


RUN = "horizonval run --out out"


def _done(page: str, folder: Path) -> dict[str, tuple]:
    """Run everything of a page in order, in one empty folder; every command's result and processor time [s]."""
    done = {one.command: (one.result, one.processor_s) for one in run_page(page, folder, PROGRAM, INSTALL_AND_TEST)}
    for command, (result, _) in done.items():
        assert result.returncode == 0, (command, result.stderr)
    # The script is last: nothing before it has stopped the page.
    assert "import horizonval as hv" in list(done)[-1]
    return done


def _assert_whole(out: Path, suite: str, frames: int, scenes_of_heads: int = 0) -> None:
    """The run is finished, and its report opens from the disk without a network."""
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["suite"], summary["n_cases"], summary["failed"]) == (suite, frames + scenes_of_heads, {})
    assert (out / "results.parquet").stat().st_size > 0
    assert len(list((out / "archive").rglob("*.exr"))) == 2 * frames
    report = out / "report"
    page = (report / "index.html").read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html>")
    for reference in re.findall(r'(?:src|href)="([^"#]+)"', page):
        if reference.startswith("data:"):
            continue
        assert "://" not in reference, "no network is needed"
        assert (report / reference.split("#")[0]).exists(), reference


def test_the_commands_are_found():
    assert COMMANDS[:2] == ["pip install .", RUN]
    assert set(COMMANDS) >= INSTALL_AND_TEST
    assert sum(block.kind == "python" for block in blocks(README)) == 1


def test_everything_runs_with_six_small_frames_for_the_default_suite(mini_suite, tmp_path):
    page = README.replace(RUN, f"horizonval run {mini_suite} --out out")
    page = page.replace('hv.run("quick"', f'hv.run("{mini_suite}"')
    assert page.count(str(mini_suite)) == 2
    _done(page, tmp_path)
    _assert_whole(tmp_path / "out", "mini", 6)


@pytest.mark.slow
def test_everything_runs_as_it_is_written(tmp_path):
    done = _done(README, tmp_path)
    assert done[RUN][1] < QUICK_SECONDS
    frames = int(re.search(r"(\d+) frames", README).group(1))
    _assert_whole(tmp_path / "out", "quick", frames, frames // 2)
    assert (tmp_path / "out" / "report" / "index.html").stat().st_size < 2e6


def test_files_named_in_the_readme_exist():
    for name in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in name:
            assert (ROOT / name).exists(), name
    # The package may be installed elsewhere, as from its wheel.
    for folder, place in (("scenes", ROOT), (".ci/run", ROOT), ("horizonval/spec", PACKAGE.parent)):
        assert folder in README
        assert (place / folder).exists()


def test_every_figure_of_the_table_is_in_the_result_it_links_to():
    rows = list(ROW.finditer(README))
    assert len(rows) == README.count("? | ")
    for row in rows:
        text = (ROOT / row["file"]).read_text(encoding="utf-8")
        figures = re.findall(r"\d+(?: \d{3})*(?:\.\d+)?", row["answer"])
        assert figures, row["question"]
        for figure in figures:
            assert re.search(rf"(?<![\d.]){re.escape(figure)}(?!\d)", text), (row["question"], figure)
