"""Four linear heads: the published formula and its axes, the exact cone, covariance, refusals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.methods.guarded import LINEAR_HEADS_PUBLISHED
from horizonval.estimation.methods.linear_heads import (
    ESTIMATOR,
    PUBLISHED,
    fit_crossings,
    head_rows,
    published_angles,
)
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.frames import cam_from_body, compose, nadir_of_roll_pitch, roll_pitch_of_nadir
from horizonval.geometry.horizon import horizon_columns
from horizonval.geometry.pose import pose_from_spec
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec

RADIUS_KM = 6378.137
SPEC = load_camera("ir-linear-160-four-heads")
CAMERA = camera_from_spec(SPEC.camera)
NAMES = [head.name for head in SPEC.head]


def crossings(roll_deg: float, pitch_deg: float, *, altitude_km: float = 400.0, mount_yaw_deg: float = 90.0):
    """Return the exact columns of all heads, shape (4,), and the heads' mountings: geometry's own, no estimator."""
    columns, mounts = [], []
    for name in NAMES:
        scene = SceneSpec.model_validate(
            {
                "camera": {"file": "x", "head": name, "mount_yaw_deg": mount_yaw_deg},
                "platform": {"altitude_km": altitude_km, "latitude_deg": 12.0, "heading_deg": 187.0},
                "attitude": {"roll_deg": roll_deg, "pitch_deg": pitch_deg},
                "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
            }
        )
        pose = pose_from_spec(scene, SPEC)
        found = horizon_columns(CAMERA, pose.q_cam_from_itrs, pose.r_itrs, [0.0], sphere(RADIUS_KM * 1e3))
        columns.append(float(found[0, 0]))
        mounts.append(pose.q_cam_from_body)
    return np.array(columns), mounts


def observation(columns: np.ndarray, mounts: list, noise: np.random.Generator | None = None) -> Observation:
    """Return rows of a hard limb of 1600 at the columns, in digital numbers of a noise of 15 where there is one."""
    heads = {}
    for name, column, q in zip(NAMES, columns, mounts, strict=True):
        row = 100.0 + 1600.0 * np.clip(column - (np.arange(160.0) - 0.5), 0.0, 1.0)
        if noise is not None:
            row = np.round(row + noise.normal(0.0, 15.0, 160))
        heads[name] = Observation(
            image=row[None, :], camera=CAMERA, q_cam_from_body=q, prior=Prior(shape="sphere", radius_m=RADIUS_KM * 1e3)
        )
    return replace(heads[NAMES[0]], heads=heads)


@pytest.mark.parametrize(
    ("sums", "printed"),
    [((28, 28), (0.9899, 0.9899)), ((-141, 141), (-4.9851, 4.9851)), ((-58, 57), (-2.0506, 2.0153))],
)
def test_formula_gives_the_printed_figures(sums: tuple[int, int], printed: tuple[float, float]) -> None:
    """Whole pixels through the formula are the publication's figures, to their last digit."""
    p, r = sums
    # A + B - C - D = p and A + D - B - C = r, with C = D = 0 or the nearest to it.
    columns = np.array([(p + r) / 2.0, (p - r) / 2.0, 0.0, 0.0])
    pitch, roll = published_angles(columns, math.radians(0.1))
    assert math.degrees(pitch) == pytest.approx(printed[0], abs=5.1e-5)
    assert math.degrees(roll) == pytest.approx(printed[1], abs=5.1e-5)


@pytest.mark.parametrize(("roll", "pitch"), [(0.01, 0.0), (0.0, -0.01), (-0.007, 0.004)])
def test_formula_has_the_signs_of_the_body(roll: float, pitch: float) -> None:
    """For 0.01 deg what the formula neglects is below 1e-5 deg: exact crossings give the attitude, signs included."""
    columns, _ = crossings(roll, pitch)
    found = np.degrees(published_angles(columns, 1.0 / CAMERA.fx))
    assert found == pytest.approx([pitch, roll], abs=1e-5)


@pytest.mark.parametrize("mount_yaw_deg", [0.0, 90.0, 33.0])
@pytest.mark.parametrize(("roll", "pitch"), [(3.0, -2.0), (-1.0, 4.0)])
def test_both_methods_find_the_body_however_mounted(mount_yaw_deg: float, roll: float, pitch: float) -> None:
    """Published: four roundings of half a pixel, 0.071 deg, and 0.02 deg of the formula. Sub-pixel on an ideal edge:
    1e-4 px."""
    seen = observation(*crossings(roll, pitch, mount_yaw_deg=mount_yaw_deg))
    for estimator, limit in ((PUBLISHED, 0.1), (ESTIMATOR, 1e-5)):
        fit = estimator.run(seen)
        assert isinstance(fit, Fit)
        assert math.degrees(fit.roll_rad) == pytest.approx(roll, abs=limit)
        assert math.degrees(fit.pitch_rad) == pytest.approx(pitch, abs=limit)


@pytest.mark.parametrize("altitude_km", [250.0, 400.0, 600.0])
def test_exact_crossings_give_the_exact_nadir(altitude_km: float) -> None:
    """Crossings are bisected to 1e-9 px, 2e-12 rad; the altitude follows to a metre."""
    columns, mounts = crossings(1.5, -2.0, altitude_km=altitude_km)
    rows = head_rows(observation(columns, mounts))
    assert isinstance(rows, list)
    fit = fit_crossings(rows, columns, np.full(4, 0.01))
    assert isinstance(fit, Fit)
    roll, pitch = roll_pitch_of_nadir(nadir_of_roll_pitch(math.radians(1.5), math.radians(-2.0)))
    assert fit.roll_rad == pytest.approx(float(roll), abs=1e-9)
    assert fit.pitch_rad == pytest.approx(float(pitch), abs=1e-9)
    assert fit.altitude_m == pytest.approx(altitude_km * 1e3, abs=1.0)


@pytest.mark.parametrize("estimator", [PUBLISHED, ESTIMATOR], ids=["published", "sub-pixel"])
def test_covariance_is_honest_under_noise(estimator) -> None:
    """Mean normalised error squared of 2 degrees of freedom over 300 attitudes and draws: 2 +- 0.12, and the published
    method's rounding is even, not normal, but has the stated variance."""
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(300):
        roll, pitch = rng.uniform(-4.0, 4.0, 2)
        columns, mounts = _moved(roll, pitch)
        fit = estimator.run(observation(columns, mounts, rng))
        assert isinstance(fit, Fit)
        error = np.array([fit.roll_rad, fit.pitch_rad]) - np.radians([roll, pitch])
        # In the first head's axes the nadir is tilted; back in the body its level components are (-pitch, roll).
        turn = np.asarray(_matrix(mounts[0]))
        level = (turn.T @ fit.covariance_nadir_cam @ turn)[:2, :2]
        across = np.array([-error[1], error[0]])
        nees.append(float(across @ np.linalg.solve(level, across)))
    assert 1.0 < np.mean(nees) < 2.6


def _moved(roll_deg: float, pitch_deg: float) -> tuple[np.ndarray, list]:
    """Return exact crossings by the cone's closed form: far faster than bisecting horizons 1200 times."""
    columns, mounts = [], []
    nadir = nadir_of_roll_pitch(math.radians(roll_deg), math.radians(pitch_deg))
    cos_rho = math.sqrt(1.0 - (RADIUS_KM / (RADIUS_KM + 400.0)) ** 2)
    for head in SPEC.head:
        azimuth = math.radians(head.mount_yaw_deg + 90.0)
        along = nadir[0] * math.cos(azimuth) + nadir[1] * math.sin(azimuth)
        angle = math.atan2(along, nadir[2]) + math.acos(cos_rho / math.hypot(along, nadir[2]))
        columns.append((angle - math.radians(70.22)) * CAMERA.fx + CAMERA.cx)
        mounts.append(
            compose(
                cam_from_body(math.radians(head.mount_yaw_deg), math.radians(70.22), 0.0),
                cam_from_body(math.radians(90.0), 0.0, 0.0),
            )
        )
    return np.array(columns), mounts


def _matrix(q: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(q).as_matrix())


def test_closed_form_of_the_crossings_is_the_horizons() -> None:
    there, mounts = crossings(2.0, -3.0)
    here, others = _moved(2.0, -3.0)
    assert here == pytest.approx(there, abs=1e-6)
    assert np.abs(mounts[2] @ others[2]) == pytest.approx(1.0)


def test_a_head_without_limb_is_a_refusal() -> None:
    seen = observation(*crossings(0.0, 0.0))
    space = np.random.default_rng(2).normal(20.0, 2.0, (1, 160)).round()
    heads = {**seen.heads, "az225": replace(seen.heads["az225"], image=space)}
    for estimator in (LINEAR_HEADS_PUBLISHED, ESTIMATOR):
        result = estimator.run(replace(seen, heads=heads))
        assert isinstance(result, Refusal)
        assert result.status is Outcome.NO_LIMB
        assert "az225" in result.reason


def test_three_heads_or_another_order_are_refused() -> None:
    seen = observation(*crossings(0.0, 0.0))
    three = {name: seen.heads[name] for name in NAMES[:3]}
    swapped = {name: seen.heads[name] for name in ("az45", "az225", "az135", "az315")}
    for estimator in (PUBLISHED, ESTIMATOR):
        result = estimator.run(replace(seen, heads=three))
        assert isinstance(result, Refusal)
        assert result.status is Outcome.BAD_INPUT
    assert isinstance(PUBLISHED.run(replace(seen, heads=swapped)), Refusal)
    # The cone does not care which head is which.
    assert isinstance(ESTIMATOR.run(replace(seen, heads=swapped)), Fit)


def test_heads_that_contradict_each_other_are_refused() -> None:
    columns, mounts = crossings(0.0, 0.0)
    result = ESTIMATOR.run(observation(columns + np.array([30.0, 0.0, 30.0, 0.0]), mounts))
    assert isinstance(result, Refusal)
    assert result.status is Outcome.AMBIGUOUS


def test_the_published_method_claims_without_a_limb_and_its_guarded_one_does_not() -> None:
    """Bare is bare: rows of noise have a largest difference too."""
    columns, mounts = crossings(0.0, 0.0)
    seen = observation(columns, mounts)
    noise = np.random.default_rng(2)
    heads = {name: replace(h, image=np.round(noise.normal(500.0, 5.0, (1, 160)))) for name, h in seen.heads.items()}
    blind = replace(heads[NAMES[0]], heads=heads)
    fit = PUBLISHED.run(blind)
    assert isinstance(fit, Fit)
    assert np.isfinite(fit.covariance_nadir_cam).all()
    flat = {name: replace(h, image=np.full((1, 160), 500.0)) for name, h in seen.heads.items()}
    assert isinstance(PUBLISHED.run(replace(flat[NAMES[0]], heads=flat)), Fit)
    assert isinstance(ESTIMATOR.run(blind), Refusal)
    assert isinstance(LINEAR_HEADS_PUBLISHED.run(blind), Refusal)
