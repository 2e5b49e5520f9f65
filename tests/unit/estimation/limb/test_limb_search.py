"""The search for the limb on drawn pictures: hard, shaded, deep, harmed, and through a fisheye."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.limb.evidence import weigh
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.picture import LimbPoints, Picture, in_wider_pixels
from horizonval.estimation.limb.pyramid import levels_of
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, in_image_circle, pixel_grid, project, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

RHO = math.radians(66.0)
CAMERA = CameraModel(240, 180, 200.0, 200.0, 119.5, 89.5)


def nadir_at(off_deg: float, turn_deg: float = 12.0) -> np.ndarray:
    off, turn = math.radians(off_deg), math.radians(turn_deg)
    return np.array([math.sin(off) * math.sin(turn), math.sin(off) * math.cos(turn), math.cos(off)])


NADIR = nadir_at(66.0)


def depth_px(camera: CameraModel, nadir: np.ndarray, rho: float) -> np.ndarray:
    """How far inside the limb pixels look, in pixels of the optical axis."""
    return (rho - off_axis_angle(unproject(camera, pixel_grid(camera)), nadir)) * camera.fx


def picture(
    depth: np.ndarray, *, bright: float = 500.0, dark: float = 40.0, noise: float = 3.0, width_px: float = 0.8
) -> np.ndarray:
    clean = dark + (bright - dark) * ndtr(depth / width_px)
    return np.rint(clean + np.random.default_rng(5).normal(0.0, noise, depth.shape))


def off_deg(found: LimbPoints | Refusal, nadir: np.ndarray) -> float:
    assert isinstance(found, LimbPoints), found
    return math.degrees(math.acos(min(1.0, float(fit_cone(found.los_cam).axis_cam @ nadir))))


def test_noise_shows_no_limb_and_a_ramp_neither() -> None:
    grain = np.random.default_rng(2).normal(100.0, 5.0, (180, 240))
    ramp = np.rint(2.0 * np.maximum(depth_px(CAMERA, NADIR, RHO), 0.0) + grain)
    for image in (grain, ramp):
        evidence = weigh(levels_of(Picture(image), CAMERA)[0], CAMERA, NADIR, RHO)
        assert evidence is not None
        assert evidence.explained < 0.1
        assert isinstance(find_limb(image, CAMERA), Refusal)


@pytest.mark.parametrize("off", [38.0, 100.0])
def test_a_limb_so_near_the_border_that_a_small_picture_holds_few_profiles_of_it_is_found(off: float) -> None:
    """The profiles of the smallest picture size reach 64 pixels to either side of the limb."""
    camera, nadir = CameraModel(240, 240, 180.0, 180.0, 119.5, 119.5), nadir_at(off, 0.3)
    found = find_limb(picture(depth_px(camera, nadir, math.radians(67.5))), camera)
    assert off_deg(found, nadir) < 0.5


@pytest.mark.parametrize("harm", ["lines", "block", "jpeg", "antenna"])
def test_what_harms_a_part_of_the_picture_leaves_the_limb(harm: str) -> None:
    """0.05 deg: a sixth of a pixel along the arc in view."""
    image = picture(depth_px(CAMERA, NADIR, RHO), bright=200.0)
    if harm == "lines":
        image[::23] = 0.0
    elif harm == "block":
        image[60:130, 90:150] = 0.0
    elif harm == "jpeg":
        _, code = cv2.imencode(".jpg", image.clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 50])
        image = cv2.imdecode(code, cv2.IMREAD_GRAYSCALE).astype(float)
    else:
        image[:, 170:178] = 150.0
    assert off_deg(find_limb(image, CAMERA), NADIR) < 0.15


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("height_px", [24.0, 60.0])
def test_a_limb_tens_of_pixels_deep_is_found_in_a_smaller_copy(sign: float, height_px: float) -> None:
    """Air of 7 km at 0.3 and 0.12 km a pixel, the Earth bright and dark."""
    camera = CameraModel(640, 480, 3000.0, 3000.0, 319.5, 239.5)
    nadir = nadir_at(67.0)
    depth = depth_px(camera, nadir, RHO)
    level = np.where(depth > 0.0, 1.0, np.exp(np.minimum(depth, 0.0) / height_px))
    image = 500.0 + sign * 400.0 * (level - 0.5) + np.random.default_rng(1).normal(0.0, 5.0, depth.shape)
    found = find_limb(image, camera)
    assert isinstance(found, LimbPoints)
    assert found.scale >= 8
    uv, _ = project(camera, found.los_cam)
    off = (RHO - off_axis_angle(found.los_cam, nadir)) * camera.fx
    assert np.std(off) < 0.1 * height_px, "on one height"
    assert -1.5 * height_px < np.mean(off) < 0.0, "of the air above the ground"
    assert np.abs(uv - found.uv).max() < 1e-6


def test_a_second_layer_above_the_limb_is_part_of_it() -> None:
    """As ozone glows over the limb in 8 to 14 um: 15 % of the step, six pixels further out."""
    depth = depth_px(CAMERA, NADIR, RHO)
    image = picture(depth) + 70.0 * (ndtr((depth + 7.0) / 0.9) - ndtr(depth / 0.9))
    assert off_deg(find_limb(image, CAMERA), NADIR) < 0.15


def test_clouds_without_end_inside_the_limb_do_not_hide_it() -> None:
    """Of nearly full contrast, up to six pixels from the limb. 1 deg: three and a half pixels."""
    rng = np.random.default_rng(9)
    clouds = cv2.GaussianBlur(rng.normal(size=(180, 240)), (0, 0), 2.0)
    depth = depth_px(CAMERA, NADIR, RHO)
    image = picture(depth) * np.where(depth > 6.0, 1.0 + 0.8 * np.tanh(6.0 * clouds), 1.0)
    assert off_deg(find_limb(image, CAMERA), NADIR) < 1.0


def test_a_crop_whose_principal_point_lies_outside() -> None:
    whole = picture(depth_px(CAMERA, NADIR, RHO))
    crop = CameraModel(110, 180, 200.0, 200.0, 119.5 - 130.0, 89.5)
    assert off_deg(find_limb(whole[:, 130:], crop), NADIR) < 0.6


def test_the_most_probable_curve_decides() -> None:
    """Of a limb too short for a nadir nothing else is told, though a cloud's rim would do for a cone."""
    telescope = CameraModel(200, 160, 5000.0, 5000.0, 99.5, 79.5)
    image = picture(depth_px(telescope, nadir_at(66.0), RHO), noise=40.0)
    v, u = np.indices(image.shape)
    image[np.hypot(u - 100.0, v - 125.0) < 22.0] += 25.0
    found = find_limb(image, telescope)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.SHORT_ARC


def test_the_guard_looks_at_a_deep_limb_in_a_smaller_copy() -> None:
    camera = CameraModel(480, 480, 420.0, 420.0, 239.5, 239.5)
    nadir = nadir_at(62.0)
    rho = math.radians(60.0)
    image = picture(depth_px(camera, nadir, rho), width_px=9.0)
    seen = Observation(image=image, camera=camera, full_scale=1023.0, prior=Prior(shape="sphere"), band_kind="thermal")
    small = in_wider_pixels(seen, 4)
    assert small.image.shape == (120, 120)
    assert small.image[3, 5] == pytest.approx(image[12:16, 20:24].mean())
    there = unproject(small.camera, np.array([30.0, 40.0]))
    assert project(camera, there)[0] == pytest.approx([4 * 30.0 + 1.5, 4 * 40.0 + 1.5])
    fit = guarded(altitude_free.ESTIMATOR).run(seen)
    assert isinstance(fit, Fit)
    assert math.degrees(math.acos(min(1.0, float(fit.nadir_cam @ nadir)))) < 0.1
    # Its points are the given image's.
    off = (rho - off_axis_angle(unproject(camera, fit.points), nadir)) * camera.fx
    assert np.abs(np.median(off)) < 1.0


SOFT_CAMERA = CameraModel(200, 160, 180.0, 180.0, 99.5, 79.5)
SOFT_NADIR = np.array([0.1, 0.92, 0.35]) / np.linalg.norm([0.1, 0.92, 0.35])
SOFT_RHO = 1.15


def _picture(sigma_px: float, noise: float, lit_from_column: float = -1.0) -> np.ndarray:
    """Return an Earth of 600 over a background of 40, blurred edge, optionally dark left of a soft terminator."""
    v, u = np.indices((SOFT_CAMERA.height, SOFT_CAMERA.width)).astype(float)
    d = np.stack(
        [(u - SOFT_CAMERA.cx) / SOFT_CAMERA.fx, (v - SOFT_CAMERA.cy) / SOFT_CAMERA.fy, np.ones_like(u)], axis=-1
    )
    d /= np.linalg.norm(d, axis=-1)[..., None]
    inside_rad = SOFT_RHO - np.arccos(np.clip(d @ SOFT_NADIR, -1.0, 1.0))
    edge = 0.5 * (1.0 + np.tanh(inside_rad * SOFT_CAMERA.fx / sigma_px))
    light = np.clip((u - lit_from_column) / 60.0, 0.0, 1.0) if lit_from_column >= 0 else 1.0
    rng = np.random.default_rng(np.random.SeedSequence(4))
    return np.round(40.0 + 560.0 * edge * light + rng.normal(0.0, noise, u.shape))


def _distance_px(points: LimbPoints) -> np.ndarray:
    angle = np.arccos(np.clip(points.los_cam @ SOFT_NADIR, -1.0, 1.0)) - SOFT_RHO
    return angle * SOFT_CAMERA.fx


@pytest.mark.parametrize(("sigma_px", "noise", "limit_px"), [(0.8, 0.0, 0.06), (1.0, 5.0, 0.2)])
def test_points_lie_on_the_edge(sigma_px: float, noise: float, limit_px: float) -> None:
    """Rms, in pixels of the optical axis; off axis a pixel is up to a third less."""
    found = find_limb(_picture(sigma_px, noise), SOFT_CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    error = _distance_px(found)
    assert len(error) > 100
    assert np.sqrt(np.mean(error**2)) < limit_px
    uv, _ = project(SOFT_CAMERA, found.los_cam)
    assert np.abs(uv - found.uv).max() < 1e-9


def test_an_inverted_picture_gives_the_same_limb() -> None:
    found = find_limb(1023.0 - _picture(0.8, 0.0), SOFT_CAMERA, None)
    assert isinstance(found, LimbPoints)
    assert np.sqrt(np.mean(_distance_px(found) ** 2)) < 0.06


def test_the_suns_blob_is_no_limb() -> None:
    picture = _picture(0.8, 2.0)
    v, u = np.indices(picture.shape)
    picture[np.hypot(u - 40, v - 25) < 6] = 1023.0
    found = find_limb(picture, SOFT_CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    assert np.abs(_distance_px(found)).max() < 2.0


def test_a_soft_terminator_is_no_limb() -> None:
    found = find_limb(_picture(0.8, 1.0, lit_from_column=30.0), SOFT_CAMERA, 1023.0)
    assert isinstance(found, LimbPoints)
    assert np.abs(_distance_px(found)).max() < 2.0


FISHEYE_RHO = math.radians(68.0)


def fisheye(circle_deg: float) -> CameraModel:
    return CameraModel(
        240, 240, 72.0, 72.0, 119.5, 119.5, (0.01, -0.002, 0.0, 0.0, 0.0), "fisheye", math.radians(circle_deg) / 2
    )


def fisheye_picture(camera: CameraModel, nadir: Any) -> Any:
    """A bright disc of angular radius RHO about the nadir on black, its edge one pixel (0.8 deg) wide."""
    d = unproject(camera, pixel_grid(camera))
    off = np.arctan2(np.linalg.norm(np.cross(d, nadir), axis=-1), d @ nadir)
    grey = 1000.0 * np.clip(0.5 + (FISHEYE_RHO - off) * 72.0, 0.0, 1.0)
    return np.where(in_image_circle(camera), grey, 0.0)


@pytest.mark.parametrize("tilt_deg", [0.0, 40.0, 110.0])
def test_the_nadir_from_a_190_deg_fisheye(tilt_deg: float) -> None:
    """0.08 deg, a tenth of a pixel: the edge is linear in angle and not in the image, and there is no noise.

    At 110 deg the nadir is behind the camera, and so are limb points at the circle.
    """
    tilt = math.radians(tilt_deg)
    nadir = np.array([0.0, math.sin(tilt), math.cos(tilt)])
    camera = fisheye(190.0)
    found = find_limb(fisheye_picture(camera, nadir), camera, 1023.0)
    assert isinstance(found, LimbPoints)
    cone = fit_cone(found.los_cam)
    assert math.degrees(math.acos(min(1.0, float(cone.axis_cam @ nadir)))) < 0.08
    assert math.degrees(abs(cone.rho_rad - FISHEYE_RHO)) < 0.08


def test_the_edge_of_the_field_is_no_limb() -> None:
    """A lens of 120 deg that looks down sees ground alone: a bright disc with black around it, all of it its own."""
    camera = fisheye(120.0)
    found = find_limb(fisheye_picture(camera, np.array([0.0, 0.0, 1.0])), camera, 1023.0)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.NO_LIMB


def test_a_line_of_pixels_is_refused_as_an_image() -> None:
    camera = CameraModel(160, 1, 569.0, 569.0, 79.5, 0.0)
    found = find_limb(np.linspace(0.0, 100.0, 160)[None, :], camera)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT


SIDE = 240
BALL_CAMERA = CameraModel(SIDE, SIDE, 300.0, 300.0, 119.5, 119.5)
BALL_RHO = np.radians(31.0)
BALL_NADIR = np.array([np.sin(0.55) * 0.6, np.sin(0.55) * 0.8, np.cos(0.55)])
FINE = 14


def _sphere(sun: np.ndarray, flat: bool = False, texture: float = 0.0) -> np.ndarray:
    """Return a picture of a unit Lambert sphere, 800 under an overhead Sun; ``flat`` glows alike everywhere.

    ``texture``: of the albedo from place to place, over a tenth of the radius.
    """
    centre = BALL_NADIR / np.sin(BALL_RHO)
    power = float(centre @ centre)

    def radiance(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        d = np.stack(
            [(u - BALL_CAMERA.cx) / BALL_CAMERA.fx, (v - BALL_CAMERA.cy) / BALL_CAMERA.fy, np.ones_like(u)], axis=-1
        )
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
    found = find_limb(image, BALL_CAMERA)
    assert isinstance(found, LimbPoints)
    return (BALL_RHO - off_axis_angle(found.los_cam, BALL_NADIR)) * BALL_CAMERA.fx


SUNS = {
    "overhead": -BALL_NADIR,
    "to the side": -BALL_NADIR * np.cos(0.4) + np.sin(0.4) * np.cross(BALL_NADIR, [0.0, 0.0, 1.0]) / np.sin(0.55),
}


@pytest.fixture(scope="module")
def pictures() -> dict[str, np.ndarray]:
    return {name: _sphere(sun) for name, sun in SUNS.items()} | {"glow": _sphere(-BALL_NADIR, flat=True)}


@pytest.mark.parametrize("sun", SUNS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_shading_does_not_move_the_limb(pictures: dict[str, np.ndarray], sun: str, sign: float) -> None:
    """Lit and as a negative; a straight line in place of the root of the ground's brightness is 0.04 px off."""
    off = _positions(pictures[sun] if sign > 0 else 900.0 - pictures[sun])
    assert len(off) > 150
    assert np.abs(np.median(off)) < 0.05
    assert off.std() < 0.03


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_half_lit_textured_limb_has_points_where_it_is_lit(sign: float) -> None:
    """The Sun 10 deg behind the disc's plane. Night shows nothing at all: no shading of the day makes an edge of it."""
    beside = np.cross(BALL_NADIR, [0.0, 0.0, 1.0])
    sun = np.cos(np.radians(10.0)) * beside / np.linalg.norm(beside) + np.sin(np.radians(10.0)) * BALL_NADIR
    image = _sphere(sun, texture=0.8)
    found = find_limb(image if sign > 0 else 900.0 - image, BALL_CAMERA)
    assert isinstance(found, LimbPoints)
    across = found.los_cam - (found.los_cam @ BALL_NADIR)[:, None] * BALL_NADIR
    # where a line passes the limb, the ground's normal is nearly across it: half a pixel makes a third of a degree
    assert (across @ sun / np.linalg.norm(across, axis=1)).min() > 0.0
    off = (BALL_RHO - off_axis_angle(found.los_cam, BALL_NADIR)) * BALL_CAMERA.fx
    # every profile has a shading of its own, which a texture of 80 % at the limb moves by some tenths of a pixel
    assert abs(np.median(off)) < 0.1
    assert np.percentile(np.abs(off), 90.0) < 0.48
    assert len(off) > 50


def test_a_rough_nadir_decides_between_two_discs() -> None:
    """Without it the first whole limb is the answer; a direction to neither leaves the two in doubt."""
    camera = CameraModel(160, 120, 147.0, 147.0, 79.5, 59.5)
    left, right = (depth_px(camera, nadir_at(15.0, turn), 0.17) for turn in (-90.0, 90.0))
    image = picture(np.maximum(left, right))
    for nadir_cam, column in (([-0.3, 0.0, 1.0], 38.5), ([0.3, 0.0, 1.0], 120.5)):
        found = find_limb(image, camera, None, Prior(nadir_cam=nadir_cam, attitude_sigma_rad=[0.1, 0.1, 0.1]))
        assert isinstance(found, LimbPoints)
        assert found.uv[:, 0].mean() == pytest.approx(column, abs=2.0)
    doubted = find_limb(image, camera, None, Prior(nadir_cam=[0.0, 1.0, 0.0], attitude_sigma_rad=[0.1, 0.1, 0.1]))
    assert isinstance(doubted, Refusal)
    assert doubted.status is Outcome.AMBIGUOUS
