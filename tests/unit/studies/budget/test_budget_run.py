"""A budget made of frames: rows derived by hand, closure, files."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from horizonval.cli import run_command_line
from horizonval.sensor.knowledge import drawn_errors
from horizonval.store.folder import read_json
from horizonval.suites.suite import load_suite

SUITE = """
[suite]
name = "small"
estimators = ["ideal"]
[defaults]
camera = { file = "ir-thermopile-32-110deg" }
render = { subsamples = 1, nodes = 16 }
atmosphere.profile = "us_standard"
prior = { attitude_sigma_deg = [1.0, 1.0, 1.0] }
[[cases]]
name = "flight"
grid = { "calibration.draw" = ["f1", "f2", "f3"] }
base.calibration = { mounting_sigma_deg = [0.1, 0.2, 0.0], focal_length_sigma_percent = 0.1 }
orbit = { epoch_utc = 2026-01-01T00:00:00Z, altitude_km = 500.0, inclination_deg = 60.0, n = 2 }
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("budget")
    (folder / "suite.toml").write_text(SUITE)
    out = folder / "out"
    words = ["budget", str(folder / "suite.toml"), "--out", str(out), "--workers", "1", "--alone"]
    assert run_command_line(words) == 0
    return folder / "suite.toml", out


def test_the_row_of_the_mounting_is_the_drawn_error(made):
    """The ideal sensor errs by the mounting it is given alone: by the drawn turn about the body's x and y axes."""
    path, out = made
    budget = read_json(out / "budget.json")["budgets"][0]
    rows = {row["source"]: row["axes"] for row in budget["rows"]}
    drawn = [
        drawn_errors(case.scene.calibration, case.scene.model_dump(mode="json"), None).mounting_rad
        for case in load_suite(path).cases
    ]
    for i, axis in enumerate(("roll", "pitch")):
        expected = np.degrees([one[i] for one in drawn]) * 3600.0
        found = rows["mounting"][axis]
        # Roll of a body that is level and errors of 0.2 deg: the turns do not mix beyond 1 part in 200.
        assert found["mean"] == pytest.approx(expected.mean(), abs=3.0)
        assert found["mixed"] == pytest.approx(expected.std(ddof=1), rel=0.01)
        assert found["temporal"] == pytest.approx(0.0, abs=0.5)
        assert budget["whole"]["axes"][axis]["mixed"] == pytest.approx(found["mixed"], rel=1e-3)
        alone = next(row for row in budget["rows"] if row["source"] == "mounting")["alone"][axis]
        assert alone["mixed"] == pytest.approx(found["mixed"], rel=1e-3)
        assert budget["closure"][axis]["closes"]
        for name in ("noise", "focal", "attitude", "estimator"):
            assert rows[name][axis]["mixed"] == pytest.approx(0.0, abs=1e-3)
    assert (budget["flights"], budget["frames"], budget["answered"]) == (3, 6, 6)


def test_the_files_hold_the_rows(made):
    _, out = made
    with (out / "budget.csv").open() as file:
        lines = list(csv.DictReader(file))
    titles = {line["source"] for line in lines}
    assert {"mounting", "total", "estimator, all sources off", "thermo-elastic drift of the mounting"} <= titles
    page = (out / "index.html").read_text()
    assert "thermo-elastic drift" in page
    assert 'href="http' not in page
