"""An answer's form, and what a crashed estimator leaves: written anywhere, bounded, the same in every run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.answer import (
    MOST_POINTS,
    checked,
    crash,
    one_line,
    raised,
    traceback_of,
)
from horizonval.estimation.observation import Fit

FIT = Fit(nadir_cam=np.array([0.0, 0.0, 1.0]), covariance_nadir_cam=np.eye(3), roll_rad=0.1, pitch_rad=-1e-17)
REFUSAL = Refusal(Outcome.DARK, "night over 5\N{DEGREE SIGN}", np.ones((3, 2)))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"nadir_cam": np.zeros(3)}, "no direction"),
        ({"nadir_cam": np.array([0.0, np.nan, 1.0])}, "not finite"),
        ({"nadir_cam": np.zeros((3, 1))}, r"shape \(3, 1\)"),
        ({"covariance_nadir_cam": np.eye(2)}, r"shape \(2, 2\)"),
        ({"covariance_nadir_cam": 1j * np.eye(3)}, "not of numbers"),
        ({"points": np.zeros((4, 3))}, r"shape \(4, 3\)"),
        ({"points": np.zeros((2 * MOST_POINTS, 2))}, "at most"),
        ({"points": np.full((1, 2), 1e300)}, "beyond"),
        ({"roll_rad": "left"}, "of type str"),
        ({"roll_rad": True}, "of type bool"),
        ({"altitude_m": 1e300}, "beyond"),
        ({"sigma_altitude_m": float("nan")}, "not finite"),
    ],
)
def test_a_fit_outside_its_form_is_none(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        checked(replace(FIT, **changes))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"reason": 5}, "of type int"),
        ({"status": "fine"}, "'fine' is no outcome"),
        ({"status": Outcome.VALID}, "status valid"),
        ({"status": None}, "NoneType"),
        ({"points": np.zeros(3)}, "shape"),
    ],
)
def test_a_refusal_outside_its_form_is_none(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        checked(replace(REFUSAL, **changes))


def _fail(depth: int) -> None:
    if depth:
        _fail(depth - 1)
    raise ValueError(f"no limb in {object()!r}")


def _caught(depth: int = 0) -> ValueError:
    try:
        _fail(depth)
    except ValueError as e:
        return e
    raise AssertionError


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("two\nlines\tand  spaces", "two lines and spaces"),
        ("red \x1b[31m", "red \N{REPLACEMENT CHARACTER}[31m"),
        ("half \ud800 of a pair", "half \N{REPLACEMENT CHARACTER} of a pair"),
        ("<f at 0x7f00dead>", "<f at 0x...>"),
        ("cannot read '/tmp/horizonval-ab_12xyz/image.png'", "cannot read '.../image.png'"),
        ("Erdhorizont, 5\N{DEGREE SIGN} über", "Erdhorizont, 5\N{DEGREE SIGN} über"),
        ("right \N{RIGHT-TO-LEFT OVERRIDE}to left", "right \N{REPLACEMENT CHARACTER}to left"),
    ],
)
def test_a_reason_is_one_line_of_text(text: str, line: str) -> None:
    assert one_line(text) == line
    assert one_line(text).encode()


def test_a_traceback_is_the_same_in_every_run() -> None:
    first, second = traceback_of(_caught()), traceback_of(_caught())
    assert first == second
    assert "_fail" in first
    assert "_caught" not in first
    assert first.endswith("ValueError: no limb in <object object at 0x...>")
    assert f'"{__file__}"' not in first


def test_an_exception_that_cannot_be_printed() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError

    assert raised(MuteError()) == "MuteError: (which cannot be printed)"


def test_a_crash_is_an_outcome() -> None:
    refusal = crash("gone\n", b"last\x07")
    assert (refusal.status, refusal.reason) == (Outcome.CRASHED, "gone")
    assert refusal.output == "last\N{REPLACEMENT CHARACTER}"
