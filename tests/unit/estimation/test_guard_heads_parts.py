"""What the guard of several heads asks of an answer, one question at a time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.heads import (
    _confirmed,
    _Limb,
    _limb_near,
    _limb_of,
    _turns,
    _without_outliers,
)
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M, Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
RADIUS_M = MEAN_RADIUS_M
RHO = math.asin(RADIUS_M / (RADIUS_M + 600e3))
AXIS = np.array([0.1, math.sin(1.05), math.cos(1.05)])
AXIS /= np.linalg.norm(AXIS)
BASIS = tangent_basis(AXIS)
DEG = math.radians(1.0)


def limb(noise: float = 1e-4, systematic: float = 1e-4, rho: float = RHO) -> _Limb:
    return _Limb(AXIS, BASIS, rho, noise**2 * np.eye(3), systematic**2 * np.eye(3))


def answer(off_rad: float = 0.0, sigma: float = 1e-4, **changes: Any) -> Fit:
    nadir = math.cos(off_rad) * AXIS + math.sin(off_rad) * BASIS[:, 0]
    return Fit(nadir, sigma**2 * (np.eye(3) - np.outer(nadir, nadir)), 0.0, 0.0, **changes)


def seen(**changes: Any) -> Observation:
    return Observation(np.zeros((120, 160)), CAMERA, **changes)


def outcome(fit: Fit, cone: _Limb, observation: Observation | None = None, claimed: float = 1e-4) -> Outcome | None:
    found = _confirmed(fit, cone, observation or seen(), claimed**2 * np.eye(2))
    return found.status if isinstance(found, Refusal) else None


def test_an_answer_is_confirmed_within_five_sigma_of_all_that_is_uncertain() -> None:
    """The answer's noise, the model's error, the limb's noise and a floor, added as variances."""
    parts = (3e-4, 4e-4, 5e-4)
    sigma = math.sqrt(sum(p**2 for p in parts) + limits.AGREEMENT_FLOOR_RAD**2)
    for sign in (-1.0, 1.0):
        for share, expected in ((0.98, None), (1.02, Outcome.AMBIGUOUS)):
            fit = answer(sign * share * limits.AGREEMENT * sigma, sigma=parts[0])
            assert outcome(fit, limb(noise=parts[2]), claimed=parts[1]) is expected
    assert outcome(answer(math.pi), limb()) is Outcome.AMBIGUOUS, "the other way round is no agreement"


def test_a_confirmed_answer_claims_the_model_error_too() -> None:
    found = _confirmed(answer(), limb(), seen(), np.diag([1e-6, 4e-6]))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam == pytest.approx(BASIS @ np.diag([1e-6, 4e-6]) @ BASIS.T)
    before = 9e-6 * np.outer(BASIS[:, 0], BASIS[:, 0])
    more = _confirmed(answer(systematic_nadir_cam=before), limb(), seen(), np.diag([1e-6, 4e-6]))
    assert isinstance(more, Fit)
    assert more.systematic_nadir_cam == pytest.approx(BASIS @ np.diag([10e-6, 4e-6]) @ BASIS.T)


@pytest.mark.parametrize(
    ("sigma", "claimed", "refused"), [(0.9, 0.1, False), (1.1, 0.1, True), (0.1, 1.1, True), (0.75, 0.75, True)]
)
def test_an_uncertain_answer_is_refused(sigma: float, claimed: float, refused: bool) -> None:
    fit = answer(sigma=sigma * limits.LARGEST_SIGMA_RAD)
    found = outcome(fit, limb(), claimed=claimed * limits.LARGEST_SIGMA_RAD)
    assert found is (Outcome.SHORT_ARC if refused else None)


@pytest.mark.parametrize(("rho_deg", "refused"), [(0.9, True), (1.1, False), (81.9, False), (82.1, True)])
def test_a_disc_that_no_orbit_shows_is_refused(rho_deg: float, refused: bool) -> None:
    assert outcome(answer(), limb(rho=rho_deg * DEG)) is (Outcome.NO_LIMB if refused else None)


@pytest.mark.parametrize("band", ["solar", "thermal", None])
def test_a_known_altitude_leaves_room_for_air_and_uncertainty(band: Any) -> None:
    """The limb stands between a little below the ground and the top of its air, five sigma to both sides."""
    low, high = (h * math.tan(RHO) / RADIUS_M for h in limb_height_m(band))
    sigma_m = 2e3
    of_altitude = math.tan(RHO) / (RADIUS_M + 600e3) * sigma_m
    slack = limits.AGREEMENT * math.hypot(3e-4, 4e-4, of_altitude)
    observation = seen(prior=Prior(altitude_m=600e3, altitude_sigma_m=sigma_m), band_kind=band)
    for off, refused in ((low - slack, False), (high + slack, False), (low - slack, True), (high + slack, True)):
        inwards = -1.0 if (off > 0) == (not refused) else 1.0
        cone = limb(noise=3e-4, systematic=4e-4, rho=RHO + off + inwards * 2e-5)
        assert outcome(answer(), cone, observation) is (Outcome.AMBIGUOUS if refused else None)
        assert outcome(answer(), cone, seen(band_kind=band)) is None, "without an altitude it is not asked"


def two_heads(**changes: Any) -> Observation:
    """Heads that look to two sides, both with the same Earth below."""
    turns = {"a": Rotation.from_euler("xyz", [0.3, -0.2, 0.5]), "b": Rotation.from_euler("xyz", [-0.9, 0.4, 2.0])}
    heads = {name: seen(q_cam_from_body=turn.as_quat(), **changes) for name, turn in turns.items()}
    return replace(heads["a"], heads=heads)


def on_limb(n: int = 300, rho: float | np.ndarray = RHO) -> np.ndarray:
    turn = np.linspace(-0.4, 0.4, n)[:, None]
    up = np.array([0.0, 0.0, 1.0]) - AXIS[2] * AXIS
    up /= np.linalg.norm(up)
    around = np.cos(turn) * up + np.sin(turn) * np.cross(AXIS, up)
    angle = np.broadcast_to(rho, (n,))[:, None]
    return np.cos(angle) * AXIS + np.sin(angle) * around


def test_points_far_off_the_others_are_left_out_and_no_others() -> None:
    rng = np.random.default_rng(0)
    px = 1 / 130.0
    off = rng.normal(0.0, 0.2 * px, 300)
    off[[20, 150, 280]] = [3 * px, -3 * px, 4 * px]
    kept = _without_outliers(on_limb(rho=RHO + off), seen())
    assert 290 < len(kept) <= 297
    angle = off_axis_angle(kept, AXIS) - RHO
    assert np.abs(angle).max() < 1.5 * px
    exact = on_limb()
    assert len(_without_outliers(exact, seen())) == 300
    near = on_limb(rho=RHO + np.where(np.arange(300) == 7, 0.2 * px, 0.0))
    assert len(_without_outliers(near, seen())) == 300, "within the smallest distance that counts"


def picture(inner: float = 600.0, outer: float = 40.0, rho: float = RHO) -> np.ndarray:
    depth = (rho - off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), AXIS)) * 130.0
    return outer + (inner - outer) / (1.0 + np.exp(-depth / 0.6))


def test_the_limb_near_an_answer_is_read_in_the_image() -> None:
    head = seen(full_scale=1023.0, band_kind="solar")
    found = _limb_near(replace(head, image=picture(rho=RHO + 1.5 / 130.0)), AXIS, RHO)
    assert isinstance(found, np.ndarray)
    assert (off_axis_angle(found, AXIS) - RHO) * 130.0 == pytest.approx(np.full(len(found), 1.5), abs=0.15)
    uv, _ = project(CAMERA, found)
    assert uv.min() > limits.HEAD_RIM_PX - 3.0
    assert len(np.unique(np.rint(uv), axis=0)) > 0.8 * len(found)
    cases = {
        Outcome.NOT_CONVERGED: (picture(), AXIS, math.nan),
        Outcome.SHORT_ARC: (picture(), -AXIS, RHO),
        Outcome.NO_LIMB: (picture(40.0, 600.0), AXIS, RHO),
    }
    for status, (image, axis, rho) in cases.items():
        refusal = _limb_near(replace(head, image=image), axis, rho)
        assert isinstance(refusal, Refusal)
        assert refusal.status is status
    dark_earth = _limb_near(replace(head, image=picture(40.0, 600.0), band_kind=None), AXIS, RHO)
    assert isinstance(dark_earth, np.ndarray), "where the band is not known the Earth may be the darker side"
    for spoiled in (np.full((120, 160), 50.0), np.minimum(picture(3000.0), 1023.0)):
        assert isinstance(_limb_near(replace(head, image=spoiled), AXIS, RHO), Refusal)


def test_limbs_of_all_heads_make_one_cone() -> None:
    observation = two_heads()
    turns = _turns(observation)
    first = on_limb()
    around = Rotation.from_rotvec(2.0 * AXIS).apply(first)
    parts = {"a": first, "b": turns["b"].apply(around)}
    cone = _limb_of(parts, observation, "geocentric")
    assert isinstance(cone, _Limb)
    assert cone.axis == pytest.approx(AXIS, abs=1e-9)
    assert cone.rho_rad == pytest.approx(RHO, abs=1e-9)
    allowed = limits.HEADS_MISFIT_PX / 130.0 + limits.HEADS_MISFIT_RAD
    for share, refused in ((0.9, False), (1.2, True)):
        # Two halves of a limb that differ by twice that in height: the cone cannot follow a wave of so short a length.
        wave = share * allowed * np.sign(np.sin(40.0 * np.linspace(-0.4, 0.4, 300)))
        high = on_limb(rho=RHO + wave)
        parts = {"a": high, "b": turns["b"].apply(Rotation.from_rotvec(2.0 * AXIS).apply(high))}
        assert isinstance(_limb_of(parts, observation, "geocentric"), Refusal) is refused
