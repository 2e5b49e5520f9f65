"""A suite with a study of the infrared horizon, as a user runs it: complete, resumable to the byte, refused early."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
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
    return out


@pytest.mark.slow
def test_the_infrared_horizon_is_complete(finished):
    summary = json.loads((finished / "summary.json").read_text())
    (band,) = summary["stability"]["bands"]
    # Half heights of the subarctic climates, 38.0 and 42.6 km, made with another integrator of the same table.
    assert band["half_km"]["min"] == pytest.approx(38.00, abs=0.05)
    assert band["half_km"]["max"] == pytest.approx(42.64, abs=0.05)
    sensors = {sensor["name"]: sensor for sensor in band["sensors"]}
    # Half of 4.6 km between opposite heads is 0.038 deg; the heads never see both extremes at once.
    assert 0.02 < sensors["edge-half"]["max_pitch_deg"] < 0.038
    # A quarter of the field, times the relative difference of plateaus: 0.37 at most.
    assert 0.08 < sensors["field"]["max_pitch_deg"] < 0.185
    # Right and left of an exactly polar orbit are mirror images in this air.
    assert sensors["edge-half"]["max_roll_deg"] < 2e-6
    assert "The infrared horizon through the year" in (finished / "report" / "index.html").read_text()
    # The air is mirrored by half a year, to 0.1 m. Poleward of 55 deg the cold low air of each winter is its own
    # pole's, which moves the horizon by some metres.
    half = json.loads((finished / "stability" / "result.json").read_text())["bands"][0]["profiles"]["half_km"]
    north, south = half[0], half[2][::-1]
    mirrored = sum(latitude < 55.0 for latitude in np.linspace(-90.0, 90.0, len(north)))
    assert north[:mirrored] == pytest.approx(south[:mirrored], abs=1e-4)
    assert north[mirrored:] == pytest.approx(south[mirrored:], abs=5e-3)
    assert half[0][0] - half[0][-1] > 4.0


@pytest.mark.slow
def test_what_is_missing_or_damaged_is_made_again_to_the_same_bytes(suite, finished, tmp_path):
    out = shutil.copytree(finished, tmp_path / "out")
    (out / "stability" / ".07.json.99.tmp").touch()
    (out / "stability" / "04.json").write_text("{")
    for name in ("stability/07.json", "stability/result.json", "summary.json"):
        (out / name).unlink()
    done = subprocess.run([PROGRAM, "run", suite, "--out", out], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 of 3 months are finished already" in done.stderr
    assert _digests(out) == _digests(finished)


def _digests(out: Path) -> dict[str, str]:
    files = [*(out / "stability").iterdir(), out / "summary.json", out / "report/index.html"]
    return {p.relative_to(out).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(files)}


def test_a_band_outside_the_tables_is_refused_before_anything_is_made(horizonval, suite, tmp_path):
    (tmp_path / "camera.toml").write_text(CAMERA)
    bad = tmp_path / "bad.toml"
    bad.write_text(SUITE.replace("hi_um = 16.3", "hi_um = 26.3"))
    assert_one_line(horizonval("run", bad, "--out", "out"), str(bad), "stability.band", "20 um")
    assert not (tmp_path / "out").exists()
