"""Pictures of system E's frames: what the cameras see, the sky, and what was measured over the pass."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Rectangle
from matplotlib.projections.polar import PolarAxes

from horizonval.core.arrays import FloatArray
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.systems.e.ground import frames as cam
from horizonval.systems.e.ground.frames import ARCSEC
from horizonval.systems.e.localisation.stations import enu_directions
from horizonval.systems.e.passes.measured_pass import StationPass
from horizonval.systems.published import page_text
from horizonval.systems.result import Figure

TEXT = page_text("E")
ZOOM_PX = 24
_AXES = ("azimuth x cos(elevation)", "elevation")
_STYLE = (("black", "o", "-"), ("tab:orange", "s", "--"))


def all_figures(passes: Sequence[StationPass], curve: dict[str, FloatArray]) -> tuple[Figure, ...]:
    """Return the figures of the passes, and of how faint the satellite may be."""
    return (
        TEXT.figure("frames", partial(draw_frames, passes)),
        TEXT.figure("frames-sky", partial(draw_sky, passes)),
        TEXT.figure("frames-signal", partial(draw_signal, passes)),
        TEXT.figure("frames-direction-errors", partial(draw_errors, passes)),
        TEXT.figure("frames-faint", partial(draw_faint, curve)),
    )


def draw_frames(passes: Sequence[StationPass]) -> MplFigure:
    """Draw one exposure of every station, and its streak."""
    figure = MplFigure(figsize=(9.0, 3.8 * len(passes)), layout="constrained")
    axes = figure.subplots(len(passes), 2, squeeze=False)
    for (whole, zoom), one in zip(axes, passes, strict=True):
        second = float(one.seconds[len(one.seconds) // 2])
        exposure = one.frames.expose(second)
        electrons = cam.electrons_of_dn(exposure.dn, one.frames.camera)
        low, noise = float(np.median(electrons)), float(np.std(electrons[:64]))
        shown = whole.imshow(electrons, cmap="gray", vmin=low - 2 * noise, vmax=low + 15 * noise)
        figure.colorbar(shown, ax=whole, label="electrons", shrink=0.8)
        u, v = exposure.path_uv[1]
        left, top = round(u) - ZOOM_PX, round(v) - ZOOM_PX
        whole.add_patch(Rectangle((left, top), 2 * ZOOM_PX, 2 * ZOOM_PX, fill=False, edgecolor="white"))
        whole.set_title(f"{one.station.name}, {second:g} s after the start")
        part = electrons[top : top + 2 * ZOOM_PX + 1, left : left + 2 * ZOOM_PX + 1]
        extent = (left - 0.5, left + 2 * ZOOM_PX + 0.5, top + 2 * ZOOM_PX + 0.5, top - 0.5)
        shown = zoom.imshow(part, cmap="gray", extent=extent)
        figure.colorbar(shown, ax=zoom, label="electrons", shrink=0.8)
        error = one.centroid_error_px[len(one.seconds) // 2]
        if np.all(np.isfinite(error)):
            zoom.plot(u + error[0], v + error[1], "+", color="tab:red", markersize=14)
        zoom.set_title(f"streak, magnitude {exposure.magnitude:.1f}")
        for axis in (whole, zoom):
            axis.set_xlabel("column, px")
            axis.set_ylabel("row, px")
            axis.grid(visible=False)
    return figure


def draw_sky(passes: Sequence[StationPass]) -> MplFigure:
    """Draw the radiance of the sky over every station."""
    figure = MplFigure(figsize=(5.0 * len(passes), 5.2), layout="constrained")
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 361, 3.0)), np.radians(np.arange(30.0, 90.1, 2.0)))
    maps = []
    for one in passes:
        towards = enu_directions(azimuth, elevation) @ one.station.itrs_from_enu.T
        maps.append(np.log10(one.frames.sky.radiance(towards, float(np.mean(one.seconds)))))
    low, high = min(m.min() for m in maps), max(m.max() for m in maps)
    axes = [cast(PolarAxes, figure.add_subplot(1, len(passes), k + 1, projection="polar")) for k in range(len(passes))]
    for axis, one, look in zip(axes, passes, maps, strict=True):
        shown = axis.pcolormesh(azimuth, 90 - np.degrees(elevation), look, vmin=low, vmax=high, cmap="viridis")
        axis.contour(azimuth, 90 - np.degrees(elevation), look, levels=8, colors="white", linewidths=0.5)
        way = 90 - np.degrees(one.true_elevation_rad)
        axis.plot(one.true_azimuth_rad, way, color="tab:red", linewidth=2)
        axis.plot(one.true_azimuth_rad[-1:], way[-1:], "^", color="tab:red", markersize=9)
        axis.plot([_sun_azimuth(one)], [60.0], "*", color="gold", markersize=16, clip_on=False, markeredgecolor="black")
        axis.set_theta_zero_location("N")
        axis.set_theta_direction(-1)
        axis.set_rmax(60.0)
        axis.set_rgrids([15, 30, 45], ["75°", "60°", "45°"], color="white")
        axis.grid(alpha=0.3)
        axis.set_title(one.station.name)
    figure.colorbar(shown, ax=axes, label="log10 of radiance, W m$^{-2}$ sr$^{-1}$ (0.50 to 0.75 µm)", shrink=0.7)
    return figure


def draw_signal(passes: Sequence[StationPass]) -> MplFigure:
    """Draw brightness and significance over the pass."""
    figure = MplFigure(figsize=(8.0, 5.0), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True)
    for one, (colour, _, line) in zip(passes, _STYLE, strict=False):
        top.plot(one.seconds, one.magnitude, line, color=colour, label=one.station.name)
        bottom.plot(one.seconds, one.significance, line, color=colour, linewidth=1)
    top.invert_yaxis()
    top.set_ylabel("magnitude above the air")
    top.legend()
    bottom.set_ylabel("significance, sigma")
    bottom.set_ylim(bottom=0.0)
    bottom.set_xlabel("time after the start of the pass, s")
    return figure


def draw_errors(passes: Sequence[StationPass]) -> MplFigure:
    """Draw the errors of all directions with what was claimed."""
    figure = MplFigure(figsize=(10.0, 2.6 * len(passes) + 0.8), layout="constrained")
    axes = figure.subplots(len(passes), 2, sharex=True, sharey=True, squeeze=False)
    for row, one in zip(axes, passes, strict=True):
        for k, axis in enumerate(row):
            claim = np.sqrt(one.covariance[:, k, k]) / ARCSEC
            axis.fill_between(one.seconds, -claim, claim, color="0.8")
            axis.plot(one.seconds, one.error_rad[:, k] / ARCSEC, ".", color="black", markersize=3)
            axis.axhline(0.0, color="0.4", linewidth=0.6)
            axis.set_title(f"{one.station.name}: {_AXES[k]}")
        row[0].set_ylabel("error, arcsec")
    for axis in axes[-1]:
        axis.set_xlabel("time after the start of the pass, s")
    return figure


def draw_faint(curve: dict[str, FloatArray]) -> MplFigure:
    """Draw the share detected and the error of the middle against the magnitude."""
    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    share, error = figure.subplots(1, 2)
    for (name, values), style in zip(curve.items(), _STYLE, strict=False):
        _draw_curve(share, error, name, values, style)
    share.set_ylabel("share of exposures measured")
    share.set_ylim(-0.03, 1.05)
    share.legend()
    error.set_yscale("log")
    error.set_ylabel("error of the streak's middle, px")
    for axis in (share, error):
        axis.set_xlabel("magnitude above the air")
    return figure


def _draw_curve(share: Axes, error: Axes, name: str, values: FloatArray, style: tuple[str, str, str]) -> None:
    colour, mark, line = style
    share.plot(values[:, 0], values[:, 1], line, marker=mark, color=colour, label=name)
    error.plot(values[:, 0], values[:, 2], mark, color=colour)
    error.plot(values[:, 0], values[:, 3], line, color=colour)


def _sun_azimuth(one: StationPass) -> float:
    sun, _ = sun_itrs(one.frames.path.epoch_utc)
    east, north, _ = sun @ one.station.itrs_from_enu
    return float(np.arctan2(east, north))
