"""The camera both ways against OpenCV, and against itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, check_invertible, pixel_solid_angle, project, unproject


@pytest.mark.parametrize(
    "lens",
    [
        (-0.2, 0.06, 8e-4, -5e-4, -0.012),
        (-0.38, 0.21, 2e-3, -3e-3, -0.06),
        (0.45, 0.12, -4e-3, 2e-3, 0.08),
        (0.62, 0.01, -0.012, -0.01, -0.14),
    ],
    ids=["mild", "barrel", "pincushion", "moustache"],
)
def test_strong_distortion_is_opencvs_and_is_undone(lens: tuple[float, float, float, float, float]) -> None:
    """Up to tens of per cent of distortion: 1e-9 px of OpenCV's closed form, and 1e-9 px there and back."""
    camera = CameraModel(800, 600, 610.0, 615.0, 402.3, 297.1, lens)
    check_invertible(camera)
    pixels = np.random.default_rng(np.random.SeedSequence(4)).uniform([-0.5, -0.5], [799.5, 599.5], (2000, 2))
    d = unproject(camera, pixels)
    matrix = np.array([[610.0, 0, 402.3], [0, 615.0, 297.1], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(d, np.zeros(3), np.zeros(3), matrix, np.array(lens))
    ours, in_front = project(camera, d)
    assert in_front.all()
    assert np.abs(ours - theirs[:, 0]).max() < 1e-9
    assert np.abs(theirs[:, 0] - pixels).max() < 1e-9


def test_pixel_centres_field_of_view_and_equal_angles() -> None:
    camera = CameraModel(101, 51, 50.5, 50.5, 50.0, 25.0)
    assert unproject(camera, [[50.0, 25.0]])[0] == pytest.approx([0.0, 0.0, 1.0])
    edge = unproject(camera, [[100.5, 25.0]])[0]
    assert np.degrees(np.arctan2(edge[0], edge[2])) == pytest.approx(45.0)
    camera = CameraModel(11, 11, 100.0, 100.0, 5.0, 5.0, projection="equal_angle")
    d = unproject(camera, [[8.0, 5.0], [5.0, 2.0]])
    assert np.arctan2(d[0, 0], d[0, 2]) == pytest.approx(0.03)
    assert np.arcsin(d[1, 1]) == pytest.approx(-0.03)


def test_solid_angles_of_a_pinhole_add_up_to_the_field() -> None:
    """3e-5: the midpoint rule over pixels h = 0.01 wide errs by about h^2 / 6."""
    camera = CameraModel(120, 80, 100.0, 100.0, 59.5, 39.5)
    a, b = 60 / 100, 40 / 100
    field = 4 * np.arctan(a * b / np.sqrt(1 + a * a + b * b))
    assert pixel_solid_angle(camera).sum() == pytest.approx(field, rel=3e-5)


def test_a_lens_that_folds_inside_the_image_is_refused() -> None:
    with pytest.raises(UserError):
        check_invertible(CameraModel(800, 600, 400.0, 400.0, 399.5, 299.5, (-0.9, 0.0, 0.0, 0.0, 0.0)))
