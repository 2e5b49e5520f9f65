"""A suite of a camera with two heads, from the file to the page: all methods' figures, cards that can be made again."""

from __future__ import annotations

import json
import shlex
import subprocess
from pathlib import Path

import pytest
from browser import Browser, chromium_path
from conftest import PROGRAM, assert_one_line

from horizonval.report import campaign
from horizonval.report.load import load_run
from horizonval.report.rerun import rerun_of
from horizonval.store.store import Store

pytestmark = pytest.mark.slow

SUITE = """
[suite]
name = "tiny"
seed = 1
estimators = ["altitude-free", "video-vertical", "guarded-video-vertical"]
[defaults]
camera = { file = "vis-pair-1024-60deg", camera = { width = 96, height = 96 } }
platform = { altitude_km = 500.0, heading_deg = 350.0 }
render = { subsamples = 1, nodes = 16, orders = "single" }
[[cases]]
name = "tilt"
grid = { "attitude.roll_deg" = [-5.0, 5.0], "attitude.pitch_deg" = [0.0, 5.0] }
[[figure]]
kind = "map"
x = "attitude.pitch_deg"
y = "attitude.roll_deg"
[[figure]]
kind = "sweep"
x = "attitude.roll_deg"
[[figure]]
kind = "exclusion"
[[figure]]
kind = "timeline"
"""
HEADS = ("left", "forward")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiny")
    (folder / "tiny.toml").write_text(SUITE)
    done = subprocess.run(
        [str(PROGRAM), "run", "tiny.toml", "--out", "out"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / "out"


def test_every_figure_holds_the_rows_of_one_image_and_of_all_heads(run):
    page = campaign.page_of(load_run(run))
    assert [section["kind"] for section in page["sections"]] == ["map", "sweep", "exclusion", "timeline"]
    maps = {figure["title"].rpartition(", ")[2] for figure in page["sections"][0]["figures"]}
    assert maps == {"altitude-free", "video-vertical", "guarded-video-vertical"}
    for section in page["sections"][1:]:
        (figure,) = section["figures"]
        # A mark of a scene of all heads leads to the scene's card, a mark of one image to the head's.
        for ending in ("", *(f".{head}" for head in HEADS)):
            assert f'"index.html#tilt_roll_deg_5_pitch_deg_0{ending}"' in figure["svg"]
        assert (run / "report" / figure["file"]).read_text() == figure["svg"]


def test_the_page_opens_and_complains_of_nothing(run, tmp_path):
    if chromium_path() is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")
    with Browser(tmp_path) as browser:
        assert browser.faults((run / "report" / campaign.PAGE).as_uri()) == []
        assert browser.evaluate("document.querySelectorAll('figure.plot svg').length") >= 6


def test_the_commands_of_a_scene_of_all_heads_give_its_result_again(run, horizonval, tmp_path):
    name = "tilt_roll_deg_5_pitch_deg_0"
    view = next(view for view in load_run(run).views if view.scene == name)
    assert set(view.head_paths) == set(HEADS)
    again = rerun_of(view, load_run(run))
    (tmp_path / "archive").symlink_to(run / "archive")
    folder = tmp_path / "again"
    folder.mkdir()
    for file, text in again.files:
        (folder / file).write_text(text)
    reports = []
    for command in again.commands:
        words = shlex.split(command)[1:]
        done = horizonval(*words, *(["--json"] if words[0] == "estimate" else []), folder=folder)
        assert done.returncode == 0, done.stderr
        if words[0] == "estimate":
            reports.append(json.loads(done.stdout))
    together = ["video-vertical", "guarded-video-vertical"]
    assert [report["estimator"] for report in reports] == ["altitude-free", *together, together[0]]
    for report in reports:
        row = view.rows[report["estimator"]]
        assert report["status"] == row.status
        fit = (view.details[report["estimator"]] or {}).get("fit") or {}
        # The same bits went in: rendering, noise and estimate repeat exactly.
        assert report["nadir_cam"] == fit.get("nadir_cam")


def test_images_that_do_not_belong_together_are_refused(run, horizonval):
    store = Store(run / "archive")
    views = {view.scene: view for view in load_run(run).views}
    one, other = (views[f"tilt_roll_deg_{roll}_pitch_deg_0"].head_paths for roll in ("-5", "5"))
    left, forward, far = (store.root.parent / path for path in (one["left"], one["forward"], other["forward"]))
    assert_one_line(horizonval("estimate", left, left, "--estimator", "video-vertical"), "second image of the head")
    # Of a method of one image they are two images.
    assert len(horizonval("estimate", left, forward, "--estimator", "altitude-free").stdout.splitlines()) == 2
    assert_one_line(
        horizonval("estimate", left, forward, "--camera", "vis-pair-1024-60deg", "--estimator", "video-vertical"),
        "camera",
    )
    assert_one_line(horizonval("estimate", left, far, "--estimator", "video-vertical"), "another camera, place, time")
