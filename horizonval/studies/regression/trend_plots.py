"""Figures of the page: the gates of the night side by side, and the trend of the nights before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from horizonval.report.plots import Draw
from horizonval.studies.regression.statistics.steps import pieces

LOOKS = {
    "PASS": ("#0072b2", "o", "full"),
    "FAIL": ("#b34700", "X", "full"),
    "IMPROVED": ("#009e73", "^", "full"),
    "INCONCLUSIVE": ("#8a6100", "o", "none"),
}
"""Colour and mark of each verdict; the marks tell them apart without colour."""
CLIP = 3.0
MOST_LABELS = 12


def gates_in_margins(gates: Sequence[Mapping[str, Any]]) -> Draw:
    """Every gate's estimate with its 95 % bounds, in units of its margin: what lies right of 1 does not pass."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.axvspan(-1, 1, color="#0072b2", alpha=0.07, linewidth=0)
        axes.axvline(0, color="#555b63", linewidth=0.8)
        axes.axvline(1, color="#b34700", linewidth=1.0, linestyle="--")
        if any(gate["two_sided"] for gate in gates):
            axes.axvline(-1, color="#b34700", linewidth=0.8, linestyle=":")
        seen = set()
        for y, gate in enumerate(gates):
            estimate, (colour, mark, fill) = gate["estimate"], LOOKS[gate["verdict"]]
            if estimate is None:
                axes.text(0.05, y, "too few scenes", va="center", color=colour)
                continue
            value, low, high = (
                float(np.clip(estimate[key] / gate["margin"] if estimate[key] is not None else CLIP, -CLIP, CLIP))
                for key in ("value", "lower95", "upper95")
            )
            label = gate["verdict"] if gate["verdict"] not in seen else None
            seen.add(gate["verdict"])
            axes.plot([low, high], [y, y], color=colour, linewidth=2)
            axes.plot(value, y, mark, color=colour, fillstyle=fill, markersize=8, label=label, linestyle="none")
        axes.set_yticks(range(len(gates)), [gate["name"] for gate in gates])
        axes.set_ylim(len(gates) - 0.4, -0.6)
        axes.set_xlim(-CLIP - 0.1, CLIP + 0.1)
        axes.set_xlabel("change for the worse, over the margin (1 is the margin; beyond 3 drawn at 3)")
        if seen:
            figure.legend(loc="outside upper right", ncols=len(seen))

    return draw


def trend(name: str, one: Mapping[str, Any], verdicts: Mapping[str, str]) -> Draw:
    """One figure over the nights, with its levels between steps and the verdict of each night as its mark."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        x = np.arange(len(one["values"]))
        for verdict, (colour, mark, fill) in LOOKS.items():
            own = [i for i, night in enumerate(one["nights"]) if verdicts.get(night) == verdict]
            if own:
                values = [one["values"][i] for i in own]
                axes.plot(
                    own, values, mark, color=colour, fillstyle=fill, linestyle="none", label=verdict, markersize=5
                )
        parts = pieces(one["values"])
        for part in parts:
            axes.plot([part.start - 0.4, part.stop - 0.6], [part.level] * 2, color="#1b1f24", linewidth=1.6)
        for part in parts[1:]:
            axes.axvline(part.start - 0.5, color="#1b1f24", linewidth=0.8, linestyle=":")
            axes.annotate(
                one["nights"][part.start],
                (part.start - 0.5, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(3, -9),
                textcoords="offset points",
                fontsize=8,
            )
        _label_nights(axes, one["nights"])
        axes.set_xlim(-0.8, max(len(x), 8) - 0.2)
        if len(set(one["values"])) == 1:
            pad = max(abs(one["values"][0]) * 0.05, 0.5)
            axes.set_ylim(one["values"][0] - pad, one["values"][0] + pad)
        elif len(parts) > 1:
            # The date of a step stands at the top, where the marks of the higher level would cross it.
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + 0.12 * (high - low))
        axes.set_ylabel("" if one["unit"] == "1" else one["unit"])
        figure.legend(loc="outside upper right", ncols=4, fontsize=8)

    return draw


def _label_nights(axes: Axes, nights: Sequence[str]) -> None:
    step = max(1, -(-len(nights) // MOST_LABELS))
    places = list(range(0, len(nights), step))
    axes.set_xticks(places, [nights[i] for i in places], rotation=35, ha="right", fontsize=8)
