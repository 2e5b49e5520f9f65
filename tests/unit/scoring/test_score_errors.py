"""Errors of a result against hand-made truths, whose answers are known in closed form."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from synthetic import estimator, fit_of, result_row, toy_image, truth_at

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.methods import ideal
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.rotation import tangent_basis
from horizonval.plugins import registry
from horizonval.scoring import limits
from horizonval.scoring.errors import ARCSEC, METHOD_RADIUS_M, is_false, score, sigma_nadir_rad
from horizonval.scoring.summary import BEYOND_SIGMA, rates, why_false
from horizonval.suites.observation import observation_of

ROUNDING_ARCSEC = 1e-6
"""Rotations of unit vectors round at 1e-16 rad = 2e-11 arcsec; a microarcsecond allows for chains of ten."""


def test_a_perfect_fit_has_no_error():
    truth = truth_at(yaw_deg=33.0, pitch_deg=12.0, roll_deg=-70.0, mount_roll_deg=15.0)
    s = score(truth, estimator(), fit_of(truth, angular_radius_rad=truth.angular_radius_rad))
    assert s.status == "valid"
    assert s.nadir_error_arcsec == pytest.approx(0, abs=ROUNDING_ARCSEC)
    assert s.roll_error_arcsec == pytest.approx(0, abs=ROUNDING_ARCSEC)
    assert s.pitch_error_arcsec == pytest.approx(0, abs=ROUNDING_ARCSEC)
    assert s.angular_radius_error_arcsec == 0
    assert s.nees_nadir == pytest.approx(0, abs=1e-12)
    assert not s.false_valid


@pytest.mark.parametrize("error_arcsec", [1e-3, 1.0, 500.0, 3600.0 * 170])
def test_nadir_error_is_the_angle_of_the_rotation(error_arcsec):
    truth = truth_at(roll_deg=50.0)
    s = score(truth, estimator(), fit_of(truth, error_rad=(0.6 * error_arcsec * ARCSEC, 0.8 * error_arcsec * ARCSEC)))
    assert s.nadir_error_arcsec == pytest.approx(error_arcsec, rel=1e-9, abs=ROUNDING_ARCSEC)


def test_roll_and_pitch_errors_are_claim_minus_truth_and_wrap():
    truth = truth_at(roll_deg=20.0, pitch_deg=-10.0)
    fit = dataclasses.replace(fit_of(truth), roll_rad=math.radians(20.1), pitch_rad=math.radians(-10.05))
    s = score(truth, estimator(), fit)
    assert s.roll_error_arcsec == pytest.approx(360, abs=ROUNDING_ARCSEC)
    assert s.pitch_error_arcsec == pytest.approx(-180, abs=ROUNDING_ARCSEC)
    truth = truth_at(roll_deg=179.9)
    fit = dataclasses.replace(fit_of(truth), roll_rad=math.radians(-179.9))
    assert score(truth, estimator(), fit).roll_error_arcsec == pytest.approx(720, abs=ROUNDING_ARCSEC)
    truth = truth_at(pitch_deg=120.0, roll_deg=5.0)
    s = score(truth, estimator(), fit_of(truth))
    assert s.roll_error_arcsec == pytest.approx(0, abs=ROUNDING_ARCSEC)
    assert s.pitch_error_arcsec == pytest.approx(0, abs=ROUNDING_ARCSEC)


def test_roll_is_empty_where_the_nadir_does_not_tell_it():
    s = score(truth_at(pitch_deg=89.5), estimator(), fit_of(truth_at(pitch_deg=89.5)))
    assert s.roll_error_arcsec is None
    assert s.pitch_error_arcsec is not None


def test_a_geodetic_method_is_held_against_the_geodetic_nadir():
    truth = truth_at(latitude_deg=45.0, altitude_km=500.0)
    fit = fit_of(truth, geodetic=True)
    assert score(truth, estimator(estimates="geodetic"), fit).nadir_error_arcsec < ROUNDING_ARCSEC
    # Deflection at 45 deg, 500 km: (e^2 / 2) / (1 + h/R)^2 up to e^4, 0.00335 rad * 0.86 = 0.165..0.18 deg.
    assert 0.16 * 3600 < score(truth, estimator(), fit).nadir_error_arcsec < 0.19 * 3600


def test_altitude_is_compared_in_the_methods_own_terms_and_in_geodetic_ones():
    truth = truth_at(latitude_deg=90.0, altitude_km=500.0)
    s = score(truth, estimator(), fit_of(truth, altitude_m=500e3))
    assert s.altitude_error_geodetic_km == pytest.approx(0, abs=1e-9)
    # Above the pole the centre is 6356.752 km + 500 km away, 14.257 km less than a mean Earth's radius + 500 km.
    assert s.altitude_error_km == pytest.approx(6371.0088 - 6356.752314, abs=1e-5)
    on_sphere = truth_at(ellipsoid=sphere(METHOD_RADIUS_M))
    s = score(on_sphere, estimator(), fit_of(on_sphere, altitude_m=501e3))
    assert s.altitude_error_km == pytest.approx(1, abs=1e-8)
    assert s.altitude_error_geodetic_km == pytest.approx(1, abs=1e-8)


def test_nees_of_honest_covariances_is_chi_squared():
    """1000 errors drawn from the claimed covariance, anisotropic and not aligned with any axis."""
    truth = truth_at(roll_deg=40.0)
    nadir = np.array(truth.nadir_geocentric_cam)
    generator = np.random.default_rng(8)
    mixing = np.array([[2e-4, 0.0], [1.5e-4, 3e-5]])
    axis = np.cross(nadir, [1.0, 0.0, 0.0])
    axis /= np.linalg.norm(axis)
    across = np.stack([np.cross(axis, nadir), np.cross(np.cross(nadir, axis), nadir)])
    covariance = across.T @ (mixing @ mixing.T) @ across
    values = []
    for draw in generator.normal(size=(1000, 2)):
        error = mixing @ draw
        fit = fit_of(truth, error_rad=(float(error[0]), float(error[1])), covariance_nadir_cam=covariance)
        values.append(score(truth, estimator(), fit).nees_nadir)
    # A wrong distribution (1 or 3 degrees of freedom, an unprojected covariance) has p < 1e-20 at this n.
    assert stats.kstest(values, stats.chi2(2).cdf).pvalue > 0.01
    assert sigma_nadir_rad(nadir, covariance) == pytest.approx(math.sqrt(np.trace(mixing @ mixing.T)), rel=1e-6)


@pytest.mark.parametrize(
    ("error_deg", "nees", "false"),
    [
        (0.6, 0.0, True),
        (0.6, None, True),
        (0.4, 1.0, False),
        (0.4, 26.0, True),
        (0.09, 1e6, False),
        (0.4, None, True),
        (0.09, None, False),
    ],
)
def test_what_counts_as_a_false_claim(error_deg, nees, false):
    assert is_false(math.radians(error_deg), nees) is false


@pytest.mark.parametrize(
    ("error_deg", "nees", "false"),
    [(0.26, 0.0, True), (0.24, 24.0, False), (0.24, 26.0, True), (1e-4, 26.0, True), (0.09, None, False)],
)
def test_fits_of_the_likelihood_are_judged_by_half_and_by_their_sigma_at_any_error(error_deg, nees, false):
    assert is_false(math.radians(error_deg), nees, limits.claim_limits("likelihood")) is false
    assert limits.claim_limits("cone") == limits.CONE_LIMITS


def test_our_methods_state_by_which_rule_they_are_judged():
    strict = {"limb-sphere", "limb-ellipsoid", "limb-profile", "limb-heads", "limb-profile-heads"}
    for name in registry.names():
        if not registry.is_foreign(name):
            assert registry.get(name).claim == ("likelihood" if name.removeprefix("guarded-") in strict else "cone")


@pytest.mark.parametrize("sigmas", [0.98, 1.02])
@pytest.mark.parametrize("azimuth_deg", [0.0, 25.0, 90.0])
def test_a_claim_is_false_beyond_so_many_of_its_own_sigma(sigmas, azimuth_deg):
    """A distance of SIGMA_LIMIT times what is claimed in the error's own direction, also with unlike axes."""
    truth = truth_at(roll_deg=30.0)
    direction = np.array([math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))])
    fit = fit_of(truth, error_rad=tuple(math.radians(0.4) * direction))
    # The tangent plane at the claim, spanned by the error and what is across it.
    along = np.array(truth.nadir_geocentric_cam) - fit.nadir_cam
    along -= (along @ fit.nadir_cam) * fit.nadir_cam
    along /= np.linalg.norm(along)
    across = np.cross(fit.nadir_cam, along)
    sigma = math.radians(0.4) / (sigmas * limits.SIGMA_LIMIT)
    covariance = sigma**2 * np.outer(along, along) + (3 * sigma) ** 2 * np.outer(across, across)
    s = score(truth, estimator(), dataclasses.replace(fit, covariance_nadir_cam=covariance))
    assert s.nees_nadir == pytest.approx((sigmas * limits.SIGMA_LIMIT) ** 2, rel=1e-6)
    assert s.false_valid is (sigmas > 1)


def test_a_refusal_keeps_its_reason_and_has_no_numbers():
    s = score(truth_at(), estimator(), Refusal(Outcome.DARK, "too dark", np.zeros((7, 2))))
    assert (s.status, s.reason, s.n_points, s.false_valid) == ("dark", "too dark", 7, False)
    numbers = dataclasses.asdict(s)
    words = ("status", "reason", "n_points", "false_valid", "without_sigma")
    assert [v for k, v in numbers.items() if k not in words] == [None] * 12


@pytest.mark.parametrize("nadir", [[np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 0]])
def test_a_claim_that_is_no_direction_is_false(nadir):
    s = score(truth_at(), estimator(), fit_of(truth_at(), nadir_cam=np.array(nadir, dtype=float)))
    assert s.false_valid
    assert s.nadir_error_arcsec is None


def test_a_score_is_finite_or_empty_even_for_a_broken_fit():
    broken = fit_of(
        truth_at(),
        covariance_nadir_cam=np.full((3, 3), np.nan),
        roll_rad=math.nan,
        pitch_rad=math.inf,
        altitude_m=math.nan,
        angular_radius_rad=math.inf,
    )
    for value in dataclasses.asdict(score(truth_at(), estimator(), broken)).values():
        assert not isinstance(value, float) or math.isfinite(value)


TRUTH = truth_at(roll_deg=40.0)


def in_plane(matrix, fit):
    basis = tangent_basis(fit.nadir_cam)
    return basis @ np.asarray(matrix, dtype=float) @ basis.T


SIGMA = math.radians(0.2)
UNSURE = {
    "zero": np.zeros((2, 2)),
    "negative": -(SIGMA**2) * np.eye(2),
    "indefinite": np.diag([SIGMA**2, -1e-12]),
    "rank one": np.diag([SIGMA**2, 0.0]),
    "rank one to rounding": np.diag([1.0, 1e-16]),
    "too small for float64": 1e-40 * np.eye(2),
    "subnormal": 5e-324 * np.eye(2),
    "asymmetric": SIGMA**2 * np.array([[1.0, 0.5], [0.0, 1.0]]),
    "nan": np.full((2, 2), np.nan),
    "infinite": np.diag([np.inf, np.inf]),
    "overflowing": np.full((2, 2), 1e308),
}


@pytest.mark.parametrize("kind", UNSURE)
@pytest.mark.parametrize("where", ["noise", "total"])
def test_a_claim_without_uncertainty_is_judged_by_the_default(kind, where):
    for error_deg, false in [(0.09, False), (0.11, True), (0.45, True)]:
        fit = fit_of(TRUTH, error_rad=(math.radians(error_deg), 0.0))
        with np.errstate(all="ignore"):
            covariance = in_plane(UNSURE[kind], fit)
        extra = {"systematic_nadir_cam": np.zeros((3, 3))} if where == "total" else {}
        fit = dataclasses.replace(fit, covariance_nadir_cam=covariance, **extra)
        s = score(TRUTH, estimator(), fit)
        assert s.without_sigma
        assert s.nees_nadir_total is None
        assert s.false_valid is false
        for value in dataclasses.asdict(s).values():
            assert not isinstance(value, float) or math.isfinite(value)


def test_a_matrix_of_another_shape_claims_nothing():
    fit = dataclasses.replace(fit_of(TRUTH, error_rad=(math.radians(0.3), 0.0)), covariance_nadir_cam=np.eye(2))
    s = score(TRUTH, estimator(), fit)
    assert (s.without_sigma, s.false_valid, s.sigma_nadir_arcsec) == (True, True, None)


def test_model_error_makes_up_for_noise_that_is_not_claimed():
    """Only what is claimed altogether decides: a bias of 0.2 deg may be claimed with no noise at all."""
    fit = fit_of(TRUTH, error_rad=(math.radians(0.3), 0.0), sigma_rad=0.0)
    s = score(TRUTH, estimator(), dataclasses.replace(fit, systematic_nadir_cam=in_plane(SIGMA**2 * np.eye(2), fit)))
    assert not s.without_sigma
    assert not s.false_valid
    assert s.nees_nadir is None


@settings(deadline=None, max_examples=100)
@given(
    error=st.floats(0.0, 0.6).map(math.radians),
    azimuth=st.floats(0.0, math.tau),
    sigmas=st.tuples(st.floats(-9.0, 1.0), st.floats(-9.0, 1.0)),
    turn=st.floats(0.0, math.pi),
    unsure=st.sampled_from(sorted(UNSURE)),
)
def test_no_claim_is_better_off_without_its_uncertainty(error, azimuth, sigmas, turn, unsure):
    """Whatever covariance makes a claim false, none makes it false, too."""
    fit = fit_of(TRUTH, error_rad=(error * math.cos(azimuth), error * math.sin(azimuth)))
    cos, sin = math.cos(turn), math.sin(turn)
    axes = np.array([[cos, -sin], [sin, cos]])
    stated = in_plane(axes @ np.diag([10.0 ** (2 * s) for s in sigmas]) @ axes.T, fit)
    with np.errstate(all="ignore"):
        nothing = in_plane(UNSURE[unsure], fit)
    with_it = score(TRUTH, estimator(), dataclasses.replace(fit, covariance_nadir_cam=stated))
    without = score(TRUTH, estimator(), dataclasses.replace(fit, covariance_nadir_cam=nothing))
    assert without.without_sigma
    assert without.false_valid >= with_it.false_valid


def test_the_ideal_sensor_claims_what_rounding_leaves():
    """It is given the pose, and its claim of 2e-7 arcsec is one: not counted among those without."""
    fit = ideal.run(observation_of(toy_image(TRUTH), ideal.ESTIMATOR))
    s = score(TRUTH, ideal.ESTIMATOR, fit)
    assert not s.without_sigma
    assert not s.false_valid


def test_claims_without_sigma_are_counted_apart():
    rows = [
        result_row(status="valid", without_sigma=True),
        result_row(status="valid", without_sigma=True, false_valid=True, nadir_error_arcsec=400.0),
        result_row(status="valid"),
        result_row(status="dark"),
    ]
    counts = rates(rows)
    assert counts["claims_without_sigma"] == 2
    assert counts["false_valid"]["beyond_sigma"] == 1
    assert why_false(rows[1]) == BEYOND_SIGMA
