"""What a crashed estimator leaves behind can be written anywhere, is bounded, and is the same in every run."""

from __future__ import annotations

import pytest

from horizonval.core.outcome import Outcome
from horizonval.estimation.answer import LONGEST_OUTPUT, LONGEST_REASON, crash, one_line, raised, tail, traceback_of


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


def test_what_is_too_long_is_cut() -> None:
    assert len(one_line("x" * 10**6)) == LONGEST_REASON
    printed = tail(b"\xff\x00" + b"line\n" * 10**5 + b"the last\n")
    assert printed.endswith("line\nthe last")
    assert len(printed) <= LONGEST_OUTPUT
    assert len(tail("y" * 10**5)) == LONGEST_OUTPUT


def test_bytes_that_are_no_text_are_replaced() -> None:
    assert tail(b"a\xffb\x00c\r\nd") == "a\N{REPLACEMENT CHARACTER}b\N{REPLACEMENT CHARACTER}c\nd"


def test_a_traceback_is_the_same_in_every_run() -> None:
    first, second = traceback_of(_caught()), traceback_of(_caught())
    assert first == second
    assert "_fail" in first
    assert "_caught" not in first
    assert first.endswith("ValueError: no limb in <object object at 0x...>")
    assert f'"{__file__}"' not in first


def test_a_deep_traceback_is_short() -> None:
    assert len(traceback_of(_caught(300))) <= LONGEST_OUTPUT


def test_an_exception_that_cannot_be_printed() -> None:
    class MuteError(Exception):
        def __str__(self) -> str:
            raise RuntimeError

    assert raised(MuteError()) == "MuteError: (which cannot be printed)"


def test_a_crash_is_an_outcome() -> None:
    refusal = crash("gone\n", b"last\x07")
    assert (refusal.status, refusal.reason) == (Outcome.CRASHED, "gone")
    assert refusal.output == "last\N{REPLACEMENT CHARACTER}"
