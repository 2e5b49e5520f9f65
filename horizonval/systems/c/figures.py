"""The picture of the ideal module's page."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.arrays import FloatArray
from horizonval.estimation.methods.ideal import ideal_horizon_sensor
from horizonval.systems.c.poses import RADIUS_M, exact_reading, pose_above_horizon

ALTITUDES = {"400 km": (400e3, "#0072b2", "-"), "3000 km": (3e6, "#d55e00", "--"), "36 000 km": (3.6e7, "#000000", ":")}
ROUNDING = 1e-17
"""Departures of exactly zero are drawn here."""


def draw_readings() -> MplFigure:
    """Pitch error against the boresight's elevation, roll error against roll, and both minus the exact ones."""
    figure = MplFigure(figsize=(9.0, 5.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", height_ratios=(3, 2))
    for label, (altitude, colour, style) in ALTITUDES.items():
        r = np.array([0.6, -0.64, 0.48]) * (RADIUS_M + altitude)
        rho = math.asin(RADIUS_M / (RADIUS_M + altitude))
        elevation = np.radians(np.arange(math.ceil(-math.degrees(rho)) + 0.5, 180 - math.degrees(rho), 1.0))
        roll = np.radians(np.arange(-179.0, 180.0, 2.0))
        for k, (x, attitudes) in enumerate(
            (
                (elevation, [pose_above_horizon(r, RADIUS_M, float(e), 0.2, 1.0) for e in elevation]),
                (roll, [pose_above_horizon(r, RADIUS_M, 0.05, float(a), 1.0) for a in roll]),
            )
        ):
            ours, theirs = _both(r, attitudes, k)
            axes[0, k].plot(np.degrees(x), np.degrees(ours), style, color=colour, label=label)
            axes[1, k].semilogy(np.degrees(x), np.maximum(np.abs(ours - theirs), ROUNDING), ".", color=colour, ms=3)
    for k, what in enumerate(("pitch error", "roll error")):
        axes[0, k].axhline(0, color="#000000", lw=0.6)
        axes[0, k].axvline(0, color="#000000", lw=0.6)
        axes[0, k].set_ylabel(f"{what} [deg]")
        axes[1, k].axhline(1e-9, color="#000000", lw=0.9, ls="-.")
        axes[1, k].set(ylabel="from exact [rad]", ylim=(ROUNDING / 2, 1e-8))
    axes[1, 0].set_xlabel("boresight above the horizon [deg]")
    axes[1, 1].set_xlabel("roll, right axis up [deg]")
    axes[0, 0].legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def _both(
    r: FloatArray,
    attitudes: list[FloatArray],
    axis: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the module's readings and the exact ones [rad]: pitch for axis 0, roll for axis 1."""
    ours, theirs = [], []
    for q in attitudes:
        reading = ideal_horizon_sensor(r, q, RADIUS_M)
        roll, pitch, _ = exact_reading(r, q, RADIUS_M)
        ours.append((reading.pitch_error_rad, reading.roll_error_rad)[axis])
        theirs.append((pitch, roll)[axis])
    return np.array(ours), np.array(theirs)
