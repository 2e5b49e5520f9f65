"""Frames made by hand: cheap, complete, and independent of the renderer."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

# One thread for linear algebra, as the command line has it, before numpy loads: two test processes on two processors
# with two threads each wait for one another more than they work. Told here, processes that tests start have it too.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.spec.camera import CameraSpec

CAMERA: dict[str, Any] = {
    "camera": {"name": "small", "width": 40, "height": 30, "fov_deg": 60.0},
    "optics": {"f_number": 4.0, "transmission": 0.8, "psf_sigma_px": 0.7},
    "band": [{"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 5.5,
        "exposure_s": 2e-4,
        "quantum_efficiency": 0.6,
        "full_well_e": 13500,
        "read_noise_e": 13,
        "dark_current_e_per_s": 125,
        "bits": 10,
        "black_level_dn": 32,
    },
}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what needs the extra ``reference``, unless ``-m`` asks for it by name."""
    if "sasktran2" in config.option.markexpr:
        return
    left_out = [item for item in items if item.get_closest_marker("sasktran2")]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("sasktran2")]


@pytest.fixture
def camera_tables() -> dict[str, Any]:
    """A complete small camera file, parsed; the test's own copy."""
    return CameraSpec.model_validate(CAMERA).model_dump(mode="json")


@pytest.fixture
def make_truth() -> Callable[..., FrameTruth]:
    """Build a self-consistent truth: 500 km above a sphere at 20 N 30 E, camera pitched 60 deg off the nadir."""

    def build(camera: dict[str, Any] | None = None, **changes: Any) -> FrameTruth:
        radius, distance = 6371008.8, 6871008.8
        up = np.array([np.cos(0.35) * np.cos(0.5), np.cos(0.35) * np.sin(0.5), np.sin(0.35)])
        east = np.array([-np.sin(0.5), np.cos(0.5), 0.0])
        lvlh = np.stack([east, np.cross(-up, east), -up])
        cam_from_lvlh = Rotation.from_euler("x", 60.0, degrees=True).as_matrix()
        cam = Rotation.from_matrix(cam_from_lvlh @ lvlh)
        nadir = tuple(cam.apply(-up).tolist())
        sun = np.array([0.1, 0.7, np.sqrt(0.5)])
        values: dict[str, Any] = {
            "scene": {"scene": {"name": "hand", "seed": 7}, "third": 1 / 3},
            "camera": CameraSpec.model_validate(camera or CAMERA).model_dump(mode="json"),
            "scene_id": "c0ffee" * 8,
            "epoch_utc": "2026-03-20T12:34:56.789+00:00",
            "ellipsoid_a_m": radius,
            "ellipsoid_b_m": radius,
            "r_itrs": tuple((distance * up).tolist()),
            "altitude_m": distance - radius,
            "q_cam_from_itrs": tuple(cam.as_quat().tolist()),
            "q_cam_from_body": (0.0, 0.0, 0.0, 1.0),
            "q_body_from_lvlh": tuple(Rotation.from_matrix(cam_from_lvlh).as_quat().tolist()),
            "yaw_rad": 0.0,
            "pitch_rad": 0.0,
            "roll_rad": float(np.radians(-60.0)),
            "sun_itrs": tuple(sun.tolist()),
            "sun_cam": tuple(cam.apply(sun).tolist()),
            "sun_angular_radius_rad": 0.00465,
            "sun_visible_fraction": 1.0,
            "nadir_geocentric_cam": nadir,
            "nadir_geodetic_cam": nadir,
            "angular_radius_rad": float(np.arcsin(radius / distance)),
        }
        return FrameTruth(**(values | changes))

    return build


@pytest.fixture
def make_frame(make_truth: Callable[..., FrameTruth]) -> Callable[..., RadianceFrame]:
    """Build a frame of the given radiance (a number, or an array per band) and camera."""

    def build(radiance: Any = None, camera: dict[str, Any] | None = None, **changes: Any) -> RadianceFrame:
        truth = make_truth(camera, **changes)
        size = truth.camera["camera"]
        shape = (size["height"], size["width"])
        if radiance is None:
            radiance = np.random.default_rng(5).uniform(0, 50, shape)
        if not isinstance(radiance, dict):
            radiance = {truth.camera["band"][0]["name"]: radiance}
        bands = {name: np.broadcast_to(np.asarray(v, np.float32), shape).copy() for name, v in radiance.items()}
        row = np.broadcast_to(np.linspace(-9e4, 3e5, shape[0])[:, None], shape).astype(np.float32)
        maps = {
            "distance": np.where(row < 0, 2e6, np.inf).astype(np.float32),
            "tangent_height": row.copy(),
            "solar_zenith": np.full(shape, 41.25, np.float32),
            "hit": (row < 0).astype(np.float32),
        }
        return RadianceFrame(radiance=bands, maps=maps, truth=truth, render={"nodes": 64, "version": "0"})

    return build


@pytest.fixture
def make_image(make_truth: Callable[..., FrameTruth]) -> Callable[..., DetectorImage]:
    """Build a 10-bit detector image with a random pattern."""

    def build(**changes: Any) -> DetectorImage:
        truth = make_truth(**changes)
        size = truth.camera["camera"]
        dn = np.random.default_rng(6).integers(0, 1024, (size["height"], size["width"])).astype(np.uint16)
        return DetectorImage(dn=dn, band="vis", truth=truth, full_scale=1023, observation={"seed": 3})

    return build
