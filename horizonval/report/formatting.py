"""Numbers and outcomes as people read them."""

from __future__ import annotations

import math

from horizonval.core.outcome import Outcome

OUTCOME_WORDS = {
    Outcome.VALID: "an attitude",
    Outcome.NO_LIMB: "no horizon in view",
    Outcome.SHORT_ARC: "too little horizon in view",
    Outcome.AMBIGUOUS: "more than one answer",
    Outcome.SUN_GLARE: "the Sun in the frame",
    Outcome.DARK: "too little of the horizon is lit",
    Outcome.SATURATED: "saturated",
    Outcome.NOT_CONVERGED: "the fit did not converge",
    Outcome.BAD_INPUT: "unusable input",
    Outcome.CRASHED: "the estimator crashed",
}


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits, without exponent between 1e-4 and 1e6; a dash for ``None``.

    Below one millionth, of an arc second or whatever, everything in a report is rounding, and shown as 0.
    """
    if value is None:
        return "–"
    if not math.isfinite(value):
        return str(value)
    if abs(value) < 1e-6:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}".replace("-", "−")
    rounded = float(f"{value:.{digits}g}")
    places = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    return f"{rounded:.{places}f}".replace("-", "−")


def percent(value: float | None) -> str:
    """Return a share as per cent, one decimal unless whole."""
    if value is None:
        return "–"
    text = f"{100 * value:.1f}".removesuffix(".0")
    return f"{text} %"


def interval(bounds: list[float] | None, *, as_percent: bool = False) -> str:
    """Return ``low to high``, or nothing."""
    if bounds is None:
        return ""
    if as_percent:
        low, high = (f"{100 * b:.1f}".removesuffix(".0") for b in bounds)
        return f"{low} to {high} %"
    return f"{number(bounds[0])} to {number(bounds[1])}"


def count(n: int, noun: str) -> str:
    """Return ``1 frame``, ``2 frames``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def outcome(name: str) -> str:
    """Return an outcome's name as words: ``sun glare``."""
    return name.replace("_", " ")


def meaning(name: str) -> str:
    """Return what an outcome says about the frame."""
    return OUTCOME_WORDS.get(Outcome(name), name) if name in set(Outcome) else name
