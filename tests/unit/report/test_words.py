"""Results as people read them: numbers, verdicts, sentences."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from synthetic import result_row

from horizonval.frame import FrameTruth
from horizonval.report import words
from horizonval.report.words import ARCSEC, DEG, unit_of, verdict_of


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
