"""The report's sections on the infrared horizon: where the radiance of thermal bands drops, and how well it is known.

One is made from the truth that is stored with the images, the other, round an orbit and through the year, from
``stability/result.json``.
"""

from __future__ import annotations

import calendar
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.frame import FrameTruth
from horizonval.report import plots
from horizonval.report.load import CaseView
from horizonval.report.words import count, number, percent
from horizonval.spec.camera import Band
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
    """Return what the template shows of the infrared horizon; None for runs whose truths have none."""
    shown = [v for v in views if v.image is not None and v.band in v.image.truth.infrared_horizon]
    if not shown:
        return None
    kinds = sorted({_stored(v)["kind"] for v in shown})
    caption = (
        "Lowest height of the ray against azimuth about the nadir; solid: half of the plateau, dotted: steepest fall. "
        f"{count(len(shown), 'frame')}, true and clear-sky; (+n): so many more with the same curve."
    )
    stated = [accuracy for v in shown if (accuracy := _stored(v).get("accuracy"))]
    return {
        "text": TEXT,
        "notes": _notes({v.band: accuracy["sentences"] for v in shown if (accuracy := _stored(v).get("accuracy"))}),
        "places": [_place(*pair) for pair in stated[0]["heights_km"]] if stated else [],
        "figure": plots.figure(
            "Height of the infrared horizon", caption, _curves_of_frames(shown, kinds), 5.8, 1.2 + 2.6 * len(kinds)
        ),
        "rows": _accuracy_rows(shown, len(stated[0]["heights_km"]) if stated else 0),
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


def _stored(view: CaseView) -> dict[str, Any]:
    assert view.image is not None
    found: dict[str, Any] = view.image.truth.infrared_horizon[view.band]
    return found


def _curves_of_frames(views: Sequence[CaseView], kinds: Sequence[str]) -> plots.Draw:
    cases: dict[tuple[Any, ...], list[str]] = {}
    for view in views:
        stored = _stored(view)
        key = (stored["kind"], *stored["half_plateau_height_m"], *stored["maximum_gradient_height_m"])
        cases.setdefault(key, []).append(view.case)
    distinct = {key: own[0] if len(own) == 1 else f"{own[0]} (+{len(own) - 1})" for key, own in cases.items()}

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(kinds), 1, sharex=True, squeeze=False)[:, 0]
        for axes, kind in zip(panels, kinds, strict=True):
            own = [(name, key[1:]) for key, name in distinct.items() if key[0] == kind]
            several = len({v.band for v in views if _stored(v)["kind"] == kind}) > 1
            for i, (name, heights) in enumerate(own):
                _curves(axes, heights, i, name if len(own) <= _MOST_CURVES else None)
            axes.set_title(f"{kind} {'bands' if several else 'band'}", fontsize=9.5, loc="left")
            axes.set_ylabel("height [km]")
            if len(own) <= _MOST_CURVES:
                axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
        panels[-1].set(xlim=(0, 360), xticks=range(0, 361, 90), xticklabels=["N", "E", "S", "W", "N"])
        panels[-1].set_xlabel("azimuth about the nadir")

    return draw


def _curves(axes: Axes, heights: tuple[float, ...], index: int, name: str | None) -> None:
    colour = plots.COLOURS[index % len(plots.COLOURS)]
    half, steepest = np.array(heights).reshape(2, -1) / 1e3
    azimuth = np.linspace(0.0, 360.0, len(half) + 1)
    width = 1.6 if name else 0.9
    axes.plot(azimuth, np.append(half, half[0]), color=colour, lw=width, label=name)
    axes.plot(azimuth, np.append(steepest, steepest[0]), color=colour, lw=0.8 * width, ls=":")


def _accuracy_rows(views: Sequence[CaseView], places: int) -> list[dict[str, Any]]:
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    for view in views:
        assert view.image is not None
        stored = _stored(view)
        spec = view.image.truth.camera_spec
        band = next(b for b in spec.band if b.name == view.band)
        accuracy = stored.get("accuracy")
        rows.setdefault(
            (view.band, _range(band), stored["kind"]),
            {
                "band": view.band,
                "range": _range(band),
                "kind": stored["kind"],
                "radiance": [_share(x) for x in accuracy["relative"]] if accuracy else ["–"] * places,
                "height": _height(accuracy),
            },
        )
    return [rows[key] for key in sorted(rows)]


def _range(band: Band) -> str:
    lo, hi = (band.lo_um, band.hi_um) if band.lo_um else (band.wavelength_um[0], band.wavelength_um[-1])
    return f"{lo:g} to {hi:g} um"


def _notes(sentences: dict[str, list[str]]) -> list[str]:
    """Return a paragraph for every band of what is said of it alone, and one of what is said of all."""
    if not sentences:
        return []
    common = [s for s in next(iter(sentences.values())) if all(s in distinct for distinct in sentences.values())]
    distinct = {band: " ".join(s for s in lines if s not in common) for band, lines in sentences.items()}
    return [*(f"{band}: {text}" for band, text in sorted(distinct.items()) if text), " ".join(common)]


def _place(low_km: float | None, high_km: float | None) -> str:
    return "ground" if low_km is None else f"above {low_km:g}" if high_km is None else f"{low_km:g}–{high_km:g}"


def _share(relative: float | None) -> str:
    return "–" if relative is None else percent(round(relative, 3))


def _height(accuracy: dict[str, Any] | None) -> str:
    if accuracy is None or accuracy["half_height_km"] is None:
        return "–"
    return f"{accuracy['half_height_km']:g} km"


# ------------------------------------------------------------------------------------ round an orbit, through the year


def section_of_year(run_dir: Path) -> dict[str, Any] | None:
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
