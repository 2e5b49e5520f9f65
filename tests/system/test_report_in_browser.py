"""The report in a browser: it opens from a file, asks for nothing, complains of nothing, and does what it offers."""

from __future__ import annotations

import pytest
from browser import Browser, chromium_path
from synthetic import write_run

from horizonval.report import build_report

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium_path() is None, reason="no Chromium on this machine (Debian: apt install chromium)"),
]

SHOWN = "[...document.querySelectorAll('#grid .tile:not([hidden]) h3')].map(h => h.textContent)"


def choose(browser: Browser, select: str, value: str) -> None:
    browser.evaluate(
        f"{{const s = document.getElementById('{select}'); s.value = '{value}'; s.dispatchEvent(new Event('change'))}}"
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return build_report(write_run(tmp_path_factory.mktemp("browser") / "run")).as_uri()


@pytest.fixture
def browser(tmp_path):
    with Browser(tmp_path) as opened:
        yield opened


def test_no_request_and_no_complaint(browser, page):
    browser.open(page)
    outside = [url[:80] for url in browser.requests if url != page and not url.startswith("data:")]
    assert outside == []
    assert page in browser.requests
    assert browser.complaints == []


def test_the_probe_would_see_a_request_and_a_complaint(browser, tmp_path):
    (tmp_path / "bad.html").write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('no'); f()</script>")
    browser.open((tmp_path / "bad.html").as_uri())
    assert "http://127.0.0.1:9/x.png" in browser.requests
    assert len(browser.complaints) >= 2


@pytest.mark.parametrize("width", [700, 1400])
def test_nothing_sticks_out(tmp_path, page, width):
    with Browser(tmp_path, width=width) as browser:
        browser.open(page)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        # Every picture decoded, none collapsed.
        assert browser.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")
        assert browser.evaluate(
            "[...document.querySelectorAll('svg.image')].every(s => s.getBoundingClientRect().height > 100)"
        )


def test_filter_sort_enlarge(browser, page):
    browser.open(page)
    assert len(browser.evaluate(SHOWN)) == 8
    choose(browser, "status", "valid")
    assert browser.evaluate(SHOWN) == ["day-arc", "day-tilted", "lwir-arc"]
    choose(browser, "camera", "lwir-160x120")
    assert browser.evaluate(SHOWN) == ["lwir-arc"]
    assert browser.evaluate("document.getElementById('count').textContent") == "1 of 8 shown"
    choose(browser, "status", "false")
    assert browser.evaluate(SHOWN) == []
    assert browser.evaluate("!document.getElementById('nothing').hidden")
    choose(browser, "status", "")
    choose(browser, "camera", "")
    choose(browser, "order", "worst")
    assert browser.evaluate(SHOWN)[:2] == ["sun-in-frame", "day-tilted"]

    browser.evaluate("document.querySelector('.tile .open').click()")
    assert browser.evaluate("document.querySelector('dialog').open")
    assert browser.evaluate("document.querySelector('dialog h3').textContent") == "sun-in-frame"
    browser.press("ArrowRight")
    assert browser.evaluate("document.querySelector('dialog h3').textContent") == "day-tilted"
    browser.evaluate("document.getElementById('close').click()")
    assert not browser.evaluate("document.querySelector('dialog').open")
    assert browser.complaints == []


def test_overlays_can_be_hidden_and_follow_the_estimator(browser, page):
    browser.open(page)
    visible = "getComputedStyle(document.querySelector('svg.image path.truth')).display"
    assert browser.evaluate(visible) != "none"
    browser.evaluate("document.getElementById('show-truth').click()")
    assert browser.evaluate(visible) == "none"
    layers = "[...document.querySelector('.tile').querySelectorAll('.layer')].map(l => getComputedStyle(l).display)"
    assert browser.evaluate(layers) == ["inline", "none"]
    choose(browser, "estimator", "ideal")
    assert browser.evaluate(layers) == ["none", "inline"]
