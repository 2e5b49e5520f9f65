"""Thinned pixels near a limb lie in every row and column that the limb's neighbourhood has."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.fit.pixels import near_pixels
from horizonval.estimation.fit.pose import LimbPose
from horizonval.geometry.camera import CameraModel


@pytest.mark.parametrize("most", [8000, 4000, 2000, 1000])
def test_no_row_or_column_stays_empty(most: int) -> None:
    """Rows and columns of one parity would shift the limb by turns, which is what torn readout does."""
    camera = CameraModel(512, 512, 900.0, 900.0, 255.5, 255.5)
    pose, axes = LimbPose(np.eye(3), np.array([0.0, 0.0, -30000e3])), np.full(3, 6378e3)
    near = near_pixels(camera, pose, axes, 10.0, 10.0, most)
    all_pixels = near_pixels(camera, pose, axes, 10.0, 10.0)
    assert len(near.columns) < len(all_pixels.columns)
    for found, whole in ((near.columns, all_pixels.columns), (near.rows, all_pixels.rows)):
        assert np.mean(np.isin(np.unique(whole), found)) > 0.9
