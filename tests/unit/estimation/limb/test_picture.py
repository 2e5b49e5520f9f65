"""A picture before the search: ranks against NumPy's to the bit, and directions of pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.estimation.limb import picture
from horizonval.estimation.limb.picture import Picture, PixelDirections
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject

SIZES = (1, 2, 3, 10, 11, 999, 1000, 4801)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("size", SIZES)
def test_ranks_are_numpys_to_the_bit(kind: type, size: int) -> None:
    values = np.random.default_rng(size).normal(50.0, 30.0, size).astype(kind)
    assert picture.median(values) == float(np.median(values))
    for q in (0.5, 50.0, 99.9):
        assert picture.percentile(values, q) == float(np.percentile(values, q))


@pytest.mark.parametrize("size", SIZES)
def test_counts_have_the_percentiles_of_what_they_count(size: int) -> None:
    levels = np.random.default_rng(size).integers(0, 1000, (size, 3)).astype(np.uint16)
    counts = picture.level_counts(levels, 999)
    assert counts.tolist() == np.bincount(levels.ravel(), minlength=1000).tolist()
    for q in (0.5, 50.0, 99.9):
        assert picture.percentile_of_counts(counts, q) == float(np.percentile(levels, q))


@pytest.mark.parametrize("full_scale", [None, 700.0, 1023.0])
def test_an_image_of_whole_numbers_is_stretched_as_any_other(full_scale: float | None) -> None:
    rng = np.random.default_rng(4)
    whole = np.rint(np.clip(rng.normal(400.0, 200.0, (90, 120)), 3.0, 1023.0))
    assert Picture(whole, full_scale).levels is not None
    # The same image off whole numbers takes the way of any other.
    shifted = Picture(whole - 3.5, None if full_scale is None else full_scale - 3.5)
    assert shifted.levels is None
    # Both formulas round to eight bits, of numbers that differ in the last bits.
    apart = Picture(whole, full_scale).eight_bit.astype(int) - shifted.eight_bit.astype(int)
    assert np.mean(apart != 0) < 1e-3


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
