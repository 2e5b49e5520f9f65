"""Score sheet of the benchmark, version 2: one number for each method, and its parts.

The sheet is arithmetic on six numbers of each frame. It has separate limits for false claims and imports nothing from
the code that makes the rows, so it does not change with that code. ``docs/howto/bench.md`` explains the rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

SHEET_VERSION = 2
FALSE_ARCSEC = 1800.0
"""Nadir error above which every claim is false."""
FREE_ARCSEC = 360.0
"""Nadir error below which no claim is false."""
FALSE_SIGMAS = 5.0
DEFAULT_SIGMA_ARCSEC = 72.0
"""Standard deviation assumed for a claim without one."""
DEFAULT_BOUND_ARCSEC = 36.0
"""Bound assumed for a frame that has none but must be answered."""
RESAMPLES = 2000


@dataclass(frozen=True)
class Answer:
    """Answer of one method on one frame.

    ``due``: the frame's bound meets what its prior accepts, and it is not borderline. ``claimed``: the method gave an
    attitude. ``error_arcsec``: nadir error; ``sigma_arcsec``: claimed total standard deviation; ``bound_arcsec``: what
    the limb allows; ``nees``: normalised error squared, with mean 2 for an honest claim.
    """

    cell: str
    frame: str
    due: bool
    claimed: bool
    error_arcsec: float | None = None
    sigma_arcsec: float | None = None
    bound_arcsec: float | None = None
    nees: float | None = None

    @property
    def is_false(self) -> bool:
        """Whether it is a claim that misleads."""
        if not self.claimed or self.error_arcsec is None:
            return False
        sigma = self.sigma_arcsec or DEFAULT_SIGMA_ARCSEC
        beyond_sigma = self.error_arcsec > FREE_ARCSEC and self.error_arcsec > FALSE_SIGMAS * sigma
        return self.error_arcsec > FALSE_ARCSEC or beyond_sigma

    @property
    def points(self) -> float:
        """Points of the frame: -1 for a false claim, up to 1 for a right claim where an answer is expected, else 0."""
        if self.is_false:
            return -1.0
        if not (self.due and self.claimed) or self.error_arcsec is None:
            return 0.0
        over_bound = self.error_arcsec / (self.bound_arcsec or DEFAULT_BOUND_ARCSEC)
        return 1.0 / (1.0 + math.log2(max(1.0, over_bound)))


def score_of(answers: Sequence[Answer]) -> float:
    """Return the score: 100 times the points over the number of frames that must be answered; 0 if there is none."""
    due = sum(answer.due for answer in answers)
    return 100.0 * math.fsum(answer.points for answer in answers) / due if due else 0.0


def sheet_of(answers: Sequence[Answer]) -> dict[str, Any]:
    """Return one method's sheet: all frames under ``all``, and each cell under its name in ``cells``."""
    cells: dict[str, list[Answer]] = {}
    for answer in answers:
        cells.setdefault(answer.cell, []).append(answer)
    return {
        "version": SHEET_VERSION,
        "all": _figures(answers),
        "cells": {cell: _figures(cells[cell]) for cell in sorted(cells)},
    }


def ranking(methods: Mapping[str, Sequence[Answer]]) -> list[dict[str, Any]]:
    """Return ``method``, ``score``, ``rank`` and ``tied`` of every method, best first; ties share the leader's rank.

    A method is tied with the leader of its group if the 95 % interval of the difference of their scores contains 0. The
    interval comes from resampling frames within cells, the same frames for both. Raises ``ValueError``: the methods did
    not see the same frames.
    """
    frames = {name: {answer.frame: answer for answer in answers} for name, answers in methods.items()}
    if len({frozenset(seen) for seen in frames.values()}) > 1:
        raise ValueError("methods can only be ranked on the same frames")
    scores = {name: score_of(answers) for name, answers in methods.items()}
    rows: list[dict[str, Any]] = []
    leader, rank = "", 0
    for place, name in enumerate(sorted(scores, key=lambda n: (-scores[n], n)), start=1):
        if not leader or not _tied(frames[leader], frames[name]):
            leader, rank = name, place
        rows.append({"method": name, "score": scores[name], "rank": rank})
    ranks = [row["rank"] for row in rows]
    return [row | {"tied": ranks.count(row["rank"]) > 1} for row in rows]


def _tied(a: Mapping[str, Answer], b: Mapping[str, Answer]) -> bool:
    cells: dict[str, list[str]] = {}
    for name in sorted(a):
        cells.setdefault(a[name].cell, []).append(name)
    random = np.random.default_rng(SHEET_VERSION)
    gained, due = np.zeros(RESAMPLES), np.zeros(RESAMPLES)
    for cell in sorted(cells):
        names = cells[cell]
        drawn = random.integers(len(names), size=(RESAMPLES, len(names)))
        gained += np.array([a[name].points - b[name].points for name in names])[drawn].sum(axis=1)
        due += np.array([float(a[name].due) for name in names])[drawn].sum(axis=1)
    low, high = np.percentile(gained / np.maximum(due, 1.0), [2.5, 97.5])
    return bool(low <= 0.0 <= high)


def _figures(answers: Sequence[Answer]) -> dict[str, Any]:
    due = [answer for answer in answers if answer.due]
    claims = [answer for answer in answers if answer.claimed]
    right = [answer for answer in due if answer.claimed and answer.error_arcsec is not None]
    errors = [answer.error_arcsec for answer in right if answer.error_arcsec is not None]
    over = [(answer.error_arcsec or 0.0) / (answer.bound_arcsec or DEFAULT_BOUND_ARCSEC) for answer in right]
    nees = [answer.nees for answer in claims if answer.nees is not None]
    return {
        "frames": len(answers),
        "due": len(due),
        "answered": sum(answer.claimed for answer in due),
        "claims": len(claims),
        "false": sum(answer.is_false for answer in claims),
        "score": score_of(answers),
        "median_error_arcsec": float(np.median(errors)) if errors else None,
        "p95_error_arcsec": float(np.percentile(errors, 95)) if errors else None,
        "median_over_bound": float(np.median(over)) if over else None,
        "mean_nees": math.fsum(nees) / len(nees) if nees else None,
    }


DPI = 110
_HEIGHT_IN, _TEXT_IN, _CELL_IN = 0.26, 3.0, 0.24


def cells_png(ranked: Sequence[Mapping[str, Any]], sheets: Mapping[str, Any]) -> bytes:
    """Return a PNG with a row for each method of :func:`ranking`, best first, and a column for each cell.

    Colour is the cell's score, from -100 (all claims false) over 0 (no claims) to 100 (the bound). Cells without a
    frame to answer are grey where the method was silent, and red where it made false claims.
    """
    from matplotlib.figure import Figure

    from horizonval.report.plots import png

    methods = [row["method"] for row in ranked]
    cells = sorted(sheets[methods[0]]["cells"])
    scores = np.array([[_score(sheets[name]["cells"][cell]) for cell in cells] for name in methods])
    width, height = _TEXT_IN + _CELL_IN * len(cells) + 0.9, 1.9 + _HEIGHT_IN * len(methods)

    def draw() -> Figure:
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.add_subplot()
        shown = axes.imshow(np.ma.masked_invalid(scores), cmap="RdYlGn", vmin=-100.0, vmax=100.0, aspect="auto")
        axes.set_facecolor("0.85")
        axes.set_xticks(np.arange(len(cells)), cells, rotation=90, fontsize=7)
        axes.set_yticks(np.arange(len(methods)), methods, fontsize=8)
        axes.set_xticks(np.arange(-0.5, len(cells)), minor=True)
        axes.set_yticks(np.arange(-0.5, len(methods)), minor=True)
        axes.grid(which="minor", color="white", linewidth=0.8)
        axes.tick_params(which="both", length=0)
        bar = figure.colorbar(shown, ax=axes, fraction=0.03, pad=0.01)
        bar.set_label("score of the cell", fontsize=8)
        bar.ax.tick_params(labelsize=7)
        return figure

    return png(draw, DPI)


def _score(cell: Mapping[str, Any]) -> float:
    """Return the score of a cell; without a frame to answer, minus the false claims per 100 frames, or NaN."""
    if cell["due"]:
        return float(cell["score"])
    return -100.0 * cell["false"] / cell["frames"] if cell["false"] else float("nan")
