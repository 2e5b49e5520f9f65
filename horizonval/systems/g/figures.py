"""Pictures of the quadrant sensor's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.arrays import FloatArray
from horizonval.systems.g.design import DESIGN_KM, QuadrantDesign
from horizonval.systems.g.errors import AltitudeErrors
from horizonval.systems.g.layout import ETA_RAD

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000")


def draw_fields(design: QuadrantDesign, sectors: Mapping[float, FloatArray], raised_km: float) -> MplFigure:
    """The mean limb in the body at both altitudes, over the fields."""
    figure = MplFigure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for name, (low, high) in design.layout.fields().items():
        axes.axvspan(*np.degrees([low, high]), color="#bbbbbb", alpha=0.6 if name == "A" else 0.3, lw=0.0)
        axes.annotate(name, (np.degrees(0.5 * (low + high)), 0.35), ha="center", fontsize=11)
    for (altitude, seen), colour in zip(sectors.items(), COLOURS, strict=False):
        low, mean, high = np.percentile(seen, [5, 50, 95], axis=(0, 1))
        style = "-" if altitude in (DESIGN_KM, raised_km) else ":"
        axes.plot(np.degrees(ETA_RAD), mean, style, color=colour, label=f"{altitude:g} km")
        axes.fill_between(np.degrees(ETA_RAD), low, high, color=colour, alpha=0.2, lw=0.0)
    axes.set(xlabel="nadir angle in the body [deg]", ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_altitudes(
    flown: Mapping[str, Sequence[AltitudeErrors]], requirement_deg: float, raised_km: float
) -> MplFigure:
    """Error, lift and scale against altitude."""
    figure = MplFigure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    for (name, found), colour in zip(flown.items(), COLOURS, strict=False):
        km = [one.altitude_km for one in found]
        axes[0].plot(km, [one.level_deg for one in found], "-o", ms=3, color=colour, label=f"{name}, level")
        axes[0].plot(km, [one.tilted_deg for one in found], "--s", ms=3, color=colour, label=f"{name}, up to 0.5 deg")
        axes[0].plot(km, [one.unchecked_deg for one in found], ":^", ms=3, color=colour)
        axes[1].plot(km, [100.0 * one.out_of_range for one in found], "-o", ms=3, color=colour)
        axes[1].plot(km, [100.0 * one.refused for one in found], "--s", ms=3, color=colour)
        axes[2].plot(km, [one.scale for one in found], "-o", ms=3, color=colour)
    axes[0].axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    for panel in axes:
        for at in (DESIGN_KM, raised_km):
            panel.axvline(at, color="#000000", lw=0.6, ls=":")
    axes[0].set(ylabel="3 sigma [deg]", ylim=(0.0, None))
    axes[1].set_ylabel("out of range,\nrefused [%]")
    axes[2].set(ylabel="reading / tilt", xlabel="altitude [km]")
    axes[0].legend(frameon=False, fontsize=8)
    return figure


def draw_widths(widths_deg: FloatArray, errors: Mapping[str, FloatArray], requirement_deg: float) -> MplFigure:
    """Error against the width of the field across the limb."""
    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for k, (name, found) in enumerate(errors.items()):
        axes.plot(widths_deg, found, ("-", "--")[k % 2] + "o", ms=3, color=COLOURS[k // 2], label=name)
    axes.axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    axes.set(xlabel="width of the field across the limb [deg]", ylabel="3 sigma [deg]", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_months(flown: Mapping[str, AltitudeErrors], requirement_deg: float) -> MplFigure:
    """Error of level bodies by month."""
    figure = MplFigure(figsize=(9.0, 3.0), layout="constrained")
    axes = figure.subplots()
    for (name, one), colour in zip(flown.items(), COLOURS, strict=False):
        axes.plot(range(1, 13), one.month_deg, "-o", ms=3, color=colour, label=name)
    axes.axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    axes.set(xlabel="month", ylabel="3 sigma, level [deg]", xticks=range(1, 13), ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure
