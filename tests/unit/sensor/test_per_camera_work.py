"""What depends on the camera alone is worked out once, and what does not matter is not worked out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel
from horizonval.sensor import motion
from horizonval.sensor.lens import optics
from horizonval.spec.sensor.optics import Optics

CAMERA = CameraModel(96, 64, 90.0, 90.0, 47.5, 31.5, (-0.1, 0.01, 0.0, 0.0, 0.0), "pinhole", None)


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
