"""The figure of docs/explanation/limb-templates.md: python docs/make_templates.py docs/_static/limb-templates.png

Mean profiles of three bands at some places, and at one of them what one standard deviation of every mode adds.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from horizonval.estimation.fit.templates import FOLDER, load_templates

COLOURS = {
    "air": "#4477aa", "haze": "#ccbb44", "ground": "#228833", "scene": "#aa3377", "below": "#ee6677"
}  # fmt: skip
WHAT = {
    "air": "air",
    "haze": "haze",
    "ground": "ground",
    "scene": "clouds: all or none",
    "below": "cloud, by place",
}
THERMAL = [(0.0, 1.0), (50.0, 7.0), (50.0, 1.0), (-80.0, 7.0)]
SUNLIT = [(25.0, 90.0), (70.0, 0.0), (70.0, 180.0), (88.0, 90.0)]


def main(path: Path) -> None:
    """Draw the figure."""
    panels = (("co2", "14 to 16.3 um", 55.0), ("lwir", "8 to 14 um", 40.0), ("vis", "450 to 750 nm", 45.0))
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 7.0), sharey="col", layout="constrained")
    for column, (name, title, top) in enumerate(panels):
        table = load_templates(FOLDER / f"limb-{name}.npz")
        z = table.height_m / 1e3
        mean_axis, mode_axis = axes[:, column]
        places = SUNLIT if table.band_kind == "solar" else THERMAL
        for shade, (a, b) in zip(np.linspace(0.15, 0.85, len(places)), places, strict=True):
            if table.band_kind == "solar":
                mean = table.at(np.radians(a), np.radians(b))[0][0]
                label, mean = f"Sun {a:g}°, {b:g}°", mean / mean.max()
            else:
                mean = table.at(np.radians(a), b)[0][0]
                side = "N" if a > 0 else "S"
                label = f"{f'{abs(a):g}° {side}' if a else 'equator'}, {'January' if b == 1.0 else 'July'}"
            mean_axis.plot(mean, z, color=matplotlib.colormaps["viridis"](shade), label=label)
        mean_axis.set_title(title)
        mean_axis.set_xlabel("over its largest" if table.band_kind == "solar" else "W m⁻² sr⁻¹ µm⁻¹")
        mean_axis.legend(fontsize=8, frameon=False)
        first, second = (np.radians(70.0), np.radians(90.0)) if table.band_kind == "solar" else (np.radians(50.0), 1.0)
        mean, modes, left = (values[0] for values in table.at(first, second))
        said = set()
        for kind, mode in zip(table.mode_kinds, modes, strict=True):
            label = None if kind in said else WHAT[kind]
            said.add(kind)
            mode_axis.plot(100.0 * mode / mean.max(), z, color=COLOURS[kind], lw=1.2, label=label)
        share = 100.0 * left / mean.max()
        mode_axis.fill_betweenx(z, -share, share, color="0.85", lw=0, label="left over")
        mode_axis.set_xlabel("% of the largest mean")
        place = "Sun 70°, 90°" if table.band_kind == "solar" else "50° N, January"
        mode_axis.text(0.98, 0.02, place, transform=mode_axis.transAxes, ha="right", fontsize=8)
        mode_axis.legend(fontsize=8, frameon=False, loc="upper left" if name == "lwir" else "upper right")
        mean_axis.set_ylim(-20.0, top)
        for axis in (mean_axis, mode_axis):
            axis.spines[["top", "right"]].set_visible(False)
            axis.axhline(0.0, color="0.8", lw=0.6, zorder=0)
    for row, what in enumerate(("mean", "one standard deviation of every mode")):
        axes[row, 0].set_ylabel(f"{what}\nheight of the line's lowest point, km")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
