"""The guard of several heads on drawn rows and pictures: what it must refuse, let through, and claim.

A limb is an error function of the angle to the nadir, so that sampling at the pixels' centres is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.methods import linear_heads, video_vertical
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.geometry.rotation import off_axis_angle
from horizonval.scoring.errors import is_false

DARK, BRIGHT, FULL = 40.0, 1600.0, 4095.0
RADIUS_M = 6371008.8
SPHERE = Prior(shape="sphere", radius_m=RADIUS_M)
RHO = math.asin(RADIUS_M / (RADIUS_M + 400e3))

ROW = CameraModel(160, 1, 573.0, 573.0, 79.5, 0.0, projection="equal_angle")
"""160 pixels of 0.1 deg."""
ROW_NAMES = ("north", "east", "south", "west")
ROWS = guarded(linear_heads.ESTIMATOR)
ROWS_PUBLISHED = guarded(linear_heads.PUBLISHED)

PICTURE = CameraModel(160, 160, 140.0, 140.0, 79.5, 79.5)
PAIR = guarded(video_vertical.ESTIMATOR)
TURNS = {"a": Rotation.identity(), "b": Rotation.from_euler("y", -90, degrees=True)}
PAIR_NADIR = np.array([0.62, 0.5, 0.62]) / np.linalg.norm([0.62, 0.5, 0.62])


def level(camera: CameraModel, nadir_cam: np.ndarray, width_px: float, off_rad: float = 0.0) -> np.ndarray:
    los = unproject(camera, pixel_grid(camera))
    return DARK + (BRIGHT - DARK) * ndtr((RHO + off_rad - off_axis_angle(los, nadir_cam)) * camera.fx / width_px)


def four(
    roll_deg: float = 0.0,
    pitch_deg: float = 0.0,
    *,
    seed: int = 0,
    noise: float = 12.0,
    off_deg: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    change: Callable[[np.ndarray], np.ndarray] | None = None,
    **known,
) -> Observation:
    """Return four rows a quarter turn apart, 70.22 deg off the nadir; ``change``: what to do to the second row."""
    rng = np.random.default_rng(seed)
    nadir = nadir_of_roll_pitch(math.radians(roll_deg), math.radians(pitch_deg))
    values = {"full_scale": FULL, "prior": SPHERE, "band_kind": "thermal"} | known
    heads = {}
    for i, name in enumerate(ROW_NAMES):
        # Columns run from the nadir outwards: x of the head is the meridian away from it.
        turn = Rotation.from_euler("ZY", [45.0 + 90.0 * i, 70.22], degrees=True).inv()
        row = level(ROW, turn.apply(nadir), 2.0, math.radians(off_deg[i]))
        if change is not None and i == 1:
            row = change(row)
        row = np.clip(np.rint(row + rng.normal(0.0, noise, row.shape)), 0.0, FULL)
        heads[name] = Observation(image=row, camera=ROW, q_cam_from_body=turn.as_quat(), **values)
    return replace(heads[ROW_NAMES[0]], heads=heads)


def two(nadir_body: np.ndarray = PAIR_NADIR, seed: int = 0, noise: float = 20.0, **changes: np.ndarray) -> Observation:
    rng = np.random.default_rng(seed)
    heads = {}
    for name, turn in TURNS.items():
        image = changes.get(name)
        if image is None:
            image = level(PICTURE, turn.apply(nadir_body), 0.8)
        image = np.clip(image + rng.normal(0.0, noise, image.shape), 0.0, FULL)
        heads[name] = Observation(
            image=image,
            camera=PICTURE,
            q_cam_from_body=turn.as_quat(),
            full_scale=FULL,
            prior=SPHERE,
            band_kind="solar",
        )
    return replace(heads["a"], heads=heads)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(math.atan2(np.linalg.norm(np.cross(a, b)), a @ b))


def first_nadir(observation: Observation, nadir_body: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(observation.q_cam_from_body).apply(nadir_body)


def normalised(fit: Fit, nadir_cam: np.ndarray) -> float:
    basis = np.linalg.svd(fit.nadir_cam[None, :])[2][1:].T
    off = basis.T @ (nadir_cam - fit.nadir_cam)
    return float(off @ np.linalg.solve(basis.T @ fit.covariance_nadir_cam @ basis, off))


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (3.0, -4.0), (-4.5, -1.0)])
def test_four_good_rows_are_answered(roll: float, pitch: float) -> None:
    """Noise of 0.8 % of the step: 0.02 px, 0.002 deg. The published one has four roundings and its formula: 0.1 deg."""
    seen = four(roll, pitch)
    nadir = first_nadir(seen, nadir_of_roll_pitch(math.radians(roll), math.radians(pitch)))
    for estimator, limit in ((ROWS, 0.01), (ROWS_PUBLISHED, 0.1)):
        fit = estimator.run(seen)
        assert isinstance(fit, Fit), fit.reason
        assert angle_deg(fit.nadir_cam, nadir) < limit
        assert fit.systematic_nadir_cam is not None
        # 0.85 km of relief seen at 0.025 deg per km, two of four crossings to a component
        assert math.degrees(math.sqrt(np.trace(fit.systematic_nadir_cam))) == pytest.approx(0.022, abs=0.006)


def test_the_bare_method_is_left_alone() -> None:
    fit, bare = ROWS.run(four(2.0, 1.0)), linear_heads.ESTIMATOR.run(four(2.0, 1.0))
    assert isinstance(fit, Fit)
    assert isinstance(bare, Fit)
    assert bare.systematic_nadir_cam is None
    assert (fit.nadir_cam == bare.nadir_cam).all()
    assert (fit.covariance_nadir_cam == bare.covariance_nadir_cam).all()


def with_disc(row: np.ndarray, peak: float = 4 * FULL) -> np.ndarray:
    """A disc of five pixels before space."""
    return np.where(np.abs(np.arange(160) - 130.0) < 2.6, peak, row)


def with_gap(row: np.ndarray) -> np.ndarray:
    return row * (1.0 - 0.52 * np.exp(-0.5 * ((np.arange(160) - 30.0) / 4.0) ** 2))


def upside_down(row: np.ndarray) -> np.ndarray:
    return BRIGHT + DARK - row


def test_a_sun_in_a_row_is_refused() -> None:
    result = ROWS.run(four(change=with_disc))
    assert isinstance(result, Refusal)
    assert result.status is Outcome.SUN_GLARE
    assert result.reason.startswith("head east")


@pytest.mark.parametrize(
    ("change", "status"),
    [
        (lambda row: with_disc(row, 0.4 * BRIGHT), Outcome.AMBIGUOUS),
        (with_gap, Outcome.AMBIGUOUS),
        (upside_down, Outcome.NO_LIMB),
    ],
    ids=["faint disc", "gap", "bright side in space"],
)
def test_rows_that_the_bare_method_takes_for_limbs_are_refused(change, status: Outcome) -> None:
    seen = four(change=change)
    assert isinstance(linear_heads.ESTIMATOR.run(seen), Fit)
    for estimator in (ROWS, ROWS_PUBLISHED):
        result = estimator.run(seen)
        assert isinstance(result, Refusal)
        assert result.status is status
        assert "head east" in result.reason


def test_a_saturated_earth_is_refused() -> None:
    result = ROWS.run(four(change=lambda row: 3.0 * row))
    assert isinstance(result, Refusal)
    assert result.status is Outcome.SATURATED


def test_an_offset_crossing_is_refused_unless_an_ellipsoid_would_have_it() -> None:
    """Half a degree, 20 km of height: nobody's relief. Pairs of opposite crossings may lie 0.06 deg apart over an
    ellipsoid, as much as its radius changes within 20 deg of the equator, and 0.1 deg by five times the relief; all
    four moved alike are another altitude."""
    for estimator in (ROWS, ROWS_PUBLISHED):
        result = estimator.run(four(off_deg=(0.0, 0.5, 0.0, 0.0)))
        assert isinstance(result, Refusal)
        assert result.status is Outcome.AMBIGUOUS
        assert isinstance(estimator.run(four(off_deg=(0.15, 0.0, 0.15, 0.0))), Refusal)
        oblate = estimator.run(four(off_deg=(0.15, 0.0, 0.15, 0.0), prior=Prior()))
        assert isinstance(oblate, Fit), oblate.reason
        assert isinstance(estimator.run(four(off_deg=(0.5, 0.5, 0.5, 0.5))), Fit)


def test_a_known_altitude_that_does_not_fit_is_refused() -> None:
    assert isinstance(ROWS.run(four(prior=replace(SPHERE, altitude_m=400e3, altitude_sigma_m=1e3))), Fit)
    result = ROWS.run(four(prior=replace(SPHERE, altitude_m=500e3, altitude_sigma_m=1e3)))
    assert isinstance(result, Refusal)
    assert result.status is Outcome.AMBIGUOUS
    assert "altitude" in result.reason


def test_noise_of_rows_has_an_honest_covariance() -> None:
    """Mean normalised error squared of 2 degrees of freedom over 40 draws: 2 +- 0.32."""
    found = []
    for seed in range(40):
        seen = four(1.0, -2.0, seed=seed, noise=60.0)
        fit = ROWS.run(seen)
        assert isinstance(fit, Fit), fit.reason
        nadir = nadir_of_roll_pitch(math.radians(1.0), math.radians(-2.0))
        found.append(normalised(fit, first_nadir(seen, nadir)))
    assert 1.0 < np.mean(found) < 3.0


def test_a_good_pair_is_answered_with_points_below_the_pixel() -> None:
    fit, bare = PAIR.run(two()), video_vertical.ESTIMATOR.run(two())
    assert isinstance(fit, Fit), fit.reason
    assert isinstance(bare, Fit)
    # A pixel is 0.4 deg. Ends of eight points, each of 0.05 px, a radian apart.
    assert angle_deg(fit.nadir_cam, PAIR_NADIR) < 0.03
    assert bare.systematic_nadir_cam is None
    assert fit.systematic_nadir_cam is not None
    assert np.trace(fit.covariance_nadir_cam) < np.trace(bare.covariance_nadir_cam)


@pytest.mark.parametrize("turn_deg", [0.0, 90.0, 180.0, 270.0])
def test_a_terminator_in_one_head_is_refused_or_the_answer_is_right(turn_deg: float) -> None:
    """Night beyond a straight line through the picture, at four angles; a claim must not be one that scoring calls
    false."""
    image = level(PICTURE, TURNS["b"].apply(PAIR_NADIR), 0.8)
    u, v = np.meshgrid(np.arange(160) - 79.5, np.arange(160) - 79.5)
    turn = math.radians(turn_deg + 20.0)
    day = ndtr((u * math.cos(turn) + v * math.sin(turn)) / 6.0)
    result = PAIR.run(two(b=DARK + (image - DARK) * day))
    if isinstance(result, Fit):
        total = normalised(replace(result, covariance_nadir_cam=result.total_covariance_nadir_cam), PAIR_NADIR)
        assert not is_false(math.radians(angle_deg(result.nadir_cam, PAIR_NADIR)), total)


def test_heads_with_limbs_of_two_planets_are_refused() -> None:
    other = Rotation.from_rotvec(np.radians([0.0, 0.0, 12.0])).apply(PAIR_NADIR)
    seen = two(b=level(PICTURE, TURNS["b"].apply(other), 0.8))
    assert isinstance(video_vertical.ESTIMATOR.run(seen), Fit)
    result = PAIR.run(seen)
    assert isinstance(result, Refusal)
    assert result.status is Outcome.AMBIGUOUS
