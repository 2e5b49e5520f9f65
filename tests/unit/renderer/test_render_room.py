"""The renderer's parts, each against a closed form or a second implementation that shares no code with it."""

from __future__ import annotations

import hashlib
import itertools
from typing import Any

import drjit as dr
import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import WGS84, geodetic_height
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.kernel.discs import cell_coverage
from horizonval.renderer.kernel.frame_geometry import RayCamera
from horizonval.renderer.planet import Planet
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

RADIUS_M = 6_371_000.0


@pytest.fixture(scope="module")
def mi() -> Any:
    activate()
    import mitsuba

    return mitsuba


@pytest.mark.parametrize("radius_px", [20.0, 300.0])
def test_coverage_of_a_disc_is_its_exact_area(mi: Any, radius_px: float) -> None:
    """2e-4 of a cell at 20 px radius (the quadrature it is held against is good to 1e-5), 3e-5 at 300 px."""
    rng = np.random.default_rng(np.random.SeedSequence(7))
    angle, offset = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(-0.75, 0.75, 2000)
    u, v = (radius_px + offset) * np.cos(angle), (radius_px + offset) * np.sin(angle)
    share, _, _ = cell_coverage(lambda x, y: radius_px - dr.sqrt(x * x + y * y), mi.Float64(u), mi.Float64(v), 1.0)
    x = u[:, None] + (np.arange(4000) + 0.5) / 4000 - 0.5
    half = np.sqrt(np.maximum(radius_px**2 - x**2, 0.0))
    low, high = np.maximum(v[:, None] - 0.5, -half), np.minimum(v[:, None] + 0.5, half)
    exact = np.maximum(high - low, 0.0).mean(axis=1)
    assert np.abs(np.array(share) - exact).max() < (2e-4 if radius_px < 100 else 3e-5)


def test_geodetic_height_in_the_kernel_equals_geometry(mi: Any) -> None:
    """1 mm up to the top of the atmosphere, poles and equator included."""
    rng = np.random.default_rng(np.random.SeedSequence(3))
    direction = rng.normal(size=(500, 3))
    direction[:3] = np.eye(3)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    r = direction * (6.36e6 + rng.uniform(0.0, 1e5, 500))[:, None]
    height, _ = Planet(WGS84.a_m, WGS84.b_m).height_and_normal(tuple(mi.Float64(r[:, k].copy()) for k in range(3)))
    assert np.abs(np.array(height) - geodetic_height(r, WGS84)).max() < 1e-3


@pytest.mark.parametrize(
    "camera",
    [
        CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0),
        CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0, (-0.2, 0.05, 1e-3, -5e-4, -0.01)),
        CameraModel(640, 640, 3000.0, 3000.0, 319.5, 319.5, projection="equal_angle"),
    ],
)
def test_kernel_rays_equal_the_analytic_camera(mi: Any, camera: CameraModel) -> None:
    """1e-12 rad: both are float64 and share no code."""
    uv = np.array(list(itertools.product(np.linspace(-0.5, 639.5, 17), np.linspace(-0.5, 479.5, 13))))
    rays = RayCamera.of(camera, np.eye(3))
    ours = rays.direction(mi.Float64(uv[:, 0].copy()), mi.Float64(uv[:, 1].copy()))
    assert np.abs(np.stack([np.array(c) for c in ours], axis=1) - unproject(camera, uv)).max() < 1e-12


def _scene(changes: dict[str, Any]) -> SceneSpec:
    scene = {
        "camera": {"file": "test", "mount_roll_deg": 66.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0},
        "sun": {"zenith_deg": 40.0, "azimuth_deg": 60.0},
    }
    return SceneSpec.model_validate(scene | changes)


def _camera(**band: Any) -> CameraSpec:
    return CameraSpec.model_validate({"camera": {"width": 96, "height": 72, "fov_deg": 60.0}, "band": [band]})


SOLAR = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
THERMAL = {"name": "lwir", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}


@pytest.mark.parametrize("band", [SOLAR, THERMAL], ids=["solar", "thermal"])
def test_the_number_of_threads_changes_no_bit(mi: Any, band: dict[str, Any]) -> None:
    seen = set()
    before = dr.thread_count()
    try:
        for threads in (1, 2, 4, 2, 4):
            dr.set_thread_count(threads)
            image = render_frame(_scene({}), _camera(**band)).radiance[band["name"]]
            seen.add(hashlib.sha256(image.tobytes()).hexdigest())
    finally:
        dr.set_thread_count(before)
    assert len(seen) == 1


@pytest.mark.parametrize(
    "zenith_deg", [40.0, *(pytest.param(low, marks=pytest.mark.slow) for low in (80.0, 88.0)), 95.0, 98.0]
)
def test_march_has_converged(mi: Any, zenith_deg: float) -> None:
    """The figures of ``RenderSettings``, against eight times the default nodes: 0.3 %, 1 % in dark pixels.

    In twilight, where rays cross the shadow's edge, 0.3 % everywhere. With the Sun 8 deg below the horizon under the
    camera it is looked for on the other side, where there is light.
    """

    def render(nodes: int) -> np.ndarray:
        sun = {"zenith_deg": zenith_deg, "azimuth_deg": 60.0 if zenith_deg < 96 else 300.0}
        # airglow, known to a factor of two, has half the nodes
        tables = {"sun": sun, "render": {"nodes": nodes}, "night": {"airglow": False}}
        scene = _scene({**tables, "atmosphere": {"refraction": False}})
        return render_frame(scene, _camera(**SOLAR)).radiance["vis"].astype(float)

    fine = render(1024)
    error = np.abs(render(128) / np.maximum(fine, 1e-30) - 1.0)
    for share, limit in ((0.05, 3e-3), (1e-3, 1e-2 if zenith_deg < 90 else 3e-3)):
        bright = fine > share * fine.max()
        assert bright.sum() > 100
        assert error[bright].max() < limit


def test_sun_in_the_frame_carries_the_solar_constant(mi: Any) -> None:
    """1 %: the disc is a few cells across here, and its outline in a cell is taken as a parabola."""
    scene = _scene(
        {
            "camera": {"file": "test", "mount_roll_deg": 180.0},
            "atmosphere": {"profile": "none"},
            "sun": {"zenith_deg": 5.0, "azimuth_deg": 30.0},
            "surface": {"albedo": 0.0},
        }
    )
    spec = CameraSpec.model_validate({"camera": {"width": 120, "height": 90, "fov_deg": 24.0}, "band": [SOLAR]})
    frame = render_frame(scene, spec)
    camera = CameraModel(120, 90, 60 / np.tan(np.radians(12.0)), 60 / np.tan(np.radians(12.0)), 59.5, 44.5)
    u, v = np.meshgrid(np.arange(120.0), np.arange(90.0))
    cosine = unproject(camera, np.stack([u, v], axis=-1))[..., 2]
    irradiance = float((frame.radiance["vis"] * cosine**3).sum() / camera.fx**2)
    from horizonval.earth.optical import optical_model
    from horizonval.geometry.sun_and_moon import AU_M, sun_itrs

    _, distance_m = sun_itrs(scene.platform.epoch_utc)
    model = optical_model(scene, spec, distance_m / AU_M)
    expected = sum(n.weight * n.solar_irradiance for n in model.nodes)
    assert irradiance == pytest.approx(expected, rel=1e-2)
