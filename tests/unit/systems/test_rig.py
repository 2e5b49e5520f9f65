"""The bench of the hardware-in-the-loop experiment: poses, reference, panel levels, design and the one-camera tilt."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.systems.b.pair.frames import tilt_rad
from horizonval.systems.b.rig import bench, runs
from horizonval.systems.b.rig.bench import NOISE_MG, SAMPLES, STEP_MG, Accelerometer
from horizonval.systems.b.rig.scene import Panel, levels, share_shown

CAMERA = CameraModel(512, 512, 443.4, 443.4, 255.5, 255.5)


def horizon_image(camera, tilt_deg, rho_deg=68.0):
    """A hard, sunlit disc seen with a level boresight, the camera turned clockwise, as a lens of 0.7 px blurs it."""
    tilt = math.radians(tilt_deg)
    nadir = np.array([math.sin(tilt), math.cos(tilt), 0.0])
    finer = CameraModel(2048, 2048, 4 * camera.fx, 4 * camera.fy, 4 * camera.cx + 1.5, 4 * camera.cy + 1.5)
    lit = unproject(finer, pixel_grid(finer)) @ nadir > math.cos(math.radians(rho_deg))
    return cv2.GaussianBlur(lit.reshape(512, 4, 512, 4).mean(axis=(1, 3)), (0, 0), 0.7) * 800.0 + 32.0


@pytest.mark.parametrize("tilt_deg", [-20.0, -7.0, 0.0, 13.0, 20.0])
def test_the_chord_of_a_hard_horizon_gives_the_tilt_with_its_sign(tilt_deg):
    # One whole pixel at one end of a chord of some 480 px turns it by 0.12 deg; both ends may be off by half of one.
    found = tilt_rad(horizon_image(CAMERA, tilt_deg), CAMERA, 1023)
    assert math.degrees(found) == pytest.approx(tilt_deg, abs=0.12)


def test_an_empty_image_has_no_tilt():
    assert tilt_rad(np.full((512, 512), 32.0), CAMERA, 1023) is None


def test_a_turned_camera_sees_the_panel_turned_the_other_way():
    camera = bench.camera_pose(math.radians(10.0), bench.BenchErrors())
    panel = bench.panel_pose(200.0, bench.BenchErrors())
    below = bench.seen_from(camera, panel, np.array([[0.0, 50.0]]))[0]
    # down in the picture leans to +x in the image, as the estimator's tilt says
    assert math.degrees(math.atan2(below[0], below[1])) == pytest.approx(10.0, abs=1e-9)
    assert below[2] == pytest.approx(200.0, abs=1e-9)


def test_a_mounting_error_moves_what_its_name_says():
    level = bench.BenchErrors()
    panel = bench.panel_pose(200.0, level)
    middle = np.zeros((1, 2))
    lens_right = bench.camera_pose(0.0, bench.BenchErrors(shift_x_mm=3.0, distance_mm=5.0))
    assert bench.seen_from(lens_right, panel, middle)[0] == pytest.approx([-3.0, 0.0, 205.0], abs=1e-9)
    # an eccentric lens travels with the stage, a shifted one does not
    quarter = bench.camera_pose(math.pi / 2, bench.BenchErrors(eccentric_x_mm=2.0))
    assert quarter.r_bench_mm == pytest.approx([0.0, 2.0, 0.0], abs=1e-9)
    askew = bench.camera_pose(0.0, bench.BenchErrors(axis_yaw_deg=1.0))
    assert bench.seen_from(askew, panel, middle)[0][0] == pytest.approx(-200.0 * math.sin(math.radians(1.0)), abs=1e-9)
    rolled = bench.panel_pose(200.0, bench.BenchErrors(panel_roll_deg=0.25))
    right = bench.seen_from(bench.camera_pose(0.0, level), rolled, np.array([[100.0, 0.0]]))[0]
    assert math.degrees(math.atan2(right[1], right[0])) == pytest.approx(0.25, abs=1e-9)


def test_an_accelerometer_without_noise_errs_by_its_roll_and_its_zero():
    for tilt_deg in (-20.0, 0.0, 20.0):
        tilt = math.radians(tilt_deg)
        read = Accelerometer(roll_rad=0.005, zero_mg=5.0).tilt_rad(tilt, None)
        # d atan2(s + b, c) = b cos(t) to first order; the second is b^2, 2.5e-5 rad
        assert read - tilt == pytest.approx(0.005 + 5e-3 * math.cos(tilt + 0.005), abs=2.5e-5)


def test_noise_and_steps_of_the_accelerometer_average_out():
    rng = np.random.default_rng(0)
    off = np.array([Accelerometer().tilt_rad(0.1, rng) for _ in range(4000)]) - 0.1
    # variance of a sample: noise, and a twelfth of a squared step
    expected = math.sqrt((NOISE_MG**2 + STEP_MG**2 / 12.0) / SAMPLES) * 1e-3
    assert off.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2 * 4000))
    assert abs(off.mean()) < 4.0 * expected / math.sqrt(4000)


def test_levels_show_what_they_were_asked_to_within_half_a_level():
    panel = Panel()
    asked = np.linspace(0.0, 1.0, 1001)[None, :]
    level = levels(asked, panel.gamma)
    black = 1.0 / panel.contrast
    shown = (share_shown(level, panel) - black) / (1.0 - black)
    half = panel.gamma * np.maximum(asked, (0.5 / 255) ** panel.gamma) ** (1.0 - 1.0 / panel.gamma) * 0.5 / 255
    # the slope of the gamma curve at the level's far edge is a little steeper than at the middle
    assert np.all(np.abs(shown - asked) <= 1.7 * half)
    assert share_shown(np.array([[0, 255]], np.uint8), panel) == pytest.approx(np.array([[black, 1.0]]), abs=1e-12)


def test_the_design_tells_errors_apart_whatever_their_signs():
    signs = bench.signs()
    assert signs.shape == (16, len(bench.NAMES))
    assert np.array_equal(signs.T @ signs, 16.0 * np.eye(len(bench.NAMES)))
    slopes = np.linspace(-0.3, 0.4, len(bench.NAMES))
    values = signs @ slopes
    assert bench.main_effects(values) == pytest.approx(slopes, abs=1e-12)
    assert np.mean(values**2) == pytest.approx(np.sum(slopes**2), abs=1e-12)
    assert bench.unused_effect(values) == pytest.approx(0.0, abs=1e-12)


def test_every_error_of_the_bench_is_stated_and_belongs_to_one_imperfection():
    fields = [name for names in runs.MOUNTING.values() for name in names]
    assert sorted(fields) == sorted(bench.NAMES)
    assert all(getattr(bench.STATED, name) > 0.0 for name in fields)


def test_switching_off_everything_leaves_a_perfect_bench():
    assert runs.errors_of(()) == bench.BenchErrors()
    assert runs.errors_of(runs.IMPERFECTIONS) == bench.STATED
    one = runs.errors_of(("panel not level",))
    assert one == bench.BenchErrors(panel_roll_deg=bench.STATED.panel_roll_deg)
    clean = runs.panel_of(())
    assert clean.smooth
    assert clean.backlight_fall == clean.backlight_slope == 0.0
    assert runs.panel_of(runs.IMPERFECTIONS) == Panel()
