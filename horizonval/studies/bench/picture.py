"""Where which method earns its points: scores of methods by cells, as a picture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

DPI = 110
_HEIGHT_IN, _TEXT_IN, _CELL_IN = 0.26, 3.0, 0.24


def cells_png(ranked: Sequence[Mapping[str, Any]], sheets: Mapping[str, Any]) -> bytes:
    """Return a PNG with a row for each method, best first, and a column for each cell.

    Colour is the cell's score, from -100 (all claims false) over 0 (silence) to 100 (the bound); cells in which no
    frame is due are grey where the method was silent, and red where it made false claims.

    Parameters
    ----------
    ranked : sequence of mapping
        As :func:`horizonval.studies.bench.sheet.ranking` returns.
    sheets : mapping
        By method, as :func:`horizonval.studies.bench.sheet.sheet_of` returns.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from horizonval.report.plots import house_style

    methods = [row["method"] for row in ranked]
    cells = sorted(sheets[methods[0]]["cells"])
    scores = np.array([[_score(sheets[name]["cells"][cell]) for cell in cells] for name in methods])
    width, height = _TEXT_IN + _CELL_IN * len(cells) + 0.9, 1.9 + _HEIGHT_IN * len(methods)
    with house_style():
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        shown = axes.imshow(np.ma.masked_invalid(scores), cmap="RdYlGn", vmin=-100.0, vmax=100.0, aspect="auto")
        axes.set_facecolor("0.85")
        axes.set_xticks(np.arange(len(cells)), cells, rotation=90, fontsize=7)
        axes.set_yticks(np.arange(len(methods)), methods, fontsize=8)
        axes.set_xticks(np.arange(-0.5, len(cells)), minor=True)
        axes.set_yticks(np.arange(-0.5, len(methods)), minor=True)
        axes.grid(visible=False, which="major")
        axes.grid(which="minor", color="white", linewidth=0.8)
        axes.tick_params(which="both", length=0)
        bar = figure.colorbar(shown, ax=axes, fraction=0.03, pad=0.01)
        bar.set_label("score of the cell", fontsize=8)
        bar.ax.tick_params(labelsize=7)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    return stream.getvalue()


def _score(cell: Mapping[str, Any]) -> float:
    """Return the score of a cell; of one without a frame that is due the false claims in a hundred frames, or none."""
    if cell["due"]:
        return float(cell["score"])
    return -100.0 * cell["false"] / cell["frames"] if cell["false"] else float("nan")
