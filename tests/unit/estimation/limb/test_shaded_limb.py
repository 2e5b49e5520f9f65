"""The position of a shaded hard limb, on pictures of a Lambert sphere sampled ray by ray in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import off_axis_angle

SIDE = 240
CAMERA = CameraModel(SIDE, SIDE, 300.0, 300.0, 119.5, 119.5)
RHO = np.radians(31.0)
NADIR = np.array([np.sin(0.55) * 0.6, np.sin(0.55) * 0.8, np.cos(0.55)])
FINE = 14


def _sphere(sun: np.ndarray, flat: bool = False, texture: float = 0.0) -> np.ndarray:
    """Return a picture of a unit Lambert sphere, 800 under an overhead Sun; ``flat`` glows alike everywhere.

    ``texture``: of the albedo from place to place, over a tenth of the radius.
    """
    centre = NADIR / np.sin(RHO)
    power = float(centre @ centre)

    def radiance(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        d = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        along = d @ centre
        under = along**2 - (power - 1.0)
        point = (along - np.sqrt(np.maximum(under, 0.0)))[..., None] * d - centre
        albedo = 1.0 + texture * np.sin(point @ waves).mean(axis=-1)
        return np.where(under > 0.0, 800.0 if flat else 800.0 * albedo * np.maximum(point @ sun, 0.0), 0.0)

    waves = 30.0 * np.random.default_rng(5).normal(size=(3, 6))
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    v, u = np.indices((SIDE, SIDE)).astype(float)
    return np.mean([radiance(u + du, v + dv) for du in offset for dv in offset], axis=0)


def _positions(image: np.ndarray) -> np.ndarray:
    """Return how far inside the limb [px] the search's points lie."""
    found = find_limb(image, CAMERA)
    assert isinstance(found, LimbPoints)
    return (RHO - off_axis_angle(found.los_cam, NADIR)) * CAMERA.fx


SUNS = {
    "overhead": -NADIR,
    "to the side": -NADIR * np.cos(0.4) + np.sin(0.4) * np.cross(NADIR, [0.0, 0.0, 1.0]) / np.sin(0.55),
}


@pytest.fixture(scope="module")
def pictures() -> dict[str, np.ndarray]:
    return {name: _sphere(sun) for name, sun in SUNS.items()} | {"glow": _sphere(-NADIR, flat=True)}


@pytest.mark.parametrize("sun", SUNS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shading_does_not_move_the_limb(pictures: dict[str, np.ndarray], sun: str, sign: float) -> None:
    """Lit and as a negative; with a straight line in place of the root it is 0.03 to 0.04 px off."""
    off = _positions(pictures[sun] if sign > 0 else 900.0 - pictures[sun])
    assert len(off) > 150
    assert np.abs(np.median(off)) < 0.025
    assert off.std() < 0.05


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_half_lit_textured_limb_has_points_where_it_is_lit(sign: float) -> None:
    """The Sun 10 deg behind the disc's plane. Night shows nothing at all: no shading of the day makes an edge of it."""
    beside = np.cross(NADIR, [0.0, 0.0, 1.0])
    sun = np.cos(np.radians(10.0)) * beside / np.linalg.norm(beside) + np.sin(np.radians(10.0)) * NADIR
    image = _sphere(sun, texture=0.8)
    found = find_limb(image if sign > 0 else 900.0 - image, CAMERA)
    assert isinstance(found, LimbPoints)
    across = found.los_cam - (found.los_cam @ NADIR)[:, None] * NADIR
    # where a line passes the limb, the ground's normal is nearly across it: half a pixel makes a third of a degree
    assert (across @ sun / np.linalg.norm(across, axis=1)).min() > 0.0
    off = (RHO - off_axis_angle(found.los_cam, NADIR)) * CAMERA.fx
    # a hundredth of a pixel is the interpolation's; the texture's own slope at the limb is some hundredths
    assert abs(np.median(off)) < 0.05
    assert np.percentile(np.abs(off), 90.0) < 0.15
    assert len(off) > 50
