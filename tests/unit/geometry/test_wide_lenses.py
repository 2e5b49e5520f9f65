"""Rational, thin prism, skewed and unified lenses: against OpenCV, the papers' formulas and themselves."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from horizonval.core.errors import UserError
from horizonval.geometry.camera import (
    CameraModel,
    camera_from_spec,
    camera_table,
    check_invertible,
    pixel_grid,
    pixel_solid_angle,
    project,
    unproject,
    widest_angle,
)
from horizonval.spec.camera import CameraGeometry

Array = NDArray[np.float64]
FX, FY, CX, CY = 610.0, 615.0, 402.3, 297.1
MATRIX = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1.0]])
RATIONAL = {
    "mild": [-0.28, 0.09, 1.2e-3, -7e-4, 0.013, 0.1, 0.02, -0.004],
    # As a depth camera's factory calibration: large terms that cancel each other.
    "cancelling": [0.5, -2.7, 2e-4, -3e-4, 1.6, 0.38, -2.5, 1.5],
    "wide": [0.9, 0.1, 1e-4, 2e-4, 0.003, 1.3, 0.35, 0.02],
    "prism": [-0.28, 0.09, 1.2e-3, -7e-4, 0.013, 0.1, 0.02, -0.004, 3e-3, -1e-3, 2e-3, 5e-4],
}
UNIFIED: dict[str, dict[str, Any]] = {
    "mei": {"xi": 0.9, "distortion": [-0.1, 0.05, 1e-3, -2e-3]},
    "mei-beyond-1": {"xi": 1.7, "distortion": [-0.05, 0.2, -1e-3, 5e-4], "skew": 3e-3},
    "double-sphere": {"xi": -0.2, "alpha": 0.6},
    "double-sphere-2": {"xi": 0.3, "alpha": 0.55},
    "eucm": {"alpha": 0.62, "beta": 1.13},
    "all": {"xi": 0.2, "alpha": 0.4, "beta": 0.9, "distortion": [0.02, -0.01, 0, 0, 0, 0.01, 0, 0, 1e-3, 0, 1e-3, 0]},
}


def lens(fx: float = FX, fy: float = FY, **keys: Any) -> CameraModel:
    size = {"width": 800, "height": 600, "fx": fx, "fy": fy, "cx": CX, "cy": CY}
    return camera_from_spec(CameraGeometry.model_validate({**size, **keys}))


def unified(name: str) -> CameraModel:
    keys = UNIFIED[name]
    scale = 420.0 * (1.0 + float(keys.get("xi", 0.0)))
    return lens(scale, 1.01 * scale, projection="unified", **keys)


def papers(d: Array, keys: dict[str, Any]) -> Array:
    """Return pixels by the formulas of Mei and Rives, Usenko et al. and Khomutenko et al., each as its paper has it."""
    x, y, z = (d / np.linalg.norm(d, axis=-1, keepdims=True)).T
    xi, alpha, beta = (float(keys.get(key, default)) for key, default in (("xi", 0.0), ("alpha", 0.0), ("beta", 1.0)))
    if "beta" in keys:
        rho = np.sqrt(beta * (x * x + y * y) + z * z)
        mx, my = x / (alpha * rho + (1 - alpha) * z), y / (alpha * rho + (1 - alpha) * z)
    elif "alpha" in keys:
        d1 = np.sqrt(x * x + y * y + z * z)
        d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
        mx, my = (c / (alpha * d2 + (1 - alpha) * (xi * d1 + z)) for c in (x, y))
    else:
        mx, my = x / (z + xi), y / (z + xi)
    k1, k2, p1, p2 = keys.get("distortion", [0.0] * 4)
    r2 = mx * mx + my * my
    radial = 1 + k1 * r2 + k2 * r2 * r2
    dx = mx * radial + 2 * p1 * mx * my + p2 * (r2 + 2 * mx * mx)
    dy = my * radial + 2 * p2 * mx * my + p1 * (r2 + 2 * my * my)
    fx, fy = 420.0 * (1.0 + xi), 424.2 * (1.0 + xi)
    return np.stack([fx * (dx + float(keys.get("skew", 0.0)) * dy) + CX, fy * dy + CY], axis=-1)


def pixels(n: int = 2000) -> Array:
    return np.random.default_rng(4).uniform([-0.5, -0.5], [799.5, 599.5], (n, 2))


def directions(largest_rad: float, n: int = 3000) -> Array:
    rng = np.random.default_rng(5)
    theta, phi = rng.uniform(0.0, largest_rad, n), rng.uniform(-np.pi, np.pi, n)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize("k", RATIONAL.values(), ids=RATIONAL)
def test_rational_and_thin_prism_are_opencvs(k: list[float]) -> None:
    """1e-9 px of OpenCV's closed form over the image, there and back."""
    camera = lens(distortion=k)
    check_invertible(camera)
    d = unproject(camera, pixels())
    theirs = cv2.projectPoints(d, np.zeros(3), np.zeros(3), MATRIX, np.array(k))[0][:, 0]
    ours, seen = project(camera, d)
    assert seen.all()
    assert np.abs(ours - theirs).max() < 1e-9
    assert np.abs(theirs - pixels()).max() < 1e-9


@pytest.mark.parametrize("alpha", [0.02, -0.3])
def test_a_skewed_fisheye_is_opencvs(alpha: float) -> None:
    k = [0.021, -0.008, 0.004, -0.001]
    camera = lens(projection="fisheye", distortion=k, skew=alpha)
    d = directions(math.radians(80.0))
    points = (d / d[:, 2:])[:, None]
    theirs = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, np.array(k), alpha=alpha)[0][:, 0]
    assert np.abs(project(camera, d)[0] - theirs).max() < 1e-9
    assert np.abs(unproject(camera, theirs) - d).max() < 1e-12


@pytest.mark.parametrize("name", UNIFIED)
def test_unified_lenses_are_the_papers(name: str) -> None:
    """1e-9 px of the formulas within 1 deg of the turning angle, and 1e-10 from direction to direction."""
    camera, keys = unified(name), UNIFIED[name]
    d = directions(widest_angle(camera) - math.radians(1.0))
    ours, seen = project(camera, d)
    assert seen.all()
    if name != "all":
        assert np.abs(ours - papers(d, keys)).max() < 1e-9 * max(1.0, np.abs(ours).max() / 1e3)
    assert np.abs(unproject(camera, ours) - d).max() < 1e-10
    outside = widest_angle(camera) + 1e-6
    assert not project(camera, [math.sin(outside), 0.0, math.cos(outside)])[1]


def test_turning_angles() -> None:
    """Mei: ``cos = -xi`` up to 1 and ``-1 / xi`` beyond; a sphere seen from its surface (alpha 1) turns at 90 deg."""
    for xi, alpha, cosine in ((0.5, 0.0, -0.5), (1.6, 0.0, -1 / 1.6), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)):
        camera = lens(projection="unified", xi=xi, alpha=alpha)
        assert math.cos(widest_angle(camera)) == pytest.approx(cosine, abs=1e-12)
    with pytest.raises(UserError, match=r"no direction: the unified lens with xi = 1.6.* 128.7 deg"):
        check_invertible(lens(projection="unified", xi=1.6, fx=300.0))


@pytest.mark.parametrize("camera", [*map(unified, UNIFIED), lens(distortion=RATIONAL["prism"], skew=0.01)])
def test_solid_angles_are_the_jacobians(camera: CameraModel) -> None:
    """1e-6 of the cross product of two central differences of unprojected pixels, 1e-3 px each way."""
    uv = pixel_grid(camera)[::40, ::40]
    h = 1e-3
    sides = [unproject(camera, uv + step) for step in ([h, 0], [-h, 0], [0, h], [0, -h])]
    area = np.cross((sides[0] - sides[1]) / (2 * h), (sides[2] - sides[3]) / (2 * h))
    expected = np.abs(np.einsum("...i,...i", area, unproject(camera, uv)))
    assert pixel_solid_angle(camera)[::40, ::40] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("camera", [*map(unified, UNIFIED), lens(distortion=RATIONAL["prism"], skew=0.05)])
def test_the_table_of_a_camera_is_read_as_the_same(camera: CameraModel) -> None:
    again = camera_from_spec(CameraGeometry.model_validate(camera_table(camera)))
    assert np.abs(project(again, unproject(camera, pixels(300)))[0] - pixels(300)).max() < 1e-9


def test_what_is_no_lens_is_refused() -> None:
    mistakes: tuple[tuple[dict[str, Any], str], ...] = (
        ({"xi": 0.5}, 'xi applies to projection = "unified" only'),
        ({"projection": "equal_angle", "skew": 0.1}, "skew does not apply"),
        ({"projection": "unified", "xi": 1.6, "image_circle_deg": 270.0}, "folds back at a full angle of 257.4 deg"),
        ({"distortion": [0.0] * 13}, "at most 12"),
    )
    for keys, line in mistakes:
        with pytest.raises(ValueError, match=line):
            lens(**keys)
    with pytest.raises(UserError, match="folds inside the image"):
        check_invertible(lens(300.0, distortion=[-0.9, 0, 0, 0, 0, 0.1, 0, 0]))
