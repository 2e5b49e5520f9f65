"""The page of a campaign: its figures, its links, its worst frames."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime

import pytest
from synthetic import result_row

from horizonval.report import campaign, page
from horizonval.report.load import CaseView, ReportRun
from horizonval.scoring.row import Row
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


@pytest.fixture(scope="module")
def shown():
    return campaign.page_of(_run(_plan("timeline", 0), _plan("map", 2), _plan("sweep", 1), _plan("exclusion", 0)))


def _lines(content: dict) -> list[str]:
    """The rows of the page's tables, as read."""
    html = page.render(
        "campaign.html", title="", heading="", filters=campaign.FILTERS, frames=[], kept=0, estimators=NAMES, **content
    )
    return [" ".join(re.sub(r"<[^>]*>", " ", row).split()) for row in re.findall(r"<tr>.*?</tr>", html, re.DOTALL)]


def test_figures_are_complete_their_marks_link_to_their_frames_and_no_ids_clash(shown):
    sections = shown["sections"]
    assert [len(section["figures"]) for section in sections] == [1, 2, 1, 1]
    links = re.findall(r'xlink:href="(index.html#c\d)"', sections[0]["figures"][0]["svg"])
    assert set(links) == {f"index.html#c{k}" for k in range(8)}
    ids = re.findall(r' id="(m[0-9a-f]+|p[0-9a-f]{6,})"', "".join(f["svg"] for s in sections for f in s["figures"]))
    assert len(ids) == len(set(ids)), "marks of one figure must not show in another"
    # bold errs at 30, 40 and 50 deg; shy refuses there
    assert "exclusion angle 60°" in sections[3]["figures"][0]["svg"]


def test_a_frame_that_is_not_shown_is_not_linked_and_the_same_run_gives_the_same_figure(shown):
    run = _run(_plan("timeline", 0))
    assert campaign.page_of(run)["sections"][0] == shown["sections"][0]
    hidden = replace(run, views=tuple(replace(view, shown=view.case != "c3") for view in run.views))
    svg = campaign.page_of(hidden)["sections"][0]["figures"][0]["svg"]
    assert "index.html#c2" in svg
    assert "index.html#c3" not in svg


def test_spans_reach_half_way_to_the_next_frame():
    rows = _run(_plan("timeline", 0)).rows
    minutes = {f"c{k}": float(k) for k in range(8)}
    assert campaign._spans(rows, minutes) == [
        ("eclipse", 2.5, 5.5),
        ("Sun in the frame", 0.5, 1.5),
        ("terminator in view", 1.5, 2.5),
    ]


def test_the_shadow_of_a_revolution_is_a_single_band():
    cases = [case for case in load_suite("shadow").cases if case.name.startswith("sso_visible_")]
    truths = [truth_of(case.scene, case.camera) for case in cases]
    clear = {"sun_in_frame": False, "lit_fraction": 1.0}
    shares = [truth.sun_visible_fraction for truth in truths]
    rows = [_row(f"c{k}", "shy", 30.0, sun_visible_fraction=share, **clear) for k, share in enumerate(shares)]
    first, second = (datetime.fromisoformat(truth.epoch_utc) for truth in truths[:2])
    step_min = (second - first).total_seconds() / 60.0
    ((label, *ends),) = campaign._spans(rows, {f"c{k}": k * step_min for k in range(len(rows))})
    assert label == "eclipse"
    # A third of the revolution and more, in from the node at 10:30.
    assert ends == pytest.approx((26.6, 62.1), abs=0.1)


def test_the_worst_frames_are_false_claims_first_and_by_their_error(shown):
    worst = shown["worst"]
    assert [kind["total"] for kind in worst] == [3, 3]
    assert worst[0]["lines"][0]["text"] == "2.00° off"
    assert all(line["link"].startswith("index.html#c") for kind in worst for line in kind["lines"])


def test_what_is_counted_strictly_is_shown_so(shown):
    bold = shown["confusions"][1]
    assert bold["reported"] == ["valid", "false: beyond the limit of the error"]
    cells = {line["expected"]: [(cell["n"], cell["glyph"]) for cell in line["cells"]] for line in bold["lines"]}
    assert cells == {"valid": [(4, "●"), (3, "✖")], "borderline": [(1, ""), (0, "")]}
    assert [line["apart"] for line in bold["lines"]] == [False, True]
    assert [(line["estimator"], line["n"]) for line in shown["rates"][:1]] == [("all bare methods", 16)]
    lines = _lines(shown)
    # Seven are due, three of them refused; five claims, none false: below 1 - 0.05^(1/5) = 45.07 %, rounded up.
    (rates,) = (line for line in lines if line.startswith("shy cam 8 1 borderline"))
    assert "4 of 7" in rates
    assert "3 of 7" in rates
    assert "0 of 5; 0 to 52.2 %; below 45.1 %" in rates
    (errors,) = (line for line in lines if line.startswith("shy cam 5 "))
    assert "– one draw of the noise 1.00 n = 5" in errors
    assert "0.500 n = 5" in errors


def test_the_noise_is_shown_where_it_was_drawn_and_else_a_dash():
    run = _run()
    assert not campaign.is_due(run)
    more = {"nees_noise": 9.0, "noise_draws": 5}
    views = [replace(v, rows={"shy": v.rows["shy"], "bold": replace(v.rows["bold"], **more)}) for v in run.views]
    drawn = replace(run, views=tuple(views))
    assert campaign.is_due(drawn)
    assert campaign.headline(drawn) == "3 of 13 claims are false."
    lines = " ".join(_lines(campaign.page_of(drawn)))
    assert "4.50 ± 0 ↑ n = 8, 40 draws; honest: 0.684 to 1.38" in lines
    assert lines.count("– no two fits of a frame") == 1
