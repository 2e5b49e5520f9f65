"""The page of a night in a browser, wide and narrow: nothing sticks out, nothing is asked for, nothing complains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from browser import Browser, chromium_path

from horizonval.spec.suite import RegressionSpec
from horizonval.studies.regression.baseline import read_baseline
from horizonval.studies.regression.fresh import judge_fresh
from horizonval.studies.regression.gates import judge_rows
from horizonval.studies.regression.page import of_baseline, write_page
from horizonval.studies.regression.partners import cameras_of, changed, pairs_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium_path() is None, reason="no Chromium on this machine (Debian: apt install chromium)"),
]
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A night whose errors are a fifth larger, after 40 others, of which the last ten stand a step higher."""
    base = read_baseline(ROOT / "results" / "baseline" / "nightly.json", "nightly")
    now = [
        row if row.nadir_error_arcsec is None else replace(row, nadir_error_arcsec=1.2 * row.nadir_error_arcsec)
        for row in base.results.rows
    ]
    pairs, cameras = pairs_of(now, base.results.rows), cameras_of(base.scenes, base.together)
    moved = changed(pairs)
    fresh = [row for row in base.results.fresh if row.case < "0/day_020" or row.table != "day"]
    level = {"fixed method: median nadir error": {"value": 700.0, "unit": "arcsec", "n": 384}}
    nights = [
        {
            "night": f"night {i:02d}",
            "verdict": ("PASS", "INCONCLUSIVE", "IMPROVED", "FAIL")[i % 4],
            "levels": {name: {**one, "value": 700.0 + 30.0 * (i >= 30) + i % 3} for name, one in level.items()},
        }
        for i in range(40)
    ]
    verdict = {
        "suite": "nightly",
        "night": "2026-11-21",
        "lanes": ["replay", "rerender", "fresh"],
        "verdict": "FAIL",
        "problems": ["one scene could not be rendered"],
        "notes": ["new, and not compared until a baseline with it is accepted: method new-method"],
        "environment": dict(base.head["environment"]),
        "comparisons": [
            {
                "name": "accepted",
                "baseline": base.label,
                "reason": base.head["reason"],
                "covers": ["FAIL: limb-profile in day (vis-cmos-512-60deg, vis): mean roll error moved by 30 arcsec"],
                "same_as_accepted": False,
                "replayed": len(now),
                "n_changed": len(moved),
                "changed": moved[:200],
                "rendered": 64,
                "n_images_changed": 0,
                "images_changed": [],
            }
        ],
        "gates": judge_rows(RegressionSpec(), "replay", pairs, cameras)
        + judge_fresh(RegressionSpec(), fresh, base.results.fresh, cameras),
        "published": [
            {
                "system": system,
                "name": "roll error, 3000 km, 60 deg, 400 px",
                "unit": "deg",
                "accepted": 0.0113697,
                "measured": 0.0113697 + 0.001 * (system == "D"),
                "verdict": "FAIL" if system == "D" else "PASS",
            }
            for system in "ABCDEFG"
        ],
        "fresh": {"batches": 1, "scenes": 64},
        "trend": [],
    }
    path = tmp_path_factory.mktemp("page") / "index.html"
    write_page(
        path,
        verdict,
        nights,
        of_baseline(base, [row for row in now if row.case in ("day_000", "day_005", "hard_000")]),
    )
    return path.as_uri()


def test_the_page_of_a_night(tmp_path, page):
    with Browser(tmp_path, width=700) as browser:
        assert browser.faults(page, [700, 1400]) == []
        # No table has to be scrolled.
        assert browser.evaluate("[...document.querySelectorAll('.scroll')].every(s => s.scrollWidth <= s.clientWidth)")
        text = browser.evaluate("document.body.innerText")
        for said in ("FAIL", "day_005", "System D"):
            assert said in text
        assert browser.evaluate("document.querySelectorAll('#v-line i').length") == 3
        name = "document.getElementById('v-name').textContent"
        assert "1 of 3: day_000, seed" in browser.evaluate(name)
        browser.press("ArrowRight")
        assert "2 of 3: day_005, seed" in browser.evaluate(name)
        assert browser.evaluate("document.getElementById('v-scores').tBodies[0].rows.length") == 1
        assert browser.complaints == []
