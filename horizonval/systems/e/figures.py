"""Pictures and tables of the two-station localisation: the pass, errors, smoothers' ends, published and ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure as MplFigure
from matplotlib.projections.polar import PolarAxes
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import geodetic_from_itrs
from horizonval.systems.e import case as noise
from horizonval.systems.e.case import (
    ALPHAS,
    METHODS,
    NOISE_ARCSEC,
    NOISE_ROUNDING_DEG,
    PUBLISHED_NOISE,
    PUBLISHED_ROUNDING,
    QUANTITIES,
    ROUNDING_DEG,
    STATIONS,
    Figures,
    exact_pass,
)
from horizonval.systems.e.localisation.pipeline import ALPHA
from horizonval.systems.e.localisation.smoothing import Kernel, smooth, smooth_clamped
from horizonval.systems.e.localisation.stations import ARCSEC
from horizonval.systems.published import page_text
from horizonval.systems.result import Cell, Table

LOOKS = {
    "plain": ("0.65", "-", 0.8, "two-ray least squares"),
    "clamped": ("#d55e00", ":", 1.6, "clamped Gaussian mean"),
    "smoothed": ("#e69f00", "-.", 1.2, "smoothed"),
    "proposed": ("#0072b2", "-", 1.8, "smoothed, adaptive filter"),
    "batch": ("black", "--", 1.4, "batch orbit fit"),
}
CLAMPED_WIDTHS_S = (1.0, 2.0, 5.0, 10.0)


def geometry() -> MplFigure:
    """Return the map of stations and pass, and the pass on both stations' skies."""
    truth = exact_pass()
    latitude, longitude, height = geodetic_from_itrs(truth.r_itrs)
    figure = plt.figure(figsize=(9.0, 4.2), layout="constrained")
    ground = figure.add_subplot(1, 2, 1)
    ground.plot(np.degrees(longitude), np.degrees(latitude), "k-", lw=1.5)
    for i, side in ((0, "right"), (120, "right"), (240, "right")):
        lon, lat = np.degrees(longitude[i]), np.degrees(latitude[i])
        ground.plot(lon, lat, "k.", ms=7)
        ground.annotate(
            f"{truth.times_s[i]:.0f} s", (lon, lat), (-8, 0), textcoords="offset points", ha=side, va="center"
        )
    for station, marker in zip(STATIONS, "^s", strict=True):
        lon, lat = np.degrees(station.longitude_rad), np.degrees(station.latitude_rad)
        ground.plot(lon, lat, marker, color="#0072b2", ms=9)
        ground.annotate(station.name, (lon, lat), (0, -16), textcoords="offset points", ha="center")
    ground.set_aspect(1.0 / np.cos(np.radians(35.7)))
    ground.set(
        xlabel="longitude [deg]",
        ylabel="latitude [deg]",
        title=f"ground track, height {height.mean() / 1e3:.0f} km",
        xlim=(46.5, 56.5),
        ylim=(31.0, 41.0),
    )
    ground.grid(alpha=0.3)
    sky = figure.add_subplot(1, 2, 2, projection="polar")
    assert isinstance(sky, PolarAxes)
    sky.set_theta_zero_location("N")
    sky.set_theta_direction(-1)
    for i, (station, look) in enumerate(zip(STATIONS, ("-", "--"), strict=True)):
        azimuth, elevation = truth.angles_rad[:, 2 * i], truth.angles_rad[:, 2 * i + 1]
        away = 90.0 - np.degrees(elevation)
        sky.plot(azimuth, away, look, color="#0072b2", lw=2, label=f"from {station.name}")
        sky.plot(azimuth[0], away[0], "o", color="#0072b2", ms=6)
    sky.set_rlim(0.0, 50.0)
    sky.set_rticks([15.0, 30.0, 45.0], labels=["75°", "60°", "45°"])
    sky.set_xticks(np.radians([0, 90, 180, 270]), ["N", "E", "S", "W"])
    sky.set_rlabel_position(165.0)
    sky.set_title("on the sky (elevation; dot: begin)")
    sky.legend(loc="lower left", bbox_to_anchor=(0.82, -0.08), frameon=False)
    return figure


def errors_against_time(errors: Mapping[str, FloatArray], title: str, times_s: FloatArray | None = None) -> MplFigure:
    """Return the three errors against time, methods by name of :data:`LOOKS`, shape (n, 3) each."""
    figure, axes = plt.subplots(3, 1, figsize=(8.0, 7.2), sharex=True, layout="constrained")
    t = exact_pass().times_s if times_s is None else times_s
    for i, ((quantity, unit), ax) in enumerate(zip(QUANTITIES, axes, strict=True)):
        for name, error in errors.items():
            colour, style, width, label = LOOKS[name]
            ax.plot(t, error[:, i], style, color=colour, lw=width, label=label)
        reach = 1.15 * np.abs(errors["plain"][:, i]).max()
        ax.set(ylabel=f"error of\n{quantity} [{unit}]", ylim=(-reach, reach))
        ax.axhline(0.0, color="0.5", lw=0.6)
        ax.grid(alpha=0.3)
    axes[0].set_title(title)
    axes[0].legend(ncols=len(errors), loc="lower center", bbox_to_anchor=(0.5, 1.12), frameon=False, fontsize=9)
    axes[-1].set_xlabel("time [s]")
    return figure


def end_bias(kernel: Kernel) -> MplFigure:
    """Return what smoothers do to exact directions of the first station, against time."""
    truth = exact_pass()
    figure, ax = plt.subplots(figsize=(8.0, 4.2), layout="constrained")
    styles = ["-", "--", "-.", ":"]
    for width, style in zip(CLAMPED_WIDTHS_S, styles, strict=True):
        ax.semilogy(
            truth.times_s, clamped_bias(width), style, color="#d55e00", lw=1.3, label=f"clamped mean, {width:g} s"
        )
    u = STATIONS[0].directions_itrs(truth.angles_rad[:, 0], truth.angles_rad[:, 1])
    local = np.linalg.norm(smooth(truth.times_s, u, kernel) - u, axis=1) / ARCSEC
    ax.semilogy(
        truth.times_s,
        np.maximum(local, 1e-3),
        color="#0072b2",
        lw=2,
        label=f"local polynomial, degree {kernel.degree}, {kernel.width_s:.0f} s",
    )
    ax.set(xlabel="time [s]", ylabel="bias of a smoothed direction [arcsec]", ylim=(1e-2, 1e5))
    ax.grid(alpha=0.3)
    ax.legend(frameon=False, ncols=3, loc="upper center", fontsize=9)
    return figure


def clamped_bias(width_s: float) -> FloatArray:
    """Return the angle [arcsec] by which a clamped mean misses exact directions of the first station, shape (n,)."""
    truth = exact_pass()
    u = STATIONS[0].directions_itrs(truth.angles_rad[:, 0], truth.angles_rad[:, 1])
    return np.linalg.norm(smooth_clamped(truth.times_s, u, width_s) - u, axis=1) / ARCSEC


def ratios(rows: Sequence[str], published: FloatArray, ours: Mapping[str, FloatArray]) -> MplFigure:
    """Return our errors over the published proposed ones; ``published`` and each of ``ours`` of shape (rows, 3)."""
    figure, axes = plt.subplots(1, 3, figsize=(9.0, 4.0), sharey=True, layout="constrained")
    y = np.arange(len(rows))[::-1]
    markers = {"smoothed": "v", "filtered": "D", "proposed": "o", "batch": "s"}
    labels = {
        "smoothed": "smoothed, least squares",
        "filtered": "+ adaptive filter",
        "proposed": "+ its way back",
        "batch": "batch orbit fit",
    }
    for i, ((quantity, _), ax) in enumerate(zip(QUANTITIES, axes, strict=True)):
        for name, marker in markers.items():
            face = "none" if name in ("smoothed", "filtered") else None
            colour = "black" if name == "batch" else "#0072b2" if name == "proposed" else "0.45"
            ax.semilogx(ours[name][:, i] / published[:, i], y, marker, color=colour, mfc=face, ms=7, label=labels[name])
        ax.axvline(1.0, color="k", lw=1)
        ax.set(xlabel="ours / published", title=quantity, xlim=(0.01, 2.0))
        ax.set_yticks(y, rows)
        ax.grid(alpha=0.3)
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False)
    return figure


Rows = dict[str, dict[str, FloatArray]]
"""Draws of every row, by the row's name: see :func:`horizonval.systems.e.case.gathered`."""


TEXT = page_text("E")


def mean(rows: Rows, row: str, method: str) -> FloatArray:
    """Return a row's three errors of a method, means over its draws, shape (3,)."""
    return rows[row]["rms"][:, METHODS.index(method)].mean(axis=0)


def as_published(rows: Rows, row: str, stage: int) -> FloatArray:
    """Return a row's three errors of the published order, means over its draws, shape (3,); stage 1 has the filter."""
    return rows[row]["published"][:, stage].mean(axis=0)


def half_width(rows: Rows, row: str, method: str) -> FloatArray:
    """Return half the 95 % confidence interval of :func:`mean`, shape (3,)."""
    draws = rows[row]["rms"][:, METHODS.index(method)]
    return stats.t.ppf(0.975, len(draws) - 1) * draws.std(axis=0, ddof=1) / np.sqrt(len(draws))


def cases() -> list[tuple[str, str, dict[str, Figures]]]:
    """Return key, description and published columns of the six published rows."""
    rounding = [
        (f"rounded {q:g}", f"rounded to {q:g} deg", {k: v[i] for k, v in PUBLISHED_ROUNDING.items()})
        for i, q in enumerate(ROUNDING_DEG)
    ]
    return rounding + [
        (f"noisy {n:g}", f"noise {n:g} arcsec", {k: v[i] for k, v in PUBLISHED_NOISE.items()})
        for i, n in enumerate(NOISE_ARCSEC)
    ]


def rounding_table(rows: Rows) -> Table:
    """Return the rounding table, published and ours."""
    lines: list[tuple[Cell, ...]] = []
    for i, q in enumerate(ROUNDING_DEG):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            shifted = mean(rows, f"shifted {q:g}", "proposed")[j]
            half = half_width(rows, f"shifted {q:g}", "proposed")[j]
            ours = [round(float(mean(rows, f"rounded {q:g}", m)[j]), 3) for m in METHODS]
            printed = [PUBLISHED_ROUNDING[k][i][j] for k in ("plain", "proposed")]
            published = [round(float(as_published(rows, f"rounded {q:g}", stage)[j]), 3) for stage in (0, 1)]
            lines.append(
                (f"{q:g} deg", f"{quantity} [{unit}]", *printed, *published, *ours, f"{shifted:.3g} ± {half:.1g}")
            )
    return TEXT.table("rounding", lines)


def noise_table(rows: Rows, nearest: noise.NoiseReading, draws: int) -> Table:
    """Return the noise table, published and ours, under one reading of its noise."""
    lines: list[tuple[Cell, ...]] = []
    for i, n in enumerate(NOISE_ARCSEC):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            ours = [
                f"{mean(rows, f'noisy {n:g}', m)[j]:.3g} ± {half_width(rows, f'noisy {n:g}', m)[j]:.1g}"
                for m in METHODS
            ]
            printed = [PUBLISHED_NOISE[k][i][j] for k in ("plain", "proposed")]
            published = [f"{as_published(rows, f'noisy {n:g}', stage)[j]:.3g}" for stage in (0, 1)]
            lines.append((f"{n:g} arcsec", f"{quantity} [{unit}]", *printed, *published, *ours))
    return TEXT.table("noise", lines, rounding_deg=NOISE_ROUNDING_DEG, reading=nearest.description, draws=draws)


def streak_table(rows: Rows, draws: int) -> Table:
    """Return both published tables again, from angles measured in rendered frames."""
    lines: list[tuple[Cell, ...]] = []
    for key, case, printed in cases():
        for j, (quantity, unit) in enumerate(QUANTITIES):
            row = f"streaks {key}"
            ours = [float(f"{mean(rows, row, m)[j]:.3g}") for m in METHODS]
            published = [float(f"{as_published(rows, row, stage)[j]:.3g}") for stage in (0, 1)]
            lines.append((case, f"{quantity} [{unit}]", printed["plain"][j], printed["proposed"][j], *published, *ours))
    return TEXT.table("streaks", lines, draws=draws)


def factor_table(rows: Rows) -> Table:
    """Return how many of the 18 printed proposed figures are matched or beaten with every forgetting factor."""
    keys = [(key, np.array(printed["proposed"])) for key, _, printed in cases()]
    lines: list[tuple[Cell, ...]] = []
    for i, alpha in enumerate(ALPHAS):
        counts = [sum(int((rows[k]["alphas"][:, i, s].mean(axis=0) <= p).sum()) for k, p in keys) for s in (0, 1)]
        lines.append((f"{alpha:g}", *counts))
    counts = [sum(int((mean(rows, k, m) <= p).sum()) for k, p in keys) for m in ("filtered", "proposed")]
    lines.insert(1, (f"{ALPHA:g}", *counts))
    counts = [sum(int((as_published(rows, k, s) <= p).sum()) for k, p in keys) for s in (0, 1)]
    lines.append((TEXT.phrase("as_published"), counts[1], None))
    return TEXT.table("factors", lines)


def meaning_table(columns: dict[noise.NoiseReading, FloatArray]) -> Table:
    """Return the plain column under every reading of the noise, the nearest first."""
    ordered = sorted(columns.items(), key=lambda pair: noise.distance(pair[1]))
    lines: list[tuple[Cell, ...]] = [
        (reading.description, round(100.0 * noise.distance(c), 1), *(round(float(v), 2) for v in c.ravel()))
        for reading, c in ordered
    ]
    printed = ", ".join(f"{v:g}" for row in PUBLISHED_NOISE["plain"] for v in row)
    return TEXT.table("readings", lines, published=printed)
