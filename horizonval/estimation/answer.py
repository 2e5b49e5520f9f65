"""What counts as an answer of an estimator: everything else is a crash of that estimator alone.

Plug-ins return what they like. Before anything is scored, drawn or written, an answer is taken apart and put together
of plain arrays and numbers: of one type, of the shapes that are declared, finite, within bounds that no sensor reaches
and no sum overflows beyond, and with words that can be written. An answer in its form stays the same to the bit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.last_words import one_line, tail
from horizonval.estimation.observation import Fit

MOST_POINTS = 1 << 20
"""Of one answer, and of its residuals and steps."""
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
    """Return an answer as plain data.

    Parameters
    ----------
    result : object
        What an estimator returned.

    Raises
    ------
    ValueError
        It is no answer; in one line, why.
    """
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
