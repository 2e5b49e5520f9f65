"""The report's section on the infrared horizon round an orbit and through the year, from ``stability/result.json``."""

from __future__ import annotations

import calendar
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.report.figures import plots
from horizonval.report.formatting import number
from horizonval.store.folder import read_json

_KIND = {"opaque": "the air", "window": "the ground, through the air"}
_SEASONS = (3, 6, 9, 12)


def section_of(run_dir: Path) -> dict[str, Any] | None:
    """Return what the template shows of the study in a run's folder; None where there is none (yet).

    Raises
    ------
    DamagedFileError
        The file is not what a run writes.
    """
    path = run_dir / "stability" / "result.json"
    result: JsonObject | None = read_json(path, fix="run the suite again")
    if result is None:
        return None
    if not {"bands", "months", "argument_deg"} <= set(result):
        raise DamagedFileError("not a study's result", where=str(path), fix="run the suite again")
    bands = result["bands"]
    leading = next((band for band in bands if band["kind"] == "opaque"), bands[0])
    return {
        "altitude_km": result["altitude_km"],
        "inclination_deg": result["inclination_deg"],
        "field_deg": result["field_deg"],
        "sensors": [sensor["name"] for sensor in bands[0]["sensors"]],
        "bands": [_band_line(band) for band in bands],
        "figures": [
            {
                "uri": plots.figure_uri(_heights(result), 3.2 * len(bands), 3.6),
                "title": "Height of the horizon against latitude",
                "text": "Full: half of the plateau; dotted: steepest fall. The shaded band is the uncertainty of the "
                "spectroscopy, which moves all curves together.",
            },
            {
                "uri": plots.figure_uri(_errors(result, leading), 3.2 * len(leading["sensors"]), 5.2),
                "title": f"Attitude error round the orbit, {_title(leading)}",
                "text": "Ascending node at 0°, northernmost point at 90°.",
            },
        ],
    }


def _band_line(band: JsonObject) -> dict[str, Any]:
    spans = {
        key: f"{number(band[key]['min'])} to {number(band[key]['max'])}"
        for key in ("half_km", "gradient_km", "plateau_w_m2_sr")
    }
    width = band["spectroscopy_km"]
    return {
        "title": _title(band),
        "kind": _KIND.get(band["kind"], "one or the other"),
        **spans,
        "std": number(band["half_km"]["std"], 2),
        "spectroscopy": "–" if width is None else f"± {number(width, 2)}",
        "errors": [f"{s['max_pitch_deg']:.3f} / {s['max_roll_deg']:.3f}" for s in band["sensors"]],
    }


def _title(band: JsonObject) -> str:
    return f"{band['lo_um']}–{band['hi_um']} µm"


def _shown(months: list[int]) -> dict[int, str]:
    """Return the months that are drawn and their colours: one of each season, else up to four of those there are."""
    chosen = _SEASONS if set(_SEASONS) <= set(months) else [months[int(i)] for i in np.linspace(0, len(months) - 1, 4)]
    return dict(zip(dict.fromkeys(chosen), ("#009e73", "#d55e00", "#cc79a7", "#0072b2"), strict=False))


def _heights(result: JsonObject) -> plots.Draw:
    def draw(figure: Figure) -> None:
        latitude, months = np.array(result["latitude_deg"]), result["months"]
        panels = figure.subplots(1, len(result["bands"]), squeeze=False)[0]
        for axes, band in zip(panels, result["bands"], strict=True):
            half, steepest = (np.array(band["profiles"][key]) for key in ("half_km", "gradient_km"))
            middle, width = half.mean(axis=0), band["spectroscopy_km"] or 0.0
            axes.fill_between(latitude, middle - width, middle + width, color="#e3e6ea", lw=0)
            for month, colour in _shown(months).items():
                i = months.index(month)
                axes.plot(latitude, half[i], color=colour, lw=1.7, label=calendar.month_name[month])
                axes.plot(latitude, steepest[i], color=colour, lw=0.9, ls=":")
            axes.set(xlim=(-90, 90), xticks=range(-90, 91, 45), xlabel="latitude [deg]")
            axes.set_title(_title(band), fontsize=10, loc="left")
        panels[0].set_ylabel("height of the horizon [km]")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)

    return draw


def _errors(result: JsonObject, band: JsonObject) -> plots.Draw:
    def draw(figure: Figure) -> None:
        argument, months = np.append(result["argument_deg"], 360.0), result["months"]
        panels = figure.subplots(2, len(band["sensors"]), sharex=True, sharey=True, squeeze=False)
        for column, sensor in enumerate(band["sensors"]):
            for axes, axis in zip(panels[:, column], ("pitch", "roll"), strict=True):
                for month, colour in _shown(months).items():
                    values = sensor[f"{axis}_round_orbit_deg"][months.index(month)]
                    label = calendar.month_name[month]
                    axes.plot(argument, [*values, values[0]], color=colour, lw=1.5, label=label)
            panels[0, column].set_title(sensor["name"], fontsize=10, loc="left")
            panels[1, column].set(xlim=(0, 360), xticks=range(0, 361, 90), xlabel="argument of latitude [deg]")
        for axes, axis in zip(panels[:, 0], ("pitch", "roll"), strict=True):
            axes.set_ylabel(f"{axis} error [deg]")
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)

    return draw
