"""A picture before the search: ranks against NumPy's to the bit, and directions of pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.estimation.limb import picture
from horizonval.estimation.limb.picture import pixel_directions
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject

SIZES = (1, 2, 3, 10, 11, 999, 1000, 4801)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("size", SIZES)
def test_ranks_are_numpys_to_the_bit(kind: type, size: int) -> None:
    values = np.random.default_rng(size).normal(50.0, 30.0, size).astype(kind)
    assert picture.median(values) == float(np.median(values))
    for q in (0.5, 50.0, 99.9):
        assert picture.percentile(values, q) == float(np.percentile(values, q))


CAMERA = CameraModel(32, 24, 30.0, 30.0, 15.5, 11.5)


def test_directions_are_those_of_the_camera_and_made_once() -> None:
    first, again = pixel_directions(CAMERA), pixel_directions(replace(CAMERA))
    assert first is again
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
    assert np.array_equal(pixel_directions(other), unproject(other, pixel_grid(other)), equal_nan=True)
    assert not np.array_equal(pixel_directions(other), pixel_directions(CAMERA))
