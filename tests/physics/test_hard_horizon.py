"""The rendered edge against the analytic horizon: no atmosphere, a glowing uniform ground, so a pixel is its coverage.

Independent sides: the renderer's edge is ``render.coverage`` on ``render.rays`` (Dr.Jit); the analytic curve is
``geometry.horizon`` and ``geometry.camera`` (numpy). They share no code. The edge of a column (or row) is the sum of
its coverages; the analytic one is the curve integrated over the pixel's width.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import horizon_columns, horizon_rows
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import truth_of

WORST_ARCSEC = 0.05
"""The edge of a pixel-perfect renderer; 1e-4 of the pixels of these cameras, a thousandth of any sensor's accuracy."""

ALTITUDES_KM = (300.0, 500.0, 800.0, 3000.0, 20_200.0, 35_786.0)
DISTORTED = [-0.12, 0.03, 4e-4, -3e-4, -0.004]
CAMERAS = {
    "square": {"width": 256, "height": 256, "fov_deg": 60.0},
    "wide": {"width": 320, "height": 200, "fov_deg": 50.0},
    "distorted": {"width": 256, "height": 240, "fov_deg": 60.0, "distortion": DISTORTED},
}


def _specs(altitude_km: float, shape: str, camera: str) -> tuple[SceneSpec, CameraSpec]:
    earth = {"shape": shape} if shape == "wgs84" else {"shape": "sphere", "radius_km": 6371.0}
    off_nadir = np.degrees(np.arcsin(6371.0 / (6371.0 + altitude_km)))
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": float(off_nadir) + 1.3, "mount_yaw_deg": 17.0},
            "platform": {"altitude_km": altitude_km, "latitude_deg": 38.0, "longitude_deg": 25.0, "heading_deg": 30.0},
            "attitude": {"yaw_deg": 8.0, "pitch_deg": -3.0, "roll_deg": 2.0},
            "earth": earth,
            "atmosphere": {"profile": "none"},
            "surface": {"temperature_k": 288.0},
        }
    )
    geometry = dict(CAMERAS[camera])
    if altitude_km > 10_000.0:
        # the field of a camera for that orbit: the disc more than fills it
        geometry["fov_deg"] = 12.0
    spec = {"camera": geometry, "band": [{"name": "glow", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}]}
    return scene, CameraSpec.model_validate(spec)


GAUSS, WEIGHT = (v / 2 for v in np.polynomial.legendre.leggauss(6))


def _edge_errors_px(coverage: np.ndarray, crossings: np.ndarray) -> np.ndarray:
    """Return rendered minus analytic edge of every column that the horizon crosses once, away from the image's ends.

    ``crossings``: shape (columns, quadrature points, k), NaN-padded.
    """
    length = len(coverage)
    once = np.all(np.isfinite(crossings).sum(axis=2) == 1, axis=1)
    rows = np.where(once[:, None], np.nan_to_num(crossings).sum(axis=2), -1.0)
    once &= (rows.min(axis=1) > 0.5) & (rows.max(axis=1) < length - 1.5)
    # a sliver at either end is a second crossing between the quadrature points
    once &= np.isin(coverage[0], (0.0, 1.0)) & np.isin(coverage[-1], (0.0, 1.0))
    top_covered = coverage[0] > 0.5
    filled = coverage.sum(axis=0)
    rendered = np.where(top_covered, filled, length - filled) - 0.5
    return (rendered - rows @ WEIGHT)[once]


EVERY = list(product(ALTITUDES_KM, ("wgs84", "sphere"), CAMERAS))
QUICK = [(altitude_km, "wgs84", "square") for altitude_km in ALTITUDES_KM]
QUICK += [(500.0, "wgs84", "wide"), (800.0, "wgs84", "distorted"), (500.0, "sphere", "square")]


@pytest.mark.parametrize(
    ("altitude_km", "shape", "camera"),
    [one if one in QUICK else pytest.param(*one, marks=pytest.mark.slow) for one in EVERY],
)
def test_rendered_edge_is_the_analytic_horizon(altitude_km: float, shape: str, camera: str) -> None:
    scene, spec = _specs(altitude_km, shape, camera)
    intrinsics = camera_from_spec(spec.camera)
    truth = truth_of(scene, spec)
    image = render_frame(scene, spec).radiance["glow"].astype(float)
    coverage = image / image.max()
    assert coverage.min() == 0.0

    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    pose = (intrinsics, truth.q_cam_from_itrs, truth.r_itrs)
    errors = []
    for find, length, lines in (
        (horizon_rows, intrinsics.width, coverage),
        (horizon_columns, intrinsics.height, coverage.T),
    ):
        at = (np.arange(length)[:, None] + GAUSS).ravel()
        crossings = find(*pose, at, ellipsoid).reshape(length, len(GAUSS), -1)
        errors.append(_edge_errors_px(lines, crossings))
    error = np.concatenate(errors) * np.degrees(1.0 / intrinsics.fx) * 3600.0
    assert error.size > 100
    worst = float(np.abs(error).max())
    assert worst < WORST_ARCSEC, f"{worst:.4f} arcsec over {error.size} lines"
