"""The search for limb points: position on a known edge, the Sun's blob and the terminator left out."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.geometry.camera import CameraModel, project

CAMERA = CameraModel(200, 160, 180.0, 180.0, 99.5, 79.5)
NADIR = np.array([0.1, 0.92, 0.35]) / np.linalg.norm([0.1, 0.92, 0.35])
RHO = 1.15


def _picture(sigma_px: float, noise: float, lit_from_column: float = -1.0) -> np.ndarray:
    """Return an Earth of 600 over a background of 40, blurred edge, optionally dark left of a soft terminator."""
    v, u = np.indices((CAMERA.height, CAMERA.width)).astype(float)
    d = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones_like(u)], axis=-1)
    d /= np.linalg.norm(d, axis=-1)[..., None]
    inside_rad = RHO - np.arccos(np.clip(d @ NADIR, -1.0, 1.0))
    edge = 0.5 * (1.0 + np.tanh(inside_rad * CAMERA.fx / sigma_px))
    light = np.clip((u - lit_from_column) / 60.0, 0.0, 1.0) if lit_from_column >= 0 else 1.0
    rng = np.random.default_rng(np.random.SeedSequence(4))
    return np.round(40.0 + 560.0 * edge * light + rng.normal(0.0, noise, u.shape))


def _distance_px(points: LimbPoints) -> np.ndarray:
    angle = np.arccos(np.clip(points.los_cam @ NADIR, -1.0, 1.0)) - RHO
    return angle * CAMERA.fx


@pytest.mark.parametrize(("sigma_px", "noise", "limit_px"), [(0.8, 0.0, 0.06), (1.0, 5.0, 0.2)])
def test_points_lie_on_the_edge(sigma_px: float, noise: float, limit_px: float) -> None:
    """Rms, in pixels of the optical axis; off axis a pixel is up to a third less."""
    found = find_limb(_picture(sigma_px, noise), CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    error = _distance_px(found)
    assert len(error) > 100
    assert np.sqrt(np.mean(error**2)) < limit_px
    uv, _ = project(CAMERA, found.los_cam)
    assert np.abs(uv - found.uv).max() < 1e-9


def test_an_inverted_picture_gives_the_same_limb() -> None:
    found = find_limb(1023.0 - _picture(0.8, 0.0), CAMERA, None)
    assert isinstance(found, LimbPoints)
    assert np.sqrt(np.mean(_distance_px(found) ** 2)) < 0.06


def test_the_suns_blob_is_no_limb() -> None:
    picture = _picture(0.8, 2.0)
    v, u = np.indices(picture.shape)
    picture[np.hypot(u - 40, v - 25) < 6] = 1023.0
    found = find_limb(picture, CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    assert np.abs(_distance_px(found)).max() < 2.0


def test_a_soft_terminator_is_no_limb() -> None:
    found = find_limb(_picture(0.8, 1.0, lit_from_column=30.0), CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    assert np.abs(_distance_px(found)).max() < 2.0
