"""The search by likelihood: what a level shows of a limb, what is left out, and views that a search of edges lost.

The pictures are formulas of the angle from the nadir, so that they are exact for any size of pixel.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.guard.three_tests import in_wider_pixels
from horizonval.estimation.limb.evidence import allowed_widths, weigh
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.estimation.limb.pyramid import known_pixels, levels_of, trace_limb
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
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


def test_a_limb_is_more_probable_where_it_is_than_beside_it() -> None:
    level = levels_of(Picture(picture(depth_px(CAMERA, NADIR, RHO))), CAMERA)[0]
    there = weigh(level, CAMERA, NADIR, RHO)
    assert there is not None
    assert there.bright_inside
    assert there.explained == 1.0
    assert there.step == pytest.approx(np.full(len(there.step), 460.0), rel=0.05)
    beside = weigh(level, CAMERA, NADIR, RHO + 8.0 / CAMERA.fx)
    assert beside is not None
    assert beside.explained == 0.0
    assert weigh(level, CAMERA, -NADIR, RHO) is None, "nothing of it in view"


def test_noise_shows_no_limb_and_a_ramp_neither() -> None:
    grain = np.random.default_rng(2).normal(100.0, 5.0, (180, 240))
    ramp = np.rint(2.0 * np.maximum(depth_px(CAMERA, NADIR, RHO), 0.0) + grain)
    for image in (grain, ramp):
        evidence = weigh(levels_of(Picture(image), CAMERA)[0], CAMERA, NADIR, RHO)
        assert evidence is not None
        assert evidence.explained < 0.1
        assert isinstance(find_limb(image, CAMERA), Refusal)


def test_an_edge_is_wide_only_where_air_may_be() -> None:
    """From 500 km a pixel of 0.3 deg is 14 km of limb; from the geostationary ring 220 km."""
    near = trace_limb(CAMERA, NADIR, RHO, 1.0, 200)
    assert allowed_widths(near, RHO, 1.0)[-1] == 1.6
    fine = CameraModel(240, 180, 2000.0, 2000.0, 119.5, 89.5)
    assert allowed_widths(trace_limb(fine, NADIR, RHO, 1.0, 200), RHO, 1.0)[-1] == 3.2
    far = math.asin(6371.0 / 42164.0)
    assert allowed_widths(trace_limb(CAMERA, nadir_at(5.0), far, 1.0, 200), far, 8.0)[-1] == 0.8


def test_a_trace_runs_along_the_limb_and_its_normals_across() -> None:
    trace = trace_limb(CAMERA, NADIR, RHO, 2.0, 400)
    angle = off_axis_angle(unproject(CAMERA, trace.uv), NADIR)
    assert angle == pytest.approx(np.full(len(angle), RHO), abs=1e-9)
    inner = off_axis_angle(unproject(CAMERA, trace.uv + 0.01 * trace.inwards), NADIR)
    # The steepest way inwards: a step of a hundredth of a pixel falls by as much as the pixel's angle says.
    assert (RHO - inner) / 0.01 == pytest.approx(trace.px_rad, rel=1e-2)
    step = np.hypot(*np.diff(trace.uv, axis=0).T)
    assert step == pytest.approx(np.full(len(step), trace.spacing), rel=0.05)


def test_lost_lines_and_blocks_are_known_and_a_black_sky_is_not_lost() -> None:
    image = picture(depth_px(CAMERA, NADIR, RHO), dark=30.0)
    assert known_pixels(Picture(image), CAMERA) is None
    image[100] = image[:, 77] = 0.0
    image[120:150, 20:60] = 0.0
    known = known_pixels(Picture(image), CAMERA)
    assert known is not None
    assert not known[100].any()
    assert not known[120:150, 20:60].any()
    assert known.mean() > 0.9
    black = np.maximum(picture(depth_px(CAMERA, NADIR, RHO), dark=0.0, noise=0.0), 0.0)
    sky = known_pixels(Picture(black), CAMERA)
    assert sky is None or sky[:3].all(), "rows of space at the rim have one value too"


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
