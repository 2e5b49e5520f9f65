"""Whole profiles in two cameras at once, of limbs that numpy alone drew, in one air that a table knows to modes."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from drawn_limbs import CAMERA, RADIUS_M, picture, table, view
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.air import POLE_ITRS, KnownAir, NodeAir, common_air
from horizonval.estimation.fit.heights import correlations
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.methods import limb_heads, limb_profile, limb_profile_heads
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior

ATTITUDE_SIGMA_RAD, POSITION_SIGMA_M = np.radians(1.0), 300.0
DRAWS = 12


@pytest.fixture(scope="module")
def climate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("air") / "air.npz"
    table(modes=True).save(path)
    return path


def a_pair(seed: int, climate: Path) -> tuple[Observation, FloatArray]:
    """Two cameras whose limbs are a quarter turn apart, and the true nadir in the axes of the first."""
    r, first_cam, random = view(seed)
    up = r / np.linalg.norm(r)
    second_cam = first_cam @ Rotation.from_rotvec(-0.5 * np.pi * up).as_matrix()
    wrong = Rotation.from_rotvec(ATTITUDE_SIGMA_RAD * random.standard_normal(3))
    believed_r = r + POSITION_SIGMA_M * random.standard_normal(3)
    heads = {}
    # The body's axes are those of the first camera.
    for name, cam in (("first", first_cam), ("second", second_cam)):
        from_first = Rotation.from_matrix(cam @ first_cam.T)
        prior = Prior(
            shape="sphere",
            radius_m=RADIUS_M,
            r_itrs=believed_r,
            position_sigma_m=POSITION_SIGMA_M,
            q_cam_from_itrs=(from_first * wrong * Rotation.from_matrix(first_cam)).as_quat(),
            attitude_sigma_rad=np.full(3, ATTITUDE_SIGMA_RAD),
            epoch_utc=datetime(2026, 1, 16, 12, tzinfo=UTC),
            climate=str(climate),
        )
        heads[name] = Observation(
            image=picture(cam, r, random, modes=True, air=np.random.default_rng(seed)),
            camera=CAMERA,
            q_cam_from_body=from_first.as_quat(),
            prior=prior,
            band_kind="thermal",
            band_um=(14.0, 16.3),
        )
    return replace(heads["first"], heads=heads), -first_cam @ up


def fitted(observation: Observation) -> Fit:
    found = limb_profile_heads.run(observation)
    assert isinstance(found, Fit), found
    return found


def squared_in_sigmas(found: Fit, nadir_cam: FloatArray) -> float:
    """The error over what is claimed, which has two degrees of freedom."""
    return float(
        (found.nadir_cam - nadir_cam)
        @ np.linalg.pinv(found.total_covariance_nadir_cam, rcond=1e-9)
        @ (found.nadir_cam - nadir_cam)
    )


@pytest.fixture(scope="module")
def pairs(climate: Path) -> list[tuple[Observation, FloatArray, Fit]]:
    made = [a_pair(100 + seed, climate) for seed in range(DRAWS)]
    return [(observation, nadir, fitted(observation)) for observation, nadir in made]


def test_the_claim_is_honest(pairs: list[tuple[Observation, FloatArray, Fit]]) -> None:
    """The sum over 12 draws lies within what chance leaves of chi-squared in 99.8 % of cases."""
    total = sum(squared_in_sigmas(found, nadir) for _, nadir, found in pairs)
    low, high = chi2.ppf([0.001, 0.999], 2 * DRAWS)
    assert low < total < high


def test_the_order_of_heads_changes_nothing(pairs: list[tuple[Observation, FloatArray, Fit]]) -> None:
    """To a hundredth of a sigma: the answer is in the axes of whichever comes first."""
    observation, _, found = pairs[0]
    other = fitted(replace(observation.heads["second"], heads=dict(reversed(observation.heads.items()))))
    turned = Rotation.from_quat(observation.heads["second"].q_cam_from_body).inv().apply(other.nadir_cam)
    sigma = np.sqrt(np.trace(found.total_covariance_nadir_cam))
    assert np.linalg.norm(turned - found.nadir_cam) < 0.01 * sigma
    assert (other.roll_rad, other.pitch_rad) == pytest.approx((found.roll_rad, found.pitch_rad), abs=0.01 * sigma)


@pytest.mark.parametrize("dark", ["first", "second"])
def test_a_head_without_a_limb_is_left_out(pairs: list[tuple[Observation, FloatArray, Fit]], dark: str) -> None:
    """The other's answer is that of ``limb-profile``, another search, to a tenth of its sigma."""
    observation, _, _ = pairs[1]
    space = np.rint(np.random.default_rng(5).normal(50.0, 4.0, observation.image.shape))
    heads = {n: replace(one, image=space) if n == dark else one for n, one in observation.heads.items()}
    found = fitted(replace(heads["first"], heads=heads))
    lit = next(one for name, one in heads.items() if name != dark)
    alone = limb_profile.run(lit)
    assert isinstance(alone, Fit)
    to_first = Rotation.from_quat(lit.q_cam_from_body).inv()
    sigma = np.sqrt(np.trace(alone.total_covariance_nadir_cam))
    assert np.linalg.norm(to_first.apply(alone.nadir_cam) - found.nadir_cam) < 0.1 * sigma
    claimed = to_first.as_matrix() @ alone.total_covariance_nadir_cam @ to_first.as_matrix().T
    assert found.total_covariance_nadir_cam == pytest.approx(claimed, rel=0.1, abs=0.05 * sigma**2)
    assert (len(found.points) > 0) == (dark == "second")


def test_no_limb_in_any_head_is_refused(pairs: list[tuple[Observation, FloatArray, Fit]]) -> None:
    observation, _, _ = pairs[0]
    space = np.rint(np.random.default_rng(5).normal(50.0, 4.0, observation.image.shape))
    heads = {name: replace(one, image=space) for name, one in observation.heads.items()}
    refused = limb_profile_heads.run(replace(heads["first"], heads=heads))
    assert isinstance(refused, Refusal)
    assert (refused.status, refused.reason[:11]) == (Outcome.NO_LIMB, "head first:")


def test_what_it_cannot_do_without(pairs: list[tuple[Observation, FloatArray, Fit]]) -> None:
    observation, _, _ = pairs[0]
    one = {"first": observation.heads["first"]}
    alone = limb_profile_heads.run(replace(observation, heads=one))
    assert isinstance(alone, Refusal)
    assert "two heads or more" in alone.reason
    timeless = {n: replace(h, prior=replace(h.prior, epoch_utc=None)) for n, h in observation.heads.items()}
    refused = limb_profile_heads.run(replace(timeless["first"], heads=timeless))
    assert isinstance(refused, Refusal)
    assert (refused.status, refused.reason) == (
        Outcome.BAD_INPUT,
        "head first: limb-profile-heads needs the time (epoch_utc)",
    )


def test_linear_arrays_are_asked_for_their_crossings() -> None:
    """By ``limb-heads``: a row shows no profile along a limb."""
    row = np.full((1, 64), 10.0)
    camera = replace(CAMERA, width=64, height=1, cy=0.0)
    heads = {name: Observation(image=row, camera=camera) for name in ("a", "b")}
    observation = replace(heads["a"], heads=heads)
    by_row, by_crossing = limb_profile_heads.run(observation), limb_heads.run(observation)
    assert isinstance(by_row, Refusal)
    assert isinstance(by_crossing, Refusal)
    assert (by_row.status, by_row.reason) == (by_crossing.status, by_crossing.reason)


def air_at(azimuth_rad: FloatArray) -> NodeAir:
    """The air of the table at places of a limb around the equator's first meridian."""
    lying = np.column_stack([0.9 * np.ones_like(azimuth_rad), 0.4 * np.cos(azimuth_rad), 0.4 * np.sin(azimuth_rad)])
    up = lying / np.linalg.norm(lying, axis=1)[:, None]
    los = np.cross(up, np.cross([1.0, 0.0, 0.0], up))
    known = KnownAir(table(modes=True, left=True), datetime(2026, 1, 16, tzinfo=UTC), None, POLE_ITRS)
    pose = LimbPose(np.eye(3), 7e6 * up[0])
    return known.nodes(up, los / np.linalg.norm(los, axis=1)[:, None], pose, (-30e3, 90e3, 500.0), 0.0)


def test_waves_of_all_heads_have_the_covariance_of_all_places() -> None:
    """To 1e-5 of a mode's variance, what is left out; the gain of one head says nothing of another's."""
    airs = [air_at(np.linspace(0.0, 0.8, 7)), air_at(np.linspace(0.6, 1.9, 9))]
    common = common_air(airs, ["table", "table"])
    up = np.concatenate([air.up_itrs for air in airs])
    lengths = np.concatenate([air.lengths_rad[:, 0] for air in airs])
    expected = correlations(lengths[:, None], up, POLE_ITRS)[0]
    rows = []
    for air, at in zip(common.images, common.columns, strict=True):
        row = np.zeros((len(air.up_itrs), common.count))
        row[:, at[: air.waves[0].shape[1]]] = air.waves[0]
        rows.append(row)
    whole = np.concatenate(rows)
    assert whole @ whole.T == pytest.approx(expected, abs=1e-4)
    gains = [at[-air.waves[-1].shape[1] :] for air, at in zip(common.images, common.columns, strict=True)]
    assert not set(gains[0]) & set(gains[1])
