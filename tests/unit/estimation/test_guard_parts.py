"""Parts of the guards: rows, points, cones of several heads."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.guard import SIGMAS
from horizonval.estimation.guard.guard import AGREEMENT_FLOOR_RAD, GuardLimb, _confirmed
from horizonval.estimation.guard.limits import seen_relief
from horizonval.estimation.guard.rows import RowLimb, misfit, row_limb
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M, Prior
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

LINE = CameraModel(160, 1, 570.0, 570.0, 79.5, 0.0)
PIXELS = np.arange(160.0)


def row(column: float = 80.3, **changes: Any) -> np.ndarray:
    """A hard limb with the Earth to the left."""
    return 100.0 + 900.0 * np.clip(column - PIXELS + 0.5, 0.0, 1.0)


def head(values: np.ndarray, **changes: Any) -> Observation:
    return Observation(values[None, :], LINE, **({"full_scale": 4095.0} | changes))


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_row_with_one_edge_has_its_line_of_sight(mirrored: bool) -> None:
    values = row()[::-1] if mirrored else row()
    limb = row_limb(head(values))
    assert isinstance(limb, RowLimb)
    column = 159.0 - 80.3 if mirrored else 80.3
    x = (column - 79.5) / 570.0
    assert limb.los_cam == pytest.approx(np.array([x, 0.0, 1.0]) / math.hypot(x, 1.0), abs=2e-8)
    # Noise free but for the rounding of its levels and the stated 0.005 px, in angle.
    px = math.atan((column + 0.5 - 79.5) / 570.0) - math.atan((column - 0.5 - 79.5) / 570.0)
    assert limb.sigma_rad == pytest.approx(5e-3 * px, rel=0.05)
    towards = 1.0 if mirrored else -1.0
    assert limb.to_bright_cam[0] * towards > 0.0
    assert np.linalg.norm(limb.to_bright_cam) == pytest.approx(px, rel=1e-3)
    assert limb.bright_side_down(np.array([towards, 0.0, 0.2]))
    assert not limb.bright_side_down(np.array([-towards, 0.0, 0.2]))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(
    ("start", "stop", "level", "outcome", "word"),
    [
        (120, 135, 4095.0, Outcome.SUN_GLARE, "Sun"),
        (30, 40, 4095.0, Outcome.SUN_GLARE, "Sun"),
        (0, 70, 4095.0, Outcome.SATURATED, "Earth"),
        (115, 140, 800.0, Outcome.AMBIGUOUS, "beyond"),
        (20, 45, 100.0, Outcome.AMBIGUOUS, "the row"),
        (20, 45, 2900.0, Outcome.AMBIGUOUS, ""),
        (115, 140, 130.0, None, ""),
        (20, 45, 950.0, None, ""),
    ],
)
def test_what_else_is_in_a_row_is_told(
    mirrored: bool, start: int, stop: int, level: float, outcome: Outcome | None, word: str
) -> None:
    values = row()
    values[start:stop] = level
    found = row_limb(head(values[::-1] if mirrored else values))
    if outcome is None:
        assert isinstance(found, RowLimb)
        return
    assert isinstance(found, Refusal)
    # Of two edges alike the first is taken for the limb: a Sun on the Earth's side may then pass for a bright Earth.
    assert found.status is outcome or (outcome is Outcome.SUN_GLARE and found.status is Outcome.SATURATED)
    if found.status is outcome:
        assert word in found.reason


def test_a_second_edge_shows_above_the_noise_that_smoothing_leaves() -> None:
    """Noise of 20 levels, of which smoothing leaves 11: five times that and a tenth of the step are 140."""
    rng = np.random.default_rng(9)
    refused = {height: 0 for height in (0.0, 270.0)}
    for height in refused:
        for _ in range(20):
            values = row() + rng.normal(0.0, 20.0, 160)
            values[115:140] += height
            refused[height] += isinstance(row_limb(head(values)), Refusal)
    assert refused == {0.0: 0, 270.0: 20}


def crossings(rho: float = 1.1) -> tuple[np.ndarray, np.ndarray]:
    """Four directions of a cone and the directions outwards from them."""
    turn = np.radians([45.0, 130.0, 225.0, 320.0])
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(4)])
    down = np.array([0.0, 0.0, 1.0])
    return math.cos(rho) * down + math.sin(rho) * around, math.cos(rho) * around - math.sin(rho) * down


def test_crossings_that_miss_one_cone_by_their_noise_are_likely_and_by_more_not() -> None:
    """On a sphere of an even limb the misfit is one of chi-squared with one degree of freedom."""
    los, outwards = crossings()
    sigma = np.array([2e-3, 4e-3, 3e-3, 2e-3])
    seen = head(row(), prior=Prior(shape="sphere"))
    rng = np.random.default_rng(1)
    chances = []
    for _ in range(400):
        noisy = los + (sigma * rng.normal(size=4))[:, None] * outwards
        noisy /= np.linalg.norm(noisy, axis=1)[:, None]
        cone = fit_cone(noisy)
        rho = float(off_axis_angle(noisy, cone.axis_cam).mean())
        chances.append(misfit(noisy, cone.axis_cam, rho, sigma, seen))
    assert stats.kstest(chances, "uniform").pvalue > 1e-3
    assert misfit(los[:3], np.array([0.0, 0.0, 1.0]), 1.1, sigma[:3], seen) == 1.0
    off = los + np.array([1, -1, 1, -1])[:, None] * 0.02 * outwards
    cone = fit_cone(off / np.linalg.norm(off, axis=1)[:, None])
    assert misfit(off, cone.axis_cam, cone.rho_rad, sigma, seen) < 1e-6
    assert misfit(off, cone.axis_cam, cone.rho_rad, 20 * sigma, seen) > 0.3


def test_the_relief_that_points_show_is_their_waves_without_their_noise() -> None:
    """Waves of 2 km under noise of 3 km: a mean over a piece of limb keeps one and hardly the other."""
    azimuth = np.linspace(-1.5, 1.5, 800)
    wave = 2000.0 * math.sqrt(2.0) * np.sin(2 * np.pi * azimuth / 0.35)
    noise = 3000.0 * np.random.default_rng(5).normal(size=800)
    assert seen_relief(wave, azimuth) == pytest.approx(2000.0, rel=0.12)
    assert seen_relief(wave + noise, azimuth) == pytest.approx(2000.0, rel=0.25)
    assert seen_relief(noise, azimuth) < 700.0


PAIR_CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
RADIUS_M = MEAN_RADIUS_M
PAIR_RHO = math.asin(RADIUS_M / (RADIUS_M + 600e3))
PAIR_AXIS = np.array([0.1, math.sin(1.05), math.cos(1.05)])
PAIR_AXIS /= np.linalg.norm(PAIR_AXIS)
BASIS = tangent_basis(PAIR_AXIS)


def pair_limb(noise: float = 1e-4, systematic: float = 1e-4, rho: float = PAIR_RHO) -> GuardLimb:
    return GuardLimb(PAIR_AXIS, rho, noise**2 * np.eye(3), systematic**2 * np.eye(3))


def answer(off_rad: float = 0.0, sigma: float = 1e-4, **changes: Any) -> Fit:
    nadir = math.cos(off_rad) * PAIR_AXIS + math.sin(off_rad) * BASIS[:, 0]
    return Fit(nadir, sigma**2 * (np.eye(3) - np.outer(nadir, nadir)), 0.0, 0.0, **changes)


def seen(**changes: Any) -> Observation:
    return Observation(np.zeros((120, 160)), PAIR_CAMERA, **changes)


def outcome(fit: Fit, cone: GuardLimb, observation: Observation | None = None, claimed: float = 1e-4) -> Outcome | None:
    found = _confirmed(fit, cone, observation or seen(), claimed**2 * np.eye(2))
    return found.status if isinstance(found, Refusal) else None


def test_an_answer_is_confirmed_within_five_sigma_of_all_that_is_uncertain() -> None:
    """The answer's noise, the model's error, the limb's noise and a floor, added as variances."""
    parts = (3e-4, 4e-4, 5e-4)
    sigma = math.sqrt(sum(p**2 for p in parts) + AGREEMENT_FLOOR_RAD**2)
    for sign in (-1.0, 1.0):
        for share, expected in ((0.98, None), (1.02, Outcome.AMBIGUOUS)):
            fit = answer(sign * share * SIGMAS * sigma, sigma=parts[0])
            assert outcome(fit, pair_limb(noise=parts[2]), claimed=parts[1]) is expected
    assert outcome(answer(math.pi), pair_limb()) is Outcome.AMBIGUOUS, "the other way round is no agreement"
