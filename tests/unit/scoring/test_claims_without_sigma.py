"""Claiming no uncertainty is never an advantage."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import estimator, fit_of, result_row, toy_image, truth_at

from horizonval.estimation.methods import ideal
from horizonval.geometry.rotation import tangent_basis
from horizonval.scoring.errors import score
from horizonval.scoring.summary import BEYOND_SIGMA, rates, why_false
from horizonval.suites.observation import observation_of

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


@settings(deadline=None, max_examples=300)
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
