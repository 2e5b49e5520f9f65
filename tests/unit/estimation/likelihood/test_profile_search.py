"""The search of the profile's fit from drawn starts, and noise that a converter's floor cuts off."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.air import KnownAir, common_air
from horizonval.estimation.fit.bundle import ShotPrior
from horizonval.estimation.fit.image import LENS, POSE
from horizonval.estimation.fit.known_profile import start_pose
from horizonval.estimation.fit.noise import floor_of
from horizonval.estimation.fit.pose import LimbPose, nadir_derivative
from horizonval.estimation.fit.profile import CLOUD_TOP_M, ProfileImage, ProfileKnowledge, ProfileModel
from horizonval.estimation.fit.profile_fit import ProfileFit, fit_profiles
from horizonval.estimation.fit.templates import shipped_templates
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import WGS84

CAMERA = CameraModel(120, 96, 104.0, 104.0, 59.5, 47.5)
EPOCH = datetime(2026, 7, 16, 12, tzinfo=UTC)
TILT_SIGMA_RAD, POSITION_SIGMA_M, LIFT_SIGMA_M, GAIN_SIGMA = np.radians(2.0), 1e3, 300.0, 0.02
NOISE = 0.004
"""Of the brightest pixel."""
FAR = 4.0
"""Of an end that missed, in what it claims: of right ones 1 of 3 000 in two dimensions."""


def drawn(seed: int) -> tuple[FloatArray, ProfileKnowledge, LimbPose, LimbPose]:
    """Return an image of the limb from 500 km, what is known of it, where a fit starts, and the true pose."""
    rng = np.random.default_rng(seed)
    r = 6878e3 * np.array([np.cos(0.7), 0.0, np.sin(0.7)])
    nadir = -r / np.linalg.norm(r)
    along = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * nadir).apply([0.0, 1.0, 0.0])
    limb = np.cos(1.19) * nadir + np.sin(1.19) * along
    cam = np.array([np.cross(nadir, limb), np.cross(limb, np.cross(nadir, limb)), limb])
    cam[:2] /= np.linalg.norm(cam[:2], axis=1)[:, None]
    true = LimbPose(cam, r)
    table = shipped_templates("thermal", (8.0, 14.0))
    assert table is not None
    air = KnownAir(table, EPOCH, None, np.array([1.0, 0.0, 0.0]))
    away = np.concatenate([rng.normal(0.0, TILT_SIGMA_RAD, 3), rng.normal(0.0, POSITION_SIGMA_M, 3), [0.0]])
    sigmas = np.concatenate([[TILT_SIGMA_RAD] * 3, [POSITION_SIGMA_M] * 3, [LIFT_SIGMA_M]])
    mean = true.moved(away)
    known = ProfileKnowledge(WGS84, mean, np.diag(sigmas**-2.0), air, gain=100.0, gain_log_sigma=GAIN_SIGMA)
    model = ProfileModel(np.ones((CAMERA.height, CAMERA.width)), CAMERA, true, np.zeros(LENS), 0.6, known)
    lift = np.concatenate([np.zeros(POSE - 1), [rng.normal(0.0, LIFT_SIGMA_M)]])
    own = np.array([np.log(0.6), 0.5, np.log(known.gain) + rng.normal(0.0, GAIN_SIGMA), 0.0])
    common = common_air([model.air], [None])
    model.air, near = common.images[0], model.near
    look = model.look(true.moved(lift), np.zeros(LENS), own, rng.normal(size=common.count))
    shown = near.values - look.residuals
    image = np.where(darker_side(near.rows, shown), 0.0, shown.max())
    image[places(model)] = shown
    image += rng.normal(0.0, NOISE * shown.max(), image.shape)
    start = start_pose(image, CAMERA, known, TILT_SIGMA_RAD)
    return image, known, start, true


def places(model: ProfileModel) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of a model's pixels."""
    return model.near.rows.astype(int), model.near.columns.astype(int)


def fitted(image: FloatArray, known: ProfileKnowledge, start: LimbPose) -> ProfileFit:
    return fit_profiles([ProfileImage(image, CAMERA, known)], ShotPrior(known.mean, known.information), start)


def darker_side(rows: np.ndarray, shown: FloatArray) -> np.ndarray:
    """Return where an image with pixels at some rows is space, shape (H, W): the start looks at all of it."""
    earth_below = np.corrcoef(rows, shown)[0, 1] > 0.0
    all_rows = np.arange(CAMERA.height)[:, None] + np.zeros(CAMERA.width)
    return np.asarray((all_rows < np.median(rows)) == earth_below)


def sigmas_off(found: ProfileFit, true: LimbPose) -> float:
    """Return how far off the nadir is, in what is claimed along its error."""
    by = nadir_derivative(found.pose)
    plane = np.linalg.svd(true.nadir_cam[None])[2][1:]
    error = plane @ (found.pose.nadir_cam - true.nadir_cam)
    covariance = plane @ by @ found.covariance @ by.T @ plane.T
    return float(np.sqrt(error @ np.linalg.solve(covariance, error)))


def test_a_search_ends_at_the_limb() -> None:
    """Of 76 draws the four that were missed by 4.3 to 7.4 of the claim while the lens was free all the way."""
    off = []
    for seed in (2, 28, 52, 71):
        image, known, start, true = drawn(seed)
        off.append(sigmas_off(fitted(image, known, start), true))
    assert max(off) < FAR


@pytest.mark.slow
def test_searches_are_off_by_what_they_claim() -> None:
    """Squares of 76 draws in two axes: their mean has a standard error of 0.11."""
    off = []
    for seed in range(76):
        image, known, start, true = drawn(seed)
        off.append(sigmas_off(fitted(image, known, start), true))
    assert max(off) < FAR
    assert 0.7 < float(np.mean(np.square(off))) / 2.0 < 1.3


def test_clear_air_above_clouds_counts_in_full() -> None:
    """Blocks of 12 px are brighter or darker below 16 km; through lens and pixel they reach a pixel higher."""
    image, known, start, true = drawn(3)
    found = fitted(image, known, start)
    model, rng = found.models[0], np.random.default_rng(5)
    blocks = rng.normal(0.0, 0.08, CAMERA.width // 12)[places(model)[1] // 12]
    cloudy = image.copy()
    share = norm.cdf((CLOUD_TOP_M - model.near.height_m) / (0.66 * model.width_m))
    cloudy[places(model)] += blocks * share * image.max()
    clouds = fitted(cloudy, known, start)
    height_m, width_m = clouds.models[0].near.height_m, clouds.models[0].width_m
    wider = np.broadcast_to(clouds.noises[0].together, height_m.shape)
    assert np.median(wider[height_m < 10e3]) > 3.0
    assert np.median(wider[height_m > CLOUD_TOP_M + 2.0 * width_m.max()]) < 1.3
    assert sigmas_off(clouds, true) < FAR


def cut(rng: np.random.Generator, level: float, sigma: float, n: int, lowest: int = 0) -> np.ndarray:
    return np.maximum(np.floor(rng.normal(level, sigma, n) + 0.5), lowest)


@pytest.mark.parametrize(
    ("level", "sigma", "lowest"), [(0.0, 13.0, 0), (6.0, 8.0, 0), (-4.0, 20.0, 0), (30.0, 5.0, 27)]
)
def test_the_noise_is_found_from_what_is_left_of_it(level: float, sigma: float, lowest: int) -> None:
    rng = np.random.default_rng(4)
    found = floor_of(cut(rng, level, sigma, 20_000, lowest), float(lowest))
    assert found is not None
    # 20 000 draws tell a share to 0.7 %, and the noise to 2 %
    assert found.sigma == pytest.approx(sigma, rel=0.03)
    assert found.background == pytest.approx(level, abs=0.03 * sigma)
    for shown in (level - 0.5 * sigma, level, level + sigma, level + 4.0 * sigma):
        expected, slope = found.expected(np.array([shown]))
        assert expected[0] == pytest.approx(cut(rng, shown, sigma, 200_000, lowest).mean(), abs=0.03 * sigma)
        step = 0.1 * sigma
        ends = [found.expected(np.array([shown + d]))[0][0] for d in (-step, step)]
        assert slope[0] == pytest.approx((ends[1] - ends[0]) / (2.0 * step), abs=1e-3)


def test_without_a_floor_there_is_none() -> None:
    rng = np.random.default_rng(5)
    free = np.floor(rng.normal(200.0, 8.0, 5000) + 0.5)
    assert floor_of(free, float(free.min())) is None
    assert floor_of(np.zeros(5000), 0.0) is None
    assert floor_of(cut(rng, 0.0, 8.0, 20), 0.0) is None
