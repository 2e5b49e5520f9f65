"""Results as people read them: numbers, verdicts, sentences."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from synthetic import result_row, synthetic_cases, write_run

from horizonval.frame import FrameTruth
from horizonval.report import words
from horizonval.report.load import load_run
from horizonval.report.words import ARCSEC, DEG, sentences, unit_of, verdict_of
from horizonval.scoring.summary import summarise


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.0, "0"),
        (-3e-12, "0"),
        (140.4, "140"),
        (-0.01234, "−0.0123"),
        (9.996, "10.0"),
        (123456.0, "123000"),
        (2e7, "2.00e+07"),
        (math.inf, "inf"),
    ],
)
def test_numbers(value, text):
    assert words.number(value) == text


def test_a_page_has_one_unit():
    assert unit_of([0.0, None, 3600.0]) is DEG
    assert unit_of([0.0, 35.9]) is ARCSEC
    assert unit_of([None]) is unit_of([]) is DEG
    assert (DEG.text(619.2), ARCSEC.text(12.0), DEG.text(None)) == ("0.172°", "12.0 arcsec", "–")


@pytest.mark.parametrize(
    ("expected", "status", "false", "verdict"),
    [
        ("valid", "valid", False, words.VALID),
        ("valid", "valid", True, words.FALSE_VALID),
        ("dark", "valid", False, words.BONUS),
        ("dark", "valid", True, words.FALSE_VALID),
        ("valid", "dark", False, words.MISSED),
        ("dark", "dark", False, words.REFUSED),
        ("dark", "no_limb", False, words.OTHER),
        ("dark", "crashed", False, words.CRASHED),
    ],
)
def test_verdicts(expected, status, false, verdict):
    assert verdict_of(result_row(expected=expected, status=status, false_valid=false)) is verdict


def test_a_refusal_of_a_borderline_frame_is_fair():
    assert verdict_of(result_row(expected="valid", status="dark", borderline=True)) is words.FAIR


def _truth(make_truth: Callable[..., FrameTruth], **atmosphere: Any) -> FrameTruth:
    truth = make_truth()
    air = {"profile": "us_standard", "file": None, "aerosol": "none", "refraction": False} | atmosphere
    return replace(truth, scene={**truth.scene, "atmosphere": air}, sun_visible_fraction=1.0)


def test_only_what_is_there_is_spoken_of(make_truth: Callable[..., FrameTruth]) -> None:
    assert words.accuracy_of([]) == []
    assert words.accuracy_of([_truth(make_truth)]) == [words.SUNLIGHT]
    assert words.accuracy_of([_truth(make_truth, profile="none")]) == []
    hazy = _truth(make_truth, aerosol="background")
    assert words.accuracy_of([_truth(make_truth), hazy]) == [words.SUNLIGHT, words.PARTICLES]
    bent = replace(_truth(make_truth), sun_visible_fraction=0.0, horizon_rise_m=1770.0)
    assert words.accuracy_of([bent]) == [words.SUNLIGHT, words.REFRACTION, words.NIGHT]
    infrared = replace(hazy, camera={**hazy.camera, "band": [{"kind": "thermal"}]})
    assert words.accuracy_of([infrared]) == []


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return load_run(write_run(tmp_path_factory.mktemp("sentence") / "run", synthetic_cases()))


def copies(run, factors):
    """The run with its judged estimator copied under other names, with errors so many times as large."""
    views = []
    for view in run.views:
        row = view.rows.get("altitude-free")
        rows = {}
        for name, factor in factors.items():
            if row is not None:
                error = row.nadir_error_arcsec
                rows[name] = replace(row, estimator=name, nadir_error_arcsec=error and error * factor)
        views.append(replace(view, rows=rows))
    return replace(run, views=tuple(views), estimators=tuple(factors), given_pose=())


def told(run):
    return sentences(run.judged_rows, run.judged_estimators, summarise(run.rows, run.given_pose, run.orbit)["groups"])


def test_one_that_is_told_the_pose_has_no_sentence(run):
    (text,) = told(run)
    assert text.startswith("altitude-free is right in ")
    claims = [row.nadir_error_arcsec for row in run.judged_rows if row.is_claim]
    assert f"the worst {max(claims) / 3600:.3g}" in text


def test_of_many_the_best_and_the_worst_are_named(run):
    first, last = told(copies(run, {"middle": 2.0, "worst": 3.0, "best": 1.0}))
    assert first.startswith("Of 3 estimators the best: best is right")
    assert last.startswith("The worst: worst is right")


def test_a_run_without_due_frames_says_so(run):
    empty = replace(run, views=(), given_pose=())
    assert told(empty) == ["No frame is due an answer."]
