"""The page of a study: made of one file, complete, and the same bytes for the same study."""

from __future__ import annotations

import html
import re
import shutil

import numpy as np
import pytest
from synthetic import write_run

from horizonval.core.errors import DamagedFileError
from horizonval.report import build_report
from horizonval.report.figures import stability_plots as draw
from horizonval.report.pages import stability as page
from horizonval.spec.stability import EdgeSensor, FieldSensor, StabilityBand, StabilitySpec
from horizonval.store.folder import write_json
from horizonval.studies.stability import study
from horizonval.studies.stability.profiles import LATITUDE_DEG, Profiles, heights_m

SPEC = StabilitySpec(
    altitude_km=900.0,
    inclination_deg=99.03,
    positions=8,
    months=[1, 7],
    band=[StabilityBand(name="lwir", lo_um=8.0, hi_um=14.0), StabilityBand(name="co2", lo_um=14.0, hi_um=16.3)],
    sensor=[
        EdgeSensor(name="half", kind="edge", locator="half"),
        FieldSensor(name="field", kind="field", field_deg=2.0),
    ],
)


def _profiles(centre_km: float, plateau: float, width_km: float) -> Profiles:
    height = heights_m(SPEC)
    limb = 0.5 * plateau * (1.0 - np.tanh((height - 1e3 * centre_km) / (1e3 * width_km)))
    ahead = np.stack([limb * 1.1, limb, limb, limb])
    return Profiles(height, np.broadcast_to(ahead, (8, *ahead.shape)), np.tile(limb, (len(LATITUDE_DEG), 1)))


@pytest.fixture(scope="module")
def result():
    profiles = {("co2", 1): _profiles(38.0, 4.5, 6.0), ("co2", 7): _profiles(42.0, 6.5, 6.0)}
    profiles |= {("lwir", month): _profiles(4.0, 25.0, 2.0) for month in (1, 7)}
    return study.conclude(SPEC, profiles)


@pytest.fixture(scope="module")
def written(tmp_path_factory, result):
    folder = write_run(tmp_path_factory.mktemp("written") / "run")
    (folder / "stability").mkdir()
    write_json(folder / page.RESULT, result)
    return folder


@pytest.fixture
def run_dir(tmp_path, written):
    return shutil.copytree(written, tmp_path / "run")


def _plain(text: str) -> str:
    body = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def test_the_first_page_leads_to_it(run_dir):
    index = build_report(run_dir)
    assert index.name == "index.html"
    assert 'href="stability.html"' in index.read_text(encoding="utf-8")
    assert "38.0 to 42.0 km high" in _plain(index.read_text(encoding="utf-8"))
    text = (run_dir / "report" / page.PAGE).read_text(encoding="utf-8")
    assert 'href="index.html"' in text
    assert set(re.findall(r'(?:src|href)="(?!data:|#)([^"]*)"', text)) == {"index.html"}


def test_what_is_published_stands_beside_ours(run_dir):
    build_report(run_dir)
    text = _plain((run_dir / "report" / page.PAGE).read_text(encoding="utf-8"))
    for words in ("0.06°", "0.03°", "0.12°", "30 %", "Seshamani", "1980", "14.0–16.3 µm", "0.03 to 0.1°"):
        assert words in text
    # The carbon dioxide band is compared, though the window stands first.
    assert "Ours, 14.0–16.3 µm" in text
    assert text.count("±") == text.count("± ")


def test_the_same_study_gives_the_same_page(run_dir):
    build_report(run_dir)
    first = (run_dir / "report" / page.PAGE).read_bytes()
    build_report(run_dir)
    assert (run_dir / "report" / page.PAGE).read_bytes() == first


def test_a_study_that_is_gone_leaves_no_page(run_dir):
    build_report(run_dir)
    (run_dir / page.RESULT).unlink()
    index = build_report(run_dir)
    assert not (run_dir / "report" / page.PAGE).exists()
    assert "stability" not in index.read_text(encoding="utf-8")


@pytest.mark.parametrize("text", ["{", "[]", '{"bands": []}'])
def test_a_damaged_result_is_told(run_dir, text):
    (run_dir / page.RESULT).write_text(text)
    with pytest.raises(DamagedFileError, match="run the suite again"):
        build_report(run_dir)


def test_published_lines_belong_to_their_sensors(result):
    sensors = {s["name"]: s for s in result["bands"][1]["sensors"]}
    assert draw.published_for(result, sensors["half"], "pitch") == 0.06
    assert draw.published_for(result, sensors["half"], "roll") == 0.03
    assert draw.published_for(result, sensors["field"], "pitch") == 0.12
    assert draw.published_for(result, sensors["field"], "roll") is None
    assert draw.published_for(result, sensors["field"] | {"field_deg": 4.0}, "pitch") is None


@pytest.mark.parametrize(
    ("months", "shown"),
    [(range(1, 13), [3, 6, 9, 12]), ([5], [5]), ([1, 7], [1, 7]), ([1, 2, 4, 5, 7, 8], [1, 4, 5, 8])],
)
def test_months_that_are_drawn(months, shown):
    assert draw.shown_months(list(months)) == shown
    assert len({draw.colour_of(m, shown) for m in shown}) == len(shown)
