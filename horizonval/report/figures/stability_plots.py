"""Figures of the stability page: profiles, heights by latitude, maps by latitude and month, errors round the orbit."""

from __future__ import annotations

import calendar
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from horizonval.core.json_types import JsonObject
from horizonval.report.plots import Draw

SEASONS = (3, 6, 9, 12)
"""Months that stand for the year: those of equinoxes and solstices."""
_COLOURS = ("#009e73", "#d55e00", "#cc79a7", "#0072b2")
_GREY = "#8d949c"
_PUBLISHED = "#111111"


def shown_months(months: Sequence[int]) -> list[int]:
    """Return the months that are drawn as lines: the seasons' if all are there, else up to four of those there are."""
    if set(SEASONS) <= set(months):
        return list(SEASONS)
    return [months[int(i)] for i in np.unique(np.linspace(0, len(months) - 1, 4).round())]


def colour_of(month: int, shown: Sequence[int]) -> str:
    """Return a month's colour."""
    return _COLOURS[list(shown).index(month)]


def profiles(result: JsonObject) -> Draw:
    """Radiance against height, one panel per band."""

    def draw(figure: Figure) -> None:
        styles = (("#555555", "-"), ("#0072b2", "-"), ("#d55e00", "-"))
        height = np.array(result["height_km"])
        panels = figure.subplots(1, len(result["bands"]), squeeze=False)[0]
        for axes, band in zip(panels, result["bands"], strict=True):
            for example, (colour, line) in zip(band["examples"], styles, strict=False):
                radiance = np.array(example["radiance_w_m2_sr"])
                axes.plot(radiance, height, color=colour, ls=line, lw=1.4, label=_place(example))
            axes.axhline(0, color="#333333", lw=0.8)
            axes.set(ylim=(-20, 80), xlabel="radiance [W m$^{-2}$ sr$^{-1}$]")
            axes.set_xlim(left=0)
            axes.set_title(title_of(band), fontsize=10, loc="left")
        panels[0].set_ylabel("lowest height of the ray [km]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)

    return draw


def heights_by_latitude(result: JsonObject) -> Draw:
    """Half-plateau height against latitude, one panel per band, the uncertainty of the spectroscopy shaded."""

    def draw(figure: Figure) -> None:
        latitude = np.array(result["latitude_deg"])
        months = result["months"]
        shown = shown_months(months)
        panels = figure.subplots(1, len(result["bands"]), squeeze=False)[0]
        for axes, band in zip(panels, result["bands"], strict=True):
            half, steep = np.array(band["half_km"]), np.array(band["gradient_km"])
            middle, width = half.mean(axis=0), band["spectroscopy_km"]
            if width is not None:
                axes.fill_between(latitude, middle - width, middle + width, color="#e3e6ea", lw=0)
            for month in shown:
                i = months.index(month)
                axes.plot(latitude, half[i], color=colour_of(month, shown), lw=1.7)
                axes.plot(latitude, steep[i], color=colour_of(month, shown), lw=0.9, ls=":")
            axes.set(xlim=(-90, 90), xticks=range(-90, 91, 45), xlabel="latitude [deg]")
            axes.set_title(title_of(band), fontsize=10, loc="left")
            _at_least(axes, 4.0)
        panels[0].set_ylabel("height of the horizon [km]")
        handles: list[Any] = [Line2D([], [], color=colour_of(m, shown), lw=1.7, label=name_of(m)) for m in shown]
        handles += [
            Line2D([], [], color="#333333", lw=0.9, ls=":", label="steepest fall"),
            Patch(color="#e3e6ea", label="uncertainty of the spectroscopy about the year's mean"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))

    return draw


def maps(result: JsonObject, band: JsonObject) -> Draw:
    """Half-plateau height and plateau of one band by latitude and month."""

    def draw(figure: Figure) -> None:
        latitude, months = np.array(result["latitude_deg"]), np.array(result["months"])
        pair = (
            ("half_km", "half-plateau height [km]", "viridis", 0.5),
            ("plateau_w_m2_sr", "plateau [W m$^{-2}$ sr$^{-1}$]", "inferno", 0.25),
        )
        for axes, (key, label, colours, step) in zip(figure.subplots(1, 2), pair, strict=True):
            values = np.array(band[key]).T
            mesh = axes.pcolormesh(_edges(months), _edges(latitude), values, cmap=colours, shading="flat")
            mesh.set_edgecolor("face")
            if len(months) > 1:
                first = np.ceil(values.min() / step) * step
                levels = np.arange(first, values.max(), step)
                lines = axes.contour(months, latitude, values, levels=levels, colors="white", linewidths=0.7)
                axes.clabel(lines, levels[::2], fontsize=7.5, fmt="%g")
            axes.set(ylim=(-90, 90), yticks=range(-90, 91, 30), ylabel="latitude [deg]")
            axes.set_xticks(months, [name_of(m)[:3] for m in months], fontsize=8)
            axes.grid(visible=False)
            figure.colorbar(mesh, ax=axes, label=label, pad=0.02)

    return draw


def errors_round_orbit(result: JsonObject, band: JsonObject) -> Draw:
    """Pitch (above) and roll error (below) of every sensor against the argument of latitude."""

    def draw(figure: Figure) -> None:
        argument, months = np.array(result["argument_deg"]), result["months"]
        shown = shown_months(months)
        sensors = band["sensors"]
        panels = figure.subplots(2, len(sensors), sharex=True, sharey="row", squeeze=False)
        loose = result["requirement_deg"][1]
        for column, sensor in enumerate(sensors):
            for row, axis in enumerate(("pitch", "roll")):
                axes = panels[row, column]
                for low, high, shade in zip((0.0, result["requirement_deg"][0]), result["requirement_deg"],
                                            ("#d9efe6", "#eef6e9"), strict=True):  # fmt: skip
                    for sign in (1, -1):
                        axes.axhspan(sign * low, sign * high, color=shade, lw=0)
                published = published_for(result, sensor, axis)
                if published is not None:
                    for sign in (1, -1):
                        axes.axhline(sign * published, color=_PUBLISHED, lw=1.1, ls="--")
                for month in shown:
                    values = np.array(sensor[f"{axis}_deg"][months.index(month)])
                    closed = np.append(argument, 360.0), np.append(values, values[0])
                    axes.plot(*closed, color=colour_of(month, shown), lw=1.5)
                axes.axhline(0, color="#555555", lw=0.6)
                axes.grid(axis="y", visible=False)
            panels[0, column].set_title(sensor_words(sensor), fontsize=10, loc="left")
            panels[1, column].set(xlim=(0, 360), xticks=range(0, 361, 90), xlabel="argument of latitude [deg]")
        for row, axis in enumerate(("pitch", "roll")):
            panels[row, 0].set_ylabel(f"{axis} error [deg]")
            reach = max(max(abs(v) for line in s[f"{axis}_deg"] for v in line) for s in sensors)
            panels[row, 0].set_ylim(*(sign * 1.12 * max(reach, loose) for sign in (-1, 1)))
        strict, loose = result["requirement_deg"]
        handles: list[Any] = [Line2D([], [], color=colour_of(m, shown), lw=1.5, label=name_of(m)) for m in shown]
        handles += [
            Line2D([], [], color=_PUBLISHED, lw=1.1, ls="--", label="published maximum"),
            Patch(color="#d9efe6", label=f"within {strict:g}°"),
            Patch(color="#eef6e9", label=f"within {loose:g}°"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))

    return draw


def published_for(result: JsonObject, sensor: JsonObject, axis: str) -> float | None:
    """Return the published maximum that belongs to a sensor's pitch or roll, if there is one."""
    quantity = f"edge_{axis}_deg" if sensor["kind"] == "edge" else f"field_{axis}_deg"
    for item in result["published"]:
        if item["quantity"] == quantity and (sensor["kind"] == "edge" or sensor["field_deg"] == item["field_deg"]):
            return float(item["high"])
    return None


def title_of(band: JsonObject) -> str:
    """Return a band's limits as text."""
    return f"{band['lo_um']}–{band['hi_um']} µm"


def sensor_words(sensor: JsonObject) -> str:
    """Return what a sensor is, in words."""
    if sensor["kind"] == "field":
        return f"field of {sensor['field_deg']:g}°"
    return {
        "half": "edge at half the own plateau",
        "gradient": "edge at the steepest fall",
        "threshold": "edge at a fixed radiance",
    }[sensor["locator"]]


def name_of(month: int) -> str:
    """Return a month's English name."""
    return calendar.month_name[month]


def _place(example: JsonObject) -> str:
    latitude = example["latitude_deg"]
    where = "equator" if latitude == 0 else f"{abs(latitude):g}° {'N' if latitude > 0 else 'S'}"
    return f"{where}, {name_of(example['month'])}"


def _edges(centres: np.ndarray) -> np.ndarray:
    """Return cell edges half way between places; half a unit about a single one."""
    centres = np.asarray(centres, dtype=np.float64)
    if len(centres) == 1:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])


def _at_least(axes: Axes, span: float) -> None:
    low, high = axes.get_ylim()
    if high - low < span:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - span / 2, middle + span / 2)
