"""The report as a file: what is in it, that it needs nothing else, and that the same run gives the same bytes."""

from __future__ import annotations

import html
import json
import re
import shutil
import tomllib
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest
from synthetic import Case, synthetic_cases, truth_at, write_run

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.report import build_report
from horizonval.report.load import load_run
from horizonval.store.folder import read_json, write_json
from horizonval.store.store import Store

VOID = {"meta", "link", "input", "br", "img", "hr"}


class Balance(HTMLParser):
    """Collects unclosed and unopened tags, and every attribute that can make a browser fetch something."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.faults: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "action", "data", "poster")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href")]

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"</{tag}> at {self.getpos()}")


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("report") / "run")


@pytest.fixture(scope="module")
def text(run_dir):
    return build_report(run_dir).read_text(encoding="utf-8")


def plain(text: str) -> str:
    """The words of a page, as read."""
    body = re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def test_the_page_is_where_it_is_expected(run_dir, text):
    assert build_report(run_dir) == run_dir / "report" / "index.html"
    assert [p.name for p in (run_dir / "report").iterdir()] == ["index.html"]


def test_every_tag_is_closed_and_every_address_is_inside(text):
    page = Balance()
    page.feed(text)
    assert page.faults == []
    assert page.open == []
    assert len(page.addresses) > 10
    assert [a[:80] for a in page.addresses if not a.startswith("data:")] == []
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL).group(1)
    assert "url(" not in style
    assert "@import" not in style


def test_same_run_same_bytes_wherever_it_lies(run_dir, text, tmp_path):
    other = tmp_path / "moved" / "elsewhere"
    shutil.copytree(run_dir, other, ignore=shutil.ignore_patterns("report"))
    assert build_report(other).read_text(encoding="utf-8") == text
    assert str(run_dir) not in text


def test_the_headline_says_the_worst_first(text):
    words = plain(text)
    assert "made-up" in words
    # Those of `ideal`, which is told the pose, are none of them.
    assert "1 false claim among 4, all by altitude-free" in words
    assert "8 frames, 3 cameras, 2 estimators" in words
    assert "horizonval run made-up.toml --out ." in words


def test_refusals_and_their_reasons_are_in_words(text):
    words = plain(text)
    assert "refused, dark" in words
    assert "made up to fail: no_limb" in words
    assert "refused, not converged; expected an attitude" in words
    assert "41 iterations, <still> moving & shaking" in words
    assert "<still>" not in text
    assert "No estimator was run on this frame." in words
    assert "expected to refuse: the Sun in the frame" in words


def test_tiles_carry_overlays_and_commands(text):
    tiles = re.findall(r"<article.*?</article>", text, re.DOTALL)
    assert [re.search(r"<h3>(.*?)</h3>", t).group(1) for t in tiles][:2] == ["day-arc", "day-tilted"]
    day, away = tiles[0], tiles[4]
    for kind in ("truth", "points", "limb"):
        assert f'<path class="{kind}"' in day
    assert '<path class="truth"' not in away
    assert "horizonval estimate day-arc.image.exr --estimator altitude-free" in plain(day)
    results = json.loads(html.unescape(re.search(r'data-results="(.*?)"', day).group(1)))
    assert results["altitude-free"][0] == "valid"
    assert results["altitude-free"][1] == pytest.approx(140, abs=1)


def test_the_scene_in_the_page_is_the_scene_of_the_truth(text):
    uri = re.search(r'download="day-arc.toml" href="data:application/toml;charset=utf-8,(.*?)"', text).group(1)
    assert tomllib.loads(unquote(html.unescape(uri))) == synthetic_cases()[0].truth.scene


def test_an_unfinished_run_says_what_is_missing(run_dir, tmp_path):
    partial = tmp_path / "partial"
    shutil.copytree(run_dir, partial)
    (partial / "cases" / "away.json").unlink()
    (partial / "results.parquet").unlink()
    (partial / "summary.json").unlink()
    assert "Not finished: away." in plain(build_report(partial).read_text())


def test_a_damaged_or_missing_image_is_told_not_fatal(run_dir, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(run_dir, broken)
    store = Store(broken / "archive")
    first, second = (json.loads((broken / "cases" / f"{n}.json").read_text())["image"] for n in ("away", "night"))
    store.path(first).write_bytes(store.path(first).read_bytes()[:-100])
    store.path(second).unlink()
    words = plain(build_report(broken).read_text())
    assert "The image in the archive is damaged" in words
    assert "The image is not in the archive any more" in words


def test_a_frame_that_failed_says_why(run_dir, tmp_path):
    failed = tmp_path / "failed"
    shutil.copytree(run_dir, failed)
    path = failed / "cases" / "day-arc.json"
    record = read_json(path)
    for row in record["rows"]:
        row |= {"status": "bad_input", "expected": "valid", "reason": "the worker died", "nadir_error_arcsec": None}
    record |= {"error": "the worker died", "image": None, "images": {}, "truth_frame": None, "details": {}}
    write_json(path, record)
    words = plain(build_report(failed).read_text())
    assert "This frame failed: the worker died" in words
    assert "1 frame failed" in words


def test_several_bands_give_a_tile_each(tmp_path):
    run = write_run(tmp_path / "run", synthetic_cases()[:1])
    path = run / "cases" / "day-arc.json"
    record = read_json(path)
    second = [row | {"band": "green", "status": "dark", "nadir_error_arcsec": None} for row in record["rows"]]
    record["images"] = {"red": record["image"], "green": "f" * 64}
    record["rows"] += second
    record["details"]["altitude-free [green]"] = {"points": [[1, 2]], "fit": None}
    write_json(path, record, sort_keys=False)
    tiles = re.findall(r"<article.*?</article>", build_report(run).read_text(), re.DOTALL)
    assert len(tiles) == 2
    assert "refused, dark" in plain(tiles[1])
    assert "not in the archive" in plain(tiles[1])


def test_a_name_that_begins_like_another_is_no_head_of_it(tmp_path):
    """A frame of 0.5 is no head 5 of the frame of 0; what the heads are, the run says."""
    names = ("psf_0", "psf_0.5", "pair", "pair.right", "pair.left")
    run = write_run(tmp_path / "run", [Case(truth_at(name=name)) for name in names])
    head = read_json(run / "run.json")
    heads = {"pair": [["right", "pair.right"], ["left", "pair.left"]]}
    write_json(run / "run.json", head | {"heads": heads})
    assert {view.case: list(view.head_paths) for view in load_run(run).views} == {
        "psf_0": [], "psf_0.5": [], "pair": ["right", "left"], "pair.right": [], "pair.left": [],
    }  # fmt: skip


def test_a_run_without_results(tmp_path):
    run = write_run(tmp_path / "run", [Case(truth_at(name="only"))])
    words = plain(build_report(run).read_text())
    assert "No attitude was claimed" in words
    assert "There are no results" in words


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"no run\.json"):
        build_report(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(DamagedFileError, match=r"has no seal.*run the suite again"):
        build_report(tmp_path)
    write_json(tmp_path / "run.json", {"suite": "x", "estimators": []})
    with pytest.raises(DamagedFileError, match="no key 'cases'"):
        build_report(tmp_path)
