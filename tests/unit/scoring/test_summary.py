"""Statistics of rows small enough to be worked out by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from synthetic import result_row

from horizonval.estimation.observation import Fit
from horizonval.scoring.row import Row
from horizonval.scoring.summary import mean_noise_nees, noise_nees, summarise


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


def test_nothing_at_all():
    nothing = summarise([])
    assert nothing.pop("rates")["false_valid"]["rate"] is None
    assert nothing == {"schema": 1, "n_cases": 0, "n_rows": 0, "groups": []}


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


def test_an_honest_covariance_gives_two_whatever_all_draws_are_off_by() -> None:
    """Two degrees of freedom each: the mean of 400 is 2 with a standard error of 0.1."""
    assert noise_nees(draws(400)).mean() == pytest.approx(2.0, abs=0.4)
    assert noise_nees(draws(400, bias=3e-3)).mean() == pytest.approx(2.0, abs=0.4)


def test_a_claim_of_half_the_scatter_gives_eight() -> None:
    assert noise_nees(draws(400, claimed=0.5)).mean() == pytest.approx(8.0, abs=1.6)


def test_a_claim_that_cannot_be_tested_has_no_mean() -> None:
    assert mean_noise_nees(draws(5)) == pytest.approx(noise_nees(draws(5)).mean())
    assert mean_noise_nees(draws(1)) is None
    with pytest.raises(ValueError, match="at least 2"):
        noise_nees(draws(1))
    assert mean_noise_nees(draws(5, claimed=0.0)) is None
    assert mean_noise_nees(draws(5, claimed=np.nan)) is None
    assert mean_noise_nees(draws(5, bias=np.nan)) is None
