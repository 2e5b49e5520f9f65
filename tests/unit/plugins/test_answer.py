"""What counts as an answer: form, rounding, and the record of a crash."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from synthetic import fit_of, toy_image, truth_at

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit
from horizonval.plugins import registry
from horizonval.plugins.answer import (
    ANGLE_DECIMALS,
    MOST_POINTS,
    checked,
    crash,
    one_line,
    raised,
    rounded,
    significant,
    traceback_of,
)
from horizonval.suites.observation import observation_of

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


RUNS = 200
METHODS = ("altitude-free", "altitude-free-closed-form", "altitude-free-published", "guarded-altitude-free")


def _bytes(result):
    assert result, result.reason
    values = {field.name: getattr(result, field.name) for field in fields(result)}
    return {name: np.asarray(value).tobytes() for name, value in values.items() if value is not None}


def _elsewhere(array, generator):
    """A copy at another distance from the boundaries of cache lines and pages."""
    buffer = np.empty(array.nbytes + 4096, np.uint8)
    start = 8 * int(generator.integers(0, 512))
    copy = buffer[start : start + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def test_last_bits_of_the_arithmetic_do_not_leave_the_estimator():
    truth = truth_at(roll_deg=65.0)
    sound = fit_of(truth, error_rad=(1e-3, 0.0))
    generator = np.random.default_rng(1)

    def last_bits(value):
        return value * (1.0 + generator.integers(-4, 5, np.shape(value)) * 2.0**-52)

    def answer(observation):
        names = ("nadir_cam", "covariance_nadir_cam", "roll_rad", "pitch_rad")
        return replace(sound, **{name: last_bits(getattr(sound, name)) for name in names})

    method = Estimator("shaky", "Shaky", run=answer)
    observation = observation_of(toy_image(truth), method)
    seen = [_bytes(registry.run_safely(method, observation)) for _ in range(RUNS)]
    raw = {answer(None).nadir_cam.tobytes() for _ in range(20)}
    assert len(raw) > 10
    assert all(one == seen[0] for one in seen)


@pytest.mark.parametrize("name", METHODS)
def test_a_fit_is_the_same_bytes_wherever_its_image_lies(name):
    method = registry.get(name)
    observation = observation_of(toy_image(truth_at(roll_deg=65.0)), method)
    generator = np.random.default_rng(2)
    first, kept = _bytes(registry.run_safely(method, observation)), []
    for _ in range(8):
        kept = [*kept[-50:], np.empty(int(generator.integers(1, 4000)), np.uint8)]
        moved = replace(observation, image=_elsewhere(observation.image, generator))
        assert _bytes(registry.run_safely(method, moved)) == first


_FRESH = """
import sys
sys.path.insert(0, sys.argv[1])
import hashlib
import numpy as np
from dataclasses import replace
from test_answer import METHODS, _bytes, _elsewhere
from synthetic import toy_image, truth_at
from horizonval.plugins import registry
from horizonval.suites.observation import observation_of
generator, image, kept = np.random.default_rng(int(sys.argv[2])), toy_image(truth_at(roll_deg=65.0)), []
for _ in range(int(sys.argv[3])):
    digest = hashlib.sha256()
    for name in METHODS:
        kept = [*kept[-50:], np.empty(int(generator.integers(1, 4000)), np.uint8)]
        method = registry.get(name)
        observation = observation_of(image, method)
        moved = replace(observation, image=_elsewhere(observation.image, generator))
        digest.update(repr(sorted(_bytes(registry.run_safely(method, moved)).items())).encode())
    print(digest.hexdigest())
"""


@pytest.mark.slow
def test_200_runs_with_memory_laid_out_anew_give_one_answer():
    """Twenty processes, each with other addresses, hashes, stack and kinds of allocation, and ten runs in each."""
    here = os.path.dirname(os.path.abspath(__file__))
    tests = os.path.dirname(os.path.dirname(here))
    answers = []
    for number in range(20):
        environment = os.environ | {
            "PYTHONPATH": tests,
            "PYTHONHASHSEED": str(number),
            "MALLOC_MMAP_THRESHOLD_": str(256 << number % 12),
            "MALLOC_TOP_PAD_": str(4096 * (number % 7)),
            "MOVES_THE_STACK": "x" * (number * 37 % 4096),
        }
        command = [sys.executable, "-c", _FRESH, here, str(number), str(RUNS // 20)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        answers += done.stdout.split()
    assert len(answers) == RUNS
    assert len(set(answers)) == 1


def test_rounding_moves_no_number_by_more_than_half_a_step():
    sound = fit_of(truth_at(roll_deg=65.0), error_rad=(1e-3, 0.0))
    fit = rounded(sound)
    assert np.abs(fit.nadir_cam - sound.nadir_cam).max() <= 0.5001 * 10.0**-ANGLE_DECIMALS
    assert abs(fit.roll_rad - sound.roll_rad) <= 0.5001 * 10.0**-ANGLE_DECIMALS
    largest = np.abs(sound.covariance_nadir_cam).max()
    assert np.abs(fit.covariance_nadir_cam - sound.covariance_nadir_cam).max() <= 0.5001e-9 * largest
    assert _bytes(rounded(fit)) == _bytes(fit)


@pytest.mark.parametrize("scale", [1e-200, 1e-12, 0.999_999_999_99, 1.0, 3e5, 1e250])
def test_significant_digits_follow_the_largest_element(scale):
    generator = np.random.default_rng(3)
    array = scale * generator.uniform(-1.0, 1.0, (3, 3))
    result = significant(array)
    assert np.abs(result - array).max() <= 0.5001e-9 * np.abs(array).max()
    assert significant(result).tobytes() == result.tobytes()
