"""The page of a campaign: its figures, its links, its worst frames."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime

import pytest
from synthetic import result_row

from horizonval.report import template
from horizonval.report.load import CaseView, ReportRun
from horizonval.report.pages import campaign_page
from horizonval.scoring.row import Row
from horizonval.scoring.summary import summarise
from horizonval.suites.suite import load_suite
from horizonval.truth.frame_truth import truth_of

NAMES = ("shy", "bold")


def _row(case: str, estimator: str, error: float | None, **more) -> Row:
    row = {
        "case": case,
        "estimator": estimator,
        "camera": "cam",
        "band": "vis",
        "expected": "valid",
        "status": "dark" if error is None else "valid",
        "nadir_error_arcsec": error,
        "sigma_nadir_arcsec": 20.0,
        "nees_nadir": 2.0,
        "roll_error_arcsec": error,
        "pitch_error_arcsec": error,
        "nees_nadir_total": 1.0,
        "borderline": case == "c7",
        "false_valid": error is not None and error > 1800.0,
        "epoch_utc": f"2026-03-20T00:{int(case[1:]):02d}:00+00:00",
        "sun_visible_fraction": 0.0 if 3 <= int(case[1:]) < 6 else 1.0,
        "sun_in_frame": case == "c1",
        "lit_fraction": 0.5 if case == "c2" else 1.0,
        "sun_boresight_deg": 10.0 * int(case[1:]),
    }
    return result_row(**(row | more))


def _run(*plans: dict) -> ReportRun:
    views = []
    for k in range(8):
        case = f"c{k}"
        rows = {
            "shy": _row(case, "shy", None if 3 <= k < 6 else 30.0),
            "bold": _row(case, "bold", 7200.0 if 3 <= k < 6 else 20.0),
        }
        views.append(CaseView(case, "vis", rows, {}, None, "", False, ""))
    return ReportRun("s", "A suite", "1", NAMES, tuple(v.case for v in views), (), tuple(views), plans)


def _plan(kind: str, axes: int) -> dict:
    cases = {f"c{k}": [float(k % 4), float(k // 4)][:axes] for k in range(8)}
    return {"kind": kind, "title": kind, "x": "attitude.yaw_deg", "y": "attitude.pitch_deg", "cases": cases}


def test_every_mark_of_a_timeline_links_to_its_frame():
    page = campaign_page.page_of(_run(_plan("timeline", 0)))
    svg = page["sections"][0]["figures"][0]["svg"]
    links = re.findall(r'xlink:href="(index.html#c\d)"', svg)
    assert set(links) == {f"index.html#c{k}" for k in range(8)}


def test_spans_reach_half_way_to_the_next_frame():
    rows = _run(_plan("timeline", 0)).rows
    minutes = {f"c{k}": float(k) for k in range(8)}
    spans = {span.label: (span.start, span.end) for span in campaign_page._spans(rows, minutes)}
    assert spans == {"eclipse": (2.5, 5.5), "Sun in the frame": (0.5, 1.5), "terminator in view": (1.5, 2.5)}


def test_the_shadow_of_a_revolution_is_a_single_band():
    cases = [case for case in load_suite("shadow").cases if case.name.startswith("sso_visible_")]
    truths = [truth_of(case.scene, case.camera) for case in cases]
    clear = {"sun_in_frame": False, "lit_fraction": 1.0}
    shares = [truth.sun_visible_fraction for truth in truths]
    rows = [_row(f"c{k}", "shy", 30.0, sun_visible_fraction=share, **clear) for k, share in enumerate(shares)]
    first, second = (datetime.fromisoformat(truth.epoch_utc) for truth in truths[:2])
    step_min = (second - first).total_seconds() / 60.0
    spans = campaign_page._spans(rows, {f"c{k}": k * step_min for k in range(len(rows))})
    assert [span.label for span in spans] == ["eclipse"]
    # A third of the revolution and more, in from the node at 10:30.
    assert (spans[0].start, spans[0].end) == pytest.approx((26.6, 62.1), abs=0.1)


def test_a_map_for_every_estimator_and_one_figure_for_curves():
    run = _run(_plan("map", 2), _plan("sweep", 1), _plan("exclusion", 0))
    sections = campaign_page.page_of(run)["sections"]
    assert [len(section["figures"]) for section in sections] == [2, 1, 1]
    ids = re.findall(r' id="(m[0-9a-f]+|p[0-9a-f]{6,})"', "".join(f["svg"] for s in sections for f in s["figures"]))
    assert len(ids) == len(set(ids)), "marks of one figure must not show in another"
    # bold errs at 30, 40 and 50 deg; shy refuses there
    assert "exclusion angle 60°" in sections[2]["figures"][0]["svg"]


def test_the_worst_frames_are_false_claims_first_and_by_their_error():
    worst = campaign_page.page_of(_run(_plan("timeline", 0)))["worst"]
    assert [kind["total"] for kind in worst] == [3, 3]
    assert worst[0]["lines"][0]["text"] == "2.00° off"
    assert all(line["link"].startswith("index.html#c") for kind in worst for line in kind["lines"])


def test_what_is_counted_strictly_is_shown_so():
    page = campaign_page.page_of(_run(_plan("timeline", 0)))
    bold = page["confusions"][1]
    assert bold["reported"] == ["valid", "false: beyond the limit of the error"]
    cells = {line["expected"]: [(cell["n"], cell["glyph"]) for cell in line["cells"]] for line in bold["lines"]}
    assert cells == {"valid": [(4, "●"), (3, "✖")], "borderline": [(1, ""), (0, "")]}
    assert [line["apart"] for line in bold["lines"]] == [False, True]
    shy = page["rates"][1]
    assert (shy["estimator"], shy["n"], shy["borderline"]) == ("shy", 8, 1)
    # Seven are due, three of them refused; five claims, none false: below 1 - 0.05^(1/5) = 45.07 %, rounded up.
    assert (shy["availability"]["of"], shy["refusal"]["of"]) == ("4 of 7", "3 of 7")
    assert (shy["false_valid"]["of"], shy["bound"]) == ("0 of 5", "45.1 %")
    errors = page["errors"][1]
    assert (errors["nees_nadir"]["mean"], errors["nees_nadir_total"]["mean"]) == ("1.00", "0.500")


def test_the_noise_is_shown_where_it_was_drawn_and_else_a_dash():
    run = _run(_plan("timeline", 0))
    lines = [campaign_page._errors(group) for group in summarise(run.rows)["groups"]]
    assert [line["nees_noise"]["mean"] for line in lines] == ["–", "–"]
    assert not campaign_page.is_due(replace(run, figures=()))
    more = {"nees_noise": 9.0, "noise_draws": 5}
    views = [replace(v, rows={"shy": v.rows["shy"], "bold": replace(v.rows["bold"], **more)}) for v in run.views]
    drawn = replace(run, views=tuple(views), figures=())
    assert campaign_page.is_due(drawn)
    page = campaign_page.page_of(drawn)
    bold, shy = (line["nees_noise"] for line in page["errors"])
    assert (bold["mean"], bold["error"], bold["n"], bold["draws"], bold["glyph"]) == ("4.50", "0", 8, 40, "↑")
    assert shy["mean"] == "–"
    assert campaign_page.headline(drawn)["text"] == "3 of 13 claims are false."
    html = (
        template.environment()
        .get_template("campaign.html")
        .render(sentences=[], frames=[], kept=0, run=drawn, **page, **template.shared_parts())
    )
    assert "4.50 ± 0" in html
    assert "n = 8, 40 draws; honest: 0.684 to 1.38" in html
    assert html.count("no two fits of a frame") == 1


def test_a_refusal_of_a_borderline_frame_is_fair():
    refused = _row("c7", "shy", None)
    assert campaign_page.verdict_of(refused).key == "fair"
    assert campaign_page.verdict_of(replace(refused, borderline=False)).key == "missed"


def test_bare_and_guarded_methods_are_put_together():
    assert [line["estimator"] for line in campaign_page.page_of(_run())["together"]] == ["all bare methods"]
    rows = [_row("c1", name, 20.0) for name in ("a", "guarded-a", "guarded-b")]
    assert [(name, len(own)) for name, own in campaign_page._pooled(rows)] == [
        ("all bare methods", 1),
        ("all guarded methods", 2),
    ]


def test_a_frame_that_is_not_shown_is_not_linked():
    run = _run(_plan("timeline", 0))
    hidden = replace(run, views=tuple(replace(view, shown=view.case != "c3") for view in run.views))
    svg = campaign_page.page_of(hidden)["sections"][0]["figures"][0]["svg"]
    assert "index.html#c2" in svg
    assert "index.html#c3" not in svg


def test_the_same_run_gives_the_same_page():
    pages = [campaign_page.page_of(_run(_plan("map", 2), _plan("timeline", 0))) for _ in range(2)]
    assert pages[0] == pages[1]
