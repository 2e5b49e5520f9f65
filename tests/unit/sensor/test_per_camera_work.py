"""What depends on the camera alone is worked out once, and what does not matter is not worked out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel
from horizonval.sensor import motion
from horizonval.sensor.lens import convolution, lens_spread, optics
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics, Scatter

CAMERA = CameraModel(96, 64, 90.0, 90.0, 47.5, 31.5, (-0.1, 0.01, 0.0, 0.0, 0.0), "pinhole", None)
BAND = Band(name="vis", kind="solar", lo_um=0.5, hi_um=0.6)


def test_pixels_have_their_solid_angles_worked_out_once_for_a_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = []

    def counted(camera: CameraModel) -> Any:
        cameras.append(camera)
        return np.full((camera.height, camera.width), 2.0)

    optics._solid_angle_through.cache_clear()
    monkeypatch.setattr(optics, "pixel_solid_angle", counted)
    plain, dimmed = Optics(f_number=4.0), Optics(f_number=4.0, vignetting_deg=[0.0, 30.0], vignetting=[1.0, 0.5])
    first, second = (optics.etendue(CAMERA, 5e-6, plain) for _ in range(2))
    assert len(cameras) == 1
    np.testing.assert_array_equal(first, second)
    assert optics.etendue(CAMERA, 5e-6, dimmed)[0, 0] < first[0, 0]
    optics._solid_angle_through.cache_clear()


def test_a_camera_that_hardly_turns_has_a_few_pixels_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    followed, seen_at = [], motion._seen_at

    def counted(camera: CameraModel, place: Any, turn_rad: Any) -> Any:
        followed.append(place.shape[0] * place.shape[1])
        return seen_at(camera, place, turn_rad)

    monkeypatch.setattr(motion, "_seen_at", counted)
    image = np.arange(96.0 * 64.0).reshape(64, 96)
    assert motion.blur_by_motion(image, CAMERA, np.array([0.0, 1e-4, 0.0]), 1e-3) is image
    assert sum(followed) < 0.05 * image.size
    assert motion.blur_by_motion(image, CAMERA, np.array([0.0, 1.0, 0.0]), 0.05) is not image
    assert max(followed) == image.size


def test_kernels_of_a_camera_are_transformed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lens = Optics(f_number=4.0, diffraction=True, psf_sigma_px=0.5, scatter=Scatter(tis=0.01, l_rad=0.005, s=-2.0))
    image = np.random.default_rng(1).uniform(1.0, 2.0, (64, 96))
    convolution._kept.clear()
    first = lens_spread.spread(image, CAMERA, lens, BAND, 5e-6)
    transforms, rfft2 = [], convolution.fft.rfft2

    def counted(values: Any, *arguments: Any, **named: Any) -> Any:
        transforms.append(values)
        return rfft2(values, *arguments, **named)

    monkeypatch.setattr(convolution.fft, "rfft2", counted)
    np.testing.assert_array_equal(lens_spread.spread(image, CAMERA, lens, BAND, 5e-6), first)
    images, kernels = len(transforms), 2
    convolution._kept.clear()
    np.testing.assert_array_equal(lens_spread.spread(image, CAMERA, lens, BAND, 5e-6), first)
    assert (images, len(transforms)) == (2, 2 * images + kernels)


def test_transforms_are_dropped_beyond_their_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convolution, "_KEPT_BYTES", 300_000)
    convolution._kept.clear()
    for size in range(32, 64, 2):
        quadrant = np.full((size, size), 1.0 / size**2)
        quadrant.flags.writeable = False
        convolution.spread_wings(np.ones((size, size)), quadrant)
    assert 0 < sum(one.spectrum.nbytes for one in convolution._kept.values()) <= 300_000
    kept = len(convolution._kept)
    convolution.spread_wings(np.ones((8, 8)), np.full((8, 8), 0.01))
    assert len(convolution._kept) == kept
