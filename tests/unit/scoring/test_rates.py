"""Rates and matrices: intervals against published ones, and who is counted where."""

from __future__ import annotations

import pytest
from synthetic import result_row

from horizonval.scoring.summary import (
    proportion,
    rates,
    strict_confusion,
    why_false,
)


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_the_exact_interval_is_the_published_one(k, n, low, high):
    """R. G. Newcombe, Statistics in Medicine 17, 857 (1998), table I, method 5 (four digits)."""
    assert proportion(k, n)["interval"] == pytest.approx([low, high], abs=6e-5)


def row(expected, status, borderline=False, false=False, estimator="e", error=None):
    return result_row(
        estimator=estimator,
        expected=expected,
        status=status,
        borderline=borderline,
        false_valid=false,
        nadir_error_arcsec=error,
    )


ROWS = [
    row("valid", "valid"),
    row("valid", "dark"),
    row("valid", "valid", false=True, error=1801.0),
    row("valid", "short_arc", borderline=True),
    row("dark", "valid", borderline=True, false=True, error=1799.0),
    row("dark", "valid"),
    row("dark", "dark"),
    row("no_limb", "valid", estimator="f"),
]


def test_borderline_frames_are_not_held_against_either_answer():
    found = rates(ROWS[:7])
    assert (found["availability"]["n"], found["availability"]["of"]) == (2, 3)
    assert (found["refusal"]["n"], found["refusal"]["of"]) == (1, 3)
    assert (found["bonus"]["n"], found["bonus"]["of"]) == (1, 2)
    assert found["n_borderline"] == 2


def test_a_false_claim_counts_on_a_borderline_frame_too():
    found = rates(ROWS[:7])
    assert (found["false_valid"]["n"], found["false_valid"]["of"]) == (2, 4)
    assert (found["false_valid_frames"]["n"], found["false_valid_frames"]["of"]) == (2, 7)
    assert found["false_valid"]["upper_bound"] > 0.5
    assert (found["false_valid"]["beyond_limit"], found["false_valid"]["beyond_sigma"]) == (1, 1)


@pytest.mark.parametrize("expected", ["valid", "dark"])
@pytest.mark.parametrize("borderline", [False, True])
def test_a_crash_is_right_on_no_frame(expected, borderline):
    crash = row(expected, "crashed", borderline)
    assert crash.is_failure
    found = rates([*ROWS[:7], crash])
    assert (found["crashed"]["n"], found["crashed"]["of"]) == (1, 8)
    assert strict_confusion([crash]) == {"borderline" if borderline else expected: {"crashed": 1}}


def test_a_claim_that_is_no_number_is_beyond_the_limit():
    assert why_false(row("valid", "valid", false=True)) == "false_beyond_limit"
    assert why_false(row("valid", "valid", error=1799.0)) is None
    assert why_false(row("valid", "valid", error=1000.0, false=True)) == "false_beyond_sigma"
    assert why_false(row("valid", "valid", error=1000.0, false=True), {"e"}) == "false_beyond_limit"


def test_the_strict_matrix_has_a_line_and_a_column_more():
    matrix = strict_confusion(ROWS[:7])
    assert matrix == {
        "valid": {"valid": 1, "dark": 1, "false_beyond_limit": 1},
        "dark": {"valid": 1, "dark": 1},
        "borderline": {"short_arc": 1, "false_beyond_sigma": 1},
    }
    assert list(matrix["valid"]) == ["valid", "false_beyond_limit", "dark"]
