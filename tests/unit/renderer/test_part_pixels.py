"""Which pixels of a part have rays, and that the others follow a light that changes slowly."""

from __future__ import annotations

import numpy as np

from horizonval.renderer.part_pixels import STRIDE, Faces, PixelPlan

SIDE = 128
ROW, COLUMN = (k.astype(float) for k in np.mgrid[:SIDE, :SIDE])


def _plan(step: float = 0.0) -> tuple[PixelPlan, np.ndarray]:
    """Two faces side by side, the right one turned by 45 deg or moved back by ``step``, in a border of nothing."""
    covered = (ROW >= 4) & (ROW < 124) & (COLUMN >= 4) & (COLUMN < 124)
    right = COLUMN >= 64
    depth = 1.0 + np.where(right, step or 0.01 * (COLUMN - 64), 0.0)
    tilt = np.where(right, 0.0 if step else np.pi / 4, 0.0)
    place = np.stack([0.01 * COLUMN, 0.01 * ROW, depth], axis=-1).reshape(-1, 3)
    normal = np.stack([np.sin(tilt), 0.0 * tilt, -np.cos(tilt)], axis=-1).reshape(-1, 3)
    return PixelPlan.of(Faces(np.where(covered, 0, -1).ravel(), normal, place), covered), right.ravel()


def test_a_light_linear_on_each_face_is_found_between_the_nodes() -> None:
    for step in (0.0, 0.5):
        plan, right = _plan(step)
        light = (1.0 + 0.01 * COLUMN + 0.005 * ROW).ravel() + np.where(right, 3.0, 0.0)
        image = np.where(np.isin(np.arange(light.size), plan.sampled), light, 0.0)
        assert len(plan.sampled) < 0.2 * 120 * 120
        # at the faces' edges nodes are on one side alone, up to two strides away
        error = np.abs(plan.mean(image) - light[plan.between])
        assert error.max() < 2 * STRIDE * 0.015
        assert np.median(error) < 1e-9
