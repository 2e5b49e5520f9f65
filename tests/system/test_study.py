"""A trade study as a user runs it: complete, extended without making anything twice, asked and compared."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, assert_one_line

from horizonval import cli
from horizonval.store.verify import verify_folder

CAMERA = MINI_CAMERA.replace("mini", "tiny").replace("96", "48").replace("80", "48").replace("60.0", "90.0")

STUDY = """
[study]
name = "tiny"
seed = 3
estimators = ["altitude-free", "ideal"]
[[requirement]]
id = "R1"
error_deg = 0.5
availability = 0.9
[[requirement]]
id = "R2"
latency_s = 60.0
[defaults]
camera = { file = "camera.toml", mount_roll_deg = 65.0 }
platform.altitude_km = 500.0
atmosphere.profile = "us_standard"
render = { subsamples = 1, nodes = 16, orders = "single" }
[design.grid]
"camera.optics.psf_sigma_px" = [0.5, 1.0]
[frames.sobol]
n = 3
ranges = { "platform.latitude_deg" = [-20.0, 20.0], "attitude.roll_deg" = [-2.0, 2.0] }
"""
WIDER = STUDY.replace("[0.5, 1.0]", "[0.5, 0.75, 1.0]")


def in_process(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command line inside this process, outside a test's own fixtures."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = cli.run_command_line([str(a) for a in arguments])
    return subprocess.CompletedProcess(["horizonval"], status, out.getvalue(), err.getvalue())


def cases(out: Path) -> dict[str, tuple[bytes, int]]:
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in sorted((out / "cases").glob("*.json"))}


@pytest.fixture(scope="module")
def run(here, tmp_path_factory):
    """The study, run and then extended by an axis value; what the folder held in between."""
    folder = tmp_path_factory.mktemp("study")
    (folder / "camera.toml").write_text(CAMERA)
    (folder / "tiny.toml").write_text(STUDY)
    out = folder / "out"
    first = in_process("study", folder / "tiny.toml", "--out", out, "--workers", 1)
    assert first.returncode == 0, first.stderr
    before = cases(out)
    table = {name: (out / name).read_bytes() for name in ("study.json", "designs.csv")}
    (folder / "tiny.toml").write_text(WIDER)
    second = in_process("study", folder / "tiny.toml", "--out", out, "--workers", 1)
    assert second.returncode == 0, second.stderr
    return folder, before, table, (first, second)


def test_an_axis_value_makes_only_what_is_new(run):
    folder, before, _, (first, second) = run
    assert "psf_sigma_px_0.5_ideal" in first.stdout
    assert "6 of 9 frames are finished already" in second.stderr
    after = cases(folder / "out")
    assert {name: after[name] for name in before} == before
    assert verify_folder(folder / "out") == []
    assert len(after) == 9


def test_the_results_follow_from_the_frames(run):
    folder, _, table, _ = run
    result = json.loads((folder / "out" / "study.json").read_text())
    first = json.loads(table["study.json"])
    assert len(result["designs"]) == 6
    # What was there already says the same, beside more designs.
    old = {design["name"]: design for design in first["designs"]}
    new = {design["name"]: design for design in result["designs"]}
    for name, design in old.items():
        assert {**new[name], "number": 0} == {**design, "number": 0}
    with (folder / "out" / "designs.csv").open() as file:
        lines = {line["design"]: line for line in csv.DictReader(file)}
    assert set(lines) == set(new)
    ideal = lines["psf_sigma_px_1_ideal"]
    assert (ideal["n"], ideal["availability"], ideal["within"]) == ("3", "1.0", "1.0")
    assert float(ideal["rms_deg"]) < 1e-4
    costs = json.loads((folder / "out" / "study-costs.json").read_text())
    assert costs["designs"]["psf_sigma_px_1_altitude-free"]["n"] == 3
    assert 0 < costs["designs"]["psf_sigma_px_1_altitude-free"]["value"] < 60
    assert "processor" not in json.dumps(result["designs"])
    page = (folder / "out" / "report" / "study.html").read_text()
    assert not re.search(r'(?:src|href)="http', page)
    assert 'href="study.html"' in (folder / "out" / "report" / "index.html").read_text()


def test_two_designs_frame_by_frame_and_another_question(run, horizonval):
    folder, *_ = run
    out = folder / "out"
    done = horizonval("study", out, "--compare", "psf_sigma_px_0.5_altitude-free", "2", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["a"], found["b"], found["n"]) == ("psf_sigma_px_0.5_altitude-free", "psf_sigma_px_0.5_ideal", 3)
    assert found["mean_difference_deg"]["value"] < 0
    done = horizonval("study", out, "--error-deg", 60, "--availability", 0.3)
    assert done.returncode == 0, done.stderr
    assert "cheapest by pixel rate" in done.stdout
    done = horizonval("study", out, "--cheapest-by", "rms_deg + mass_g")
    assert_one_line(done, "--cheapest-by")
    assert "'mass_g' is no column" in done.stderr


def test_mistakes_are_one_line(run, tmp_path, horizonval):
    folder, *_ = run
    out = folder / "out"
    assert_one_line(horizonval("study", out, "--compare", "1", "nobody"), "no design 'nobody'", "psf_sigma_px")
    assert_one_line(horizonval("study", folder / "tiny.toml"), "--out", "folder")
    assert_one_line(horizonval("study", folder / "tiny.toml", "--out", out, "--compare", "1", "2"), "--compare")
    assert_one_line(horizonval("study", tmp_path), "study-plan.json", str(tmp_path))
    (folder / "wrong.toml").write_text(STUDY.replace('"ideal"', '"ideel"'))
    assert_one_line(horizonval("study", folder / "wrong.toml", "--out", tmp_path / "out"), "study.estimators", "ideal")
    assert not (tmp_path / "out").exists()
    (folder / "other.toml").write_text(STUDY.replace('name = "tiny"', 'name = "other"'))
    assert_one_line(horizonval("study", folder / "other.toml", "--out", out), "holds a run of", "'tiny'")


def test_information_alone_tells_what_any_method_can_do(run, tmp_path):
    """Beside the trial of the same frames; the bound is below the requirement of 0.5 deg, with and without the air."""
    folder, *_ = run
    out = tmp_path / "out"
    shutil.copytree(folder / "out", out)
    done = in_process("study", folder / "tiny.toml", "--out", out, "--by-information", "--workers", 1)
    assert done.returncode == 0, done.stderr
    result = json.loads((out / "study-information.json").read_text())
    assert [design["n"] for design in result["designs"]] == [3, 3, 3]
    for design in result["designs"]:
        assert design["noise_arcsec"]["n"] == 3
        assert 0.0 < design["noise_arcsec"]["median"] < design["bound_arcsec"]["median"] < 1800.0
        assert design["within"] > 0.95
        assert set(design["trial"]) == {"altitude-free", "ideal"}
        assert "estimator" not in design["settings"]
    # A lens that blurs more tells less of the place of the limb.
    noise = {design["name"]: design["noise_arcsec"]["median"] for design in result["designs"]}
    assert noise["psf_sigma_px_0.5"] < noise["psf_sigma_px_0.75"] < noise["psf_sigma_px_1"]
    assert len(done.stdout.splitlines()) == 4
    kept = {path: path.stat().st_mtime_ns for path in (out / "information").rglob("*.json")}
    assert len(kept) == 9
    assert in_process("study", folder / "tiny.toml", "--out", out, "--by-information").returncode == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert verify_folder(out) == []
