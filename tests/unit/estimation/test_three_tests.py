"""The three tests of a claim on pictures made by formula: each of them refuses what it is there for, and only that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.three_tests import doubted
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.plugins import registry

CAMERA = CameraModel(160, 120, 110.0, 110.0, 79.5, 59.5)
RADIUS_M = 6371008.8
ALTITUDE_M = 500e3
RHO = math.asin(RADIUS_M / (RADIUS_M + ALTITUDE_M))
NADIR = np.array([0.0, math.sin(math.radians(64.0)), math.cos(math.radians(64.0))])
ACROSS = np.eye(3) - np.outer(NADIR, NADIR)
CLAIM = Fit(
    nadir_cam=NADIR,
    covariance_nadir_cam=math.radians(0.05) ** 2 * ACROSS,
    roll_rad=0.0,
    pitch_rad=0.0,
    angular_radius_rad=RHO,
)


def _inside_px() -> tuple[np.ndarray, np.ndarray]:
    """How far pixels lie inside the limb [px], and their azimuth about the nadir from the image's middle [rad]."""
    column, row = np.meshgrid(np.arange(160.0), np.arange(120.0))
    d = np.stack([(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, np.ones_like(row)], axis=-1)
    d /= np.linalg.norm(d, axis=-1)[..., None]
    angle = np.arccos(d @ NADIR)
    by_row, by_column = np.gradient(angle)
    return (RHO - angle) / np.hypot(by_row, by_column), np.arctan2(d[..., 0], -(d @ np.cross([1.0, 0.0, 0.0], NADIR)))


X, AZIMUTH = _inside_px()


def _seen(light: np.ndarray, **changes) -> Observation:
    image = np.clip(np.rint(20.0 + 180.0 * light + np.random.default_rng(1).normal(0.0, 2.0, light.shape)), 0.0, 255.0)
    values = {"full_scale": 255.0, "band_kind": "thermal", "prior": Prior(shape="sphere")}
    return Observation(image, CAMERA, **(values | changes))


LIMB = ndtr(X / 0.75)


def _reason(refusal: Refusal | None) -> str:
    assert isinstance(refusal, Refusal)
    return refusal.reason


@pytest.mark.parametrize("light", [LIMB, 1.0 - LIMB], ids=["bright Earth", "bright space"])
@pytest.mark.parametrize("band", ["solar", "thermal", None])
def test_a_limb_where_it_is_claimed_is_believed(light: np.ndarray, band: str | None) -> None:
    assert doubted(CLAIM, _seen(light, band_kind=band)) is None


def test_an_edge_with_teeth_fails_chi_squared() -> None:
    """Teeth 6 px deep, a tenth of a radian long: no limb's relief is that high so shortly."""
    teeth = 3.0 * np.sign(np.sin(60.0 * AZIMUTH))
    assert "profile" in _reason(doubted(CLAIM, _seen(ndtr((X + teeth) / 0.75))))


def test_half_a_limb_is_not_explained() -> None:
    """Bright to one side of the middle only: a thermal limb is so all round."""
    half = LIMB * (AZIMUTH > 0.1)
    refusal = doubted(CLAIM, _seen(half))
    assert isinstance(refusal, Refusal)
    assert refusal.status is Outcome.NO_LIMB


def test_of_two_limbs_none_is_chosen() -> None:
    double = 0.5 * LIMB + 0.5 * ndtr((X - 12.0) / 0.75)
    refusal = doubted(CLAIM, _seen(double))
    assert isinstance(refusal, Refusal)
    assert refusal.status is Outcome.AMBIGUOUS
    assert "second limb" in refusal.reason


def test_an_edge_softer_than_air_is_refused() -> None:
    """Falling to a third over 8 px, which from here are 330 km."""
    soft = np.where(X > 0.0, 1.0, np.exp(np.minimum(X, 0.0) / 8.0))
    assert "soft" in _reason(doubted(CLAIM, _seen(soft)))


def test_a_claim_off_the_limb_is_refused() -> None:
    for turn, word in ((3.0, "claimed one"), (-3.0, "claimed one")):
        nadir = Rotation.from_rotvec([math.radians(turn), 0.0, 0.0]).apply(NADIR)
        assert word in _reason(doubted(replace(CLAIM, nadir_cam=nadir), _seen(LIMB)))


def test_known_altitude_and_attitude_are_asked_for() -> None:
    """Five sigma of both: 100 km and 10 deg off are too much, at 50 km and 5 deg of doubt they are not."""

    def prior(altitude_m: float, sigma_m: float, turn_deg: float, sigma_deg: float) -> Prior:
        nadir = Rotation.from_rotvec([math.radians(turn_deg), 0.0, 0.0]).apply(NADIR)
        attitude, _ = Rotation.align_vectors([nadir, [1.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        return Prior(
            shape="sphere",
            altitude_m=altitude_m,
            altitude_sigma_m=sigma_m,
            r_itrs=[RADIUS_M + altitude_m, 0.0, 0.0],
            position_sigma_m=sigma_m,
            q_cam_from_itrs=attitude.as_quat(),
            attitude_sigma_rad=np.radians([sigma_deg] * 3),
        )

    right = prior(ALTITUDE_M, 1e3, 0.0, 0.5)
    assert doubted(CLAIM, _seen(LIMB, prior=right)) is None
    assert "known altitude" in _reason(doubted(CLAIM, _seen(LIMB, prior=prior(900e3, 1e3, 0.0, 0.5))))
    assert doubted(CLAIM, _seen(LIMB, prior=prior(600e3, 50e3, 0.0, 0.5))) is None
    assert "known attitude" in _reason(doubted(CLAIM, _seen(LIMB, prior=prior(ALTITUDE_M, 1e3, 10.0, 0.5))))
    assert doubted(CLAIM, _seen(LIMB, prior=prior(ALTITUDE_M, 1e3, 10.0, 5.0))) is None


def test_a_claim_without_a_limb_is_refused() -> None:
    assert "predicts no limb" in _reason(doubted(replace(CLAIM, angular_radius_rad=None), _seen(LIMB)))
    assert "no orbit" in _reason(doubted(replace(CLAIM, angular_radius_rad=math.radians(0.3)), _seen(LIMB)))


@pytest.mark.parametrize("name", ["guarded-altitude-free", "guarded-limb-sphere"])
def test_a_bright_space_is_as_good_as_a_bright_earth(name: str) -> None:
    """In the infrared: under a known Sun the limb's height is that of light, which a negative shows as well."""
    method = registry.get(name)
    fits = [method.run(_seen(light, prior=Prior(shape="sphere"))) for light in (LIMB, 1.0 - LIMB)]
    for fit in fits:
        assert isinstance(fit, Fit), fit
        # the pictures are alike but for their noise, 0.01 of the step
        assert np.linalg.norm(fit.nadir_cam - fits[0].nadir_cam) < math.radians(0.1)
        assert np.linalg.norm(fit.nadir_cam - NADIR) < math.radians(0.3)
