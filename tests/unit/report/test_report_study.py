"""The page of a trade study: what it says of designs with much, little and no result."""

from __future__ import annotations

import re

import pytest
from browser import Browser, chromium_path

from horizonval.core.errors import DamagedFileError
from horizonval.report.study import write_page
from horizonval.store.folder import write_json

NONE = {"n": 0, "of": 0, "rate": None, "interval": None, "lower": None, "upper": None, "effective": None}


def share(k: int, n: int) -> dict:
    return {"n": k, "of": n, "rate": k / n, "interval": [0.1, 0.9], "lower": 0.2, "upper": 0.8, "effective": float(n)}


def measure(value: float | None, n: int = 9, high: float | None = 0.4) -> dict:
    return {"value": value, "interval": None if value is None else [value / 2, high], "n": n}


def design(number: int, name: str, width: int, *, silent: bool = False) -> dict:
    error = None if silent else 0.1 * number
    return {
        "number": number,
        "name": name,
        "settings": {"camera.camera.width": width, "estimator": "ideal"},
        "camera": "cam <1>",
        "estimator": "ideal",
        "n": 10,
        "claims": 0 if silent else 9,
        "pixels": width * 10,
        "pixel_rate": width * 10.0,
        **{key: measure(error) for key in ("bias_deg", "noise_deg", "rms_deg", "p95_deg")},
        "three_sigma_deg": measure(error, high=None),
        "exclusion_deg": measure(None, n=4),
        "availability": share(0 if silent else 9, 10),
        "answered_due": NONE,
        "false_valid": NONE if silent else share(1, 9),
        "within": share(0 if silent else 5, 10),
        "costs": {"mass_g": 10.0 * number},
        "misses": {"dark": {"n": 5, "due": 0}} | ({"too inaccurate": {"n": 5, "due": 3}} if silent else {}),
        "verdict": "fails" if silent else "open",
    }


DESIGNS = [design(1, "a", 100), design(2, "b", 50), design(3, "c", 200, silent=True)]
QUERY = {"text": "none is shown to meet it", "needed": 299}
RESULT = {
    "version": "1",
    "study": {
        "name": "s",
        "title": "T",
        "frame_rate_hz": 2.0,
        "cheapest_by": "mass_g + pixels",
    },
    "required": "0.05 deg in 99 % of all conditions",
    "limit": {"error_deg": 0.05, "availability": 0.99},
    "conditions": 10,
    "clusters": 5,
    "failed": [],
    "axes": ["camera.camera.width", "estimator"],
    "designs": DESIGNS,
    "fronts": {"pixel_rate": ["a", "b"], "unavailability": ["a"], "price": ["b"]},
    "prices": {
        name: {"value": value, "interval": None, "known": True}
        for name, value in (("a", 1010.0), ("b", 520.0), ("c", None))
    },
    "effects": {
        "basis": "common",
        "n": 9,
        "designs": 2,
        "left_out": ["c"],
        "complete": False,
        "variance": 0.1,
        "terms": [{"axes": ["camera.camera.width"], "dof": 1, "share": {"value": 1.0, "interval": [0.9, 1.0]}}],
        "levels": {
            "camera.camera.width": [
                {"level": 100, "factor": 0.5, "interval": [0.4, 0.6], "designs": 1},
                {"level": 50, "factor": 2.0, "interval": None, "designs": 1},
            ]
        },
    },
    "pairs": [
        {
            "a": "a",
            "b": "b",
            "n": 10,
            "both": 8,
            "mean_difference_deg": {"value": 0.1, "interval": [0.05, 0.15]},
            "rms_ratio": {"value": 2.0, "interval": None},
            "typical_ratio": {"value": 2.0, "interval": [1.5, 2.5]},
            "correlation": None,
            "answered": {"only_a": 0, "only_b": 0, "difference": 0.0, "interval": None, "p": None},
            "within": {"only_a": 1, "only_b": 3, "difference": 0.2, "interval": None, "p": 0.625},
        }
    ],
    "query": QUERY,
}
COSTS = {
    "machine": "m",
    "frames_s": 12.0,
    "frames": 30,
    "front": ["a"],
    "prices": None,
    "query": QUERY | {"text": "cheapest by processor time: a"},
    "designs": {"a": measure(0.1), "b": measure(None, n=0), "c": measure(0.2)},
}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study-page")
    write_json(folder / "study.json", RESULT)
    write_json(folder / "study-costs.json", COSTS)
    return write_page(folder)


def test_the_numbers_are_those_of_the_study(page):
    text = page.read_text()
    words = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text.partition("<body>")[2]))
    for said in (
        "3 designs under the same 10 conditions from 5 flights; 2 estimates a second",
        "Cheapest by processor time: a.",
        "1 &middot; width [px] = 100, estimator = ideal",
        "above 0.0500, open",
        "10 of 10 5 5 3 due",
        "520.0 mass_g 20.00",
    ):
        assert said in words
    assert "cam &lt;1&gt;" in text


def test_the_same_data_give_the_same_page(page):
    text = page.read_bytes()
    assert write_page(page.parents[1]).read_bytes() == text


def test_designs_without_an_answer_have_dashes(page):
    accuracy, costs = page.read_text().split("<h2>Accuracy of claims</h2>")[1].split("<h2>Shares and costs</h2>")
    line = accuracy.split("3 &middot; width [px] = 200")[1].split("</tr>")[0]
    assert re.findall(r'<td class="num"[^>]*>([^<]*)<', line) == ["–"] * 5
    line = costs.split("3 &middot; width [px] = 200")[1].split("</tr>")[0]
    assert re.search(r'data-label="False, of claims">–<small>none', line)
    assert re.search(r'data-label="Exclusion angle \[deg\]">none<', line)


def test_a_damaged_result_is_told(tmp_path):
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(DamagedFileError, match="run the study again"):
        write_page(tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(chromium_path() is None, reason="no Chromium on this machine (Debian: apt install chromium)")
def test_it_opens_in_a_browser(page, tmp_path):
    with Browser(tmp_path / "profile") as browser:
        assert browser.faults(page.as_uri()) == []
