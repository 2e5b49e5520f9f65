"""The report as a file: what is in it, that it needs nothing else, and that its frames can be made again."""

from __future__ import annotations

import html
import json
import re
import shutil
import tomllib
from html.parser import HTMLParser
from urllib.parse import unquote

import pytest
from synthetic import SOLAR_CAMERA, Case, synthetic_cases, toy_image, truth_at, write_run

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.report import build_report, rerun
from horizonval.report.load import CaseView, ReportRun, load_run
from horizonval.report.words import DEG
from horizonval.scoring.summary import summarise
from horizonval.spec.load import load_scene
from horizonval.store.folder import read_json, write_json
from horizonval.store.store import Store
from horizonval.truth.frame_truth import truth_of

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
        self.open += [] if tag in VOID else [tag]

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
    body = re.sub(r"<(style|script)\b.*?</\1>", "", text, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", body)).split())


def frames_of(text: str) -> list[dict]:
    """What the page gives its viewer."""
    found = re.findall(r'<script type="application/json" class="v-data">(.*?)</script>', text, re.DOTALL)
    return [json.loads(one) for one in found]


def test_every_tag_is_closed_and_every_address_is_inside(run_dir, text):
    assert [p.name for p in (run_dir / "report").iterdir()] == ["index.html"]
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


def test_the_numbers_of_the_page_are_those_of_the_rows(run_dir, text):
    words, run = plain(text), load_run(run_dir)
    # The claims of `ideal`, which is given the pose, are none of them.
    assert "1 false claim: 1 of 3 by altitude-free with vis-640x480" in words
    assert "8 frames, 3 cameras, 2 methods" in words
    for view, frame in zip(run.views, frames_of(text), strict=True):
        assert (frame["name"], frame["band"]) == (view.case, view.band)
        for name, row in view.rows.items():
            assert frame["rows"][name]["arcsec"] == row.nadir_error_arcsec
    (group,) = (g for g in summarise(run.judged_rows)["groups"] if g["camera"] == "vis-640x480")
    table = words.partition("Outcomes")[2]
    for key in ("rms", "median", "p95", "max"):
        assert DEG.number(group["nadir_error_arcsec"][key]) in table


def test_refusals_and_their_reasons_are_in_words_and_no_markup(text):
    words = plain(text)
    assert "refused, not converged; expected an attitude" in words
    assert "41 iterations, <still> moving & shaking" in words
    assert "<still>" not in text
    assert "No estimator was run on this frame." in words


def test_frames_carry_curves_and_commands(text):
    frames = frames_of(text)
    assert [frame["name"] for frame in frames[:2]] == ["day-arc", "day-tilted"]
    day, away = frames[0], frames[4]
    assert day["truth"].startswith("M")
    assert all(day["layers"][0].values())
    assert away["truth"] == ""
    assert day["rows"]["altitude-free"]["kind"] == "valid"
    assert "horizonval estimate day-arc.image.exr --estimator altitude-free" in plain(text)


def test_the_scene_in_the_page_is_the_scene_of_the_truth(text):
    uri = re.search(r'download="day-arc.toml" href="data:application/toml;charset=utf-8,(.*?)"', text).group(1)
    assert tomllib.loads(unquote(html.unescape(uri))) == synthetic_cases()[0].truth.scene


def test_what_is_missing_damaged_or_failed_is_told_not_fatal(run_dir, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(run_dir, run)
    store = Store(run / "archive")
    first, second = (json.loads((run / "cases" / f"{n}.json").read_text())["image"] for n in ("day-tilted", "night"))
    store.path(first).write_bytes(store.path(first).read_bytes()[:-100])
    store.path(second).unlink()
    for gone in ("cases/away.json", "results.parquet", "summary.json"):
        (run / gone).unlink()
    path = run / "cases" / "day-arc.json"
    record = read_json(path)
    for row in record["rows"]:
        row |= {"status": "bad_input", "expected": "valid", "reason": "the worker died", "nadir_error_arcsec": None}
    record |= {"error": "the worker died", "image": None, "images": {}, "truth_frame": None, "details": {}}
    write_json(path, record)
    words = plain(build_report(run).read_text())
    assert "Not finished: away." in words
    assert "The image in the archive is damaged" in words
    assert "The image is not in the archive any more" in words
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
    """A frame of 0.5 is no head 5 of the frame of 0: the run says what the heads are. The first has all rows."""
    names = ("psf_0", "psf_0.5", "pair", "pair.right", "pair.left")
    run = write_run(tmp_path / "run", [Case(truth_at(name=name)) for name in names])
    head = read_json(run / "run.json")
    heads = {"pair": [["right", "pair.right"], ["left", "pair.left"]]}
    write_json(run / "run.json", head | {"heads": heads})
    assert {view.case: list(view.head_paths) for view in load_run(run).views} == {
        "psf_0": [], "psf_0.5": [], "pair.right": ["right", "left"], "pair.left": [],
    }  # fmt: skip


def test_what_is_no_run_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"no run\.json"):
        build_report(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(DamagedFileError, match=r"has no seal.*run the suite again"):
        build_report(tmp_path)
    write_json(tmp_path / "run.json", {"suite": "x", "estimators": []})
    with pytest.raises(DamagedFileError, match="no key 'cases'"):
        build_report(tmp_path)


def test_toml_comes_back():
    data = {
        "top": 1,
        "text": 'quotes " \\ and\nlines, ü, \x7f',
        "none": None,
        "table": {"float": 1e-05, "big": 1e22, "flag": True, "list": [1.0, [2, 3]], "inner": {"x": -0.0}},
        "empty": {},
        "band": [{"name": "a", "shape": {"kind": "hat", "no": None}}, {"name": "b"}],
        "odd key": {"a.b": 1},
    }
    expected = {**data, "band": [{"name": "a", "shape": {"kind": "hat"}}, {"name": "b"}]}
    del expected["none"]
    assert tomllib.loads(rerun.toml(data)) == expected


def again(folder, truth, path="", estimators=("one",), programs=(), command=()):
    """Write the files that make a frame again into a folder; return their names and the commands."""
    case = truth.scene["scene"]["name"]
    view = CaseView(case, truth.camera_spec.band[0].name, {}, {}, toy_image(truth), "", False, path)
    run = ReportRun("s", "", "", estimators, (case,), (), (view,), command=command, programs=programs)
    made = rerun.rerun_of(view, run)
    folder.mkdir()
    for name, text in made.files:
        (folder / name).write_text(text)
    assert truth_of(*load_scene(folder / f"{case}.toml")) == truth
    return [name for name, _ in made.files], made.commands


def test_the_written_scene_gives_the_same_frame(tmp_path):
    """The scene's hash names the frame and seeds its noise: it must survive the trip through the page."""
    (tmp_path / "cam.toml").write_text(rerun.toml(SOLAR_CAMERA))
    (tmp_path / "scene.toml").write_text(
        'camera.file = "cam.toml"\nscene.name = "x"\nplatform = { altitude_km = 512.3456789, latitude_deg = -3e-7 }\n'
        "attitude.roll_deg = 66.1\nsun = { zenith_deg = 33.3 }\n"
    )
    truth, command = truth_of(*load_scene(tmp_path / "scene.toml")), ("horizonval", "run", "../my suite.toml")
    names, commands = again(tmp_path / "again", truth, "archive/ab/abc.exr", ("one", "two"), ("one",), command)
    assert names == ["x.toml", "cam.toml"]
    assert commands[-1] == "horizonval estimate ../archive/ab/abc.exr --estimator one --suite '../../my suite.toml'"


@pytest.mark.parametrize(
    ("changes", "files"),
    [("", ["x.toml"]), (", camera = { width = 96, height = 96 }", ["x.toml", "vis-cmos-512-60deg"])],
    ids=["as shipped", "changed"],
)
def test_a_shipped_camera_is_written_where_its_keys_were_changed(tmp_path, changes, files):
    (tmp_path / "scene.toml").write_text(
        f'scene.name = "x"\nplatform.altitude_km = 500.0\ncamera = {{ file = "vis-cmos-512-60deg"{changes} }}\n'
    )
    assert again(tmp_path / "again", truth_of(*load_scene(tmp_path / "scene.toml")))[0] == files
