"""``horizonval check`` and the warnings before a run."""

from __future__ import annotations

import json

import pytest

import horizonval as hv
from horizonval.cli.app import run_command_line
from horizonval.core.errors import UserError

SUITE = """
[suite]
name = "bright"
estimators = ["altitude-free"]
[defaults]
camera = {{ file = "vis-cmos-512-60deg", mount_roll_deg = 65.0, detector = {{ exposure_s = {exposure_s} }} }}
platform = {{ epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }}
[[frame]]
scene.name = "a"
[[frame]]
scene.name = "b"
platform.latitude_deg = 10.0
"""


@pytest.fixture
def suite(tmp_path):
    def write(exposure_s):
        path = tmp_path / "suite.toml"
        path.write_text(SUITE.format(exposure_s=exposure_s))
        return str(path)

    return write


def test_exit_status_and_json(suite, capsys):
    assert run_command_line(["check", suite(1e-4)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("nothing wrong")
    assert run_command_line(["check", suite(1e-2), "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["findings"][0]["code"] == "saturated"
    assert run_command_line(["check", "no-such-thing"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1


def start_and_stop(*arguments, on_start, **options):
    on_start()
    raise UserError("started")


@pytest.mark.parametrize(("exposure_s", "told"), [(1e-2, True), (1e-4, False)])
def test_a_run_says_first_what_is_wrong(suite, tmp_path, capsys, monkeypatch, exposure_s, told):
    monkeypatch.setattr("horizonval.suites.run.stream", start_and_stop)
    run_command_line(["run", suite(exposure_s), "--out", str(tmp_path / "out"), "--json"])
    captured = capsys.readouterr()
    *warnings, last = captured.err.splitlines()
    assert captured.out == ""
    assert last == "horizonval: error: started"
    assert [line.startswith("horizonval: warning: ") and "saturated" in line for line in warnings] == [True] * told


def test_a_study_says_so_too(tmp_path, capsys, monkeypatch):
    path = tmp_path / "study.toml"
    path.write_text(
        SUITE.format(exposure_s=1e-2).partition("[[frame]]")[0].replace("[suite]", "[study]")
        + '[design.grid]\n"camera.optics.f_number" = [2.8, 4.0]\n'
        + '[frames.grid]\n"platform.latitude_deg" = [0.0, 10.0]\n'
    )
    monkeypatch.setattr("horizonval.suites.run.stream", start_and_stop)
    run_command_line(["study", str(path), "--out", str(tmp_path / "out")])
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("horizonval: warning: f_number_2.8, f_number_4: all 4 frames: limb at ")
    assert lines[1:] == ["horizonval: error: started"]


def test_warnings_are_on_the_run_and_a_dry_run_has_them(suite, tmp_path):
    counted = hv.run(suite(1e-2), out=tmp_path / "out", dry_run=True)
    assert [finding.code for finding in counted.warnings] == ["saturated"]
    assert (counted.missing, counted.dry_run.total, counted.summary) == (2, {"frames": 2}, {})
    assert not (tmp_path / "out").exists()
