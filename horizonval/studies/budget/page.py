"""The page of a pointing budget."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from horizonval.core.json_types import JsonObject
from horizonval.report import page, plots
from horizonval.report.plots import COLOURS, GREY, LINE_STYLES, SMALL, Draw

AXES = ("roll", "pitch")


def text_of(result: JsonObject) -> str:
    """Return the page as text."""
    figures = [_figures(budget) for budget in result["budgets"]]
    return page.render(
        "budget.html",
        title=f"{result['suite']}: pointing budget",
        heading=f"{result['suite']}: pointing budget",
        version=result["version"],
        about=[f"suite {result['suite']}"],
        folder=Path(__file__).parent,
        result=result,
        budgets=list(zip(result["budgets"], figures, strict=True)),
        axes=AXES,
        filters={"combine": lambda one, other: {**one, **other}},
    )


def _figures(budget: JsonObject) -> list[dict[str, Any]]:
    made = [
        plots.figure(
            "Contributions",
            "Bars: standard deviation over all frames and flights; diamonds: the mean's size.",
            _bars(budget),
            8.0,
            1.2 + 0.34 * (len(budget["rows"]) + 1),
        )
    ]
    if any(budget["whole"]["axes"][axis]["curve"] for axis in AXES):
        made.append(
            plots.figure(
                "Correlation in time",
                "Autocorrelation of the whole error along the flight; the dotted line is 1/e.",
                _curves(budget),
                6.0,
                3.6,
            )
        )
    return made


def _bars(budget: JsonObject) -> Draw:
    def draw(figure: Figure) -> None:
        rows = [*budget["rows"], {"title": "total", **budget["whole"]}]
        panel = figure.subplots()
        place = np.arange(len(rows))[::-1]
        for i, axis in enumerate(AXES):
            values = [row["axes"][axis]["mixed"] or 0.0 for row in rows]
            means = [abs(row["axes"][axis]["mean"] or 0.0) for row in rows]
            at = place + (0.19 if i == 0 else -0.19)
            panel.barh(at, values, 0.36, color=COLOURS[i], hatch=("", "//")[i], edgecolor="white", label=axis)
            panel.plot(means, at, ls="", marker="D", ms=3.5, color=GREY)
        panel.set_yticks(place, [row["title"] for row in rows])
        panel.set_xlabel("error [arcsec]")
        panel.grid(axis="y", visible=False)
        panel.legend(fontsize=SMALL, frameon=False)

    return draw


def _curves(budget: JsonObject) -> Draw:
    def draw(figure: Figure) -> None:
        panel = figure.subplots()
        for i, axis in enumerate(AXES):
            curve = np.array(budget["whole"]["axes"][axis]["curve"] or np.zeros((0, 3)))
            panel.plot(curve[:, 0], curve[:, 1], LINE_STYLES[i], marker="os"[i], ms=3, color=COLOURS[i], label=axis)
        panel.axhline(np.exp(-1.0), color=GREY, ls=":", lw=1.0)
        panel.axhline(0.0, color=GREY, lw=0.8)
        panel.set_xlabel("time difference [s]")
        panel.set_ylabel("autocorrelation")
        panel.legend(fontsize=SMALL, frameon=False)

    return draw
