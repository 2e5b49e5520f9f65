"""The hardware-in-the-loop bench: poses, reference, panel levels, design, one-camera tilt, rows and tables."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.systems.b.pair.frames import tilt_rad
from horizonval.systems.b.rig import bench, experiment, film, runs
from horizonval.systems.b.rig.bench import NOISE_MG, SAMPLES, STEP_MG, Accelerometer
from horizonval.systems.b.rig.runs import (
    IMPERFECTIONS,
    BenchRun,
    RigResults,
    own_deviation_deg,
    percentile_of,
    plausible_benches,
)
from horizonval.systems.b.rig.scene import Panel, levels, share_shown

CAMERA = CameraModel(512, 512, 443.4, 443.4, 255.5, 255.5)


def horizon_image(camera, tilt_deg, rho_deg=68.0):
    """A hard, sunlit disc seen with a level boresight, the camera turned clockwise, as a lens of 0.7 px blurs it."""
    tilt = math.radians(tilt_deg)
    nadir = np.array([math.sin(tilt), math.cos(tilt), 0.0])
    finer = CameraModel(2048, 2048, 4 * camera.fx, 4 * camera.fy, 4 * camera.cx + 1.5, 4 * camera.cy + 1.5)
    lit = unproject(finer, pixel_grid(finer)) @ nadir > math.cos(math.radians(rho_deg))
    return cv2.GaussianBlur(lit.reshape(512, 4, 512, 4).mean(axis=(1, 3)), (0, 0), 0.7) * 800.0 + 32.0


@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 13.0])
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


def test_switching_off_everything_leaves_a_perfect_bench():
    fields = [name for names in runs.MOUNTING.values() for name in names]
    assert sorted(fields) == sorted(bench.NAMES)
    assert runs.errors_of(()) == bench.BenchErrors()
    assert runs.errors_of(runs.IMPERFECTIONS) == bench.STATED
    one = runs.errors_of(("panel not level",))
    assert one == bench.BenchErrors(panel_roll_deg=bench.STATED.panel_roll_deg)
    clean = runs.panel_of(())
    assert clean.smooth
    assert clean.backlight_fall == clean.backlight_slope == 0.0
    assert runs.panel_of(runs.IMPERFECTIONS) == Panel()


TILTS = np.array([-20.0, 0.0, 20.0])


def run(error_deg):
    """Sixteen benches that err by this much, half of them to the left."""
    side = np.where(np.arange(16) % 2, 1.0, -1.0)[:, None]
    reference = np.broadcast_to(TILTS, (16, 3))
    return BenchRun(TILTS, reference + side * error_deg, reference)


def results(sizes):
    alone = dict(zip(IMPERFECTIONS, (run(math.hypot(0.05, size)) for size in sizes), strict=True))
    order = tuple(sorted(IMPERFECTIONS, key=lambda name: -alone[name].rms_deg))
    whole = run(math.sqrt(0.05**2 + sum(size**2 for size in sizes)))
    after = {name: run(0.05) for name in order}
    return RigResults(whole, run(0.05), alone, order, after, run(0.05), run(0.05))


SIZES = [0.3, 0.2, 0.0, 0.1, 0.2, 0.25, 0.35, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0]


def test_a_run_counts_lost_frames_and_leaves_those_without_an_answer_out_of_its_rms():
    whole = run(0.3)
    estimated = whole.estimated_deg.copy()
    estimated[0, 0], estimated[1, 2] = math.nan, 177.0
    broken = BenchRun(TILTS, estimated, whole.reference_deg)
    assert broken.lost == pytest.approx(2 / 48, abs=1e-12)
    assert broken.answered == pytest.approx(47 / 48, abs=1e-12)
    estimated[1, 2] = 20.3
    assert BenchRun(TILTS, estimated, whole.reference_deg).rms_deg == pytest.approx(0.3, abs=1e-9)


def test_independent_imperfections_add_up_and_their_shares_make_the_whole():
    made = results(SIZES)
    assert made.root_sum_square_deg() == pytest.approx(made.whole.rms_deg, abs=1e-9)
    family = made.families()
    assert sum(family.values()) == pytest.approx(1.0, abs=1e-12)
    total = sum(size**2 for size in SIZES)
    # the accelerometer's are the two of 0.3 deg beside each other
    assert family["accelerometer"] == pytest.approx(2 * 0.3**2 / total, abs=1e-9)
    assert family["light"] == pytest.approx(0.0, abs=1e-9)


def test_rows_have_names_of_their_own_and_bars_that_can_be_missed():
    made = results(SIZES)
    kept = {row.name: row.holds for row in rows_of(made)}
    rough = replace(made, after={name: run(0.2) for name in made.order}, whole=run(1.0))
    assert len(kept) == len(rows_of(made)) == 10 + len(IMPERFECTIONS)
    assert [v for v in kept.values() if v is not None] == [True] * 2
    assert [row.holds for row in rows_of(rough) if row.holds is not None] == [False] * 2


def rows_of(made):
    return experiment.rig_rows(made, np.random.default_rng(0))


def test_the_range_over_plausible_benches_follows_the_sizes():
    """One effect of 0.4 deg, the same at all tilts: half to twice of it as root mean square, none of it as scatter."""
    sign = bench.signs()[:, 0]
    reference = np.broadcast_to(TILTS, (16, 3))
    benches = plausible_benches(
        BenchRun(TILTS, reference + 0.4 * sign[:, None], reference), 0.0, np.random.default_rng(1)
    )
    low, high = np.percentile(benches.rms_deg, [0.0, 100.0])
    assert (low, high) == pytest.approx((0.2, 0.8), rel=1e-3)
    assert np.abs(benches.deviation_deg).max() < 1e-9
    assert percentile_of(benches.rms_deg, 0.4) == pytest.approx(50.0, abs=2.0)
    assert own_deviation_deg(run(0.3)) == pytest.approx(0.0, abs=1e-9)


def test_the_film_rests_at_five_tilts_and_a_mean_of_samples_is_late_in_motion():
    assert film.length_s() == pytest.approx(5 * 5.0 + 40.0)
    assert film.tilt_at(np.array([-1.0, 4.9, 10.0, 15.1, film.length_s()])) == pytest.approx([-20, -20, -15, -10, 20])
    rng = np.random.default_rng(2)
    resting = np.mean([film.reading_deg(3.0, 0.0, 0.0, rng) for _ in range(50)])
    moving = np.mean([film.reading_deg(10.0, 0.0, 0.0, rng) for _ in range(50)])
    assert resting == pytest.approx(-20.0, abs=0.02)
    # 63 of 100 samples are half a sample less than the module's closed form
    assert moving == pytest.approx(-15.0 - 0.315, abs=0.02)


def test_imperfections_are_counted_until_the_rms_stays_below_a_limit():
    made = results(SIZES)
    assert made.switched_off_below(0.1) == 1
    late = replace(made, after={name: run(0.2 if k == 4 else 0.05) for k, name in enumerate(made.order)})
    assert late.switched_off_below(0.1) == 6
    assert replace(made, after={name: run(0.2) for name in made.order}).switched_off_below(0.1) == len(made.order) + 1
