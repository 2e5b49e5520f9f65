"""The directions that are kept by camera: right, told apart by every number of a camera, and bounded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.estimation.limb import picture
from horizonval.estimation.limb.picture import PixelDirections
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject

CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)
BYTES = 32 * 24 * 3 * 8


def test_directions_are_those_of_the_camera_and_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def counted(camera: CameraModel, uv: np.ndarray) -> np.ndarray:
        made.append(camera)
        return unproject(camera, uv)

    monkeypatch.setattr(picture, "unproject", counted)
    kept = PixelDirections()
    first, again = kept.of(CAMERA), kept.of(replace(CAMERA))
    assert first is again
    assert made == [CAMERA]
    assert np.array_equal(first, unproject(CAMERA, pixel_grid(CAMERA)))
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0, 0] = 1.0


@pytest.mark.parametrize(
    "change",
    [
        {"distortion": (0.0, 0.0, 0.0, 0.0, 1e-3)},
        {"cx": 15.25},
        {"fy": 30.5},
        {"projection": "equal_angle"},
        {"image_circle_rad": 0.3},
    ],
)
def test_cameras_that_differ_in_one_number_are_two(change: dict) -> None:
    other = replace(CAMERA, **change)
    kept = PixelDirections()
    kept.of(CAMERA)
    assert np.array_equal(kept.of(other), unproject(other, pixel_grid(other)), equal_nan=True)
    assert not np.array_equal(kept.of(other), kept.of(CAMERA))
    assert kept.nbytes == 2 * BYTES


def test_what_is_kept_is_bounded_and_the_camera_of_longest_ago_goes_first() -> None:
    cameras = [replace(CAMERA, cx=float(k)) for k in range(4)]
    kept = PixelDirections(most_bytes=2 * BYTES + 1)
    first, second = kept.of(cameras[0]), kept.of(cameras[1])
    assert kept.of(cameras[0]) is first
    kept.of(cameras[2])
    assert kept.nbytes == 2 * BYTES
    assert kept.of(cameras[0]) is first, "asked for since"
    assert kept.of(cameras[1]) is not second, "asked for longest ago"
    large = PixelDirections(most_bytes=BYTES - 1)
    assert np.array_equal(large.of(CAMERA), unproject(CAMERA, pixel_grid(CAMERA)))
    assert large.nbytes == 0
