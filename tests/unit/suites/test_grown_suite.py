"""One number sets the size of a suite: a folder goes on with another one, and what is left over counts nowhere.

Frames and fits are made by hand here, and no report is drawn: what is tested is which of them are made and counted.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import horizonval.report
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Silent
from horizonval.jobs import engine
from horizonval.scoring.row import read_results
from horizonval.suites.run import run_suite
from horizonval.suites.suite import load_suite, with_options
from horizonval.suites.units import case as of_case
from horizonval.suites.units import scored

SUITE = """
[suite]
name = "grows"
estimators = ["altitude-free"]
frames = 2
draws = 3
keep = "none"
[defaults]
camera.file = "c.toml"
platform.altitude_km = 500.0
[[cases]]
name = "sobol"
sobol = { share = 1.0, ranges = { attitude.yaw_deg = [-20.0, 20.0] } }
"""


class Kept(Silent):
    """How many frames were finished already."""

    kept = -1

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        self.kept = kept


class Refusing:
    spent_s = None

    def run(self, name, observation):
        return Refusal(Outcome.DARK, "dark")


@pytest.fixture
def suite_file(make_frame, monkeypatch, tmp_path) -> Path:
    frame = make_frame()
    camera = frame.truth.camera_spec
    monkeypatch.setattr(of_case, "_frame", lambda *_: (frame, None))
    monkeypatch.setattr(scored, "supervisor_of", lambda _: Refusing())
    monkeypatch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
    monkeypatch.setattr(horizonval.report, "build_report", lambda folder: folder)
    text = '[camera]\nname = "small"\nwidth = 40\nheight = 30\nfov_deg = 60.0\n'
    for table, values in (("[optics]", camera.optics), ("[[band]]", camera.band[0]), ("[detector]", camera.detector)):
        plain = values.model_dump(mode="json", exclude_defaults=True) | ({"kind": "cmos"} if "det" in table else {})
        text += f"{table}\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in plain.items())
    (tmp_path / "c.toml").write_text(text)
    (tmp_path / "grows.toml").write_text(SUITE)
    return tmp_path / "grows.toml"


def test_another_number_of_frames_goes_on_in_the_same_folder(suite_file, tmp_path):
    out, outcomes = tmp_path / "out", {}
    for frames, kept in ((2, 0), (3, 2), (2, 2)):
        progress = Kept()
        summary = run_suite(load_suite(suite_file, frames), out, 1, progress).summary
        assert (summary["n_cases"], progress.kept) == (frames, kept)
        outcome = [(out / name).read_bytes() for name in ("summary.json", "results.parquet", "run.json")]
        assert outcomes.setdefault(frames, outcome) == outcome
    assert [row.case for row in read_results(out / "results.parquet")] == ["sobol_000", "sobol_001"]
    assert (out / "cases" / "sobol_002.json").is_file(), "what was computed is not lost"


@pytest.mark.parametrize("change", ["keep", "seed", "draws = 4", "platform.altitude_km = 501.0"])
def test_anything_else_that_differs_is_another_suite(suite_file, tmp_path, change):
    run_suite(load_suite(suite_file), tmp_path / "out", 1)
    if change == "keep":
        suite = with_options(load_suite(suite_file, 3), None, "all")
    elif change == "seed":
        suite = load_suite(suite_file, 3, seed=5)
    else:
        key = change.partition(" = ")[0]
        lines = [change if line.startswith(key) else line for line in SUITE.splitlines()]
        suite_file.write_text("\n".join(lines))
        suite = load_suite(suite_file, 3)
    with pytest.raises(UserError, match="holds a run of other frames"):
        run_suite(suite, tmp_path / "out", 1)
