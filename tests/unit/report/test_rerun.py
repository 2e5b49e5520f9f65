"""How to make a frame again: the scene in the page is the scene of the frame, to the last bit."""

from __future__ import annotations

import tomllib

import pytest
from synthetic import SOLAR_CAMERA, toy_image

from horizonval.report import rerun
from horizonval.report.load import CaseView, ReportRun
from horizonval.spec.load import load_scene
from horizonval.truth.frame_truth import truth_of


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
