"""Every claim of every method, in the order of the page's tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

TITLES = {
    "hard-visible": "visible, sphere without air",
    "air-visible": "visible, Earth with air",
    "clouds-visible": "visible, broken clouds",
    "hard-infrared": "infrared, sphere without air",
    "air-infrared": "infrared, Earth with air",
}
PLACES = {
    "500km": ("500 km", "#0b6e99", "o"),
    "1400km": ("1400 km", "#c2571a", "s"),
    "35786km": ("35 786 km", "#5b8c2a", "^"),
}
NARROWEST_DEG, WIDEST_DEG = 1e-4, 180.0


def plot(digest: dict[str, Any], path: Path) -> None:
    """Write the picture: nadir errors on a logarithmic axis, one row for each method and one panel for each table."""
    methods = digest["methods"]
    figure = Figure(figsize=(15.0, 0.36 * len(methods) + 1.6), layout="constrained")
    panels = figure.subplots(1, len(TITLES), sharey=True)
    for panel, (table, title) in zip(panels, TITLES.items(), strict=True):
        for row, method in enumerate(methods):
            group = digest["groups"][table][method]
            for step, (place, (label, colour, marker)) in enumerate(PLACES.items()):
                errors = [max(e, NARROWEST_DEG) for e in group["errors_deg"].get(place, [])]
                heights = [row + 0.22 * (step - 1)] * len(errors)
                panel.plot(
                    errors, heights, marker, color=colour, markersize=4.5, alpha=0.75, markeredgewidth=0.0,
                    label=label if row == 0 else None,
                )  # fmt: skip
            silent = group["frames"] - group["claims"]
            if silent:
                note = {"va": "center", "fontsize": 7, "color": "#555555"}
                panel.text(NARROWEST_DEG, row, f"{silent} refused", **note)
        panel.axvline(0.5, color="#999999", linewidth=0.8, linestyle="--")
        panel.set(xscale="log", xlim=(NARROWEST_DEG * 0.7, WIDEST_DEG), xlabel="nadir error [deg]")
        panel.set_title(title, fontsize=10)
        panel.grid(axis="x", color="#e4e4e4", linewidth=0.6)
        panel.tick_params(labelsize=8)
    panels[0].set_yticks(range(len(methods)), methods, fontsize=8)
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(PLACES), fontsize=8, frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
