"""Frames through lenses that are no pinholes: rays, coverage, discs and the image circle, against exact geometry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import horizonval as hv
from horizonval.frame import Hit, RadianceFrame
from horizonval.geometry.camera import (
    CameraModel,
    camera_from_spec,
    check_invertible,
    in_image_circle,
    pixel_grid,
    pixel_solid_angle,
    unproject,
)
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.horizon import horizon_columns, signed_limb_angle
from horizonval.renderer.frame import render_frame
from horizonval.renderer.kernel.frame_geometry import RayCamera
from horizonval.spec.camera import CameraGeometry, CameraSpec
from horizonval.spec.scene import SceneSpec

THERMAL = {"name": "lwir", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
SOLAR = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
FISHEYE = {"width": 160, "height": 160, "fov_deg": 196.0, "projection": "fisheye", "image_circle_deg": 190.0}


def frame_of(
    geometry: dict[str, Any], band: dict[str, Any], *, altitude_km: float = 500.0, **scene: Any
) -> tuple[RadianceFrame, CameraModel]:
    """A planet without air, black in the infrared and in sunlight, the Sun behind it; and the camera that sees it."""
    spec = CameraSpec.model_validate({"camera": geometry, "band": [band]})
    data = {
        "platform": {"altitude_km": altitude_km, "latitude_deg": 20.0},
        "atmosphere": {"profile": "none"},
        "surface": {"albedo": 0.0, "temperature_k": 288.0},
        "sun": {"zenith_deg": 170.0},
        "moon": {"enabled": False},
        "night": {"sky_background": False},
    }
    frame = render_frame(SceneSpec.model_validate(data | scene), spec)
    return frame, camera_from_spec(spec.camera)


def limb_angle(frame: RadianceFrame, camera: CameraModel) -> Any:
    """Exact angle [rad] of every pixel's centre inside the Earth's outline; NaN beyond the image circle."""
    truth = frame.truth
    d = rotate(inverse(truth.q_cam_from_itrs), unproject(camera, pixel_grid(camera)))
    lit = np.isfinite(d).all(axis=-1)
    angle = np.full(lit.shape, np.nan)
    angle[lit] = signed_limb_angle(d[lit], truth.r_itrs, Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m))
    return angle


RATIONAL = (0.5, -2.7, 2e-4, -3e-4, 1.6, 0.38, -2.5, 1.5, 0.0, 0.0, 0.0, 0.0)
PRISM = (0.9, 0.1, 1e-4, 2e-4, 3e-3, 1.3, 0.35, 0.02, 2e-3, 0.0, 1e-3, 0.0)
OMNI: dict[str, Any] = {
    **{"fx": 680.0, "fy": 688.0, "projection": "unified", "xi": 1.2, "skew": 0.01},
    "distortion": [-0.1, 0.05, 1e-3, -2e-3],
}
CAMERAS = {
    "pinhole": CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0),
    "distorted": CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0, (-0.2, 0.05, 1e-3, -5e-4, -0.01)),
    "equal angle": CameraModel(640, 640, 3000.0, 3000.0, 319.5, 319.5, projection="equal_angle"),
    "f-theta": CameraModel(640, 480, 200.0, 201.0, 320.4, 241.0, projection="fisheye"),
    "fisheye": CameraModel(640, 480, 170.0, 170.0, 319.5, 239.5, (0.03, -0.012, 0.002, -0.0001, 0.0), "fisheye"),
    "fisheye beside its fold": CameraModel(640, 480, 466.0, 466.0, 319.5, 239.5, (-0.2, 0.0, 0.0, 0.0, 0.0), "fisheye"),
    "barrel": CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0, (-0.45, 0.25, 1e-3, -5e-4, -0.05)),
    "pincushion": CameraModel(640, 480, 250.0, 250.0, 319.5, 239.5, (0.17, 0.05, 2e-3, -5e-4, 0.02)),
    "rational": CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0, RATIONAL),
    "thin prism": CameraModel(640, 480, 500.0, 510.0, 320.4, 241.0, PRISM),
    "skewed f-theta": CameraModel(640, 480, 200.0, 201.0, 320.4, 241.0, projection="fisheye", skew=0.05),
    "omnidirectional": camera_from_spec(CameraGeometry(width=640, height=480, **OMNI)),
    "double sphere": CameraModel(640, 480, 300.0, 310.0, 320.4, 241.0, projection="unified", shape=(-0.2, 0.6, 1.0)),
    "extended unified": CameraModel(
        640, 480, 300.0, 310.0, 320.4, 241.0, projection="unified", shape=(0.0, 0.62, 1.13)
    ),
    "moustache": CameraModel(640, 480, 400.0, 400.0, 319.5, 239.5, (0.63, 5e-3, -1e-2, -1e-2, -0.4)),
}
SIMPLE = ("pinhole", "distorted", "equal angle")


@pytest.mark.parametrize("name", CAMERAS)
def test_rays_equal_the_analytic_camera(mi: Any, name: str) -> None:
    """1e-12 rad through simple lenses, else 1e-9 rad: both are float64 and share no code. Up to the outer edge."""
    camera = CAMERAS[name]
    check_invertible(camera)
    u, v = np.meshgrid(np.linspace(-0.5, 639.5, 65), np.linspace(-0.5, 479.5, 49))
    rays = RayCamera.of(camera, np.eye(3)).direction(mi.Float64(u.ravel()), mi.Float64(v.ravel()))
    ours = np.stack([np.array(c) for c in rays], axis=1)
    assert np.abs(ours - unproject(camera, np.stack([u, v], axis=-1)).reshape(-1, 3)).max() < (
        1e-12 if name in SIMPLE else 1e-9
    )


@pytest.mark.parametrize("projection", ["fisheye", "pinhole", "equal_angle", "unified"])
def test_both_sides_see_the_same_image_circle(mi: Any, projection: Any) -> None:
    camera = CameraModel(64, 48, 30.0, 30.0, 31.0, 24.2, (0.01, 0.0, 0.0, 0.0, 0.0), projection, math.radians(41.0))
    grid = pixel_grid(camera).reshape(-1, 2)
    sees = RayCamera.of(camera, np.eye(3)).sees(mi.Float64(grid[:, 0].copy()), mi.Float64(grid[:, 1].copy()))
    assert np.array_equal(np.array(sees).reshape(48, 64), in_image_circle(camera))
    assert 0.2 < in_image_circle(camera).mean() < 0.8


def test_a_fisheye_frame_shows_the_exact_horizon(mi: Any) -> None:
    """190 deg, the limb from before to behind the camera: hits exact to 1e-6 rad, shares beyond a pixel (21 mrad)."""
    frame, camera = frame_of(FISHEYE, THERMAL, camera={"file": "t", "mount_roll_deg": 75.0})
    inside, angle = in_image_circle(camera), limb_angle(frame, camera)
    hit = frame.maps["hit"]
    assert (hit[~inside] == Hit.SPACE).all()
    assert (hit[inside & (angle > 1e-6)] == Hit.SURFACE).all()
    assert (hit[inside & (angle < -1e-6)] != Hit.SURFACE).all()
    assert not any(np.isnan(values).any() for values in frame.maps.values())
    radiance = frame.radiance["lwir"]
    share = radiance / radiance.max()
    assert (radiance[~inside] == 0.0).all()
    assert share[inside & (angle > 0.022)] == pytest.approx(1.0, rel=1e-6)
    assert (share[inside & (angle < -0.022)] == 0.0).all()
    behind = unproject(camera, pixel_grid(camera))[..., 2] < 0.0
    assert (hit[behind] == Hit.SURFACE).any()
    assert (hit[behind & inside] != Hit.SURFACE).any()


@pytest.mark.parametrize(
    "lens",
    [
        OMNI | {"fx": 170.0, "fy": 172.0},
        {"fx": 70.0, "projection": "unified", "xi": -0.2, "alpha": 0.6, "skew": 0.01},
        {"fx": 80.0, "distortion": [0.9, 0.1, 1e-4, 2e-4, 0.003, 1.3, 0.35, 0.02, 2e-3, 0.0, 1e-3, 0.0]},
    ],
    ids=["omnidirectional", "double sphere", "rational"],
)
def test_nadir_and_horizon_through_lenses_of_other_programs(mi: Any, lens: dict[str, Any]) -> None:
    """Hits are exact to 1e-6 rad. The sensor without error reads the nadir, and a fit finds it to 0.1 px of 9 mrad."""
    scene: dict[str, Any] = {
        "camera": {"file": "t", "mount_roll_deg": 62.0},
        "prior": {"position_sigma_km": 0.1, "attitude_sigma_deg": [2.0, 2.0, 2.0]},
    }
    frame, camera = frame_of({"width": 160, "height": 120, "cx": 70.0, "cy": 65.0, **lens}, THERMAL, **scene)
    angle = limb_angle(frame, camera)
    clear = np.abs(angle) > 1e-6
    assert np.array_equal((frame.maps["hit"] == Hit.SURFACE)[clear], (angle > 0.0)[clear])
    for method, error in (("ideal", 1e-9), ("limb-ellipsoid", 9e-4)):
        fit = hv.estimate(frame, method)
        assert isinstance(fit, hv.Fit)
        assert np.linalg.norm(fit.nadir_cam - frame.truth.nadir_geocentric_cam) < error


@pytest.mark.parametrize(
    ("geometry", "roll_deg"),
    [
        ({"width": 160, "height": 160, "fov_deg": 160.0, "projection": "fisheye"}, 0.0),
        ({"width": 200, "height": 200, "fov_deg": 300.0, "projection": "fisheye", "image_circle_deg": 290.0}, 160.0),
    ],
    ids=["down", "up, the limb behind the camera"],
)
def test_the_whole_earth_fills_its_solid_angle(mi: Any, geometry: dict[str, Any], roll_deg: float) -> None:
    """Looking down from 500 km, the radiance adds up over pixels to ``2 pi (1 - cos rho)``: 1e-4.

    The midpoint rule errs by 1.3e-5 and 2.9e-5. Looking up the missing part is space, ``2 pi (1 + cos rho)``.
    """
    scene: dict[str, Any] = {"camera": {"file": "t", "mount_roll_deg": roll_deg}, "earth": {"shape": "sphere"}}
    frame, camera = frame_of(geometry, THERMAL, **scene)
    share = frame.radiance["lwir"].astype(float) / frame.radiance["lwir"].max()
    rho = math.asin(6371.0088 / 6871.0088)
    if roll_deg == 0.0:
        assert (share * pixel_solid_angle(camera)).sum() == pytest.approx(2 * math.pi * (1 - math.cos(rho)), rel=1e-4)
    else:
        space = ((1.0 - share) * pixel_solid_angle(camera)).sum()
        assert space == pytest.approx(2 * math.pi * (1 + math.cos(rho)), rel=1e-4)


@pytest.mark.parametrize(
    ("geometry", "off_axis_deg", "error"),
    [(FISHEYE, 40.0, 1e-4), (FISHEYE, 93.0, 1e-4), ({"width": 120, "height": 90, "fov_deg": 24.0}, 5.0, 1e-2)],
    ids=["fisheye", "behind a fisheye", "pinhole"],
)
def test_the_sun_carries_its_irradiance_wherever_it_stands(
    mi: Any, geometry: dict[str, Any], off_axis_deg: float, error: float
) -> None:
    """1e-4 of the Sun's irradiance on a surface that faces it, also behind the camera plane of a 190 deg fisheye.

    The renderer's solid angle of a pixel is the polygon of its corners, here the Jacobian: 4.6e-4 / 12 apart. In the
    pinhole the disc is a few cells across, and its outline in a cell is a parabola: 1 %.
    """
    scene: dict[str, Any] = {
        "camera": {"file": "t", "mount_roll_deg": 180.0},
        "sun": {"zenith_deg": off_axis_deg, "azimuth_deg": 30.0},
    }
    spec = CameraSpec.model_validate({"camera": geometry, "band": [SOLAR]})
    frame, camera = frame_of(geometry, SOLAR, **scene)
    from horizonval.earth.optical import optical_model
    from horizonval.geometry.sun_and_moon import AU_M, sun_itrs

    full = SceneSpec.model_validate(frame.truth.scene)
    _, distance_m = sun_itrs(full.platform.epoch_utc)
    nodes = optical_model(full, spec, distance_m / AU_M).nodes
    expected = sum(n.weight * n.solar_irradiance for n in nodes)
    assert float((frame.radiance["vis"] * pixel_solid_angle(camera)).sum()) == pytest.approx(expected, rel=error)


def test_a_line_of_pixels_sees_the_limb(mi: Any) -> None:
    """160 x 1 pixels of 0.1 deg across the limb: the column where it falls, to 1e-3 px from the covered share."""
    geometry = {"width": 160, "height": 1, "fov_deg": 16.0}
    frame, camera = frame_of(geometry, THERMAL, camera={"file": "t", "mount_yaw_deg": 45.0, "mount_pitch_deg": 67.0})
    share = frame.radiance["lwir"][0].astype(float) / frame.radiance["lwir"].max()
    truth = frame.truth
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    exact = horizon_columns(camera, truth.q_cam_from_itrs, truth.r_itrs, [0.0], ellipsoid)[0, 0]
    assert 10.0 < exact < 150.0
    assert share.sum() - 0.5 == pytest.approx(exact, abs=1e-3)


def test_the_full_disc_from_the_geostationary_orbit(mi: Any) -> None:
    """An equal-angle grid of 17.4 deg: the hit map is exact, and the Earth's solid angle right to 1e-5."""
    geometry = {"width": 200, "height": 200, "fov_deg": 17.8, "projection": "equal_angle"}
    scene: dict[str, Any] = {"earth": {"shape": "sphere"}, "camera": {"file": "t", "mount_yaw_deg": 20.0}}
    frame, camera = frame_of(geometry, THERMAL, altitude_km=35786.0, **scene)
    angle = limb_angle(frame, camera)
    clear = np.abs(angle) > 1e-6
    assert np.array_equal((frame.maps["hit"] == Hit.SURFACE)[clear], (angle > 0.0)[clear])
    share = frame.radiance["lwir"].astype(float) / frame.radiance["lwir"].max()
    rho = math.asin(6371.0088 / (6371.0088 + 35786.0))
    assert (share * pixel_solid_angle(camera)).sum() == pytest.approx(2 * math.pi * (1 - math.cos(rho)), rel=1e-5)
