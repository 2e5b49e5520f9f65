"""Pictures of the conical scanner's page."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.json_types import JsonObject
from horizonval.systems.f.errors import THRESHOLDS, BandErrors, signal_of
from horizonval.systems.f.settings import CO2, FRACTION, WINDOW

COLOURS = {CO2: "#0072b2", WINDOW: "#d55e00"}


def draw_scans(scans: Mapping[str, Mapping[str, JsonObject]]) -> MplFigure:
    """The signal of the cloudiest scan in both bands, clear and under clouds."""
    figure = MplFigure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    cloudiest = max(scans[WINDOW], key=lambda name: float(scans[WINDOW][name]["covered"]))
    for panel, band in zip(axes, (CO2, WINDOW), strict=True):
        one = scans[band][cloudiest]
        phase = np.array(one["phase_rad"])
        for sky, style in (("clear", "--"), ("clouds", "-")):
            signal = signal_of(phase, np.array(one[sky]))
            panel.plot(np.degrees(signal.phase_rad), signal.value, style, color=COLOURS[band], lw=1.2, label=sky)
        top = float(np.max(one["clear"]))
        panel.axhline(FRACTION * top, color="#000000", lw=0.7, ls=":")
        panel.set(title=band, ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
        panel.legend(frameon=False, fontsize=8, loc="lower center")
    axes[-1].set_xlabel("phase of the scan from the nadir's [deg]")
    axes[-1].set_xlim(*(math.degrees(p) for p in (phase[0] - 0.1, phase[-1] + 0.2)))
    return figure


def draw_errors(errors: Mapping[str, Mapping[str, BandErrors]]) -> MplFigure:
    """Errors of all scans, clear and under clouds, pitch against roll."""
    figure = MplFigure(figsize=(9.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, band in zip(axes, errors, strict=True):
        for panel, kind in zip(row, THRESHOLDS, strict=True):
            one = errors[band][kind]
            for sky, mark in (("clear", "o"), ("clouds", "x")):
                panel.plot(one.pitch[sky], one.roll[sky], mark, ms=4, mfc="none", color=COLOURS[band], label=sky)
            panel.axhline(0.0, color="#000000", lw=0.5)
            panel.axvline(0.0, color="#000000", lw=0.5)
            panel.set(title=f"{band}: {kind}", xlabel="pitch error [deg]", ylabel="roll error [deg]")
            panel.legend(frameon=False, fontsize=8)
    return figure
