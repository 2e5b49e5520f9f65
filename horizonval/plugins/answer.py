"""The form of an estimator's answer, its rounding, and the record of a crash.

**Form** (:func:`checked`). An answer is rebuilt of plain arrays and numbers: of the declared types and shapes, finite,
within bounds that no sensor reaches. Anything else counts as a crash of that estimator alone.

**Digits** (:func:`rounded`). The last bits of a least-squares fit depend on the order in which a linear algebra library
adds, hence on the processor. A fit is therefore rounded once, where it leaves its estimator:

=========================  ==================================  =====================================================
quantity                   step                                why no result is lost
=========================  ==================================  =====================================================
directions, angles         1e-12 rad (2e-7 arcsec)             the best sensor scored here is at 1e-6 rad
points, their residuals    1e-6 pixel, 1e-9 rad                the best sub-pixel edge is at 1e-3 pixel
altitude                   1e-4 m                              1e-12 rad of the angular radius at 36 000 km
covariances, deviations    10 digits of the largest element    a sample of 1e6 points knows a variance to 3 digits
=========================  ==================================  =====================================================

Arithmetic changes a fit by some 1e-16 to 1e-14 rad, so that fewer than one number in a hundred moves, by one step.

**Crashes** (:func:`crash`). Reason, printed lines and traceback are bounded, and control characters replaced. What
differs between two runs of the same code (addresses in memory, paths) is left out.
"""

from __future__ import annotations

import contextlib
import math
import re
import sys
import traceback
import unicodedata
from dataclasses import replace
from pathlib import PurePath
from types import TracebackType
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit

LONGEST_REASON = 500
LONGEST_OUTPUT = 4096
"""Characters, of what was printed and the traceback together."""
_FRAMES = 20
_TEMPORARY = re.compile(r"[^\s'\"]*/horizonval-[a-z0-9_]{8}\b")
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{4,}")
_UNSAFE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Unicode categories that steer a terminal or a page, or cannot be written."""


def crash(reason: str, output: str | bytes = "") -> Refusal:
    """Return the outcome of an estimator that gave no answer. ``output``: what was printed last, and a traceback."""
    return Refusal(Outcome.CRASHED, one_line(reason) or "no reason given", output=tail(output))


def one_line(text: str) -> str:
    """Return text as one line that can be written anywhere, cut after :data:`LONGEST_REASON` characters."""
    line = _safe(" ".join(str(text)[: 4 * LONGEST_REASON].split()))
    return line if len(line) <= LONGEST_REASON else line[: LONGEST_REASON - 3] + "..."


def tail(text: str | bytes) -> str:
    """Return the last lines of text, at most :data:`LONGEST_OUTPUT` characters that can be written anywhere."""
    if isinstance(text, bytes):
        text = text[-4 * LONGEST_OUTPUT :].decode("utf-8", "replace")
    lines = [_safe(line).rstrip() for line in text[-4 * LONGEST_OUTPUT :].replace("\r\n", "\n").split("\n")]
    joined = "\n".join(lines).strip("\n")
    if len(joined) <= LONGEST_OUTPUT:
        return joined
    cut = joined[-LONGEST_OUTPUT:]
    return cut.partition("\n")[2] or cut


def _safe(text: str) -> str:
    text = text.replace("\t", "    ")
    if not text.isascii() or not text.isprintable():
        text = "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in _UNSAFE else c for c in text)
    return _TEMPORARY.sub("...", _ADDRESS.sub("0x...", text))


def raised(error: BaseException) -> str:
    """Return the type of an exception and what it says, in one line, whatever its ``__str__`` does."""
    try:
        words = str(error)
    except BaseException:
        words = "(which cannot be printed)"
    return one_line(f"{type(error).__name__}: {words}" if words else type(error).__name__)


def traceback_of(error: BaseException, below: int = 1) -> str:
    """Return a traceback without the first frames, which are ours, and with paths as a module would be imported."""
    with contextlib.suppress(BaseException):
        start: TracebackType | None = error.__traceback__
        for _ in range(below):
            start = start.tb_next if start is not None else None
        frames = traceback.extract_tb(start, limit=-_FRAMES)
        for frame in frames:
            frame.filename = _importable(frame.filename)
        return tail("Traceback (most recent call last):\n" + "".join(frames.format()) + raised(error))
    return raised(error)


def _importable(filename: str) -> str:
    """Return a path below the place that it was imported from, else the file's name."""
    path = PurePath(filename)
    places = sorted((place for place in sys.path if place), key=len, reverse=True)
    below = next((path.relative_to(place) for place in places if path.is_relative_to(place)), None)
    return (PurePath(path.name) if below is None else below).as_posix()


MOST_POINTS = 1 << 20
"""Largest number of points, residuals or steps of one answer."""
LARGEST = {
    "nadir_cam": 1e6,
    "covariance_nadir_cam": 1e6,
    "systematic_nadir_cam": 1e6,
    "roll_rad": 1e6,
    "pitch_rad": 1e6,
    "angular_radius_rad": 1e6,
    "altitude_m": 1e13,
    "sigma_altitude_m": 1e13,
    "points": 1e9,
}
"""Largest magnitude of a number of an answer, in the unit of its name."""
_EMPTY = {"points": (0, 2), "residuals_rad": (0,), "steps": (0, 0)}


def checked(result: object) -> Fit | Refusal:
    """Return an answer as plain data; raises ``ValueError`` with a one-line reason if it is no answer."""
    if isinstance(result, Refusal):
        return _refusal(result.status, result.reason, result.points, result.output)
    if not isinstance(result, Fit):
        raise ValueError(f"it is of type {type(result).__name__}, neither Fit nor Refusal")
    nadir = _array("nadir_cam", result.nadir_cam, (3,))
    length = float(np.linalg.norm(nadir))
    if not (math.isfinite(length) and length > 0.0):
        raise ValueError("nadir_cam is no direction")
    systematic = result.systematic_nadir_cam
    return Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=_array("covariance_nadir_cam", result.covariance_nadir_cam, (3, 3)),
        roll_rad=_number("roll_rad", result.roll_rad),
        pitch_rad=_number("pitch_rad", result.pitch_rad),
        angular_radius_rad=_optional("angular_radius_rad", result.angular_radius_rad),
        altitude_m=_optional("altitude_m", result.altitude_m),
        sigma_altitude_m=_optional("sigma_altitude_m", result.sigma_altitude_m),
        points=_array("points", result.points, (None, 2)),
        residuals_rad=_array("residuals_rad", result.residuals_rad, (None,), finite=False),
        steps=_array("steps", result.steps, (None, None), finite=False),
        systematic_nadir_cam=None if systematic is None else _array("systematic_nadir_cam", systematic, (3, 3)),
        estimates="geodetic" if result.estimates == "geodetic" else "geocentric",
    )


def _refusal(status: object, reason: object, points: object, output: object) -> Refusal:
    if not isinstance(status, str) or status not in tuple(Outcome):
        raise ValueError(f"its status {_shown(status)} is no outcome")
    if Outcome(status) is Outcome.VALID:
        raise ValueError("it is a refusal with status valid")
    if not isinstance(reason, str):
        raise ValueError(f"its reason is of type {type(reason).__name__}, no text")
    words = tail(output) if isinstance(output, str) and status == Outcome.CRASHED else ""
    return Refusal(Outcome(status), one_line(reason), _array("points", points, (None, 2)), words)


def _shown(value: object) -> str:
    return repr(value[:40]) if isinstance(value, str) else f"(of type {type(value).__name__})"


def _array(name: str, value: Any, shape: tuple[int | None, ...], *, finite: bool = True) -> FloatArray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} is of {array.dtype.name}, not of numbers")
    if array.size > 2 * MOST_POINTS:
        raise ValueError(f"{name} has {array.size} numbers; at most {2 * MOST_POINTS} are read")
    if array.size == 0 and name in _EMPTY:
        return np.empty(_EMPTY[name])
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has the shape {array.shape}, where ({wanted}) was expected")
    plain = np.ascontiguousarray(array, dtype=np.float64).view(np.ndarray)
    if finite and not np.isfinite(plain).all():
        raise ValueError(f"{name} is not finite")
    if name in LARGEST and plain.size and float(np.abs(plain).max()) > LARGEST[name]:
        raise ValueError(f"{name} is beyond {LARGEST[name]:g}")
    return plain


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise ValueError(f"{name} is of type {type(value).__name__}, no number")
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{name} is not finite")
    if abs(number) > LARGEST[name]:
        raise ValueError(f"{name} is beyond {LARGEST[name]:g}")
    return number


def _optional(name: str, value: Any) -> float | None:
    return None if value is None else _number(name, value)


ANGLE_DECIMALS = 12
"""Decimals of radians and of components of unit vectors."""
POINT_DECIMALS, RESIDUAL_DECIMALS = 6, 9
ALTITUDE_DECIMALS = 4
SIGNIFICANT = 10
"""Digits of covariances and standard deviations, counted from the first digit of the largest element."""


def significant(values: FloatArray | float, digits: int = SIGNIFICANT) -> FloatArray:
    """Round a finite array to so many digits of its largest element."""
    array = np.asarray(values, dtype=np.float64)
    largest = float(np.abs(array).max(initial=0.0))
    # Below this, ten digits are beyond what powers of ten can scale.
    if largest < 1e-280:
        return np.zeros_like(array)
    return np.asarray(np.round(array, digits - 1 - math.floor(math.log10(largest))))


def rounded(fit: Fit) -> Fit:
    """Return a fit of finite numbers, rounded to the digits that are results (table above)."""

    def angle(value: float) -> float:
        return round(value, ANGLE_DECIMALS)

    systematic, sigma_altitude = fit.systematic_nadir_cam, fit.sigma_altitude_m
    return replace(
        fit,
        nadir_cam=np.round(fit.nadir_cam, ANGLE_DECIMALS),
        covariance_nadir_cam=significant(fit.covariance_nadir_cam),
        roll_rad=angle(fit.roll_rad),
        pitch_rad=angle(fit.pitch_rad),
        angular_radius_rad=None if fit.angular_radius_rad is None else angle(fit.angular_radius_rad),
        altitude_m=None if fit.altitude_m is None else round(fit.altitude_m, ALTITUDE_DECIMALS),
        sigma_altitude_m=None if sigma_altitude is None else float(significant(sigma_altitude)),
        points=np.round(fit.points, POINT_DECIMALS),
        residuals_rad=np.round(fit.residuals_rad, RESIDUAL_DECIMALS),
        steps=np.round(fit.steps, ANGLE_DECIMALS),
        systematic_nadir_cam=None if systematic is None else significant(systematic),
    )
