"""The position of a shaded hard limb, on pictures of a Lambert sphere sampled ray by ray in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.limb.edges import find_edges
from horizonval.estimation.limb.model.shading import unshade
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.limb.subpixel import refine
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.cone import fit_cone
from horizonval.geometry.directions import off_axis_angle

SIDE = 240
CAMERA = CameraModel(SIDE, SIDE, 300.0, 300.0, 119.5, 119.5)
RHO = np.radians(31.0)
NADIR = np.array([np.sin(0.55) * 0.6, np.sin(0.55) * 0.8, np.cos(0.55)])
FINE = 14


def _sphere(sun: np.ndarray, flat: bool = False) -> np.ndarray:
    """Return a picture of a unit Lambert sphere, 800 under an overhead Sun; ``flat`` glows alike everywhere."""
    centre = NADIR / np.sin(RHO)
    power = float(centre @ centre)

    def radiance(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        d = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        along = d @ centre
        under = along**2 - (power - 1.0)
        point = (along - np.sqrt(np.maximum(under, 0.0)))[..., None] * d - centre
        return np.where(under > 0.0, 800.0 if flat else 800.0 * np.maximum(point @ sun, 0.0), 0.0)

    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    v, u = np.indices((SIDE, SIDE)).astype(float)
    return np.mean([radiance(u + du, v + dv) for du in offset for dv in offset], axis=0)


def _positions(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far inside the limb [px] the points of both refinements lie."""
    edges = find_edges(Picture(image, saturated=np.zeros(image.shape, dtype=bool)).eight_bit, 9)
    uv, kept, _ = refine(image, edges.uv, edges.gradient)
    better, _ = unshade(image, CAMERA, fit_cone(unproject(CAMERA, uv)).axis_cam, uv, edges.gradient[kept])
    plain, unshaded = ((RHO - off_axis_angle(unproject(CAMERA, points), NADIR)) * CAMERA.fx for points in (uv, better))
    return plain, unshaded


SUNS = {
    "overhead": -NADIR,
    "to the side": -NADIR * np.cos(0.4) + np.sin(0.4) * np.cross(NADIR, [0.0, 0.0, 1.0]) / np.sin(0.55),
}


@pytest.fixture(scope="module")
def pictures() -> dict[str, np.ndarray]:
    return {name: _sphere(sun) for name, sun in SUNS.items()} | {"glow": _sphere(-NADIR, flat=True)}


@pytest.mark.parametrize("sun", SUNS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shading_no_longer_moves_the_limb(pictures: dict[str, np.ndarray], sun: str, sign: float) -> None:
    """Lit and as a negative. Left is the next order: 7 px of 12 arcmin at the limb are an arc of 0.2 rad of ground,
    whose cosine departs from a straight line by 2 %, and the window weighs it with its length."""
    image = pictures[sun] if sign > 0 else 900.0 - pictures[sun]
    plain, unshaded = _positions(image)
    assert len(unshaded) > 150
    assert np.median(plain) > 0.15
    assert np.abs(np.median(unshaded)) < 0.03
    assert unshaded.std() < 0.02


def test_an_even_disc_stays_where_it_is(pictures: dict[str, np.ndarray]) -> None:
    """A pixel's coverage is sampled to 1 / 14 px in each of 15 rows: 2e-3 px."""
    _, unshaded = _positions(pictures["glow"])
    assert np.abs(np.mean(unshaded)) < 2e-3
    assert unshaded.std() < 0.01


def test_noise_of_one_column_is_not_paid_for_with_a_slope_of_its_own(pictures: dict[str, np.ndarray]) -> None:
    """A column that fitted its own slope would scatter by 3.4 times as much as one that does not."""
    rng = np.random.default_rng(np.random.SeedSequence(8))
    plain, unshaded = _positions(pictures["glow"] + rng.normal(0.0, 8.0, (SIDE, SIDE)))
    assert unshaded.std() < 1.5 * plain.std()


def test_windows_over_the_rim_are_left_out_and_tiny_images_stay(pictures: dict[str, np.ndarray]) -> None:
    image = pictures["overhead"]
    axis = NADIR
    uv = np.array([[120.0 + i, 3.2] for i in range(20)])
    gradient = np.tile([0.0, 1.0], (20, 1))
    same, kept = unshade(image, CAMERA, axis, uv, gradient)
    assert np.array_equal(same, uv)
    assert len(kept) == 20
    tiny = CameraModel(32, 32, 40.0, 40.0, 15.5, 15.5)
    same, _ = unshade(image[:32, :32], tiny, axis, uv[:, :] / 8.0, gradient)
    assert np.array_equal(same, uv / 8.0)
