"""A camera's errors found from the limbs of a pass: synthetic limbs, of a known camera and honest platforms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Silent
from horizonval.earth.limb_heights import reliefs
from horizonval.estimation.fit import edge_pixels
from horizonval.estimation.fit.calibrate import CameraCalibration, calibrate, edges_of
from horizonval.estimation.fit.edge import EdgeModel
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX, relief_modes
from horizonval.estimation.fit.light import edge_profile
from horizonval.estimation.fit.pixels import Limb
from horizonval.estimation.lens_error import miscalibrated
from horizonval.estimation.methods import limb_ellipsoid
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import compose
from horizonval.geometry.rotation import tangent_basis

CAMERA = CameraModel(width=320, height=320, fx=240.0, fy=240.0, cx=160.3, cy=158.8)
MOUNT = Rotation.from_euler("x", -65.0, degrees=True)
"""``cam_from_body``: the boresight 65 deg off the nadir."""
HEIGHT_M, SCALE_M, BLUR_PX, NOISE = 20e3, 6e3, 0.7, 3.0
ATTITUDE_SIGMA_DEG, POSITION_SIGMA_M = 0.005, 100.0
TURNS_DEG = (-28.0, -14.0, 0.0, 14.0, 28.0)
"""Of the body: they carry the limb across the image."""


def limb_image(
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    random: np.random.Generator,
    uneven_m: float = 0.0,
    camera: CameraModel = CAMERA,
) -> FloatArray:
    """Return what the camera sees of a soft limb, with noise, shape (H, W).

    Of one height; or uneven as the fit's priors have it: from frame to frame by ``uneven_m``, misplaced in its pixels,
    and along the limb by the relief that a limb of an unknown band may have.
    """
    axes = WGS84.axes_m + HEIGHT_M
    grid = pixel_grid(camera).reshape(-1, 2)
    los = [unproject(camera, grid + step).T for step in ([0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5])]
    across = [Limb(cam_from_itrs, r_itrs, axes).seen(np.ascontiguousarray(one))[1] for one in los]
    width, inside = np.hypot(across[1] - across[2], across[3] - across[4]), -across[0]
    if uneven_m:
        first, second = tangent_basis(-cam_from_itrs @ r_itrs / np.linalg.norm(r_itrs)).T @ los[0]
        rho = float(np.arcsin(axes[0] / np.linalg.norm(r_itrs)))
        nodes, modes = relief_modes(2.0 * np.pi, reliefs(None), 0.0, rho)
        height = uneven_m * random.standard_normal() + random.standard_normal(len(modes)) @ modes
        lift = np.interp(np.mod(np.arctan2(second, first), 2.0 * np.pi), nodes, height)
        inside = inside + lift + MISPLACED_PX * random.standard_normal() * width
    level = edge_profile(inside / width, float(np.hypot(BLUR_PX, 12**-0.5)), SCALE_M / width).level
    return (100.0 + 800.0 * level + NOISE * random.standard_normal(len(level))).reshape(camera.height, camera.width)


def body_of(number: int, frames: int, turns_deg: tuple[float, ...]) -> tuple[FloatArray, Rotation]:
    """Return the position (3,) and ``body_from_itrs`` of one of the frames of an orbit."""
    u = 2.0 * np.pi * number / frames
    r = 6.92e6 * np.array([np.cos(u), 0.3 * np.sin(u), np.sin(u) * 0.91**0.5])
    ahead = np.array([-np.sin(u), 0.3 * np.cos(u), np.cos(u) * 0.91**0.5])
    down = -r / np.linalg.norm(r)
    level = Rotation.from_matrix(np.stack([ahead, np.cross(down, ahead), down]))
    angles = [turns_deg[number % len(turns_deg)], 3.0 * (number % 3 - 1), 20.0 * (number % 2)]
    return r, Rotation.from_euler("xyz", angles, degrees=True) * level


def a_pass(
    frames: int,
    seed: int,
    turns_deg: tuple[float, ...] = TURNS_DEG,
    height_sigma_m: float = 300.0,
    *,
    uneven: bool = False,
    camera: CameraModel = CAMERA,
) -> list[Observation]:
    """Return what an honest platform says of the frames of an orbit, the camera and its mounting right."""
    random = np.random.default_rng(seed)
    height = HEIGHT_M + height_sigma_m * random.standard_normal()
    made = []
    for number in range(frames):
        r, body = body_of(number, frames, turns_deg)
        image = limb_image((MOUNT * body).as_matrix(), r, random, height_sigma_m if uneven else 0.0, camera)
        error = np.radians(ATTITUDE_SIGMA_DEG) * random.standard_normal(3)
        believed = MOUNT * Rotation.from_rotvec(error) * body
        prior = Prior(
            shape="wgs84",
            r_itrs=r + POSITION_SIGMA_M * random.standard_normal(3),
            position_sigma_m=POSITION_SIGMA_M,
            q_cam_from_itrs=believed.as_quat(),
            attitude_sigma_rad=np.full(3, np.radians(ATTITUDE_SIGMA_DEG)),
            limb_height_m=height,
            limb_height_sigma_m=height_sigma_m,
        )
        made.append(Observation(image=image, camera=camera, q_cam_from_body=MOUNT.as_quat(), prior=prior))
    return made


def a_pass_and_levels(frames: int, seed: int) -> tuple[list[Observation], list[FloatArray]]:
    """Return a pass of uneven limbs, and the true nadir of its frames in camera axes, (3,) each."""
    made = a_pass(frames, seed, uneven=True)
    nadirs = []
    for number in range(frames):
        r, body = body_of(number, frames, TURNS_DEG)
        nadirs.append((MOUNT * body).apply(-r / np.linalg.norm(r)))
    return made, nadirs


def misled(
    frames: list[Observation], focal: float, point_px: tuple[float, float], turn_rad: FloatArray
) -> list[Observation]:
    """Return the same frames told with a wrong camera, whose mounting is off by a turn in camera axes."""
    turn = Rotation.from_rotvec(-turn_rad).as_quat()
    camera = miscalibrated(frames[0].camera, focal, point_px)
    told = []
    for one in frames:
        prior = replace(one.prior, q_cam_from_itrs=compose(turn, one.prior.q_cam_from_itrs))
        told.append(replace(one, camera=camera, q_cam_from_body=compose(turn, one.q_cam_from_body), prior=prior))
    return told


def errors_of(found: CameraCalibration, camera: CameraModel = CAMERA) -> FloatArray:
    """Return found less true: ln f, principal point, distortion, turn of the camera, shape (7,)."""
    turn = Rotation.from_quat(found.q_cam_from_body) * MOUNT.inv()
    point = [found.camera.cx - camera.cx, found.camera.cy - camera.cy]
    bend = found.camera.distortion[0] - camera.distortion[0]
    return np.array([np.log(found.camera.fx / camera.fx), *point, bend, *turn.as_rotvec()])


WRONG = (0.01, (1.5, -2.0), np.radians([0.1, -0.2, 0.15]))
"""A percent of the focal length, two pixels, and a quarter of a degree."""
USED = [0, 1, 2, 4, 5, 6]
"""Of the camera's errors, those that are not held: all but the distortion."""


def nees_of(found: CameraCalibration) -> float:
    error = errors_of(found)[USED]
    return float(error @ np.linalg.solve(found.covariance[np.ix_(USED, USED)], error)) / len(USED)


@pytest.mark.slow
def test_a_percent_of_the_focal_length_is_found() -> None:
    """20 frames claim 0.03 %; all six unknowns within 3.3 of what is claimed (a chance in a thousand of each)."""
    found = calibrate(misled(a_pass(20, 1), *WRONG))
    assert isinstance(found, CameraCalibration), found
    assert found.sigma[0] < 3.5e-4
    assert found.not_determined == ()
    assert found.frames == 20
    assert np.abs(errors_of(found)[USED] / found.sigma[USED]).max() < 3.3
    assert found.change[0] == pytest.approx(-0.01, abs=2e-3)


@pytest.mark.slow
def test_limbs_of_many_pixels_depth_determine_the_camera() -> None:
    """A scale height is four pixels deep."""
    fine = CameraModel(width=512, height=510, fx=960.0, fy=960.0, cx=257.3, cy=252.6)
    frames = a_pass(10, 6, turns_deg=(-6.0, -3.0, 0.0, 3.0, 6.0), camera=fine)
    found = calibrate(misled(frames, *WRONG))
    assert isinstance(found, CameraCalibration), found
    assert found.sigma[0] < WRONG[0] / 4.0
    assert np.abs(errors_of(found, fine)[USED] / found.sigma[USED]).max() < 3.3
    assert (found.camera.width, found.camera.height) == (512, 510)


@pytest.mark.slow
def test_over_an_orbit_of_48_frames_it_is_found_to_two_hundredths_of_a_percent() -> None:
    found = calibrate(misled(a_pass(48, 2), *WRONG))
    assert isinstance(found, CameraCalibration), found
    assert found.sigma[0] < 2.2e-4
    assert abs(errors_of(found)[0]) < 3.3 * found.sigma[0]


@pytest.mark.slow
def test_the_covariance_is_honest_over_draws() -> None:
    """Chi-squared of 6 over 6, the mean of 16: 1 with a standard deviation of 0.14. Limbs as uneven as priors say."""
    found = [calibrate(misled(a_pass(10, 100 + seed, uneven=True), *WRONG)) for seed in range(16)]
    mean = np.mean([nees_of(one) for one in found if isinstance(one, CameraCalibration)])
    assert all(isinstance(one, CameraCalibration) for one in found)
    assert 0.5 < mean < 2.0


@pytest.mark.slow
def test_a_fit_told_its_cameras_errors_claims_what_they_do_to_it() -> None:
    """Errors of 0.3 % and half a pixel, drawn for every frame: chi-squared of 2 over 2, the mean of 24 (0.2 by chance).

    Without being told it is 20 and more.
    """
    random = np.random.default_rng(12)
    said = Calibration(focal_length_sigma=3e-3, principal_point_sigma_px=0.5)
    told, silent = [], []
    for one, level in zip(*a_pass_and_levels(24, 11), strict=True):
        focal, u, v = random.standard_normal(3) * [3e-3, 0.5, 0.5]
        prior = replace(one.prior, attitude_sigma_rad=np.full(3, np.radians(2.0)))
        camera = miscalibrated(one.camera, focal, (u, v))
        for calibration, found in ((said, told), (None, silent)):
            fit = limb_ellipsoid.ESTIMATOR.run(replace(one, camera=camera, prior=prior, calibration=calibration))
            assert isinstance(fit, Fit)
            basis = tangent_basis(level)
            error = basis.T @ fit.nadir_cam
            found.append(0.5 * error @ np.linalg.solve(basis.T @ fit.total_covariance_nadir_cam @ basis, error))
    assert 0.4 < np.mean(told) < 2.0
    assert np.mean(silent) > 5.0


@pytest.mark.slow
def test_where_the_camera_starts_changes_nothing() -> None:
    """The same frames told rightly and wrongly lead to one camera, to half of what is claimed, and to the true one.

    All six unknowns are within 3.3 of what is claimed: a chance in a thousand of each.
    """
    frames = a_pass(8, 3)
    right, wrong = calibrate(frames), calibrate(misled(frames, *WRONG))
    assert isinstance(right, CameraCalibration)
    assert isinstance(wrong, CameraCalibration)
    assert np.abs((errors_of(right) - errors_of(wrong))[USED] / right.sigma[USED]).max() < 0.5
    assert np.abs(errors_of(wrong)[USED] / wrong.sigma[USED]).max() < 3.3
    assert wrong.sigma[0] < 1e-3
    assert wrong.not_determined == ()
    assert wrong.change[0] == pytest.approx(-0.01, abs=3e-3)


def test_a_limb_that_keeps_its_place_determines_no_focal_length_that_is_known_well() -> None:
    """A narrow field at one attitude, its limbs' height open: told to 0.1 %, the limbs say nothing more."""
    said = Calibration(focal_length_sigma=1e-3)
    frames = [replace(one, calibration=said) for one in a_pass(4, 4, turns_deg=(0.0,), height_sigma_m=2e3)]
    refused = calibrate(frames)
    assert isinstance(refused, Refusal)
    assert refused.status is Outcome.AMBIGUOUS
    assert "focal length is not observable" in refused.reason


def test_what_cannot_be_calibrated_is_refused() -> None:
    frames = a_pass(2, 5)
    assert calibrate([]).status is Outcome.BAD_INPUT  # type: ignore[union-attr]
    other = replace(frames[1], camera=replace(CAMERA, fx=250.0))
    assert "another camera" in str(calibrate([frames[0], other]))
    assert "position" in str(calibrate([replace(one, prior=Prior()) for one in frames]))
    dark = [replace(one, image=np.zeros_like(one.image)) for one in frames]
    assert "images with a limb" in str(calibrate(dark))


@pytest.mark.parametrize("step", [[1e-3, 0.0, 0.0, 0.0], [0.0, 0.2, 0.0, 0.0], [0.0, 0.0, -0.2, 0.0]])
def test_a_changed_lens_moves_the_edge_as_pixels_chosen_with_it_see_it(
    step: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To a hundredth of the motion, where the edge is: a lens's scale stretches distances from the edge a little."""
    monkeypatch.setattr(edge_pixels, "MOST_PIXELS", 10**6)
    gathered = edges_of(a_pass(2, 3), Silent())
    assert not isinstance(gathered, Refusal)
    shot, lens = gathered[0].shots[0], np.array(step)
    seen = []
    for chosen_with in (np.zeros(4), lens):
        model = shot._chooser(shot.state, chosen_with, 10**6, 1.0, None).models[0]
        assert isinstance(model, EdgeModel)
        looks = [
            model.look(shot.state.pose, one, shot.state.own[0], shot.state.air, None) for one in (0.0 * lens, lens)
        ]
        places = zip(model.pixels.columns, model.pixels.rows, strict=True)
        seen.append({place: (looks[0].seen.x[k], looks[1].seen.x[k]) for k, place in enumerate(places)})
    both = list(seen[0].keys() & seen[1].keys())
    before, linear = np.array([seen[0][place] for place in both]).T
    exact = np.array([seen[1][place][1] for place in both])
    assert len(both) > 100
    motion = float(np.abs(exact - before).max())
    assert np.abs(linear - exact)[np.abs(exact) < 1.0].max() < 1e-2 * motion
