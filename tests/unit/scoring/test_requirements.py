"""Requirements: which frames count, the verdicts, and the frames that are missing."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import stats

from horizonval.scoring.requirements import Answers, frames_needed, judge, judged, proportion, verdict_of, write
from horizonval.spec.requirement import Requirement


def answers(error_deg, *, roll=0.6, pitch=0.8, false=0, seconds=0.1, cluster=None):
    """Answers with these nadir errors [deg], NaN for a refusal; the first ``false`` of them are false claims."""
    error = np.asarray(error_deg, dtype=np.float64)
    n = len(error)
    return Answers(
        cluster=np.arange(n) if cluster is None else np.asarray(cluster),
        claimed=np.isfinite(error),
        false=np.arange(n) < false,
        error_deg=error,
        roll_deg=-roll * error,
        pitch_deg=pitch * error,
        seconds=np.full(n, seconds),
    )


def counted(found):
    return [(one["axis"], one["n"], one["of"]) for one in found["evidence"]]


MIXED = answers([0.01] * 6 + [0.12] * 2 + [np.nan] * 2, false=1, seconds=0.3)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"error_deg": 0.1, "availability": 0.9}, [("nadir", 6, 10)]),
        ({"error_deg": 0.1, "n_sigma": 3}, [("nadir", 6, 8)]),
        ({"error_deg": 0.1, "quantile": 0.95, "axis": "roll"}, [("roll", 8, 8)]),
        ({"error_deg": 0.08, "quantile": 0.95, "axis": "each"}, [("roll", 8, 8), ("pitch", 6, 8)]),
        ({"availability": 0.9}, [("", 8, 10)]),
        ({"false_claims": 0.01}, [("", 7, 8)]),
        ({"latency_s": 0.25}, [("", 0, 10)]),
    ],
)
def test_the_frames_that_count(keys, expected):
    assert counted(judge(Requirement(id="R", **keys), MIXED)) == expected


@pytest.mark.parametrize(("misses", "needed"), [(0, 299), (1, 473), (2, 628), (3, 773)])
def test_frames_that_show_99_percent(misses, needed):
    """The numbers of the binomial test at 95 % confidence, which tables of acceptance sampling print."""
    assert frames_needed(0.99, 0.95, misses) == needed
    assert stats.binom.cdf(misses, needed, 0.01) <= 0.05 < stats.binom.cdf(misses, needed - 1, 0.01)


def test_three_sigma_at_95_percent_takes_1108_frames():
    required = Requirement(id="R", error_deg=0.1, n_sigma=3)
    assert required.share == pytest.approx(0.9973002, abs=1e-7)
    assert frames_needed(required.share) == 1109
    assert judge(required, answers([0.01] * 1109))["verdict"] == "meets"
    found = judge(required, answers([0.01] * 1000))
    assert (found["verdict"], found["evidence"][0]["more"]) == ("open", 109)


def test_the_worst_axis_decides():
    required = Requirement(id="R", error_deg=0.07, quantile=0.9, axis="each")
    found = judge(required, answers([0.1] * 100))
    assert [one["verdict"] for one in found["evidence"]] == ["meets", "fails"]
    assert found["verdict"] == "fails"


def test_bounds_are_those_of_the_binomial_test():
    found = proportion(np.arange(50) < 45, np.arange(50), 0.9)
    exact = stats.binomtest(45, 50).proportion_ci(0.9)
    assert found["interval"] == pytest.approx([exact.low, exact.high], rel=1e-12)
    assert found["lower"] == pytest.approx(stats.binomtest(45, 50, alternative="greater").proportion_ci(0.9).low)
    assert verdict_of(proportion(np.ones(0, bool), np.zeros(0, int)), 0.9) == "open"


def test_frames_of_one_flight_are_worth_one():
    required = Requirement(id="R", availability=0.9)
    assert judge(required, answers([0.01] * 100))["verdict"] == "meets"
    found = judge(required, answers([0.01] * 100, cluster=np.repeat(np.arange(5), 20)))
    assert (found["verdict"], found["evidence"][0]["effective"], found["evidence"][0]["more"]) == ("open", 5.0, 24)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "give one of"),
        ({"error_deg": 0.1}, "needs one of n_sigma"),
        ({"error_deg": 0.1, "n_sigma": 3, "quantile": 0.9}, "needs one of n_sigma"),
        ({"error_deg": 0.1, "n_sigma": 3, "latency_s": 1.0}, "give one of"),
        ({"false_claims": 0.1, "availability": 0.9}, "take availability out"),
        ({"latency_s": 1.0, "n_sigma": 3}, "not with n_sigma"),
        ({"availability": 0.9, "axis": "roll"}, "axis goes with error_deg"),
    ],
)
def test_a_requirement_is_one_limit(keys, message):
    with pytest.raises(ValidationError, match=message):
        Requirement(id="R", **keys)


def test_the_files_say_the_same(tmp_path):
    required = [
        Requirement(id="R1", error_deg=0.1, availability=0.5, text="a | b"),
        Requirement(id="R2", availability=0.999),
        Requirement(id="R3", false_claims=0.01),
    ]
    result = judged(required, {"camera, method": answers([0.01] * 20, false=10)})
    json_file, page, junit = write(tmp_path, "suite", result)
    assert json.loads(json_file.read_text())["groups"] == result["groups"]
    assert [one["verdict"] for one in result["groups"][0]["judged"]] == ["meets", "open", "fails"]
    lines = page.read_text().splitlines()
    assert "| camera, method | R3 | not met | 10 of 20 frames, bounds 30.2 and 69.8 % |" in lines
    assert any(line.startswith("| camera, method | R2 | not shown | 20 of 20") for line in lines)
    suite = ElementTree.parse(junit).getroot()[0]
    assert {key: suite.get(key) for key in ("tests", "failures", "skipped", "errors")} == {
        "tests": "3", "failures": "1", "skipped": "1", "errors": "0",
    }  # fmt: skip
