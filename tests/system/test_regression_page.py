"""The page of a night in a browser, wide and narrow: nothing sticks out, nothing is asked for, nothing complains."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from browser import Browser, chromium_path

from horizonval.studies.regression.baseline.baseline import read_baseline
from horizonval.studies.regression.page import write_page
from horizonval.studies.regression.statistics.gates import GateInputs, changed, measure, pairs_of
from horizonval.studies.regression.statistics.judge import judge
from horizonval.suites.suite import load_suite

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium_path() is None, reason="no Chromium on this machine (Debian: apt install chromium)"),
]
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A night whose errors are ten percent larger, after 40 others of which the last ten stand a step higher."""
    suite = load_suite(ROOT / "scenes" / "suites" / "nightly.toml")
    base = read_baseline(ROOT / "results" / "baseline" / "nightly.json", "nightly")
    now = [
        row if row.nadir_error_arcsec is None else replace(row, nadir_error_arcsec=1.1 * row.nadir_error_arcsec)
        for row in base.results.rows
    ]
    results = GateInputs(now, {}, base.results.fresh, "tonight")
    moved = changed(pairs_of(now, base.results.rows))
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
        "environment": dict(base.head["environment"]),
        "comparisons": [
            {
                "name": "accepted",
                "baseline": base.label,
                "reason": base.head["reason"],
                "same_as_accepted": False,
                "replayed": len(now),
                "n_changed": len(moved),
                "changed": moved[:200],
                "rendered": 64,
                "n_images_changed": 0,
                "images_changed": [],
            }
        ],
        "gates": judge([("accepted", measure(gate, results, base.results)) for gate in suite.regression.gate]),
        "anchors": [
            {
                "name": "furnace",
                "verdict": "PASS",
                "found": 3e-9,
                "limit": 1e-6,
                "unit": "relative",
                "n": 10,
                "what": "x",
            }
        ],
        "fresh": {"batches": 1, "scenes": 64},
        "trend": [],
    }
    path = tmp_path_factory.mktemp("page") / "index.html"
    write_page(path, verdict, nights)
    return path.as_uri()


@pytest.mark.parametrize("width", [700, 1400])
def test_the_page_of_a_night(tmp_path, page, width):
    with Browser(tmp_path, width=width) as browser:
        browser.open(page)
        assert browser.complaints == []
        assert [url[:80] for url in browser.requests if url != page and not url.startswith("data:")] == []
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        assert browser.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")
        # No table has to be scrolled, at either width.
        assert browser.evaluate("[...document.querySelectorAll('.scroll')].every(s => s.scrollWidth <= s.clientWidth)")
        text = browser.evaluate("document.body.innerText")
        assert "FAIL" in text
        assert "day_005" in text
