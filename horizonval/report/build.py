"""The report of a run: its first page, and the page of a campaign, if any.

A page is one file without external addresses: style, code, figures and pictures are inside. It depends on the run's
content only, not on its path or the time.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from horizonval.core import atomic
from horizonval.core.outcome import Outcome
from horizonval.frame import FrameTruth
from horizonval.report import campaign, infrared, page, pictures, plots, rerun, viewer
from horizonval.report.load import CaseView, ReportRun, load_run
from horizonval.report.words import (
    DEFAULT_SIGMA_ARCSEC,
    VERDICTS,
    AngleUnit,
    accuracy_of,
    by_camera,
    confusion_tables,
    count,
    headline,
    limit_words,
    meaning,
    number,
    outcome,
    percent,
    prior_words,
    unit_of,
    verdict_of,
)
from horizonval.scoring import requirements
from horizonval.scoring.bound import known_bound
from horizonval.scoring.expected import Expected, expected_outcome
from horizonval.scoring.summary import summarise
from horizonval.sensor.knowledge import drawn_prior
from horizonval.spec.prior import PriorSpec
from horizonval.store.folder import read_json
from horizonval.store.verify import amend_manifest

STRIP_RATIO = 20
"""Aspect ratio above which images are drawn as strips of their proportions."""
MOST_CASES_SHOWN = 300
"""Maximum number of pictures; a larger page would not open."""
_MOST_SOURCES = 4
"""Number of methods and cameras whose false claims are named."""
COARSE_PX = 320
"""Largest size of images whose pixels are shown as squares."""


def build_report(run_dir: Path) -> Path:
    """Write ``run_dir/report/index.html``, the page of a campaign and the figures; return the first page's path.

    The report of an unfinished run or damaged archive says so. Raises ``UserError``: no run, or unreadable files.
    """
    before = {path for path in (run_dir / "report").rglob("*") if path.is_file()}
    pages = write_report(run_dir)
    amend_manifest(run_dir, [*pages, *(path for path in before if not path.exists())])
    return pages[0]


def write_report(run_dir: Path) -> list[Path]:
    """Write the pages of a report and return them, as :func:`build_report` does the first."""
    run = load_run(run_dir, MOST_CASES_SHOWN)
    summary = summarise(run.rows, run.given_pose, run.orbit, run.likelihood)
    has_campaign = campaign.is_due(run)
    common: dict[str, Any] = {
        "version": run.version, "about": [f"suite {run.suite}"], "again": run.again, "run": run,
    }  # fmt: skip
    texts = {
        "index.html": page.render(
            "report.html",
            title=f"{run.suite}: horizonval report",
            heading=run.title or run.suite,
            stability=infrared.section_of_year(run_dir),
            requirements=read_json(run_dir / requirements.FILES[0]),
            campaign={"page": campaign.PAGE, "text": campaign.headline(run)} if has_campaign else None,
            **common,
            **page_of(run, summary),
        )
    }
    common["links"] = [("frames and estimators", "index.html")]
    if has_campaign:
        content = campaign.page_of(run)
        title = f"{run.title or run.suite}: where it works and where it fails"
        texts[campaign.PAGE] = page.render(
            "campaign.html",
            title=f"{run.suite}: where it works and where it fails",
            heading=title,
            **common,
            **content,
            **viewer.striking_frames(run.views, run.estimators),
            filters=campaign.FILTERS,
        )
        texts |= {figure["file"]: figure["svg"] for section in content["sections"] for figure in section["figures"]}
    folder = run_dir / "report"
    if (folder / campaign.FIGURES).is_symlink():
        (folder / campaign.FIGURES).unlink()
    shutil.rmtree(folder / campaign.FIGURES, ignore_errors=True)
    (folder / campaign.PAGE).unlink(missing_ok=True)
    for name, text in texts.items():
        atomic.make_folder((folder / name).parent)
        page.write(folder / name, text)
    return [folder / name for name in texts]


def page_of(run: ReportRun, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of the first page's template."""
    unit = unit_of(row.nadir_error_arcsec for row in run.judged_rows if row.is_claim)
    broken = sum(view.broken for view in run.views)
    views = [view for view in run.views if view.shown]
    numbered = viewer.numbered_frames([view.image for view in views])
    cards = [_card(view, run, unit, numbered=i in numbered) for i, view in enumerate(views)]
    viewer.share_directions([card["frame"] for card in cards])
    shown = {row["verdict"] for card in cards for row in card["rows"]}
    return {
        "summary": summary,
        "unit": unit,
        "n_frames": len({view.case for view in run.views}) + len(run.missing),
        "groups": [{**group, "finding": _finding(group, unit)} for group in by_camera(summary["groups"])],
        "prior": prior_words(run.prior),
        "headline": _verdict(summary, run, broken),
        "without_numbers": sum(card["frame"].get("numbers") == "" for card in cards),
        "broken": broken,
        "cameras": sorted({card["camera"] for card in cards}),
        "confusions": confusion_tables(run.rows, run.judged_estimators),
        "figures": _figures(run, unit),
        "cards": cards,
        "hidden": len({view.case for view in run.views if not view.shown}),
        "verdicts": [verdict for verdict in VERDICTS if verdict in shown],
        "limits": limit_words(unit),
        "gamma": f"{pictures.GAMMA:g}",
        "percentiles": [f"{value:g}" for value in pictures.GREY_PERCENTILES],
        "accuracy": accuracy_of(view.image.truth for view in run.views if view.image is not None),
        "infrared": infrared.section_of_frames(views),
    }


def _finding(group: Mapping[str, Any], unit: AngleUnit) -> str:
    if not group["given_pose"]:
        return headline(group, unit)
    worst = unit.text(group["nadir_error_arcsec"]["max"])
    return f"given the true pose, to test the scoring, and counted nowhere else; worst {worst}."


def _verdict(summary: Mapping[str, Any], run: ReportRun, broken: int) -> dict[str, str]:
    """Main result: crashes and false claims, else failed or missing frames, else success."""
    rates = summary["rates"]
    false, claims, crashes = rates["false_valid"]["n"], rates["false_valid"]["of"], rates["crashed"]["n"]
    parts = [f"{crashes} {'crash' if crashes == 1 else 'crashes'}"] if crashes else []
    if false:
        parts.append(f"{count(false, 'false claim')}: {_whose(summary['groups'])}")
    if parts:
        return {"kind": "false", "glyph": "✖", "text": "; ".join(parts)}
    if broken or run.missing:
        parts = [f"{count(broken, 'frame')} failed"] if broken else []
        parts += [f"{count(len(run.missing), 'frame')} not finished"] if run.missing else []
        return {"kind": "missed", "glyph": "▼", "text": ", ".join(parts)}
    if claims:
        return {"kind": "valid", "glyph": "●", "text": f"No false claim among {claims}"}
    return {"kind": "none", "glyph": "–", "text": "No attitude was claimed"}


def _whose(groups: Sequence[Mapping[str, Any]]) -> str:
    """Return the sources of the false claims, most frequent first."""
    false = [group for group in groups if not group["given_pose"] and group["false_valid"]["n"]]
    false.sort(key=lambda group: -group["false_valid"]["n"])
    words = [
        f"{group['false_valid']['n']} of {group['false_valid']['of']} by {group['estimator']} with {group['camera']}"
        for group in false[:_MOST_SOURCES]
    ]
    rest = sum(group["false_valid"]["n"] for group in false[_MOST_SOURCES:])
    return ", ".join([*words, f"{rest} by others"] if rest else words)


def _figures(run: ReportRun, unit: AngleUnit) -> list[dict[str, Any]]:
    # Estimators that receive the pose have zero errors and would stretch the axes.
    names, rows, many = run.judged_estimators, run.judged_rows, len(run.views) > 45
    floor = f"{unit.of(plots.FLOOR_ARCSEC):g}{unit.sign}"
    figures = [
        plots.figure(
            "Nadir error of every frame",
            "Angle between the claimed and the true nadir. The strip on top marks the frames that an estimator "
            f"refused. Errors below {floor} are drawn at {floor}.",
            plots.error_by_frame(run.views, names, unit),
            13.0 if many else 11.0,
            3.4 + 0.17 * len(names) + (0.0 if many else 1.0),
            wide=True,
        ),
        plots.figure(
            "Error against claimed uncertainty",
            "Points far above the diagonal are errors that the estimator does not know of: bias, such as the soft "
            "edge of the atmosphere.",
            plots.error_by_sigma(rows, names, unit),
            5.4,
            4.6,
        ),
        plots.figure(
            "Roll and pitch errors",
            "Claimed minus true, body axes. A cloud whose centre is off zero is a bias.",
            plots.roll_and_pitch(rows, names, unit),
            5.4,
            4.6,
        ),
    ]
    if any(row.error_over_bound is not None for row in rows):
        figures.insert(
            2,
            plots.figure(
                "Error against the bound",
                "The bound is the smallest root mean square error that the limb in the image allows (Cramér-Rao), "
                "with air, light and height of the limb as known as the scene says.",
                plots.error_by_bound(rows, names, unit),
                5.4,
                4.9 + 0.12 * len(names),
            ),
        )
    return figures


def _card(view: CaseView, run: ReportRun, unit: AngleUnit, *, numbered: bool) -> dict[str, Any]:
    """Return the content of a frame's card, and its data for the viewer."""
    image = view.image
    expected = None
    if image is not None:
        expected = expected_outcome(image.truth, view.band, bound=known_bound([image], image.truth, view.band))
    frame = viewer.one_frame(view, run.estimators, expected, numbered=numbered)
    card: dict[str, Any] = {
        "frame": frame,
        "name": view.case,
        "camera": frame["camera"],
        "band": view.band,
        "rows": [_result(view, name, unit) for name in run.estimators if name in view.rows],
        "expected": expected.outcome if expected else None,
        "expected_meaning": meaning(expected.outcome) if expected else "",
        "problem": view.problem,
        "picture": "",
        "facts": [],
        "rerun": None,
    }
    if image is not None and expected is not None:
        height, width = image.dn.shape
        drawn = f"{number(frame['black'])} to {number(frame['white'])} of {image.full_scale} digital numbers"
        card |= {
            "picture": pictures.card_uri(pictures.grey_levels(image)[0]),
            "width": width,
            "height": height,
            "coarse": max(width, height) <= COARSE_PX,
            # A line of pixels is drawn taller than to scale, or it would be invisible.
            "strip": width > STRIP_RATIO * height,
            "facts": [*_facts(expected, image.truth), *infrared.facts_of(image.truth, view.band),
                      ("drawn from black to white", drawn)],
            "rerun": _rerun(view, run),
        }  # fmt: skip
    return card


def _result(view: CaseView, estimator: str, unit: AngleUnit) -> dict[str, Any]:
    row = view.rows[estimator]
    verdict = verdict_of(row, broken=view.broken)
    expected = meaning(row.expected)
    if row.is_claim:
        text = f"{unit.text(row.nadir_error_arcsec)} off"
        if row.without_sigma:
            text += ", claims no uncertainty"
        elif sigma := row.sigma_total_arcsec:
            text += f", claims {unit.text(sigma)} (1 sigma)"
        if row.expected != Outcome.VALID:
            text += f"; expected to refuse: {expected}"
    else:
        crashed = row.status == Outcome.CRASHED
        text = "crashed" if crashed else f"refused, {outcome(row.status)}"
        if row.status != row.expected and not view.broken and not crashed:
            usable = row.expected == Outcome.VALID
            text += f"; expected {'an attitude' if usable else outcome(row.expected)}"
        if row.reason and not view.broken:
            text += f". Its reason: {row.reason}"
    values = [
        ("reported", outcome(row.status)),
        ("expected", f"{outcome(row.expected)} ({expected})"),
        ("reason given", row.reason or ""),
        ("nadir error", unit.text(row.nadir_error_arcsec)),
        (
            "claimed (1 sigma)",
            f"none: judged by {unit.text(DEFAULT_SIGMA_ARCSEC)}"
            if row.without_sigma
            else unit.text(row.sigma_total_arcsec),
        ),
        ("normalised error squared", f"{number(row.nees_nadir_total)} (2 expected)"),
        ("of the noise alone", f"{number(row.nees_noise)} in {row.noise_draws} draws (2 expected)"),
        ("bound of the nadir error", unit.text(row.bound_arcsec)),
        ("by noise alone", unit.text(row.bound_noise_arcsec)),
        ("error over the bound", number(row.error_over_bound)),
        ("roll error", unit.text(row.roll_error_arcsec)),
        ("pitch error", unit.text(row.pitch_error_arcsec)),
        ("altitude error", f"{number(row.altitude_error_km)} km"),
        ("angular radius error", unit.text(row.angular_radius_error_arcsec)),
        ("limb points", str(row.n_points)),
    ]
    values = [(key, value) for key, value in values if value and not value.startswith("–")]
    return {
        "estimator": estimator,
        "verdict": verdict,
        "text": text,
        "values": values,
        "output": (view.details.get(estimator) or {}).get("output", ""),
    }


def _angular_radius(truth: FrameTruth) -> str:
    geometric = f"{number(math.degrees(truth.angular_radius_rad), 4)}°"
    if truth.horizon_rise_m == 0.0:
        return geometric
    return f"{geometric}, refracted {number(math.degrees(truth.refracted_angular_radius_rad), 4)}°"


def _facts(expected: Expected, truth: FrameTruth) -> list[tuple[str, str]]:
    sun_side = "above" if expected.sun_limb_distance_deg > 0 else "below"
    return [
        ("epoch", truth.epoch_utc),
        ("altitude", f"{number(truth.altitude_m / 1e3, 4)} km"),
        (
            "roll, pitch, yaw",
            ", ".join(f"{number(math.degrees(a), 4)}°" for a in (truth.roll_rad, truth.pitch_rad, truth.yaw_rad)),
        ),
        ("Earth's angular radius", _angular_radius(truth)),
        ("Sun's zenith angle below the satellite", f"{number(expected.sun_zenith_deg, 4)}°"),
        (
            "Sun",
            f"{percent(truth.sun_visible_fraction)} of its disc seen past the Earth, "
            f"{'in' if expected.sun_in_frame else 'not in'} the frame, "
            f"{number(abs(expected.sun_limb_distance_deg))}° {sun_side} the horizon",
        ),
        (
            "horizon in view",
            f"{number(expected.horizon_arc_px)} px, {percent(expected.lit_fraction)} of it lit"
            if expected.lit_fraction is not None
            else "none",
        ),
        *_known(truth),
    ]


def _known(truth: FrameTruth) -> list[tuple[str, str]]:
    """Return the prior of the methods, if the scene has one."""
    stated = truth.scene.get("prior")
    if stated is None:
        return []
    first = truth.camera_spec.band[0].name
    return [("known in addition to the image", drawn_prior(PriorSpec.model_validate(stated), truth, first).in_words)]


def _rerun(view: CaseView, run: ReportRun) -> dict[str, Any]:
    made = rerun.rerun_of(view, run)
    files = [
        {"name": name, "text": text, "uri": f"data:application/toml;charset=utf-8,{quote(text)}"}
        for name, text in made.files
    ]
    return {"files": files, "commands": "\n".join(made.commands), "archived": bool(view.image_path)}
