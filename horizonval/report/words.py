"""Results in words: numbers, units, outcomes, verdicts on rows, and sentences about estimators."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from horizonval.core.outcome import Outcome
from horizonval.frame import FrameTruth
from horizonval.scoring import limits
from horizonval.scoring.row import Row
from horizonval.scoring.summary import BEYOND_LIMIT, BEYOND_SIGMA, BORDERLINE, in_order, strict_confusion

# ------------------------------------------------------------------------------------------------- numbers and units

DASH = "\N{EN DASH}"
UNITS = {
    "_deg": "deg",
    "_px": "px",
    "_um": "µm",
    "_mm": "mm",
    "_km": "km",
    "_s": "s",
    "_h": "h",
    "_k": "K",
    "_c": "°C",
    "_e": "e",
}
"""Units by suffix of a key."""


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with the given significant digits, without exponent between 1e-4 and 1e6; a dash for None.

    Below 1e-6 of any unit everything in a report is rounding, and shown as 0.
    """
    if value is None:
        return DASH
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
    return DASH if value is None else f"{100 * value:.1f}".removesuffix(".0") + " %"


def interval(bounds: Sequence[float] | None, *, as_percent: bool = False) -> str:
    """Return ``low to high``, or an empty text."""
    if bounds is None:
        return ""
    if as_percent:
        low, high = (f"{100 * b:.1f}".removesuffix(".0") for b in bounds)
        return f"{low} to {high} %"
    return f"{number(bounds[0])} to {number(bounds[1])}"


def share(found: Mapping[str, Any]) -> dict[str, str]:
    """Return a proportion in words: ``rate``, ``of`` (n of how many) and its ``interval``."""
    if not found["of"]:
        return {"rate": DASH, "of": "none", "interval": ""}
    return {
        "rate": percent(found["rate"]),
        "of": f"{found['n']} of {found['of']}",
        "interval": interval(found["interval"], as_percent=True),
    }


def count(n: int, noun: str) -> str:
    """Return ``1 frame``, ``2 frames``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def key_words(key: str) -> str:
    """Return the words of a dotted key: its last part, the unit in brackets."""
    word = key.rpartition(".")[2]
    if word in ("width", "height"):
        return f"{word} [px]"
    for ending, unit in UNITS.items():
        if word.endswith(ending):
            return f"{word.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return word.replace("_", " ")


@dataclass(frozen=True)
class AngleUnit:
    """The common unit of all errors on a page.

    ``sign`` follows a number in a sentence, ``name`` stands in brackets; ``arcsec`` is its size in arc seconds.
    """

    name: str
    sign: str
    arcsec: float

    def of(self, arcsec: float) -> float:
        """Return an angle in this unit."""
        return arcsec / self.arcsec

    def number(self, arcsec: float | None) -> str:
        """Return an angle with three significant digits; a dash for ``None``."""
        return number(None if arcsec is None else self.of(arcsec))

    def text(self, arcsec: float | None) -> str:
        """Return an angle with its unit."""
        return DASH if arcsec is None else f"{self.number(arcsec)}{self.sign}"


DEG = AngleUnit("deg", "\N{DEGREE SIGN}", 3600.0)
ARCSEC = AngleUnit("arcsec", " arcsec", 1.0)


def unit_of(errors_arcsec: Iterable[float | None]) -> AngleUnit:
    """Return degrees; arc seconds if every error is below a hundredth of a degree."""
    largest = max((error for error in errors_arcsec if error is not None), default=math.inf)
    return ARCSEC if largest < 0.01 * DEG.arcsec else DEG


DEFAULT_SIGMA_ARCSEC = 3600.0 * math.degrees(limits.DEFAULT_SIGMA_RAD)
"""Standard deviation assumed for claims without a usable one."""


def limit_words(unit: AngleUnit) -> dict[str, str]:
    """Return the limits of false claims for the notes below the tables."""
    return {
        "limit_deg": f"{math.degrees(limits.NADIR_ERROR_LIMIT_RAD):g}",
        "likelihood_deg": f"{math.degrees(limits.LIKELIHOOD_LIMITS.nadir_error_rad):g}",
        "floor_deg": f"{math.degrees(limits.SIGMA_TEST_FLOOR_RAD):g}",
        "sigmas": f"{limits.SIGMA_LIMIT:g}",
        "default_sigma": unit.text(DEFAULT_SIGMA_ARCSEC),
    }


# --------------------------------------------------------------------------------------------- outcomes and verdicts

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


def outcome(name: str) -> str:
    """Return an outcome's name as words: ``sun glare``."""
    return name.replace("_", " ")


def meaning(name: str) -> str:
    """Return the meaning of an outcome for the frame."""
    return OUTCOME_WORDS.get(Outcome(name), name) if name in set(Outcome) else name


@dataclass(frozen=True)
class VerdictMark:
    """One kind of result by word, glyph and colour, each sufficient alone.

    ``key``: for the code of pages. ``marker``: for matplotlib. Colours are those of Okabe and Ito (2008), safe for
    common colour vision deficiencies, darkened for text on white.
    """

    key: str
    glyph: str
    label: str
    colour: str
    marker: str


FALSE_VALID = VerdictMark("false", "✖", "false claim", "#b34700", "X")
CRASHED = VerdictMark("crashed", "✱", "the estimator crashed", "#b34700", "*")
MISSED = VerdictMark("missed", "▼", "refused, though the limb is usable", "#8a6100", "v")
OTHER = VerdictMark("other", "◇", "refused, for another reason than expected", "#555555", "D")
FAIR = VerdictMark("fair", "▽", "refused, on a borderline frame", "#555555", "v")
REFUSED = VerdictMark("refused", "○", "refused, as expected", "#555555", "o")
BONUS = VerdictMark("bonus", "◐", "valid, though a refusal was expected", "#0072b2", "s")
VALID = VerdictMark("valid", "●", "valid", "#0072b2", "o")
BROKEN = VerdictMark("broken", "!", "the frame failed", "#b34700", "P")
NONE = VerdictMark("none", "–", "no result", "#555555", "_")

VERDICTS = (FALSE_VALID, CRASHED, MISSED, OTHER, FAIR, REFUSED, BONUS, VALID, BROKEN, NONE)
"""Worst first."""


def verdict_of(row: Row | None, *, broken: bool = False) -> VerdictMark:
    """Return the verdict on one row; ``broken``: the frame itself failed, regardless of the estimator.

    A crash is equally bad on every frame. On a borderline frame refusals and true claims are both acceptable.
    """
    if broken:
        return BROKEN
    if row is None:
        return NONE
    if row.false_valid:
        return FALSE_VALID
    if row.is_claim:
        return VALID if row.borderline or row.is_due else BONUS
    if row.status == Outcome.CRASHED:
        return CRASHED
    if row.borderline:
        return FAIR
    if row.is_due:
        return MISSED
    return REFUSED if row.status == row.expected else OTHER


_FALSE_WORDS = {
    BEYOND_LIMIT: "false: beyond the limit of the error",
    BEYOND_SIGMA: f"false: beyond {limits.SIGMA_LIMIT:g} of its own sigma",
}


def confusion_tables(
    rows: Sequence[Row], estimators: Sequence[str], likelihood: Collection[str] = ()
) -> list[dict[str, Any]]:
    """Return tables of expected against reported outcomes, one for each estimator over all cameras, counted strictly.

    Each has ``estimator``, ``n``, ``reported`` (the columns' words) and ``lines``: ``expected``, ``meaning``,
    ``total``, ``apart`` (borderline frames, always the last line) and ``cells`` of ``n``, ``share`` of the line,
    ``kind`` (a class of the style sheet) and ``glyph``.
    """
    return [_confusion_table([row for row in rows if row.estimator == name], name, likelihood) for name in estimators]


def _confusion_table(rows: Sequence[Row], estimator: str, likelihood: Collection[str]) -> dict[str, Any]:
    counts = strict_confusion(rows, likelihood)
    columns = list(in_order({reported: 1 for line in counts.values() for reported in line}))
    lines = []
    for expected, found in counts.items():
        total, apart, cells = sum(found.values()), expected == BORDERLINE, []
        for reported in columns:
            n = found.get(reported, 0)
            kind, glyph = _cell_look(expected, reported) if n else ("zero", "")
            cells.append({"n": n, "share": n / total, "kind": kind, "glyph": glyph})
        words = "either answer is fair" if apart else meaning(expected)
        lines.append({"expected": expected, "meaning": words, "cells": cells, "total": total, "apart": apart})
    reported_words = [_FALSE_WORDS.get(name, outcome(name)) for name in columns]
    return {"estimator": estimator, "n": len(rows), "reported": reported_words, "lines": lines}


def _cell_look(expected: str, reported: str) -> tuple[str, str]:
    """Return the class of a cell and its glyph."""
    if reported in _FALSE_WORDS:
        return "alarm", FALSE_VALID.glyph
    if reported == Outcome.CRASHED:
        return "alarm", CRASHED.glyph
    if expected == BORDERLINE:
        return "fair", ""
    if reported == Outcome.VALID:
        return ("same", VALID.glyph) if expected == Outcome.VALID else ("wrong", BONUS.glyph)
    if expected == Outcome.VALID:
        return "wrong", MISSED.glyph
    return ("same", REFUSED.glyph) if reported == expected else ("other", OTHER.glyph)


# -------------------------------------------------------------------------------------------------------- sentences

_MOST_PLACES = 3


def by_camera(groups: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the groups of a summary by camera, so that methods on the same frames are next to each other.

    Groups without a usable frame or a claim come after the others, estimators that receive the true pose last.
    """

    def order(group: Mapping[str, Any]) -> tuple[bool, bool, str, str]:
        is_empty = not group["headline"]["due"]["of"] and not group["n_valid"]
        return bool(group["given_pose"]), is_empty, group["camera"], group["estimator"]

    return sorted(groups, key=order)


def prior_words(prior: Mapping[str, Any]) -> str:
    """Return a table ``[prior]`` in words: what methods may use in addition to the image."""
    words = []
    for key, value in prior.items():
        values = value if isinstance(value, list) else [value]
        # Equal values of three axes are said once.
        text = ", ".join(dict.fromkeys(f"{one:g}" if isinstance(one, float) else str(one) for one in values))
        name, of, unit = key.partition("_sigma_")
        words.append(f"{name.replace('_', ' ')} to {text} {unit}" if of else f"{name.replace('_', ' ')} {text}")
    return "; ".join(words)


def headline(group: Mapping[str, Any], unit: AngleUnit) -> str:
    """Return the summary of an estimator with a camera: rate, exceptions, largest error.

    ``group``: one of the summary's.
    """
    line = group["headline"]
    orbit, due = line["orbit"], line["due"]
    if orbit["of"]:
        parts = [f"works {percent(orbit['rate'])} of the orbit ({orbit['n']} of {count(orbit['of'], 'frame')})"]
    elif due["of"]:
        bounds = interval(due["interval"], as_percent=True)
        parts = [f"works in {percent(due['rate'])} of the usable frames ({due['n']} of {due['of']}; "
                 f"{bounds} with 95 %)"]  # fmt: skip
    else:
        parts = [f"none of {count(group['n'], 'frame')} is usable"]
    for key, words in (("crashed", "crashes"), ("false", "false"), ("silent", "no answer")):
        if line[key]:
            parts.append(f"{words} {_places(line[key])}")
    if group["claims_without_sigma"]:
        parts.append(f"{count(group['claims_without_sigma'], 'claim')} without uncertainty")
    if line["n"]:
        parts.append(f"worst {unit.text(line['worst_arcsec'])} (n = {line['n']})")
    return "; ".join(parts) + "."


def _places(found: Sequence[tuple[str, int, int]]) -> str:
    words = [f"{condition} ({n} of {of})" for condition, n, of in found[:_MOST_PLACES]]
    if rest := sum(n for _, n, _ in found[_MOST_PLACES:]):
        words.append(f"elsewhere ({rest})")
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


SUNLIGHT = (
    "Scattered sunlight: radiance within 1 % of independent Monte Carlo, from a high Sun to one 18° below the horizon, "
    "molecules and ozone; tables of multiple scattering read over the ellipsoid add less than 0.5 %."
)
PARTICLES = (
    "Particles: 1 % by day (1.5 % in dense layers with sharp edges), 1 % until the Sun is 2° below the horizon; 5 % in "
    "dark rays until 12°, after an eruption 8 %."
)
REFRACTION = (
    "Refraction: single rays 0.1 % for light scattered once; frames of 128 nodes 0.5 % in bright pixels with the Sun "
    "up, 0.9 % in twilight, 4 % in pixels a thousand times darker; light scattered more than once is not refracted."
)
NIGHT = "Airglow is known to a factor of two, the Moon's brightness to 3 %."


def accuracy_of(truths: Iterable[FrameTruth]) -> list[str]:
    """Return the renderer's tested accuracy for the frames' content; empty without scattered sunlight."""
    solar = [t for t in truths if any(band["kind"] == "solar" for band in t.camera.get("band", []))]
    # Frames of other versions may lack keys.
    airs = [{"profile": "none", "file": None} | t.scene.get("atmosphere", {}) for t in solar]
    found = {
        SUNLIGHT: any(air["profile"] != "none" or air["file"] is not None for air in airs),
        PARTICLES: any(air.get("aerosol", "none") != "none" or air["file"] is not None for air in airs),
        REFRACTION: any(t.horizon_rise_m > 0.0 or air.get("refraction") for t, air in zip(solar, airs, strict=True)),
        NIGHT: any(t.sun_visible_fraction == 0.0 for t in solar),
    }
    return [text for text, holds in found.items() if holds]
