"""System B: the test bench, its geometry and its accelerometer, and the figures of the Sun."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.systems.b.bench import (
    DISTANCE_MM,
    NOISE_MG,
    PANEL_PX,
    PITCH_MM,
    SAMPLES,
    SIGNS,
    SIZES,
    STEP_MG,
    accelerometer_rad,
    radiance_seen,
    tilt_rad,
)
from horizonval.systems.b.experiment import EXPOSURES, LENSES, sun_figures

CAMERA = CameraModel(512, 512, 443.4, 443.4, 255.5, 255.5)
NONE = dict.fromkeys(SIZES, 0.0)
COLUMN, ROW = np.meshgrid(np.arange(PANEL_PX[0], dtype=np.float32), np.arange(PANEL_PX[1], dtype=np.float32))


@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 13.0])
def test_the_chord_of_a_hard_horizon_gives_the_tilt_with_its_sign(tilt_deg: float) -> None:
    tilt = math.radians(tilt_deg)
    nadir = np.array([math.sin(tilt), math.cos(tilt), 0.0])
    finer = CameraModel(2048, 2048, 4 * CAMERA.fx, 4 * CAMERA.fy, 4 * CAMERA.cx + 1.5, 4 * CAMERA.cy + 1.5)
    lit = unproject(finer, pixel_grid(finer)) @ nadir > math.cos(math.radians(68.0))
    image = cv2.GaussianBlur(lit.reshape(512, 4, 512, 4).mean(axis=(1, 3)), (0, 0), 0.7) * 800.0 + 32.0
    # One whole pixel at one end of a chord of some 480 px turns it by 0.12 deg; both ends may be off by half of one.
    assert math.degrees(tilt_rad(image, CAMERA, 1023)) == pytest.approx(tilt_deg, abs=0.12)
    assert math.isnan(tilt_rad(np.full((512, 512), 32.0), CAMERA, 1023))


def _seen_from(errors: dict[str, float], tilt_deg: float = 0.0) -> tuple[float, float]:
    """Return the place on the panel [mm], from its middle, that the camera's middle sees."""
    tilt, size = math.radians(tilt_deg), np.array(PANEL_PX)
    places = [radiance_seen(one, CAMERA, NONE | errors, tilt)[255:257, 255:257].mean() for one in (COLUMN, ROW)]
    x, y = (np.array(places) - (size - 1) / 2) * PITCH_MM
    return float(x), float(y)


def test_a_mounting_error_moves_what_its_name_says() -> None:
    assert _seen_from({}, 20.0) == pytest.approx((0.0, 0.0), abs=1e-2)
    assert _seen_from({"shift_x_mm": 3.0}, 20.0) == pytest.approx((3.0, 0.0), abs=1e-2)
    # an eccentric lens turns with the stage, a shifted one does not
    turned = 2.0 * math.cos(math.radians(20.0)), 2.0 * math.sin(math.radians(20.0))
    assert _seen_from({"eccentric_x_mm": 2.0}, 20.0) == pytest.approx(turned, abs=1e-2)
    assert _seen_from({"axis_yaw_deg": 1.0})[0] == pytest.approx(DISTANCE_MM * math.tan(math.radians(1.0)), abs=1e-2)
    assert _seen_from({"centre_y_px": 5.0})[1] == pytest.approx(-5.0 * DISTANCE_MM / CAMERA.fy, abs=1e-2)


def test_a_turned_camera_sees_the_panel_turned_the_other_way() -> None:
    """Down in the picture leans to +x in the image, as the estimator's tilt says; so does a panel that is rolled."""
    for errors, tilt_deg, turn_deg in (({}, 10.0, 10.0), ({"panel_roll_deg": -3.0}, 0.0, 3.0)):
        seen = radiance_seen(ROW, CAMERA, NONE | errors, math.radians(tilt_deg))
        down, right = np.gradient(seen[200:300, 200:300])
        assert math.degrees(math.atan2(right.mean(), down.mean())) == pytest.approx(turn_deg, abs=1e-2)


def test_an_accelerometer_errs_by_its_roll_and_zero_and_noise_and_steps_average_out() -> None:
    for tilt in np.radians([-20.0, 0.0, 20.0]):
        read = accelerometer_rad(tilt, NONE | {"accelerometer_roll_deg": 0.3, "accelerometer_zero_mg": 5.0}, None)
        roll = math.radians(0.3)
        # d atan2(s + b, c) = b cos(t) to first order; the second is b^2, 2.5e-5 rad
        assert read - tilt == pytest.approx(roll + 5e-3 * math.cos(tilt + roll), abs=2.5e-5)
    rng = np.random.default_rng(0)
    off = np.array([accelerometer_rad(0.1, NONE, rng) for _ in range(4000)]) - 0.1
    # variance of a sample: noise, and a twelfth of a squared step
    expected = math.sqrt((NOISE_MG**2 + STEP_MG**2 / 12.0) / SAMPLES) * 1e-3
    assert off.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2 * 4000))
    assert abs(off.mean()) < 4.0 * expected / math.sqrt(4000)


def test_the_design_separates_errors_whatever_their_signs() -> None:
    assert SIGNS.shape == (16, len(SIZES))
    assert np.array_equal(SIGNS.T @ SIGNS, 16.0 * np.eye(len(SIZES)))


def test_views_are_lost_to_a_lens_only_where_the_clean_one_is_right() -> None:
    def view(clean: float | None, other: float | None) -> dict[str, dict[str, float | None]]:
        return {
            f"{lens} lens, {exposure} exposure": {"error": clean if lens == "clean" else other, "saturated": 0.1}
            for lens in LENSES
            for exposure in EXPOSURES
        }

    values, note = sun_figures([view(0.1, 0.1), view(0.1, None), view(0.2, 3.0), view(0.3, 0.3), view(5.0, 0.2)])
    assert values["sun"] == [0.5] * 4
    assert values["sun_saturated"] == pytest.approx([0.1] * 6)
    assert values["sun_wrong"] == pytest.approx([0.2, 0.2, 0.4, 0.4, 0.4, 0.4])
    assert "0.93" in note
