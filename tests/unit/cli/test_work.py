"""How work of the command line begins and ends: seeds in place of the suite's, interruptions, foreign exits."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from horizonval import cli
from horizonval.cli.output import interruptible, resumable
from horizonval.core.errors import UserError
from horizonval.suites.suite import load_suite

LATE = {"mitsuba", "drjit", "numpy", "scipy", "cv2", "OpenEXR", "pydantic", "rich", "duckdb", "matplotlib"}
"""numpy also because the number of its threads is fixed after this import, before numpy's own."""


def test_import_loads_nothing_heavy():
    code = "import sys, horizonval.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "typer" in loaded
    assert not loaded & LATE


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "horizonval", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("horizonval ")
    done = subprocess.run([sys.executable, "-m", "horizonval", "rendr"], capture_output=True, text=True)
    assert done.returncode == 2


@pytest.mark.parametrize(
    ("kept", "line"),
    [
        (None, "horizonval: interrupted; the same command goes on from here\n"),
        ("units", "horizonval: interrupted; finished units are kept, the same command goes on from here\n"),
    ],
)
def test_an_interruption_is_one_line_and_status_130(kept, line, capsys):
    with pytest.raises(SystemExit) as end, resumable("night", "units", kept=kept):
        raise KeyboardInterrupt
    assert end.value.code == 130
    assert capsys.readouterr().err == line


@pytest.mark.parametrize(
    ("end", "status"),
    [(SystemExit(0), 1), (SystemExit(None), 1), (SystemExit(3), 3), (BrokenPipeError(), 1), (KeyboardInterrupt(), 130)],
)
def test_who_ends_work_early_does_not_say_that_it_is_done(end: BaseException, status: int) -> None:
    with pytest.raises(SystemExit) as ended, interruptible():
        raise end
    assert ended.value.code == status


def test_a_run_that_somebody_ends_with_status_0_has_not_succeeded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("horizonval.api.run.run_suite", lambda *_, **__: sys.exit(0))
    with pytest.raises(SystemExit) as ended:
        cli.run_command_line(["run", "quick", "--out", str(tmp_path / "out")])
    assert ended.value.code == 1
    assert "before the work was done" in capsys.readouterr().err


def test_another_seed_draws_other_scenes(monkeypatch, tmp_path):
    taken = []

    def take(suite, out, **_):
        taken.append(suite)
        raise UserError("enough")

    monkeypatch.setattr("horizonval.api.run.run_suite", take)
    for seed in ("1", "9"):
        assert cli.run_command_line(["run", "strict", "--frames", "40", "--seed", seed, "--out", str(tmp_path)]) == 2
    own = load_suite("strict", 40)
    assert own.seed == 1
    same, other = taken
    assert (same.seed, other.seed) == (1, 9)
    assert [case.scene for case in same.cases] == [case.scene for case in own.cases]
    names = {case.name for case in other.cases}
    assert names == {case.name for case in own.cases}
    assert not {c.scene.model_dump_json() for c in other.cases} & {c.scene.model_dump_json() for c in own.cases}
