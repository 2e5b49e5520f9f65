"""The figure of the loops: how far from the nadir each of them points, and what the filter claims."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

TITLES = {
    "visible": "visible fisheye, {estimator}",
    "infrared": "two infrared cameras, {estimator}",
    "truth": "the truth as the sensor",
}
ESTIMATORS = {"visible": "limb-ellipsoid", "infrared": "limb-heads", "truth": ""}
SHADES = {"eclipse": "#b9c2cf", "Sun in frame": "#f6dfa4"}
LEAST_DEG = 1e-3


def draw(folder: Path, path: Path) -> None:
    """Draw what the JSON files of a folder say."""
    figure, axes = plt.subplots(3, 1, figsize=(9.0, 8.4), sharex=True, sharey=True, constrained_layout=True)
    for axis, name in zip(axes, TITLES, strict=True):
        found = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        _panel(axis, found)
        axis.set_title(TITLES[name].format(estimator=ESTIMATORS[name]), loc="left", fontsize=10)
    axes[-1].set_xlabel("time of flight, min")
    axes[1].set_ylabel("angle to the nadir, deg")
    handles = {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncol=4, fontsize=8, frameon=False)
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)


def _panel(axis: Any, found: dict[str, Any]) -> None:
    series = found["series"]
    minutes = np.array(series["time_s"]) / 60.0
    kinds = np.array(series["kind"])
    for kind, colour in SHADES.items():
        for start, end in _spans(minutes, kinds == kind):
            axis.axvspan(start, end, color=colour, lw=0, label=kind)
    axis.semilogy(
        minutes, np.maximum(series["pointing_deg"], LEAST_DEG), color="#1f4e79", lw=0.8, label="pointing error"
    )
    # Per axis as the filter states it; both axes together are root two of it.
    claimed = np.sqrt(2.0) * np.array(series["claimed_deg"])
    axis.semilogy(minutes, claimed, color="black", lw=1.0, ls="--", label="filter's claim, 1 sigma")
    if found["sensor"] != "truth":
        for taken, colour, label in (
            (True, "#c2571a", "sensor's error"),
            (False, "#7b1fa2", "sensor's error, left out"),
        ):
            some = [e for e in found["images"] if e.get("taken") is taken]
            if some:
                x, y = [e["time_s"] / 60.0 for e in some], [e["error_deg"] for e in some]
                axis.semilogy(x, np.maximum(y, LEAST_DEG), ".", color=colour, ms=4, label=label)
        refused = [e["time_s"] / 60.0 for e in found["images"] if "error_deg" not in e]
        axis.plot(refused, np.full(len(refused), 1.3 * LEAST_DEG), "x", color="#444444", ms=4, label="refused")
    axis.set_ylim(LEAST_DEG, 200.0)
    axis.set_xlim(0.0, minutes[-1])
    axis.grid(True, which="major", lw=0.3)


def _spans(minutes: Any, inside: Any) -> list[tuple[float, float]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    return [(minutes[a], minutes[min(b, len(minutes) - 1)]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
