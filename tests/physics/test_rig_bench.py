"""The rendered bench against OpenCV's pinhole, the radiance that was put in, and the formula of the moire."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel
from horizonval.renderer.backend import activate
from horizonval.systems.b.rig import bench
from horizonval.systems.b.rig.scene import Panel

activate()

from horizonval.systems.b.rig import scene  # noqa: E402

CAMERA = CameraModel(256, 256, 222.0, 222.0, 130.0, 126.0)
EVEN = {"backlight_fall": 0.0, "backlight_slope": 0.0, "viewing_power": 0.0}


def rendered(panel, share, camera=CAMERA, tilt_deg=0.0, errors=bench.BenchErrors(), distance_mm=200.0, blur_px=0.0):  # noqa: B008
    poses = bench.panel_pose(distance_mm, errors), bench.camera_pose(math.radians(tilt_deg), errors)
    loaded = scene.bench_scene(panel, share, poses[0], camera, poses[1])
    return scene.render(loaded, blur_px).astype(float)


def white(panel):
    return np.ones((panel.height, panel.width))


@pytest.mark.parametrize("tilt_deg", [-20.0, 0.0, 15.0])
def test_bright_pixels_appear_where_opencv_projects_them(tilt_deg):
    panel = Panel(480, 270, pitch_mm=4 * 0.2768, **EVEN)
    errors = bench.BenchErrors(3.0, -2.0, 2.0, 1.5, 5.0, 1.0, -1.5, 0.0, 0.0, 0.25, 2.0, -1.0)
    bright = np.array([[240, 135], [200, 100], [290, 120], [215, 190], [270, 170], [300, 150]])
    at, camera_at = bench.panel_pose(200.0, errors), bench.camera_pose(math.radians(tilt_deg), errors)
    # OpenCV wants world to camera
    turn, _ = cv2.Rodrigues(camera_at.bench_from_body.T)
    on_panel = np.column_stack([(bright - [239.5, 134.5]) * panel.pitch_mm, np.zeros(len(bright))])
    places = on_panel @ at.bench_from_body.T + at.r_bench_mm
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
    shift = -camera_at.bench_from_body.T @ camera_at.r_bench_mm
    expected, _ = cv2.projectPoints(places, turn, shift, matrix, None)
    expected = expected[:, 0]
    assert np.all((expected > 8) & (expected < 247))
    for pixel, place in zip(bright, expected, strict=True):
        share = np.zeros((panel.height, panel.width))
        share[pixel[1], pixel[0]] = 1.0
        image = rendered(panel, share, tilt_deg=tilt_deg, errors=errors)
        u, v = np.meshgrid(np.arange(256), np.arange(256))
        centre = np.array([(image * u).sum(), (image * v).sum()]) / image.sum()
        # The stripes' shares pull the centroid 0.01 pixels of the panel to the left; samples stand 1/4 px apart.
        assert centre == pytest.approx(place, abs=0.1)


@pytest.mark.parametrize("smooth", [True, False])
def test_an_even_panel_has_the_radiance_that_was_put_in(smooth):
    panel = Panel(1920, 1080, smooth=smooth, white_w_m2_sr=0.8, **EVEN)
    image = rendered(panel, 0.5 * white(panel))
    # The matrix has mean 1 over a pixel; 50 x 50 camera pixels hold 2700 panel pixels, cut at their rim to 1 %.
    tolerance = 1e-5 if smooth else 2e-3
    assert image[100:150, 100:150].mean() == pytest.approx(0.4, rel=tolerance)
    if smooth:
        assert np.ptp(image) < 1e-6


def test_a_panel_seen_askew_dims_with_the_power_of_the_cosine():
    panel = Panel(smooth=True, backlight_fall=0.0, backlight_slope=0.0, viewing_power=2.5)
    image = rendered(panel, white(panel))
    for column, row in ((130, 126), (20, 126), (130, 240), (230, 30)):
        x, y = (column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy
        cosine = 1.0 / math.sqrt(1.0 + x * x + y * y)
        # mean over a pixel against its centre: 1e-5; single precision 1e-6
        assert image[row, column] == pytest.approx(0.8 * cosine**2.5, rel=1e-4)


@pytest.mark.parametrize("distance_mm", [40.0, 75.0, 85.0, 200.0])
def test_the_moire_has_the_period_of_the_beat(distance_mm):
    panel = Panel(**EVEN)
    image = rendered(panel, white(panel), distance_mm=distance_mm)
    # A panel pixel covers m camera pixels; its 1/m cycles per pixel are seen as their distance to a whole number. Near
    # a whole number the camera's pixels let nothing of them through, and one would see the harmonics.
    frequency = distance_mm / (panel.pitch_mm * CAMERA.fx)
    expected = abs(frequency - round(frequency))
    down = image[:, 96:160].mean(axis=1)
    spectrum = np.abs(np.fft.rfft((down - down.mean()) * np.hanning(256), 4096))
    seen = np.argmax(spectrum) / 4096
    # A tenth of the resolution of 256 pixels
    assert seen == pytest.approx(expected, abs=0.1 / 256)
    assert np.ptp(down) > 0.02 * down.mean()


def test_the_lens_wipes_the_moire_out_before_the_pixels_sample_it():
    panel = Panel(**EVEN)
    camera = CameraModel(128, 128, 443.4, 443.4, 63.5, 63.5)
    bare = rendered(panel, white(panel), camera)[32:96, 32:96]
    behind = rendered(panel, white(panel), camera, blur_px=0.7)[32:96, 32:96]
    assert bare.std() > 0.05 * bare.mean()
    # 1.6 cycles per pixel pass a Gaussian of 0.7 px by 1e-11; what is left is the grid of samples.
    assert behind.std() < 3e-3 * behind.mean()
    # blurring the sampled pixels instead, as for scenes that are even within a pixel, would leave more
    assert cv2.GaussianBlur(bare, (0, 0), 0.7).std() > 3.0 * behind.std()


def test_two_renders_have_the_same_bytes():
    panel = Panel(480, 270, pitch_mm=4 * 0.2768)
    share = np.random.default_rng(0).random((270, 480))
    assert np.array_equal(*(rendered(panel, share, tilt_deg=7.0) for _ in range(2)))
