"""Errors on the frames for test against the floor, and whether what is claimed of them is true."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from horizonval_learned.score import ALONE, FLOOR, ON_ALL, ON_SAMPLE, OURS

COLOURS = dict(
    zip((*ON_ALL, *ON_SAMPLE), ("#0b6e99", "#5aa7c7", "#c2571a", "#999999", "#5b8c2a", "#7a4fa3"), strict=True)
)


def plot(digest: dict[str, Any], path: Path) -> None:
    """Write the picture: shares of frames by error, and of claims by normalised error squared."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for method, errors in digest["test"]["errors_deg"].items():
        found = np.sort([e for e in errors if np.isfinite(e)])
        if not len(found):
            continue
        share = (np.arange(len(found)) + 1.0) / len(errors)
        thin = {"linewidth": 1.2, "linestyle": "--"} if method in ON_SAMPLE else {"linewidth": 2.0}
        label = f"{method} ({len(errors)} frames)"
        left.plot(np.maximum(found, 1e-4), share, color=COLOURS[method], label=label, **thin)
    left.set(xscale="log", xlim=(1e-3, 2.0), ylim=(0.0, 1.02), xlabel="nadir error [deg]", ylabel="share of frames")
    left.set_title("frames for test, of scenes that were not learned from", fontsize=10)
    left.legend(fontsize=8, frameon=False, loc="upper left")
    steps = np.linspace(0.0, 8.0, 400)
    right.plot(steps, np.exp(-steps), color="#333333", linewidth=1.0, linestyle=":", label="an honest claim")
    for method in (OURS, ALONE):
        values = np.sort(digest["test"]["normalised"][method])
        beyond = 1.0 - np.arange(len(values)) / len(values)
        right.plot(values, beyond, color=COLOURS[method], linewidth=2.0, label=method)
    right.set(yscale="log", xlim=(0.0, 8.0), ylim=(1e-3, 1.1))
    right.set(xlabel="normalised error squared / 2", ylabel="share of claims beyond")
    right.set_title(f"what is claimed ({FLOOR} claims nothing)", fontsize=10)
    right.legend(fontsize=8, frameon=False)
    for panel in (left, right):
        panel.grid(color="#e4e4e4", linewidth=0.6)
    figure.savefig(path, dpi=110, metadata={"Software": None})
