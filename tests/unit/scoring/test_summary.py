"""Statistics of rows, rates, noise and headlines, by hand and by closed forms."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from scipy import stats
from synthetic import result_row

from horizonval.estimation.observation import Fit
from horizonval.scoring import summary as module
from horizonval.scoring.row import Row
from horizonval.scoring.summary import (
    condition_of,
    headline,
    mean_noise_nees,
    noise_nees,
    proportion,
    rates,
    strict_confusion,
    summarise,
    upper_bound,
    why_false,
)


def row(case: str, expected: str, status: str, error: float | None = None, **changes: Any) -> Row:
    values: dict[str, Any] = {
        "case": case,
        "expected": expected,
        "status": status,
        "nadir_error_arcsec": error,
        "roll_error_arcsec": error,
        "pitch_error_arcsec": None if error is None else -error,
        "nees_nadir": None if error is None else 1.0,
    }
    return result_row(**(values | changes))


ROWS = [
    row("a", "valid", "valid", 10.0),
    row("b", "valid", "valid", 20.0, nees_nadir=5.0),
    row("c", "valid", "short_arc"),
    row("d", "dark", "dark"),
    row("e", "dark", "valid", 9000.0, false_valid=True, nees_nadir=None),
    row("a", "valid", "valid", 1.0, estimator="aaa"),
]


def test_groups_are_sorted_and_counted():
    summary = summarise(ROWS)
    assert [(g["estimator"], g["camera"], g["n"]) for g in summary["groups"]] == [("aaa", "cam", 1), ("est", "cam", 5)]
    assert (summary["n_cases"], summary["n_rows"]) == (5, 6)


def test_numbers_by_hand():
    group = summarise(ROWS)["groups"][1]
    assert (group["n_expected_valid"], group["n_valid"]) == (3, 3)
    assert group["availability"]["n"] == 2
    assert group["availability"]["rate"] == pytest.approx(2 / 3)
    error = group["nadir_error_arcsec"]
    assert (error["n"], error["median"], error["max"]) == (3, 20.0, 9000.0)
    assert error["rms"] == pytest.approx(((100 + 400 + 81e6) / 3) ** 0.5)
    assert error["p95"] == pytest.approx(20 + 0.9 * 8980)
    assert group["roll_error_arcsec"]["mean"] == pytest.approx(9030 / 3)
    assert group["pitch_error_arcsec"]["mean"] == pytest.approx(-9030 / 3)
    assert group["nees_nadir"]["mean"] == 3.0
    assert group["nees_nadir"]["n"] == 2
    # Chi-squared with 4 degrees of freedom: 2.5 and 97.5 % points 0.4844 and 11.1433 (any table), over n = 2.
    assert group["nees_nadir"]["interval"] == pytest.approx([0.4844 / 2, 11.1433 / 2], abs=1e-4)
    assert group["altitude_error_km"] == {"n": 0, "mean": None, "std": None}
    assert group["refusals"] == {"short_arc": 1, "dark": 1}
    assert group["confusion"] == {"valid": {"valid": 2, "short_arc": 1}, "dark": {"valid": 1, "dark": 1}}
    assert (group["false_valid"]["n"], group["false_valid"]["of"]) == (1, 3)


def test_a_summary_is_plain_json_in_any_order_of_rows():
    text = json.dumps(summarise(ROWS), allow_nan=False)
    assert json.dumps(summarise(ROWS[::-1]), allow_nan=False) == text


def test_noise_over_frames_counts_each_by_its_degrees_of_freedom():
    rows = [
        row("a", "valid", "valid", 10.0, nees_noise=1.0, noise_draws=4),
        row("b", "dark", "dark", nees_noise=4.0, noise_draws=2),
        row("c", "valid", "valid", 10.0, nees_noise=None, noise_draws=1),
    ]
    noise = summarise(rows)["groups"][0]["nees_noise"]
    assert (noise["n"], noise["draws"], noise["expected"]) == (2, 6, 2.0)
    # (3 x 1 + 1 x 4) / 4 = 1.75; its error from 3 x -0.75 and 1 x 2.25: sqrt(2 x 10.125) / 4.
    assert noise["mean"] == pytest.approx(1.75)
    assert noise["standard_error"] == pytest.approx(1.125)
    # Chi-squared with 8 degrees of freedom: 2.1797 and 17.5345 (any table), over 4.
    assert noise["interval"] == pytest.approx([2.1797 / 4, 17.5345 / 4], abs=1e-4)
    assert summarise(rows[:1])["groups"][0]["nees_noise"]["standard_error"] is None
    assert summarise(ROWS)["groups"][1]["nees_noise"] == {
        "n": 0, "draws": 0, "mean": None, "standard_error": None, "expected": 2.0, "interval": None,
    }  # fmt: skip


SIGMA = np.array([2e-4, 5e-5])


def draws(count: int, claimed: float = 1.0, bias: float = 0.0) -> list[Fit]:
    rng = np.random.default_rng(5)
    fits = []
    for _ in range(count):
        off = rng.normal(0.0, SIGMA) + bias
        nadir = np.array([off[0], off[1], 1.0])
        covariance = np.diag([*(claimed * SIGMA) ** 2, 0.0])
        fits.append(Fit(nadir / np.linalg.norm(nadir), covariance, 0.0, 0.0))
    return fits


def test_an_honest_covariance_gives_two_and_half_the_scatter_eight() -> None:
    """Two degrees of freedom each: the mean of 400 is 2 with a standard error of 0.1."""
    assert noise_nees(draws(400)).mean() == pytest.approx(2.0, abs=0.4)
    assert noise_nees(draws(400, bias=3e-3)).mean() == pytest.approx(2.0, abs=0.4)
    assert noise_nees(draws(400, claimed=0.5)).mean() == pytest.approx(8.0, abs=1.6)


def test_a_claim_that_cannot_be_tested_has_no_mean() -> None:
    assert mean_noise_nees(draws(5)) == pytest.approx(noise_nees(draws(5)).mean())
    assert mean_noise_nees(draws(1)) is None
    with pytest.raises(ValueError, match="at least 2"):
        noise_nees(draws(1))
    assert mean_noise_nees(draws(5, claimed=0.0)) is None
    assert mean_noise_nees(draws(5, claimed=np.nan)) is None
    assert mean_noise_nees(draws(5, bias=np.nan)) is None


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_the_exact_interval_is_the_published_one(k, n, low, high):
    """R. G. Newcombe, Statistics in Medicine 17, 857 (1998), table I, method 5 (four digits)."""
    assert proportion(k, n)["interval"] == pytest.approx([low, high], abs=6e-5)


def outcome_row(expected, status, borderline=False, false=False, estimator="e", error=None):
    return result_row(
        estimator=estimator,
        expected=expected,
        status=status,
        borderline=borderline,
        false_valid=false,
        nadir_error_arcsec=error,
    )


OUTCOMES = [
    outcome_row("valid", "valid"),
    outcome_row("valid", "dark"),
    outcome_row("valid", "valid", false=True, error=1801.0),
    outcome_row("valid", "short_arc", borderline=True),
    outcome_row("dark", "valid", borderline=True, false=True, error=1799.0),
    outcome_row("dark", "valid"),
    outcome_row("dark", "dark"),
    outcome_row("no_limb", "valid", estimator="f"),
]


def test_borderline_frames_are_not_held_against_either_answer():
    found = rates(OUTCOMES[:7])
    assert (found["availability"]["n"], found["availability"]["of"]) == (2, 3)
    assert (found["refusal"]["n"], found["refusal"]["of"]) == (1, 3)
    assert (found["bonus"]["n"], found["bonus"]["of"]) == (1, 2)
    assert found["n_borderline"] == 2


def test_a_false_claim_counts_on_a_borderline_frame_too():
    found = rates(OUTCOMES[:7])
    assert (found["false_valid"]["n"], found["false_valid"]["of"]) == (2, 4)
    assert (found["false_valid_frames"]["n"], found["false_valid_frames"]["of"]) == (2, 7)
    assert found["false_valid"]["upper_bound"] > 0.5
    assert (found["false_valid"]["beyond_limit"], found["false_valid"]["beyond_sigma"]) == (1, 1)


@pytest.mark.parametrize("expected", ["valid", "dark"])
@pytest.mark.parametrize("borderline", [False, True])
def test_a_crash_is_right_on_no_frame(expected, borderline):
    crash = outcome_row(expected, "crashed", borderline)
    assert crash.is_failure
    found = rates([*OUTCOMES[:7], crash])
    assert (found["crashed"]["n"], found["crashed"]["of"]) == (1, 8)
    assert strict_confusion([crash]) == {"borderline" if borderline else expected: {"crashed": 1}}


def test_a_claim_that_is_no_number_is_beyond_the_limit():
    assert why_false(outcome_row("valid", "valid", false=True)) == "false_beyond_limit"
    assert why_false(outcome_row("valid", "valid", error=1799.0)) is None
    assert why_false(outcome_row("valid", "valid", error=1000.0, false=True)) == "false_beyond_sigma"
    assert why_false(outcome_row("valid", "valid", error=1000.0, false=True), {"e"}) == "false_beyond_limit"


def test_the_strict_matrix_has_a_line_and_a_column_more():
    matrix = strict_confusion(OUTCOMES[:7])
    assert matrix == {
        "valid": {"valid": 1, "dark": 1, "false_beyond_limit": 1},
        "dark": {"valid": 1, "dark": 1},
        "borderline": {"short_arc": 1, "false_beyond_sigma": 1},
    }
    assert list(matrix["valid"]) == ["valid", "false_beyond_limit", "dark"]


@pytest.mark.parametrize(("k", "n"), [(0, 1), (1, 1), (3, 10), (0, 300), (10, 10)])
def test_bounds_hold_the_chance_they_state(k: int, n: int) -> None:
    """At the bounds of Clopper and Pearson what was seen, or more of it, has just the chance left outside."""
    low, high = proportion(k, n)["interval"]
    if k > 0:
        assert stats.binom.sf(k - 1, n, low) == pytest.approx(0.025, rel=1e-6)
    if k < n:
        assert stats.binom.cdf(k, n, high) == pytest.approx(0.025, rel=1e-6)
        assert stats.binom.cdf(k, n, upper_bound(k, n)) == pytest.approx(0.05, rel=1e-6)
    assert proportion(k, n)["rate"] == k / n
    assert proportion(0, 0) == {"n": 0, "of": 0, "rate": None, "interval": None}
    assert upper_bound(0, 0) is None


def seen_row(case: str, status: str, error_deg: float | None = None, **changes: Any) -> Row:
    lit = {"epoch_utc": "2026-03-20T12:00:00Z", "lit_fraction": 1.0, "sun_in_frame": False, "borderline": False}
    error = None if error_deg is None else 3600.0 * error_deg
    return result_row(**(lit | {"case": case, "status": status, "nadir_error_arcsec": error} | changes))


ORBIT = [
    seen_row("o1", "valid", 0.1),
    seen_row("o2", "valid", 0.2),
    seen_row("o3", "valid", 6.6, lit_fraction=0.4, false_valid=True),
    seen_row("o4", "dark", expected="dark", lit_fraction=0.0),
    seen_row("o5", "dark", expected="dark", lit_fraction=0.0),
]
OTHERS = [
    seen_row("sun", "sun_glare", expected="sun_glare", sun_in_frame=True),
    seen_row("space", "crashed", expected="no_limb", lit_fraction=None),
    seen_row("bright", "valid", 0.3, expected="saturated"),
]


@pytest.mark.parametrize(
    ("changes", "condition"),
    [
        ({}, module.CLEAR),
        ({"lit_fraction": 0.5}, module.TERMINATOR),
        ({"lit_fraction": 0.0}, module.NIGHT),
        ({"lit_fraction": None}, module.NO_LIMB),
        ({"expected": "short_arc"}, module.NO_LIMB),
        ({"sun_in_frame": True, "lit_fraction": 0.5}, module.SUN),
        ({"expected": "saturated"}, module.SATURATED),
        ({"epoch_utc": None, "lit_fraction": None}, module.NOT_MADE),
    ],
)
def test_what_was_in_view_has_words(changes, condition):
    assert condition_of(seen_row("a", "dark", **changes)) == condition


def test_what_does_not_work_counts_along_the_orbit_whatever_was_to_be_expected():
    line = headline(ORBIT + OTHERS, {"o1", "o2", "o3", "o4", "o5"})
    assert (line["orbit"]["n"], line["orbit"]["of"]) == (2, 5)
    assert (line["due"]["n"], line["due"]["of"]) == (2, 3)
    assert line["false"] == [[module.TERMINATOR, 1, 1]]
    assert line["crashed"] == [[module.NO_LIMB, 1, 1]]
    assert line["silent"] == [[module.NIGHT, 2, 2], [module.SUN, 1, 1]]
    assert (line["worst_arcsec"], line["n"]) == (6.6 * 3600.0, 4)


def test_who_is_told_the_pose_is_counted_apart():
    told = [seen_row(case, "valid", 0.0, estimator="told") for case in "abcd"]
    summary = summarise([*ORBIT, *told], given_pose=["told"])
    assert (summary["rates"]["false_valid"]["n"], summary["rates"]["false_valid"]["of"]) == (1, 3)
    assert [group["given_pose"] for group in summary["groups"]] == [False, True]
