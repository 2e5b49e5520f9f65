"""A camera calibrated from rendered infrared limbs, of air that the fit knows as a climate only."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import horizonval as hv
from horizonval.api.calibrate import observations_of
from horizonval.estimation.fit.calibrate import CameraCalibration, calibrate

SUITE = """
[suite]
name = "pass"
estimators = ["limb-ellipsoid"]
keep = "all"

[defaults]
platform = { altitude_km = 550.0, epoch_utc = 2026-03-20T12:00:00Z }
atmosphere = { profile = "weather" }
surface = { kind = "earth" }
render = { subsamples = 12, nodes = 64 }
prior = { position_sigma_km = 0.1, attitude_sigma_deg = [0.005, 0.005, 0.005] }
calibration = { draw = "flight-1", focal_length_error_percent = 1.0, mounting_error_deg = [0.1, 0.0, 0.0] }

[defaults.camera]
file = "ir-bolometer-160-57deg"
mount_roll_deg = 62.0

[defaults.camera.camera]
width = 320
height = 240
fov_deg = 70.0

[[cases]]
name = "rolls"

[cases.sobol]
n = 36

[cases.sobol.ranges]
"attitude.roll_deg" = [-17.0, 17.0]
"attitude.pitch_deg" = [-5.0, 5.0]
"platform.latitude_deg" = { from = -90.0, to = 90.0, scale = "sine" }
"platform.longitude_deg" = [-180.0, 180.0]
"platform.heading_deg" = [-180.0, 180.0]
"""


@pytest.mark.slow
def test_a_percent_of_the_focal_length_is_found_on_infrared_frames(tmp_path: Path) -> None:
    """36 frames over the globe know a quarter of a thousandth, and are as near as they claim."""
    (tmp_path / "pass.toml").write_text(SUITE)
    hv.run(tmp_path / "pass.toml", out=tmp_path / "out")
    found = calibrate(observations_of([tmp_path / "out"]))
    assert isinstance(found, CameraCalibration), found
    assert found.frames >= 30
    assert found.sigma[0] < 2.5e-4
    assert abs(found.change[0] + math.log(1.01)) < 3.3 * found.sigma[0]
