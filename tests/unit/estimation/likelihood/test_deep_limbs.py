"""A limb tens of pixels deep: a megapixel that sees a shipped profile over the ellipsoid, without the renderer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from horizonval.estimation import registry
from horizonval.estimation.likelihood.profile.ray_height import ray_height
from horizonval.estimation.likelihood.templates import shipped_templates
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import WGS84

pytestmark = pytest.mark.slow

SIZE, FOCAL_PX = 1024, 512.0 / np.tan(np.radians(30.0))
CAMERA = CameraModel(SIZE, SIZE, FOCAL_PX, FOCAL_PX, 0.5 * (SIZE - 1), 0.5 * (SIZE - 1))
NOISE_DN = 16.0
"""Of a limb of 2400: photons and read-out of a sunlit one."""


def megapixel(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A sunlit limb from 550 km across the middle of the image, and the nadir in camera axes."""
    rng = np.random.default_rng(seed)
    latitude, turn = np.radians(10.0), rng.uniform(0.0, 6.0)
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    r = 6.9213e6 * up
    level = np.cross(up, [0.0, 0.0, 1.0])
    level /= np.linalg.norm(level)
    level = np.cos(turn) * level + np.sin(turn) * np.cross(up, level)
    off = np.arcsin(6.371e6 / 6.9213e6)
    forward = -np.cos(off) * up + np.sin(off) * level
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    cam_from_itrs = np.array([right, np.cross(forward, right), forward])
    row, column = np.mgrid[:SIZE, :SIZE].reshape(2, -1).astype(float)
    ray = ray_height(unproject(CAMERA, np.column_stack([column, row])).T, cam_from_itrs, r, WGS84.axes_m)
    table = shipped_templates("solar", (0.45, 0.75))
    assert table is not None
    mean = table.mean_at(np.radians(35.0), np.radians(60.0))[0]
    sky = np.interp(ray.height_m, table.height_m, mean, right=0.0) * (ray.distance_m > 0.0) / mean.max()
    seen = gaussian_filter(sky.reshape(SIZE, SIZE), np.hypot(0.7, np.sqrt(1.0 / 12.0)))
    image = np.rint(300.0 + 2400.0 * seen + rng.normal(0.0, NOISE_DN, seen.shape))
    return np.clip(image, 0.0, 4095.0), -cam_from_itrs @ up


def test_a_sphere_is_fitted_to_a_sunlit_megapixel_and_claims_what_it_is_off_by() -> None:
    """Of the first two draws that in whose pixels of 2.9 km the steps do not end; flattening is in the claim."""
    image, nadir = megapixel(2)
    seen = Observation(image, CAMERA, full_scale=4095.0, band_kind="solar", band_um=(0.45, 0.75))
    fit = registry.get("limb-sphere").run(seen)
    assert isinstance(fit, Fit), fit
    error = np.linalg.norm(np.cross(fit.nadir_cam, nadir))
    claimed = np.sqrt(np.trace(fit.total_covariance_nadir_cam))
    assert error < 3.0 * claimed
    assert claimed < np.radians(0.25)
