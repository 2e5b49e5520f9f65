"""Pictures of brightness temperature: all thermal bands of a frame, two to a row, each row on one colour scale.

A scale spans the temperatures of ground, clouds and low limb in its row, and goes on to SPAN_K or MARGIN_K below them:
wide enough for the limb to fade into space, which is black, and narrow enough for a carbon dioxide band, whose whole
disc is within ten kelvin, to show anything. What is hotter than the scale, the Sun, has the colour of its upper end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

SPAN_K = 60.0
"""From end to end, at least."""
MARGIN_K = 15.0
STEP_K = 5.0
PERCENTILES = (0.5, 99.8)
COLOURS = "inferno"
PER_ROW = 2
PANEL_PX = 320
"""Smallest width of a band's picture; narrower images are enlarged by whole pixels."""
_DPI = 100
_EDGE, _GAP, _HEAD, _BAR, _NUMBERS = 12, 10, 26, 12, 62
_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": "#e6e8ec",
    "ytick.color": "#e6e8ec",
    "axes.labelcolor": "#e6e8ec",
    "figure.facecolor": "#171a20",
}


@dataclass(frozen=True)
class ThermalPanel:
    """One band of a frame.

    Attributes
    ----------
    title : str
    temperature_k : ndarray, shape (H, W)
        Brightness temperature, 0 where there is no light.
    counts : ndarray of bool, shape (H, W)
        The pixels that decide the scale; none are as good as all.
    """

    title: str
    temperature_k: NDArray[np.float64]
    counts: NDArray[np.bool_]


def scale_k(panels: Sequence[ThermalPanel]) -> tuple[float, float]:
    """Return the temperatures that are drawn black and brightest in the pictures of some bands."""
    seen = np.concatenate([p.temperature_k[p.counts] for p in panels])
    if not seen.size:
        seen = np.concatenate([p.temperature_k.ravel() for p in panels])
    coldest, warmest = np.percentile(seen, PERCENTILES)
    top = STEP_K * math.ceil(warmest / STEP_K)
    return max(0.0, STEP_K * math.floor(min(coldest - MARGIN_K, top - SPAN_K) / STEP_K)), top


def infrared_picture(panels: Sequence[ThermalPanel]) -> NDArray[np.uint8]:
    """Return the picture of the bands of one frame with their colour bars, shape (H, W, 3), sRGB."""
    rows = [panels[i : i + PER_ROW] for i in range(0, len(panels), PER_ROW)]
    height, width = panels[0].temperature_k.shape
    scale = max(1, math.ceil(PANEL_PX / width))
    w, h = scale * width, scale * height
    bar_x = _EDGE + len(rows[0]) * (w + _GAP)
    total_w, total_h = bar_x + _BAR + _NUMBERS, len(rows) * (_HEAD + h) + _EDGE
    with matplotlib.rc_context():
        # A user's own matplotlibrc must not show.
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        # A quarter of a pixel more: 2.3 inches are 229.999 px, and some versions of matplotlib cut.
        figure = Figure(figsize=((total_w + 0.25) / _DPI, (total_h + 0.25) / _DPI), dpi=_DPI)
        canvas = FigureCanvasAgg(figure)

        for r, row in enumerate(rows):
            y = _HEAD + r * (h + _HEAD)
            colours = ScalarMappable(Normalize(*scale_k(row)), COLOURS)
            for c, panel in enumerate(row):
                x = _EDGE + c * (w + _GAP)
                # Laid down pixel by pixel: axes may round where their image begins.
                figure.figimage(_enlarged(colours.to_rgba(panel.temperature_k, bytes=True), scale), x, total_h - y - h)
                figure.text(x / total_w, 1 - (y - 7) / total_h, panel.title, va="baseline")
            bar = figure.add_axes((bar_x / total_w, 1 - (y + h) / total_h, _BAR / total_w, h / total_h))
            legend = figure.colorbar(colours, cax=bar)
            legend.set_label("brightness temperature [K]")
            bar.spines["outline"].set_visible(False)
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _enlarged(picture: NDArray[np.uint8], scale: int) -> NDArray[np.uint8]:
    return picture.repeat(scale, axis=0).repeat(scale, axis=1)
