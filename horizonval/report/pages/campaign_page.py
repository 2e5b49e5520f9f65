"""The page of a campaign: the figures that the suite asks for, rates with their intervals, and the worst frames.

Made of the run's folder alone. Every mark of a frame links to that frame's card on the report's first page.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any
from urllib.parse import quote

from horizonval.core.json_types import JsonObject
from horizonval.report.figures import campaign_plots as draw
from horizonval.report.figures.campaign_plots import Span, inline_svg
from horizonval.report.figures.plots import Draw
from horizonval.report.formatting import count, interval, number, percent
from horizonval.report.load import ReportRun
from horizonval.report.pages.confusion_section import matrices_of
from horizonval.report.verdict import FALSE_VALID, MISSED, verdict_of
from horizonval.scoring import limits
from horizonval.scoring.expected import exclusion_angle_deg
from horizonval.scoring.row import Row
from horizonval.scoring.summary import rates, summarise

PAGE = "campaign.html"
FIGURES = "figures"
"""Folder beside the page with its figures as files."""
WORST = 6
GUARDED = "guarded-"


def headline(run: ReportRun) -> JsonObject:
    """Return the page's name and the campaign in one sentence."""
    rows = run.judged_rows
    false = sum(verdict_of(row) is FALSE_VALID for row in rows)
    claims = sum(row.is_claim for row in rows)
    figures = f"{count(len(run.figures), 'figure')}; " if run.figures else ""
    return {"page": PAGE, "text": f"{figures}{false} of {claims} claims are false."}


def is_due(run: ReportRun) -> bool:
    """Whether a run has this page: figures that the suite asks for, or several draws of the noise, or both."""
    return bool(run.figures) or has_draws(run)


def has_draws(run: ReportRun) -> bool:
    """Whether frames were observed more than once."""
    return any(row.noise_draws is not None for row in run.rows)


def page_of(run: ReportRun) -> JsonObject:
    """Return everything the template shows."""
    rows, link, names = run.judged_rows, links_of(run), run.judged_estimators
    groups = summarise(rows)["groups"]
    # One claim has no spread.
    spread = [group for group in groups if group["roll_error_arcsec"]["n"] > 1]
    return {
        "headline": headline(run)["text"],
        "sections": [_section(run, plan, number, link) for number, plan in enumerate(run.figures)],
        "confusions": matrices_of(rows, names),
        "together": [_rates(name, "", rates(own), len(own)) for name, own in _pooled(rows)],
        "rates": [_rates(group["estimator"], group["camera"], group, group["n"]) for group in groups],
        "errors": [_errors(group) for group in groups],
        "tails": inline_svg(draw.error_distribution(rows, names, link), 6.2, 4.8, "tails"),
        "bias": inline_svg(draw.bias_and_noise(spread), 7.4, 1.1 + 0.42 * len(spread), "bias") if spread else "",
        "worst": _worst(rows, link),
        "drawn": has_draws(run),
        "limit_deg": f"{math.degrees(limits.NADIR_ERROR_LIMIT_RAD):g}",
        "default_sigma_deg": f"{math.degrees(limits.DEFAULT_SIGMA_RAD):g}",
        "sigmas": f"{limits.SIGMA_LIMIT:g}",
        "likelihood_deg": f"{math.degrees(limits.LIKELIHOOD_LIMITS.nadir_error_rad):g}",
        "floor_deg": f"{math.degrees(limits.SIGMA_TEST_FLOOR_RAD):g}",
    }


def links_of(run: ReportRun) -> draw.Link:
    """Return what gives the address of a row's frame: ``None`` where the first page does not show it."""
    shown = {view.case for view in run.views if view.shown}
    return lambda row: f"index.html#{quote(row.case)}" if row.case in shown else None


def _pooled(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Return the rows of all bare and of all guarded methods, those that are there."""
    guarded = [row for row in rows if row.estimator.startswith(GUARDED)]
    bare = [row for row in rows if not row.estimator.startswith(GUARDED)]
    return [(name, own) for name, own in (("all bare methods", bare), ("all guarded methods", guarded)) if own]


def _section(run: ReportRun, plan: JsonObject, index: int, link: draw.Link) -> JsonObject:
    rows = [row for row in run.judged_rows if row.case in plan["cases"]]
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.camera, row.band), []).append(row)
    figures = []
    for (camera, band), own in sorted(groups.items()):
        names = [name for name in run.judged_estimators if any(row.estimator == name for row in own)]
        for k, (estimator, drawn, width, height) in enumerate(_drawings(plan, own, names, link)):
            salt = f"figure-{index}-{camera}-{band}-{k}"
            name = "-".join(filter(None, [str(index + 1), plan["kind"], camera, band, estimator]))
            figures.append(
                {
                    "title": ", ".join(filter(None, [camera, band, estimator])),
                    "svg": inline_svg(drawn, width, height, salt),
                    "file": f"{FIGURES}/{re.sub(r'[^A-Za-z0-9._-]+', '-', name)}.svg",
                }
            )
    return {"title": plan["title"], "kind": plan["kind"], "figures": figures, "n": len({row.case for row in rows})}


def _drawings(
    plan: JsonObject, rows: Sequence[Row], names: Sequence[str], link: draw.Link
) -> list[tuple[str, Draw, float, float]]:
    """Return the estimator of each drawing, "" of all together, what draws it, and its width and height [in]."""
    first = {case: values[0] for case, values in plan["cases"].items() if values}
    match plan["kind"]:
        case "timeline":
            minutes = _minutes(rows)
            height = draw.timeline_height_in(rows, names)
            return [("", draw.timeline(rows, names, minutes, _spans(rows, minutes), link), 10.0, height)]
        case "map":
            second = {case: values[1] for case, values in plan["cases"].items()}
            labels = (_label(plan["x"]), _label(plan["y"]))
            return [
                (
                    name,
                    draw.heat_map([r for r in rows if r.estimator == name], first, second, labels),
                    5.4,
                    4.2,
                )
                for name in names
            ]
        case "sweep":
            height = draw.curves_height_in(names)
            return [("", draw.sweep(rows, names, first, _label(plan["x"]), link), 9.0, height)]
        case _:
            angles = {row.case: row.sun_boresight_deg for row in rows if row.sun_boresight_deg is not None}
            rows = [row for row in rows if row.case in angles]
            found = {
                name: exclusion_angle_deg([angles[r.case] for r in own], [r.is_right for r in own])
                for name in names
                if (own := [row for row in rows if row.estimator == name])
            }
            height = draw.curves_height_in(names)
            return [("", draw.exclusion_curves(rows, names, angles, found, link), 9.0, height)]


def _label(key: str) -> str:
    """Return an axis' words: the last part of its key, the unit in brackets."""
    word = key.rpartition(".")[2]
    for ending, unit in UNITS.items():
        if word.endswith(ending):
            return f"{word.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return word.replace("_", " ")


UNITS = {"_deg": "deg", "_km": "km", "_um": "µm", "_s": "s", "_c": "°C", "_k": "K", "_px": "px", "_e": "e", "_h": "h"}


def _minutes(rows: Sequence[Row]) -> dict[str, float]:
    times = {row.case: datetime.fromisoformat(row.epoch_utc) for row in rows if row.epoch_utc}
    start = min(times.values())
    return {case: (time - start).total_seconds() / 60.0 for case, time in times.items()}


def _spans(rows: Sequence[Row], minutes: Mapping[str, float]) -> list[Span]:
    """Return the stretches of eclipse, Sun in frame and terminator in view, from half-way to the next frame on."""
    by_case = {row.case: row for row in rows}
    order = sorted(by_case, key=lambda case: minutes[case])
    times = [minutes[case] for case in order]
    tests = {
        "eclipse": lambda row: row.sun_visible_fraction == 0.0,
        "Sun in the frame": lambda row: bool(row.sun_in_frame),
        "terminator in view": lambda row: row.lit_fraction is not None and 0.0 < row.lit_fraction < 1.0,
    }
    spans = []
    for label, test in tests.items():
        start: float | None = None
        for i, case in enumerate(order):
            before = times[i] if i == 0 else (times[i - 1] + times[i]) / 2
            if test(by_case[case]):
                start = before if start is None else start
            elif start is not None:
                spans.append(Span(label, start, before))
                start = None
        if start is not None:
            spans.append(Span(label, start, times[-1]))
    return spans


def _rates(name: str, camera: str, found: Mapping[str, Any], n: int) -> JsonObject:
    """Return the words of a line of the table of rates; ``found`` as :func:`horizonval.scoring.summary.rates`."""
    false = found["false_valid"]
    return {
        "estimator": name,
        "camera": camera,
        "n": n,
        "borderline": found["n_borderline"],
        "crashed": found["crashed"]["n"],
        "without_sigma": found["claims_without_sigma"],
        **{key: _share(found[key]) for key in ("availability", "refusal", "bonus", "false_valid")},
        "bound": "" if false["upper_bound"] is None else _bound(false["upper_bound"]),
        "beyond_limit": false["beyond_limit"],
        "beyond_sigma": false["beyond_sigma"],
    }


def _share(found: Mapping[str, Any]) -> JsonObject:
    if not found["of"]:
        return {"rate": number(None), "of": "none", "interval": ""}
    return {
        "rate": percent(found["rate"]),
        "of": f"{found['n']} of {found['of']}",
        "interval": interval(found["interval"], as_percent=True),
    }


def _bound(share: float) -> str:
    """Return an upper bound in per cent, rounded up: it must not look better than it is."""
    digits = 1 if share >= 0.01 else 3
    return f"{math.ceil(100 * share * 10**digits - 1e-9) / 10**digits:.{digits}f} %"


def _errors(group: Mapping[str, Any]) -> JsonObject:
    """Return the words of a line of the table of errors."""
    error = group["nadir_error_arcsec"]
    return {
        "estimator": group["estimator"],
        "camera": group["camera"],
        "n": error["n"],
        **{key: number(_degrees(error[key])) for key in ("median", "p95", "max")},
        **{key: _bias(group[f"{key}_error_arcsec"]) for key in ("roll", "pitch")},
        **{key: _consistency(group[key]) for key in ("nees_noise", "nees_nadir", "nees_nadir_total")},
    }


def _bias(found: Mapping[str, Any]) -> JsonObject:
    return {"mean": _signed(_degrees(found["mean"])), "std": number(_degrees(found["std"]))}


def _signed(degrees: float | None) -> str:
    """Return a bias to a thousandth of a degree; below that it is nothing to anyone."""
    return number(None) if degrees is None else f"{degrees:+.3f}".replace("-", "\N{MINUS SIGN}")


def _consistency(found: Mapping[str, Any]) -> JsonObject:
    """Return the words of a mean normalised error squared, per degree of freedom."""
    if not found["n"]:
        return {"mean": number(None), "n": 0, "interval": "", "glyph": "", "error": ""}
    dof = found["expected"]
    mean = found["mean"] / dof
    glyph = "" if 0.5 <= mean <= 2.0 else ("\N{UPWARDS ARROW}" if mean > 1.0 else "\N{DOWNWARDS ARROW}")
    bounds = [value / dof for value in found["interval"]]
    error = found.get("standard_error")
    return {
        "mean": number(mean),
        "n": found["n"],
        "draws": found.get("draws"),
        "error": "" if error is None else number(error / dof, 2),
        "interval": interval(bounds),
        "glyph": glyph,
    }


def _degrees(arcsec: float | None) -> float | None:
    return None if arcsec is None else arcsec / 3600.0


def _worst(rows: Sequence[Row], link: draw.Link) -> list[JsonObject]:
    """Return the worst frames of each kind: false claims by their error, and usable frames that were refused."""
    false = sorted(
        (row for row in rows if verdict_of(row) is FALSE_VALID), key=lambda row: -(row.nadir_error_arcsec or 0.0)
    )
    missed = sorted((row for row in rows if verdict_of(row) is MISSED), key=lambda row: -(row.lit_fraction or 0.0))
    return [
        {
            "kind": kind.label,
            "glyph": kind.glyph,
            "total": len(found),
            "lines": [
                {
                    "case": row.case,
                    "estimator": row.estimator,
                    "link": link(row),
                    "text": f"{number(_degrees(row.nadir_error_arcsec))}° off"
                    if kind is FALSE_VALID
                    else f"{row.status.replace('_', ' ')}: {row.reason or ''}",
                }
                for row in found[:WORST]
            ],
        }
        for kind, found in ((FALSE_VALID, false), (MISSED, missed))
        if found
    ]
