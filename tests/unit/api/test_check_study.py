"""A study is told before a run that none of its frames can show anything."""

from __future__ import annotations

import pytest

from horizonval.api.check import Level, check, check_before_run, check_suite
from horizonval.studies.trade.design import expand, read_study

STUDY = """
[study]
name = "all-saturated"
seed = 1
estimators = ["altitude-free"]

[defaults]
camera = {{ file = "vis-cmos-512-60deg", mount_roll_deg = 65.0, detector = {{ exposure_s = {exposure_s} }} }}
platform = {{ epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }}

[design.grid]
"camera.camera.fov_deg" = [60.0, 90.0]
"camera.optics.f_number" = [2.8, 4.0]
"camera.camera.width" = [256, 512]

[frames.grid]
"platform.latitude_deg" = [-20.0, 0.0, 20.0]
"platform.heading_deg" = [0.0, 10.0]
"""


@pytest.fixture
def load(tmp_path):
    def build(exposure_s):
        path = tmp_path / "study.toml"
        path.write_text(STUDY.format(exposure_s=exposure_s))
        return path, expand(*read_study(path))

    return build


def test_eight_designs_whose_48_frames_are_all_saturated(load):
    path, study = load(1e-3)
    report = check(path)
    assert (len(study.designs), report.examined, report.frames) == (8, 48, 48)
    assert not report.ok
    saturated = [finding for finding in report.findings if finding.code == "saturated"]
    assert {finding.subject for finding in saturated} == {design.frames for design in study.designs}
    for finding in saturated:
        assert finding.level is Level.WARNING
        assert (finding.frames, finding.of) == (6, 6)
        assert finding.value > finding.limit == 1.0
        assert "saturated" in finding.text
        assert "exposure 1 ms -> " in finding.fix
    # The engine's own words come first: a few lines in all, one of them about all designs together.
    lines = check_before_run(study).summary_lines()
    assert len(lines) == 2
    assert "8 designs: all 32 frames looked at: " in lines[0]
    assert "saturated" in lines[0]
    assert lines[1].startswith("looked at 32 of 48 frames")


def test_the_proposed_exposure_mends_it(load):
    _, study = load(1e-3)
    worst = max((f for f in check_suite(study).findings if f.code == "saturated"), key=lambda f: f.value)
    number, unit = worst.fix.split(" -> ")[1].split(" puts")[0].split()
    _, mended = load(float(number) * {"ms": 1e-3, "us": 1e-6}[unit])
    report = check_suite(mended)
    assert report.ok
    assert "saturated" not in {finding.code for finding in report.findings}
    assert check_before_run(mended).summary_lines() == []
