"""How pixels move points, against finite differences and integrals in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import ndtr

from horizonval.estimation.limb.cone import limb_directions
from horizonval.estimation.limb.steepest import _bilinear, _response, pixel_variance, to_steepest
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
from horizonval.geometry.rotation import off_axis_angle

CAMERA = CameraModel(width=90, height=70, fx=80.0, fy=80.0, cx=44.0, cy=36.0)
RHO = math.radians(66.0)
AXIS = np.array([math.sin(1.1) * math.sin(0.3), math.sin(1.1) * math.cos(0.3), math.cos(1.1)])


def picture(bright_inside: bool) -> np.ndarray:
    depth = (RHO - off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), AXIS)) * CAMERA.fx
    return 30.0 + 500.0 * ndtr((depth if bright_inside else -depth) / 1.3)


def test_weights_interpolate_as_scipy_does() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(size=(70, 90))
    uv = np.column_stack([rng.uniform(0, 89, 300), rng.uniform(0, 69, 300)])
    uv[:4] = [[0, 0], [89, 69], [89, 0], [3.0, 69.0]]
    expected = map_coordinates(image, [uv[:, 1], uv[:, 0]], order=1)
    assert _bilinear(uv, CAMERA) @ image.ravel() == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("bright_inside", [True, False])
def test_a_pixel_moves_the_points_as_the_search_does(bright_inside: bool) -> None:
    """Every pixel within reach of three points, changed by a little: the search ends where the derivative says."""
    image = picture(bright_inside)
    start = limb_directions(CAMERA, AXIS, RHO, 12.0)[::12]
    los, _ = to_steepest(image, CAMERA, start, AXIS, bright_inside)
    los, _ = to_steepest(image, CAMERA, los, AXIS, bright_inside)
    response = _response(image, CAMERA, los, AXIS, 1.0 if bright_inside else -1.0).toarray()
    uv, _ = project(CAMERA, los)
    delta, largest = 0.05, np.abs(response).max()
    for point in (1, len(los) // 2):
        column, row = np.rint(uv[point]).astype(int)
        for down in range(-3, 4):
            for right in (-1, 0, 2):
                ends = []
                for sign in (-1.0, 1.0):
                    changed = image.copy()
                    changed[row + down, column + right] += sign * delta
                    moved, kept = to_steepest(changed, CAMERA, los, AXIS, bright_inside)
                    assert len(kept) == len(los)
                    ends.append(off_axis_angle(moved, AXIS)[point])
                # Inwards is towards the axis: the angle from it falls.
                slope = -(ends[1] - ends[0]) / (2 * delta)
                expected = response[point, (row + down) * CAMERA.width + column + right]
                assert slope == pytest.approx(expected, abs=0.08 * largest)


@pytest.mark.parametrize("sigma", [2.0, 6.0])
def test_even_noise_has_one_variance_inside_and_out(sigma: float) -> None:
    big = CameraModel(width=180, height=140, fx=160.0, fy=160.0, cx=88.0, cy=72.0)
    depth = (RHO - off_axis_angle(unproject(big, pixel_grid(big)), AXIS)) * big.fx
    image = 30.0 + 500.0 * ndtr(depth / 1.3) + np.random.default_rng(1).normal(0.0, sigma, (140, 180))
    found = pixel_variance(image, big, AXIS, RHO)
    assert np.median(found[depth > 5]) == pytest.approx(sigma**2, rel=0.15)
    assert np.median(found[depth < -5]) == pytest.approx(sigma**2, rel=0.15)
    assert found.min() > 0.0
