"""The page of a study of the infrared horizon: made of ``stability/result.json`` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.report import plots
from horizonval.report.figures import stability_plots as draw
from horizonval.report.words import number
from horizonval.store.folder import read_json

RESULT = Path("stability") / "result.json"
PAGE = "stability.html"


def load_result(run_dir: Path) -> dict[str, Any] | None:
    """Return the result of a run's study, or ``None`` where there is none (yet).

    Raises
    ------
    DamagedFileError
        The file is not what a run writes.
    """
    path = run_dir / RESULT
    result: dict[str, Any] | None = read_json(path, fix="run the suite again")
    if result is None:
        return None
    if not {"bands", "months", "published"} <= set(result):
        raise DamagedFileError("not a study's result", where=str(path), fix="run the suite again")
    return result


def headline(result: JsonObject) -> str:
    """Return the study in one sentence, for the report's first page."""
    band = leading_band(result)
    half = band["half_statistics"]
    pitch = [f"{s['max_pitch_deg']:.3f}° ({draw.sensor_words(s)})" for s in band["sensors"]]
    return (
        f"at {draw.title_of(band)} half of the plateau stands {number(half['min'])} to {number(half['max'])} km high. "
        f"Largest pitch error: {', '.join(pitch)}."
    )


def leading_band(result: JsonObject) -> JsonObject:
    """Return the band that is compared with what is published: the first whose horizon is the air itself."""
    bands: list[JsonObject] = result["bands"]
    return next((band for band in bands if band["kind"] == "opaque"), bands[0])


def page_of(result: JsonObject) -> dict[str, Any]:
    """Return everything the template shows."""
    band = leading_band(result)
    return {
        "result": result,
        "headline": headline(result),
        "figures": _figures(result, band),
        "bands": [_band_line(b) for b in result["bands"]],
        "errors": [_error_line(b, s) for b in result["bands"] for s in b["sensors"]],
        "published": [
            {**item, "value": _published_value(item), "ours": _ours(item, band)} for item in result["published"]
        ],
        "leading": draw.title_of(band),
    }


def _figures(result: JsonObject, band: JsonObject) -> list[dict[str, Any]]:
    panels, sensors = len(result["bands"]), len(band["sensors"])
    title = draw.title_of(band)
    return [
        plots.figure(
            "Radiance of the limb",
            (
                "Against the lowest height of the ray, seen along a parallel. In the bands of carbon dioxide the "
                "air hides the ground, and the radiance falls over 30 km; a window shows the ground, and falls over 10."
            ),
            draw.profiles(result),
            3.2 * panels,
            3.4,
            wide=True,
        ),
        plots.figure(
            "Height of the horizon against latitude",
            (
                "Half of the plateau (full) and steepest fall (dotted). The grey band is how far the spectroscopy "
                "may be off: it would shift all curves together, which calibration takes out. Where a limb falls "
                "evenly over many kilometres, as that of carbon dioxide does, its steepest place jumps: a poor edge."
            ),
            draw.heights_by_latitude(result),
            3.2 * panels,
            3.6,
            wide=True,
        ),
        plots.figure(
            f"Height and plateau through the year, {title}",
            ("By latitude of the lowest point and month."),
            draw.maps(result, band),
            3.2 * panels,
            4.0,
            wide=True,
        ),
        plots.figure(
            f"Attitude error round the orbit, {title}",
            (
                f"{result['altitude_km']:g} km, inclination {result['inclination_deg']:g}°; ascending node at 0°, "
                "northernmost point at 90°. Dashed: the largest errors that were published; green: the requirement."
            ),
            draw.errors_round_orbit(result, band),
            3.2 * sensors,
            5.2,
            wide=True,
        ),
    ]


def _band_line(band: JsonObject) -> dict[str, str]:
    def span(key: str, digits: int) -> str:
        statistics = band[key]
        low, high, mean = (number(statistics[name], digits) for name in ("min", "max", "mean"))
        return f"{low} to {high}, mean {mean}"

    width = band["spectroscopy_km"]
    return {
        "title": draw.title_of(band),
        "name": band["name"],
        "kind": {"opaque": "the air", "window": "the ground, through the air"}.get(band["kind"], "one or the other"),
        "half": span("half_statistics", 3),
        "std": number(band["half_statistics"]["std"], 2),
        "gradient": span("gradient_statistics", 3),
        "plateau": span("plateau_statistics", 3),
        "spectroscopy": f"± {number(width, 2)}" if width is not None else "–",
    }


def _error_line(band: JsonObject, sensor: JsonObject) -> dict[str, str]:
    keys = ("max_pitch_deg", "rms_pitch_deg", "max_roll_deg", "rms_roll_deg")
    return {
        "band": draw.title_of(band),
        "first": "yes" if sensor is band["sensors"][0] else "",
        "sensor": draw.sensor_words(sensor),
        **{key: f"{sensor[key]:.3f}" for key in keys},
    }


def _published_value(item: JsonObject) -> str:
    low, high = item["low"], item["high"]
    if item["quantity"] == "variation":
        return f"{100 * high:g} %"
    unit = "°" if item["quantity"].endswith("_deg") else " km" if item["quantity"].endswith("_km") else " W m⁻² sr⁻¹"
    return (f"{low:g}" if low == high else f"{low:g} to {high:g}") + unit


def _ours(item: JsonObject, band: JsonObject) -> list[str]:
    """Return the study's own figures beside a published one, a line each."""
    quantity, words = item["quantity"], draw.sensor_words
    edges = [s for s in band["sensors"] if s["kind"] == "edge"]
    fields = [s for s in band["sensors"] if s["kind"] == "field" and s["field_deg"] == item["field_deg"]]
    if quantity in ("edge_pitch_deg", "edge_roll_deg"):
        key = "max_pitch_deg" if "pitch" in quantity else "max_roll_deg"
        return [f"{s[key]:.3f}°, {words(s)}" for s in edges]
    if quantity == "field_pitch_deg":
        return [f"{s['max_pitch_deg']:.3f}° in pitch, {s['max_roll_deg']:.3f}° in roll" for s in fields]
    if quantity == "requirement_deg":
        return [f"{max(s['max_pitch_deg'], s['max_roll_deg']):.3f}° at most, {words(s)}" for s in band["sensors"]]
    if quantity == "variation":
        return [f"{100 * band['variation']:.0f} % over latitude and season, none with longitude"]
    if quantity in ("half_std_km", "threshold_std_km"):
        edge_sensors = [s for s in edges if quantity.startswith(s["locator"])]
        return [f"{number(s['calibration']['std_km'], 2)} km, {words(s)}" for s in edge_sensors]
    statistics = band["half_statistics" if quantity == "half_km" else "plateau_statistics"]
    unit = "km" if quantity == "half_km" else "W m⁻² sr⁻¹"
    return [f"{number(statistics['min'])} to {number(statistics['max'])} {unit}"]
