"""All problems of a file are told at once, each as one line."""

from __future__ import annotations

import copy
import json
import pickle
import time
from pathlib import Path

import pytest

import horizonval as hv
from horizonval import cli
from horizonval.api.check import check
from horizonval.core.errors import MOST_MISTAKES, MistakeCollector, SeveralMistakesError, UserError, several
from horizonval.earth.atmosphere_file import read_atmosphere
from horizonval.spec.load import load_camera
from horizonval.suites.suite import load_suite

CAMERA = """
[camera]
width = 0
height = "512"
fov_deg = 60
[optic]
[[band]]
name = "vis"
kind = "solar"
lo_um = -1
hi_um = 0.7
nods = 3
"""

SUITE = """
[suite]
name = "five"
estimators = ["ideal"]
[defaults]
camera = { file = "vis-cmos-512-60deg" }
platform = { altitude_km = 500.0, longitud_deg = 3.0 }
[[frame]]
scene = { name = "a" }
render = { subsamples = 99 }
[[frame]]
scene = { name = "b" }
attitude = { roll = 3.0 }
[[cases]]
name = "t"
[cases.grid]
"platform.altitude_km" = [500.0, -3.0]
[[cases]]
name = "o"
[cases.orbit]
epoch_utc = 2026-03-20T00:00:00Z
n = 8
tle = 3
"""


def _mistakes(path: Path, load) -> list[str]:
    with pytest.raises(UserError) as e:
        load(path)
    return e.value.lines()


def test_a_camera_file_tells_all_its_mistakes(tmp_path, capsys):
    path = tmp_path / "c.toml"
    path.write_text(CAMERA)
    lines = _mistakes(path, load_camera)
    keys = ["band[1].nods", "optic", "camera.width", "camera.height", "band[1].lo_um"]
    assert [line.removeprefix(f"{path}: ").partition(": ")[0] for line in lines] == keys
    arguments = ["estimate", "a.png", "--camera", str(path), "--estimator", "ideal"]
    assert cli.run_command_line(arguments) == 2
    assert capsys.readouterr().err == "".join(f"horizonval: error: {line}\n" for line in lines)


def test_a_suite_tells_the_mistakes_of_all_its_frames(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(SUITE)
    lines = _mistakes(path, load_suite)
    starts = [line.removeprefix(f"{path}: ").partition("; expected")[0] for line in lines]
    assert starts == [
        "frame[1] (a): platform.longitud_deg: unknown key (so in 4 places)",
        "frame[1] (a): render.subsamples: found 99",
        "frame[2] (b): attitude.roll: unknown key",
        "cases[1] (t): t_altitude_km_-3: platform.altitude_km: found -3.0",
        "cases[2] (o).orbit: tle: found 3",
    ]


def test_many_mistakes_are_counted(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("[camera]\n" + "".join(f"key{i} = {i}\n" for i in range(3000)))
    start = time.process_time()
    lines = _mistakes(path, load_camera)
    assert time.process_time() - start < 5.0
    assert len(lines) == MOST_MISTAKES + 1
    assert lines[-1] == "and 2982 more problems"


def test_a_mistake_of_a_thousand_frames_is_told_once_and_soon(tmp_path):
    path = tmp_path / "s.toml"
    text = SUITE.partition("[[frame]]")[0]
    path.write_text(text + '[[cases]]\nname = "t"\n[cases.grid]\n"platform.latitude_deg" = {from=0, to=80, n=100000}\n')
    start = time.process_time()
    lines = _mistakes(path, load_suite)
    assert time.process_time() - start < 10.0
    assert len(lines) == 1
    assert "longitud_deg: unknown key (so in at least 200 places)" in lines[0]


def test_what_a_run_would_refuse_is_told_of_all_frames(tmp_path):
    path = tmp_path / "s.toml"
    text = SUITE.partition("[[frame]]")[0].replace(", longitud_deg = 3.0", "")
    frame = '[[frame]]\nscene = {{ name = "{0}" }}\natmosphere = {{ profile = "{0}" }}\n'
    path.write_text(text + frame.format("venus") + frame.format("mars"))
    suite = load_suite(path)
    with pytest.raises(UserError) as e:
        hv.run(path, tmp_path / "out")
    assert [name in line for name, line in zip(("venus", "mars"), e.value.lines(), strict=True)] == [True, True]
    assert [finding.code for finding in check(suite).findings] == ["cannot-run", "cannot-run"]


def test_an_atmosphere_file_tells_all_its_mistakes(tmp_path):
    path = tmp_path / "a.json"
    band = {"name": "", "wavelength_nm": -1, "scattering_per_m": [1], "absorption_per_m": [1], "phase": "blue"}
    path.write_text(json.dumps({"planet_radius_km": "x", "altitude_km": [0, 1], "bands": [band]}))
    keys = " ".join(line.removeprefix(f"{path}: ").partition(": ")[0] for line in _mistakes(path, read_atmosphere))
    bands = "bands[0].name bands[0].wavelength_nm bands[0].phase"
    assert keys == f"planet_radius_km top_km temperature_K {bands} surface"


def test_several_mistakes_are_one_error():
    first, second = UserError("a", where="k"), UserError("b", expected="c")
    assert several([first]) is first
    both = several([first, second], more=1)
    assert isinstance(both, SeveralMistakesError)
    assert (both.what, both.where, both.line()) == ("a", "k", "k: a")
    assert str(both) == "k: a\nb; expected c\nand 1 more problem"
    assert both.inside("f").lines() == ["f: k: a", "f: b; expected c", "and 1 more problem"]
    assert both.at("f").lines() == ["f: a", "f: b; expected c", "and 1 more problem"]
    assert pickle.loads(pickle.dumps(both)).lines() == copy.copy(both).lines() == both.lines()
    assert both.mistakes == (first, second)


def test_defects_pass_and_no_line_is_longer_than_anyone_reads():
    collector = MistakeCollector()
    collector.tell()
    with pytest.raises(ZeroDivisionError), collector.caught():
        raise ZeroDivisionError
    error = UserError("w" * 10**6, where="p" * 10**6, expected="e" * 10**6, fix="f" * 10**6)
    assert len(error.line()) < 3100
    assert UserError("a  b\nc", where=" k ").line() == "k: a b c"
