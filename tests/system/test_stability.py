"""A suite with a study of the infrared horizon, as a user runs it: complete, resumable to the byte, refused early."""

from __future__ import annotations

import hashlib
import json
import subprocess
import time
from pathlib import Path

import pytest
from conftest import PROGRAM, assert_one_line

CAMERA = """
[camera]
width = 32
height = 24
fov_deg = 50.0
[optics]
f_number = 1.1
[[band]]
name = "lwir"
kind = "thermal"
lo_um = 10.5
hi_um = 12.5
[detector]
kind = "microbolometer"
pixel_pitch_um = 12.0
netd_k = 0.05
bits = 14
"""

SUITE = """
[suite]
name = "small"
estimators = ["ideal"]
[[frame]]
scene.name = "frame"
camera = { file = "camera.toml", mount_roll_deg = 62.0 }
platform = { altitude_km = 900.0, latitude_deg = 40.0 }

[stability]
altitude_km = 900.0
inclination_deg = 90.0
positions = 8
months = [1, 4, 7]
[[stability.band]]
name = "co2"
lo_um = 14.0
hi_um = 16.3
[[stability.sensor]]
name = "edge"
kind = "edge"
locator = "half"
[[stability.sensor]]
name = "field"
kind = "field"
field_deg = 2.0
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    (folder / "camera.toml").write_text(CAMERA)
    (folder / "small.toml").write_text(SUITE)
    return folder / "small.toml"


@pytest.fixture(scope="module")
def finished(suite, tmp_path_factory) -> Path:
    """The folder of an uninterrupted run; do not change it."""
    out = tmp_path_factory.mktemp("small-run") / "out"
    done = subprocess.run([PROGRAM, "run", suite, "--out", out], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "[3/3] co2-" in done.stderr
    return out


def _digests(out: Path) -> dict[str, str]:
    files = [*(out / "stability").iterdir(), out / "stability.csv", out / "summary.json", out / "report/stability.html"]
    return {p.relative_to(out).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(files)}


@pytest.mark.slow
def test_a_study_is_complete(finished):
    summary = json.loads((finished / "summary.json").read_text())
    (band,) = summary["stability"]["bands"]
    # Half heights of the subarctic climates, 38.0 and 42.6 km, made with another integrator of the same table.
    assert band["half_km"]["min"] == pytest.approx(38.00, abs=0.05)
    assert band["half_km"]["max"] == pytest.approx(42.64, abs=0.05)
    edge, field = band["sensors"]
    # Half of 4.6 km between opposite heads is 0.038 deg; the heads never see both extremes at once.
    assert 0.02 < edge["max_pitch_deg"] < 0.038
    # A quarter of the field, times the relative difference of plateaus: 0.37 at most.
    assert 0.08 < field["max_pitch_deg"] < 0.185
    # Right and left of an exactly polar orbit are mirror images in this air.
    assert edge["max_roll_deg"] < 2e-6
    lines = (finished / "stability.csv").read_text().splitlines()
    assert len(lines) == 1 + 3 * 8
    assert 'href="stability.html"' in (finished / "report" / "index.html").read_text()


@pytest.mark.slow
def test_south_in_july_is_north_in_january(finished):
    """Air and ground are mirrored by half a year; to 0.1 m, the march's own asymmetry."""
    result = json.loads((finished / "stability" / "result.json").read_text())
    half = result["bands"][0]["half_km"]
    assert half[0] == pytest.approx(half[2][::-1], abs=1e-4)
    assert half[0][0] - half[0][-1] > 4.0


@pytest.mark.slow
def test_a_killed_study_goes_on_to_the_same_bytes(suite, finished, tmp_path):
    out = tmp_path / "out"
    command = [PROGRAM, "run", suite, "--out", out, "--workers", "1"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(out.glob("stability/co2-*.json")):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.kill()
    process.wait()
    (out / "stability" / ".co2-07.json.99.tmp").touch()
    (out / "stability" / "co2-04.json").write_text("{")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "of 3 months are finished already" in done.stderr
    assert _digests(out) == _digests(finished)


@pytest.mark.slow
def test_the_page_is_made_again_from_the_result_alone(finished, program, tmp_path):
    page = finished / "report" / "stability.html"
    before = page.read_bytes()
    page.unlink()
    assert program("report", finished).returncode == 0
    assert page.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("lo_um = 14.0\nhi_um = 16.3", "lo_um = 14.0\nhi_um = 26.3"), ["stability.band[1] (co2)", "20 um"]),
        (('locator = "half"', 'locator = "hlf"'), ["stability.sensor[1].locator", "hlf"]),
        (("positions = 8", 'positions = 8\natmosphere.profile = "tropicl"'), ["atmosphere", "tropicl", "tropical"]),
    ],
)
def test_mistakes_are_told_before_anything_is_made(horizonval, suite, tmp_path, change, parts):
    (tmp_path / "camera.toml").write_text(CAMERA)
    bad = tmp_path / "bad.toml"
    bad.write_text(SUITE.replace(*change))
    assert_one_line(horizonval("run", bad, "--out", "out"), str(bad), *parts)
    assert not (tmp_path / "out").exists()
