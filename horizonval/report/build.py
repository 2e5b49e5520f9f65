"""Put the report together: what is said and drawn is worked out here, how it looks is in the template beside it.

The page is one file without any address in it: style, code, figures and pictures are inside. It is a pure function of
the run's folder, not of its place or of the clock.
"""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from horizonval.core.outcome import Outcome
from horizonval.frame import FrameTruth
from horizonval.report import angle_unit, formatting, rerun, template, viewer
from horizonval.report.accuracy import accuracy_of
from horizonval.report.angle_unit import AngleUnit
from horizonval.report.figures import overlay, picture, plots
from horizonval.report.frames_on_demand import striking_frames
from horizonval.report.headline import headline
from horizonval.report.load import CaseView, ReportRun, load_run
from horizonval.report.pages import campaign_page, confusion_section, infrared_section, stability_section
from horizonval.report.sentence import sentences
from horizonval.report.verdict import VERDICTS, verdict_of
from horizonval.scoring import limits
from horizonval.scoring.expected import Expected, expected_outcome
from horizonval.scoring.summary import summarise
from horizonval.sensor.knowledge import drawn_prior
from horizonval.spec.prior import PriorSpec
from horizonval.store.manifest import amend_manifest

STRIP_RATIO = 20
"""Wider images than this are drawn as a strip of their own proportions."""
DEFAULT_SIGMA_ARCSEC = 3600.0 * math.degrees(limits.DEFAULT_SIGMA_RAD)
MOST_CASES_SHOWN = 300
"""With a picture each; the page of a longer run would not open."""


def build_report(run_dir: Path) -> Path:
    """Write ``run_dir/report/index.html`` and return its path; beside it the page of a campaign, if any.

    The figures that a suite asks for are there as files, too.

    A run that is not finished, or whose archive is damaged, gets a report that says so.

    Parameters
    ----------
    run_dir : Path
        Folder of a run: ``run.json``, ``cases/`` and ``archive/``.

    Raises
    ------
    UserError
        There is no run in the folder, or its files cannot be read or written.
    """
    before = {path for path in (run_dir / "report").rglob("*") if path.is_file()}
    pages = write_report(run_dir)
    amend_manifest(run_dir, [*pages, *(path for path in before if not path.exists())])
    return pages[0]


def write_report(run_dir: Path) -> list[Path]:
    """Write the pages of a report and return them, the first one first; otherwise as :func:`build_report`."""
    run = load_run(run_dir, MOST_CASES_SHOWN)
    environment, parts = template.environment(), template.shared_parts()
    campaign = campaign_page.headline(run) if campaign_page.is_due(run) else None
    stability = stability_section.section_of(run_dir)
    shown = environment.get_template("page.html").render(
        **page_of(run), stability=stability, campaign=campaign, **parts
    )
    texts = {"index.html": shown}
    if campaign is not None:
        page = campaign_page.page_of(run)
        opening = sentences(run, summarise(run.rows, run.given_pose, run.orbit)["groups"])
        texts[campaign_page.PAGE] = environment.get_template("campaign.html").render(
            run=run, sentences=opening, **striking_frames(run), **page, **parts
        )
        texts |= {figure["file"]: figure["svg"] for section in page["sections"] for figure in section["figures"]}
    pages = run_dir / "report"
    if (pages / campaign_page.FIGURES).is_symlink():
        (pages / campaign_page.FIGURES).unlink()
    shutil.rmtree(pages / campaign_page.FIGURES, ignore_errors=True)
    for place in {(pages / name).parent for name in texts}:
        place.mkdir(parents=True, exist_ok=True)
    (pages / campaign_page.PAGE).unlink(missing_ok=True)
    for name, text in texts.items():
        template.write(pages / name, text)
    return [pages / name for name in texts]


def page_of(run: ReportRun) -> dict[str, Any]:
    """Return everything the template shows."""
    summary = summarise(run.rows, run.given_pose, run.orbit)
    unit = angle_unit.unit_of(row.nadir_error_arcsec for row in run.judged_rows if row.is_claim)
    broken = sum(view.broken for view in run.views)
    pixels = sum(view.image.dn.size for view in run.views if view.image is not None)
    reduced = pixels > picture.LOSSLESS_BUDGET_PX
    shown_views = [view for view in run.views if view.shown]
    numbered = viewer.chosen([view.image for view in shown_views])
    tiles = [
        _tile(view, run, index, reduced, unit, numbered=index in numbered) for index, view in enumerate(shown_views)
    ]
    shown = {tile_row["verdict"] for tile in tiles for tile_row in tile["rows"]}
    cameras = sorted({tile["camera"] for tile in tiles})
    return {
        "run": run,
        "summary": summary,
        "unit": unit,
        "groups": [{**group, "finding": _finding(group, unit)} for group in _in_order(summary["groups"], run)],
        "headline": _verdict(summary, run, broken),
        "sentences": sentences(run, summary["groups"]),
        "without_numbers": sum(tile["picture"] is not None and not tile["numbers"] for tile in tiles),
        "broken": broken,
        "cameras": cameras,
        "confusions": confusion_section.matrices_of(run.rows, run.judged_estimators),
        "figures": _figures(run, unit),
        "tiles": tiles,
        "reduced": reduced,
        "hidden": len({view.case for view in run.views if not view.shown}),
        "verdicts": [verdict for verdict in VERDICTS if verdict in shown],
        "limit_deg": f"{math.degrees(limits.NADIR_ERROR_LIMIT_RAD):g}",
        "likelihood_deg": f"{math.degrees(limits.LIKELIHOOD_LIMITS.nadir_error_rad):g}",
        "floor_deg": f"{math.degrees(limits.SIGMA_TEST_FLOOR_RAD):g}",
        "default_sigma": unit.text(DEFAULT_SIGMA_ARCSEC),
        "sigmas": f"{limits.SIGMA_LIMIT:g}",
        "gamma": f"{picture.GAMMA:g}",
        "percentiles": [f"{value:g}" for value in picture.PERCENTILES],
        "accuracy": accuracy_of(view.image.truth for view in run.views if view.image is not None),
        "infrared": infrared_section.section_of(shown_views),
    }


def _in_order(groups: Sequence[Mapping[str, Any]], run: ReportRun) -> list[Mapping[str, Any]]:
    """Return groups in the suite's order of estimators; those that are told the true pose last."""
    return sorted(groups, key=lambda group: (group["given_pose"], run.estimators.index(group["estimator"])))


def _finding(group: Mapping[str, Any], unit: AngleUnit) -> str:
    if not group["given_pose"]:
        return headline(group, unit)
    worst = unit.text(group["nadir_error_arcsec"]["max"])
    return f"told the true pose, to test the scoring, and counted nowhere else; worst {worst}."


def _verdict(summary: Mapping[str, Any], run: ReportRun, broken: int) -> dict[str, str]:
    """The first thing to know: crashes and false claims, else broken or missing frames, else that all is well."""
    rates = summary["rates"]
    false, claims, crashes = rates["false_valid"]["n"], rates["false_valid"]["of"], rates["crashed"]["n"]
    parts = [f"{crashes} {'crash' if crashes == 1 else 'crashes'}"] if crashes else []
    if false:
        parts.append(f"{formatting.count(false, 'false claim')} among {claims}, {_whose(summary['groups'])}")
    if parts:
        return {"kind": "false", "glyph": "✖", "text": "; ".join(parts)}
    if broken or run.missing:
        parts = [f"{formatting.count(broken, 'frame')} failed"] if broken else []
        parts += [f"{formatting.count(len(run.missing), 'frame')} not finished"] if run.missing else []
        return {"kind": "missed", "glyph": "▼", "text": ", ".join(parts)}
    if claims:
        return {"kind": "valid", "glyph": "●", "text": f"No false claim among {claims}"}
    return {"kind": "none", "glyph": "–", "text": "No attitude was claimed"}


def _whose(groups: Sequence[Mapping[str, Any]]) -> str:
    """Return whose the false claims are, the most first."""
    counts: Counter[str] = Counter()
    for group in groups:
        if not group["given_pose"]:
            counts[group["estimator"]] += group["false_valid"]["n"]
    false = [(name, n) for name, n in counts.most_common() if n]
    if len(false) == 1:
        return f"all by {false[0][0]}"
    return ", ".join(f"{n} by {name}" for name, n in false)


def _figures(run: ReportRun, unit: AngleUnit) -> list[dict[str, str]]:
    # What is told the pose stands at zero, and would only stretch the axes.
    names, rows = run.judged_estimators, run.judged_rows
    width = 11.0 if len(run.views) <= 45 else 13.0
    floor = f"{unit.of(plots.FLOOR_ARCSEC):g}{unit.sign}"
    height = 3.4 + 0.17 * len(names) + (1.0 if len(run.views) <= 45 else 0.0)
    return [
        {
            "uri": plots.figure_uri(plots.error_by_frame(run.views, names, unit), width, height),
            "title": "Nadir error of every frame",
            "text": "Angle between the claimed and the true nadir. The strip on top marks the frames that an estimator "
            f"refused. Errors below {floor} are drawn at {floor}.",
            "wide": "wide",
        },
        {
            "uri": plots.figure_uri(plots.error_by_sigma(rows, names, unit), 5.4, 4.6),
            "title": "Error against claimed uncertainty",
            "text": "Points far above the diagonal are errors that the estimator does not know of: bias, such as the "
            "soft edge of the atmosphere.",
            "wide": "",
        },
        *_bound_figure(run, unit),
        {
            "uri": plots.figure_uri(plots.roll_and_pitch(rows, names, unit), 5.4, 4.6),
            "title": "Roll and pitch errors",
            "text": "Claimed minus true, body axes. A cloud whose centre is off zero is a bias.",
            "wide": "",
        },
    ]


def _bound_figure(run: ReportRun, unit: AngleUnit) -> list[dict[str, str]]:
    """Return the figure of the bound, of runs whose images carry what their limb says."""
    names, rows = run.judged_estimators, run.judged_rows
    if all(row.error_over_bound is None for row in rows):
        return []
    return [
        {
            "uri": plots.figure_uri(plots.error_by_bound(rows, names, unit), 5.4, 4.9 + 0.12 * len(names)),
            "title": "Error against the bound",
            "text": "The bound is the smallest root mean square error that the limb in the image allows (Cramér-Rao), "
            "with air, light and height of the limb as known as the scene says.",
            "wide": "",
        }
    ]


def _tile(
    view: CaseView, run: ReportRun, index: int, reduced: bool, unit: AngleUnit, *, numbered: bool
) -> dict[str, Any]:
    image = view.image
    made = picture.picture_of(image, reduced=reduced) if image is not None else None
    # A frame without any row says so once.
    rows = [_tile_row(view, name, unit) for name in run.estimators if name in view.rows]
    some = next(iter(view.rows.values()), None)
    expected = expected_outcome(image.truth, view.band) if image is not None else None
    camera = some.camera if some else (image.truth.camera_spec.camera.name or "" if image else "")
    tile: dict[str, Any] = {
        "index": index,
        "name": view.case,
        "camera": camera,
        "band": view.band,
        "rows": rows,
        "expected": expected.outcome if expected else None,
        "expected_meaning": formatting.meaning(expected.outcome) if expected else "",
        "problem": view.problem,
        "picture": None,
        "numbers": viewer.packed(image.dn) if image is not None and numbered else "",
        "viewer": json.dumps(viewer.frame_data(view, expected, made, run.estimators), sort_keys=True),
        "data": json.dumps({row["estimator"]: [row["verdict"].key, row["error"]] for row in rows}),
        "facts": [*_facts(expected, image.truth), *infrared_section.facts_of(image.truth, view.band)]
        if expected and image
        else [],
        "rerun": None,
    }
    if image is not None:
        assert made is not None
        height, width = image.dn.shape
        tile |= {
            "picture": made,
            "width": width,
            "height": height,
            "coarse": max(width, height) <= 320,
            # A line of pixels would be a hair on the page: it is drawn tall, its rows out of proportion.
            "strip": width > STRIP_RATIO * height,
            "black": formatting.number(made.black_dn),
            "white": formatting.number(made.white_dn),
            "full_scale": image.full_scale,
            "horizon": overlay.horizon_path(image.truth),
            "infrared": overlay.infrared_path(image.truth, view.band),
            "layers": viewer.layers_of(view, image.truth, run.estimators),
            "rerun": _rerun(view, image.truth, run),
        }
    return tile


def _tile_row(view: CaseView, estimator: str, unit: AngleUnit) -> dict[str, Any]:
    row = view.rows[estimator]
    verdict = verdict_of(row, broken=view.broken)
    number = formatting.number
    expected = formatting.meaning(row.expected)
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
        text = "crashed" if crashed else f"refused, {formatting.outcome(row.status)}"
        if row.status != row.expected and not view.broken and not crashed:
            usable = row.expected == Outcome.VALID
            text += f"; expected {'an attitude' if usable else formatting.outcome(row.expected)}"
        if row.reason and not view.broken:
            text += f". Its reason: {row.reason}"
    values = [
        ("reported", formatting.outcome(row.status)),
        ("expected", f"{formatting.outcome(row.expected)} ({expected})"),
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
        "error": row.nadir_error_arcsec,
        "output": (view.details.get(estimator) or {}).get("output", ""),
    }


def _angular_radius(truth: FrameTruth) -> str:
    number = formatting.number
    geometric = f"{number(math.degrees(truth.angular_radius_rad), 4)}°"
    if truth.horizon_rise_m == 0.0:
        return geometric
    return f"{geometric}, refracted {number(math.degrees(truth.refracted_angular_radius_rad), 4)}°"


def _facts(expected: Expected, truth: FrameTruth) -> list[tuple[str, str]]:
    number = formatting.number
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
            f"{formatting.percent(truth.sun_visible_fraction)} of its disc seen past the Earth, "
            f"{'in' if expected.sun_in_frame else 'not in'} the frame, "
            f"{number(abs(expected.sun_limb_distance_deg))}° {sun_side} the horizon",
        ),
        (
            "horizon in view",
            f"{number(expected.horizon_arc_px)} px, {formatting.percent(expected.lit_fraction)} of it lit"
            if expected.lit_fraction is not None
            else "none",
        ),
        *_known(truth),
    ]


def _known(truth: FrameTruth) -> list[tuple[str, str]]:
    """Return what methods were given beside the image, where the scene says what that is."""
    stated = truth.scene.get("prior")
    if stated is None:
        return []
    first = truth.camera_spec.band[0].name
    return [("known beside the image", drawn_prior(PriorSpec.model_validate(stated), truth, first).in_words)]


def rerun_of_view(view: CaseView, truth: FrameTruth, run: ReportRun) -> rerun.Rerun:
    """Return how to make a view's image, or those of all heads, and the results again."""
    ran = [name for name in run.estimators if name in view.rows] or list(run.estimators)
    paths = view.head_paths or ({"": view.image_path} if view.image_path else {})
    return rerun.rerun_of(truth, view.case, view.band, paths, ran, run.suite_of_programs)


def _rerun(view: CaseView, truth: FrameTruth, run: ReportRun) -> dict[str, Any]:
    made = rerun_of_view(view, truth, run)
    files = [
        {"name": name, "text": text, "uri": f"data:application/toml;charset=utf-8,{quote(text)}"}
        for name, text in made.files
    ]
    return {"files": files, "commands": "\n".join(made.commands), "archived": bool(view.image_path)}
