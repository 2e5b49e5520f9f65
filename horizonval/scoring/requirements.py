"""Requirements judged by a run's rows: met, not met, or not shown, with the frames that are missing.

Every requirement is a share of frames that must keep a limit (:mod:`horizonval.spec.requirement`). It is *met* if the
one-sided lower bound of the share exceeds what is required, *not met* if the upper bound is below it, and *not shown*
in between. Bounds are Clopper and Pearson's (Biometrika 26, 404, 1934). For samples of one flight the effective
sample size, n over the design effect, replaces n (E. L. Korn and B. I. Graubard, Survey Methodology 24, 193, 1998); if
all frames have the same outcome, the variation between flights is unknown, and every flight counts once. Bounds are not
adjusted for the number of requirements.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core import atomic, junit
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.scoring.row import Row
from horizonval.spec.requirement import Requirement
from horizonval.store.folder import write_json

Verdict = Literal["meets", "open", "fails"]
WORDS: dict[Verdict, str] = {"meets": "met", "open": "not shown", "fails": "not met"}
BoolArray = NDArray[np.bool_]
CONFIDENCE = 0.95
ARCSEC_PER_DEG = 3600.0
MOST_FRAMES = 10**7
"""Largest number of missing frames that is searched."""


@dataclass(frozen=True, kw_only=True)
class Answers:
    """The outcomes of one method in frames that belong together; all arrays have shape (n,).

    ``cluster``: index of the frame's flight, or of the frame. ``claimed``, ``false``: answered; false claim.
    ``error_deg``, ``roll_deg``, ``pitch_deg``: errors of claims, else NaN. ``seconds``: processor time of the
    estimate, NaN where it was not timed.
    """

    cluster: NDArray[np.int64]
    claimed: BoolArray
    false: BoolArray
    error_deg: FloatArray
    roll_deg: FloatArray
    pitch_deg: FloatArray
    seconds: FloatArray

    def within(self, error_deg: float, axis: str = "nadir") -> BoolArray:
        """Return which frames have an answer with at most this error."""
        errors = {"nadir": self.error_deg, "roll": self.roll_deg, "pitch": self.pitch_deg}[axis]
        return self.claimed & (np.abs(np.nan_to_num(errors, nan=np.inf)) <= error_deg)


def columns_of(rows: Sequence[Row]) -> dict[str, NDArray]:
    """Return the columns of :class:`Answers` that rows have."""

    def degrees(values: Sequence[float | None]) -> FloatArray:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64) / ARCSEC_PER_DEG

    return {
        "claimed": np.array([row.is_claim for row in rows], dtype=np.bool_),
        "false": np.array([bool(row.false_valid) for row in rows], dtype=np.bool_),
        "error_deg": degrees([row.nadir_error_arcsec for row in rows]),
        "roll_deg": degrees([row.roll_error_arcsec for row in rows]),
        "pitch_deg": degrees([row.pitch_error_arcsec for row in rows]),
    }


def proportion(flags: BoolArray, cluster: NDArray[np.int64], confidence: float = CONFIDENCE) -> JsonObject:
    """Return a share with its two-sided interval and its one-sided bounds; inputs have shape (n,).

    The result has ``n`` (set flags), ``of``, ``rate``, ``interval``, ``lower``, ``upper`` (each one-sided), and
    ``effective`` (sample size); all but the counts are None for 0 of 0.
    """
    n, k = int(flags.size), int(np.count_nonzero(flags))
    if n == 0:
        none = dict.fromkeys(("rate", "interval", "lower", "upper", "effective"))
        return {"n": 0, "of": 0, **none}
    effective = effective_size(flags, cluster)
    rate = k / n
    low, high = _bounds(rate, effective, (1.0 - confidence) / 2.0)
    lower, upper = _bounds(rate, effective, 1.0 - confidence)
    return {
        "n": k,
        "of": n,
        "rate": rate,
        "interval": [low, high],
        "lower": lower,
        "upper": upper,
        "effective": effective,
    }


def effective_size(flags: BoolArray, cluster: NDArray[np.int64]) -> float:
    """Return the number of independent frames equivalent to a sample, at most its size."""
    n = int(flags.size)
    _, index = np.unique(cluster, return_inverse=True)
    clusters = int(index.max()) + 1
    if clusters == n:
        return float(n)
    rate = float(np.mean(flags))
    if rate in (0.0, 1.0) or clusters == 1:
        return float(clusters)
    excess = np.bincount(index, weights=flags - rate)
    variance = clusters / (clusters - 1.0) * float(np.sum(excess**2)) / n**2
    if variance == 0.0:
        return float(n)
    return min(float(n), rate * (1.0 - rate) / variance)


def _bounds(rate: float, n: float, tail: float) -> tuple[float, float]:
    """Return Clopper and Pearson's bounds, each with the tail probability ``tail``."""
    k = rate * n
    low = 0.0 if rate == 0.0 else float(stats.beta.ppf(tail, k, n - k + 1.0))
    high = 1.0 if rate == 1.0 else float(stats.beta.ppf(1.0 - tail, k + 1.0, n - k))
    return low, high


def verdict_of(found: Mapping[str, float | None], required: float) -> Verdict:
    """Return the verdict on a share (:func:`proportion`) for the required one."""
    if found["lower"] is None or found["upper"] is None:
        return "open"
    if found["lower"] >= required:
        return "meets"
    return "fails" if found["upper"] < required else "open"


def frames_needed(required: float, confidence: float = CONFIDENCE, misses: float = 0.0) -> int | None:
    """Return the number of independent frames that shows a share, with this many misses; None above ten million."""
    tail = 1.0 - confidence
    if misses == 0.0:
        return math.ceil(math.log(tail) / math.log(required) - 1e-9)
    low, high = math.ceil(misses), MOST_FRAMES
    if float(stats.beta.ppf(tail, high - misses, misses + 1.0)) < required:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        shows = middle > misses and float(stats.beta.ppf(tail, middle - misses, misses + 1.0)) >= required
        low, high = (low, middle) if shows else (middle, high)
    return high


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """Return the verdict on several things that must all be met."""
    return next((verdict for verdict in ("fails", "open") if verdict in verdicts), "meets")


def judge(requirement: Requirement, answers: Answers) -> JsonObject:
    """Return the verdict on a requirement with its evidence.

    The result has ``id``, ``verdict`` and ``evidence``: for each axis ``axis`` (empty where the requirement has none)
    and ``verdict`` with the columns of :func:`proportion`, and ``more``: how many further independent frames without a
    miss would show the requirement, None where the verdict is no longer open or it would take over ten million.
    """
    axes = {"each": ("roll", "pitch")}.get(requirement.axis, (requirement.axis,))
    evidence = []
    for axis in axes:
        counted = answers.claimed
        if requirement.error_deg is not None:
            passed = answers.within(requirement.error_deg, axis)
            counted = np.ones_like(counted) if requirement.availability is not None else counted
        elif requirement.false_claims is not None:
            passed = ~answers.false
        elif requirement.latency_s is not None:
            counted = np.isfinite(answers.seconds)
            passed = np.nan_to_num(answers.seconds, nan=np.inf) <= requirement.latency_s
        else:
            passed, counted = answers.claimed, np.ones_like(counted)
        found = proportion(passed[counted], answers.cluster[counted], requirement.confidence)
        verdict = verdict_of(found, requirement.share)
        more = None
        if verdict == "open":
            size = found["effective"] or 0.0
            misses = (1.0 - (found["rate"] if found["rate"] is not None else 1.0)) * size
            needed = frames_needed(requirement.share, requirement.confidence, misses)
            more = None if needed is None else max(needed - math.floor(size), 1)
        shown = axis if requirement.error_deg is not None else ""
        evidence.append({"axis": shown, "verdict": verdict, **found, "more": more})
    return {"id": requirement.id, "verdict": worst([one["verdict"] for one in evidence]), "evidence": evidence}


def judged(requirements: Sequence[Requirement], groups: Mapping[str, Answers]) -> JsonObject:
    """Return the verdicts on all requirements by group, such as a design, or a method with a camera."""
    return {
        "requirements": [
            {"id": one.id, "words": one.in_words, "text": one.text, "share": one.share, "confidence": one.confidence}
            for one in requirements
        ],
        "groups": [
            {"name": name, "verdict": worst([one["verdict"] for one in found]), "judged": found}
            for name, answers in groups.items()
            for found in [[judge(one, answers) for one in requirements]]
        ],
    }


def sentence(found: JsonObject) -> str:
    """Return the evidence of a judged requirement in words."""
    return "; ".join(_evidence(one) for one in found["evidence"])


def _evidence(one: JsonObject) -> str:
    axis = f"{one['axis']}: " if one["axis"] not in ("", "nadir") else ""
    if not one["of"]:
        return f"{axis}no frame to count"
    text = f"{axis}{one['n']} of {one['of']} frames, bounds {100 * one['lower']:.4g} and {100 * one['upper']:.4g} %"
    if one["effective"] < one["of"] - 0.5:
        text += f", worth {one['effective']:.0f} independent frames"
    if one["verdict"] != "open":
        return text
    return text + ("" if one["more"] is None else f", {one['more']} more without a miss would show it")


MOST_NAMED = 4


def lines_of(result: JsonObject) -> list[str]:
    """Return a line for each requirement: who meets it, who does not, and for whom it is not shown."""
    lines = []
    for i, one in enumerate(result["requirements"]):
        parts = []
        for verdict, words in WORDS.items():
            names = [group["name"] for group in result["groups"] if group["judged"][i]["verdict"] == verdict]
            if names:
                more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
                parts.append(f"{words} by {' / '.join(names[:MOST_NAMED])}{more}")
        lines.append(f"requirement {one['id']} ({one['words']}): {'; '.join(parts)}")
    return lines


FILES = ("requirements.json", "requirements.md", "requirements.xml")


def write(folder: Path, title: str, result: JsonObject) -> list[Path]:
    """Write the verdicts as JSON, Markdown and JUnit XML (:data:`FILES`); return the files."""
    paths = [folder / name for name in FILES]
    write_json(paths[0], result)
    atomic.write_text(paths[1], _markdown(title, result))
    outcomes: dict[Verdict, Literal["pass", "failure", "skipped"]] = {
        "meets": "pass", "fails": "failure", "open": "skipped",
    }  # fmt: skip
    words = {one["id"]: one["words"] for one in result["requirements"]}
    cases = [
        junit.TestCase(
            group["name"],
            f"{found['id']}: {words[found['id']]}",
            outcomes[found["verdict"]],
            WORDS[found["verdict"]],
            sentence(found),
        )
        for group in result["groups"]
        for found in group["judged"]
    ]
    junit.write(paths[2], title, {}, cases)
    return paths


def _markdown(title: str, result: JsonObject) -> str:
    lines = [f"# {title}: requirements", "", "| id | requirement | confidence | text |", "|---|---|---|---|"]
    for one in result["requirements"]:
        text = one["text"].replace("|", "\\|").replace("\n", " ")
        lines.append(f"| {one['id']} | {one['words']} | {100 * one['confidence']:g} % | {text} |")
    lines += ["", "| | requirement | verdict | evidence |", "|---|---|---|---|"]
    for group in result["groups"]:
        for found in group["judged"]:
            lines.append(f"| {group['name']} | {found['id']} | {WORDS[found['verdict']]} | {sentence(found)} |")
    return "\n".join([*lines, ""])
