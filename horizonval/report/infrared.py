"""The report's section on the infrared horizon: where the radiance of thermal bands drops, and how well that is known.

All of it comes from the truth stored with the images.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from horizonval.frame import FrameTruth
from horizonval.infrared_horizon.curve import MAXIMUM_GRADIENT, visible_height_m
from horizonval.report import plots
from horizonval.report.load import View
from horizonval.report.wording import count, number, percent
from horizonval.spec.camera import Band, CameraSpec

TEXT = (
    "A thermal band does not see the hard horizon but the edge of what radiates. The truth of every thermal frame says "
    "where that is in a clear sky, from rays integrated apart from the renderer: the height at which the radiance has "
    "fallen to half its plateau, and the one at which it falls fastest. In opaque bands the plateau is the air's (the "
    "largest radiance from 10 to 24 km), in window bands the ground's (10 km below the hard horizon). Clouds are left "
    "out; they lift the horizon of a window band to their tops."
)
NOTE = (
    "For the profile that the scene describes; weather, season and stratospheric warmings move the horizon by more. "
    "Emission is that of local thermodynamic equilibrium, which fails above about 75 km."
)
_MOST_NAMED = 7


def section_of(views: Sequence[View]) -> dict[str, Any] | None:
    """Return what the template shows of the infrared horizon; None for runs whose truths have none."""
    shown = [v for v in views if v.image is not None and v.band in v.image.truth.infrared_horizon]
    if not shown:
        return None
    kinds = sorted({_stored(v)["kind"] for v in shown})
    caption = (
        "Lowest height of the ray against azimuth about the nadir; solid: half of the plateau, dotted: steepest fall. "
        f"{count(len(shown), 'frame')}, true and clear-sky; equal curves lie on each other."
    )
    return {
        "text": TEXT,
        "note": NOTE,
        "title": "Height of the infrared horizon",
        "caption": caption,
        "uri": plots.figure_uri(_around(shown, kinds), 5.8, 1.2 + 2.6 * len(kinds)),
        "rows": _accuracy_rows(shown),
    }


def facts_of(truth: FrameTruth, band: str) -> list[tuple[str, str]]:
    """Return what a frame's list of facts says of the infrared horizon in view."""
    half, steepest = (visible_height_m(truth, band, *locator) for locator in ((), (MAXIMUM_GRADIENT,)))
    if half is None or steepest is None:
        return []
    return [
        (
            "infrared horizon in view",
            f"half of the plateau at {number(half / 1e3)} km, steepest fall at {number(steepest / 1e3)} km, on average",
        )
    ]


def _stored(view: View) -> dict[str, Any]:
    assert view.image is not None
    found: dict[str, Any] = view.image.truth.infrared_horizon[view.band]
    return found


def _around(views: Sequence[View], kinds: Sequence[str]) -> plots.Draw:
    distinct: dict[tuple[Any, ...], str] = {}
    for view in views:
        stored = _stored(view)
        key = (stored["kind"], *stored["half_plateau_height_m"], *stored["maximum_gradient_height_m"])
        distinct.setdefault(key, view.case)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
        for axes, kind in zip(panels, kinds, strict=True):
            own = [(name, key[1:]) for key, name in distinct.items() if key[0] == kind]
            several = len({v.band for v in views if _stored(v)["kind"] == kind}) > 1
            for i, (name, heights) in enumerate(own):
                _curves(axes, heights, i, name if len(own) <= _MOST_NAMED else None)
            axes.set_title(f"{kind} {'bands' if several else 'band'}", fontsize=9.5, loc="left")
            axes.set_ylabel("height [km]")
            if len(own) <= _MOST_NAMED:
                axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
        panels[-1].set(xlim=(0, 360), xticks=range(0, 361, 90), xticklabels=["N", "E", "S", "W", "N"])
        panels[-1].set_xlabel("azimuth about the nadir")

    return draw


def _curves(axes: Axes, heights: tuple[float, ...], index: int, name: str | None) -> None:
    colour = plots.ESTIMATOR_COLOURS[index % len(plots.ESTIMATOR_COLOURS)]
    half, steepest = np.array(heights).reshape(2, -1) / 1e3
    azimuth = np.linspace(0.0, 360.0, len(half) + 1)
    width = 1.6 if name else 0.9
    axes.plot(azimuth, np.append(half, half[0]), color=colour, lw=width, label=name)
    axes.plot(azimuth, np.append(steepest, steepest[0]), color=colour, lw=0.8 * width, ls=":")


def _accuracy_rows(views: Sequence[View]) -> list[dict[str, Any]]:
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for view in views:
        assert view.image is not None
        stored = _stored(view)
        spec = CameraSpec.model_validate(view.image.truth.camera)
        band = next(b for b in spec.band if b.name == view.band)
        told = stored.get("accuracy")
        rows.setdefault(
            (view.band, _range(band), stored["kind"]),
            {
                "band": view.band,
                "range": _range(band),
                "kind": stored["kind"],
                "radiance": _radiance_lines(told) if told else ["not stated"],
                "height": _height(told),
            },
        )
    return [rows[key] for key in sorted(rows)]


def _range(band: Band) -> str:
    lo, hi = (band.lo_um, band.hi_um) if band.lo_um else (band.wavelength_um[0], band.wavelength_um[-1])
    return f"{lo:g} to {hi:g} um"


def _radiance_lines(told: dict[str, Any]) -> list[str]:
    lines = []
    for (low, high), relative in zip(told["heights_km"], told["relative"], strict=True):
        place = "ground" if low is None else f"above {low:g} km" if high is None else f"{low:g} to {high:g} km"
        lines.append(f"{place}: {'not stated' if relative is None else percent(round(relative, 3))}")
    return lines


def _height(told: dict[str, Any] | None) -> str:
    if told is None or told["half_height_km"] is None or not math.isfinite(told["half_height_km"]):
        return "not stated"
    return f"{told['half_height_km']:g} km"
