"""Sections of the report on the infrared horizon, the height where the radiance of thermal bands drops, and its error.

One section uses the truth of the images, the other ``stability/result.json``, along an orbit and through the year.
"""

from __future__ import annotations

import calendar
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.earth.spectral.bands import limits_um
from horizonval.frame import FrameTruth
from horizonval.report import plots
from horizonval.report.load import CaseView
from horizonval.report.words import DASH, count, number, percent
from horizonval.store.folder import read_json
from horizonval.truth.infrared_horizon import MAXIMUM_GRADIENT, visible_height_m

TEXT = (
    "A thermal band does not see the hard horizon but the edge of what radiates. The truth of every thermal frame says "
    "where that is in a clear sky, from rays integrated apart from the renderer: the height at which the radiance has "
    "fallen to half its plateau, and the one at which it falls fastest. In opaque bands the plateau is the air's (the "
    "largest radiance from 10 to 24 km), in window bands the ground's (10 km below the hard horizon). Clouds are left "
    "out; they lift the horizon of a window band to their tops."
)
_MOST_CURVES = 7
"""Curves of the infrared horizon with names."""
_KIND = {"opaque": "the air", "window": "the ground, through the air"}
_SEASONS = (3, 6, 9, 12)

# -------------------------------------------------------------------------------------------- of the frames of a run


def section_of_frames(views: Sequence[CaseView]) -> dict[str, Any] | None:
    """Return the template's data of the infrared horizon; None for runs without one."""
    frames = [
        (view.case, view.band, view.image.truth, view.image.truth.infrared_horizon[view.band])
        for view in views
        if view.image is not None and view.band in view.image.truth.infrared_horizon
    ]
    if not frames:
        return None
    places: list[str] = []
    sentences: dict[str, list[str]] = {}
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for _, name, truth, stored in frames:
        lo, hi = limits_um(next(band for band in truth.camera_spec.band if band.name == name))
        row = {"band": name, "range": f"{lo:g} to {hi:g} um", "kind": stored["kind"], "radiance": [], "height": DASH}
        if accuracy := stored.get("accuracy"):
            places = places or [_place(*pair) for pair in accuracy["heights_km"]]
            sentences[name] = accuracy["sentences"]
            row["radiance"] = [percent(None if x is None else round(x, 3)) for x in accuracy["relative"]]
            if accuracy["half_height_km"] is not None:
                row["height"] = f"{accuracy['half_height_km']:g} km"
        rows.setdefault((name, row["range"], row["kind"]), row)
    for row in rows.values():
        row["radiance"] = row["radiance"] or [DASH] * len(places)
    kinds = sorted({stored["kind"] for *_, stored in frames})
    caption = (
        "Lowest height of the ray against azimuth about the nadir; solid: half of the plateau, dotted: steepest fall. "
        f"{count(len(frames), 'frame')}, true and clear-sky; (+n): so many more with the same curve."
    )
    curves = [(stored["kind"], band, case, stored) for case, band, _, stored in frames]
    drawn = _curves_of_frames(curves, kinds)
    return {
        "text": TEXT,
        "notes": _notes(sentences),
        "places": places,
        "figure": plots.figure("Height of the infrared horizon", caption, drawn, 5.8, 1.2 + 2.6 * len(kinds)),
        "rows": [rows[key] for key in sorted(rows)],
    }


def facts_of(truth: FrameTruth, band: str) -> list[tuple[str, str]]:
    """Return a frame's facts about the infrared horizon in view."""
    half, steepest = (visible_height_m(truth, band, *locator) for locator in ((), (MAXIMUM_GRADIENT,)))
    if half is None or steepest is None:
        return []
    half_km, steepest_km = number(half / 1e3), number(steepest / 1e3)
    heights = f"half of the plateau at {half_km} km, steepest fall at {steepest_km} km, on average"
    return [("infrared horizon in view", heights)]


def _curves_of_frames(frames: Sequence[tuple[str, str, str, JsonObject]], kinds: Sequence[str]) -> plots.Draw:
    """Draw the heights of frames (kind, band, case, stored data), a panel for each kind."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
        for axes, kind in zip(panels, kinds, strict=True):
            cases: dict[tuple[float, ...], list[str]] = {}
            for _, _, case, stored in (frame for frame in frames if frame[0] == kind):
                key = (*stored["half_plateau_height_m"], *stored["maximum_gradient_height_m"])
                cases.setdefault(key, []).append(case)
            named = len(cases) <= _MOST_CURVES
            for i, (heights, own) in enumerate(cases.items()):
                half, steepest = np.array(heights).reshape(2, -1) / 1e3
                azimuth = np.linspace(0.0, 360.0, len(half) + 1)
                look = {"color": plots.COLOURS[i % len(plots.COLOURS)], "lw": 1.6 if named else 0.9}
                label = own[0] if len(own) == 1 else f"{own[0]} (+{len(own) - 1})"
                axes.plot(azimuth, np.append(half, half[0]), label=label, **look)
                axes.plot(azimuth, np.append(steepest, steepest[0]), ls=":", **look)
            several = len({band for found, band, *_ in frames if found == kind}) > 1
            axes.set_title(f"{kind} {'bands' if several else 'band'}", fontsize=9.5, loc="left")
            axes.set_ylabel("height [km]")
            if named:
                axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
        panels[-1].set(xlim=(0, 360), xticks=range(0, 361, 90), xticklabels=["N", "E", "S", "W", "N"])
        panels[-1].set_xlabel("azimuth about the nadir")

    return draw


def _notes(sentences: dict[str, list[str]]) -> list[str]:
    """Return a paragraph for every band with its sentences, and one with the common sentences."""
    if not sentences:
        return []
    common = [s for s in next(iter(sentences.values())) if all(s in lines for lines in sentences.values())]
    distinct = {band: " ".join(s for s in lines if s not in common) for band, lines in sentences.items()}
    return [*(f"{band}: {text}" for band, text in sorted(distinct.items()) if text), " ".join(common)]


def _place(low_km: float | None, high_km: float | None) -> str:
    return "ground" if low_km is None else f"above {low_km:g}" if high_km is None else f"{low_km:g}–{high_km:g}"


# ------------------------------------------------------------------------------------ round an orbit, through the year


def section_of_year(run_dir: Path) -> dict[str, Any] | None:
    """Return the template's data of the yearly study; None without one. Raises ``DamagedFileError``: a changed file."""
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
            plots.figure(
                "Height of the horizon against latitude",
                "Full: half of the plateau; dotted: steepest fall. The shaded band is the uncertainty of the "
                "spectroscopy, which moves all curves together.",
                _heights(result),
                3.2 * len(bands),
                3.6,
                wide=True,
            ),
            plots.figure(
                f"Attitude error round the orbit, {_title(leading)}",
                "Ascending node at 0°, northernmost point at 90°.",
                _errors(result, leading),
                3.2 * len(leading["sensors"]),
                5.2,
                wide=True,
            ),
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
    """Return the months to draw and their colours: one of each season, else up to four."""
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
