"""Specification files: what they become, and the one line every mistake becomes."""

from __future__ import annotations

import re
from datetime import UTC, datetime

import pytest

from horizonval.core.errors import UserError
from horizonval.spec.earth import Atmosphere
from horizonval.spec.files import shipped_names, shipped_root
from horizonval.spec.load import deep_merge, load_camera, load_scene, load_suite
from horizonval.suites.suite import load_suite as load_flown_suite

CAMERA = '[camera]\nname = "c"\nwidth = 64\nheight = 48\nfov_deg = 60.0\n'
BAND = '[[band]]\nname = "vis"\nkind = "solar"\nlo_um = 0.5\nhi_um = 0.7\n'
THERMAL_BAND = '[[band]]\nname = "co2"\nkind = "thermal"\nlo_um = 14.0\nhi_um = 16.3\n'
BOLOMETER = '[detector]\nkind = "microbolometer"\npixel_pitch_um = 17.0\nnetd_k = 0.05\nbits = 14\n'
SCENE = '[camera]\nfile = "c.toml"\n[platform]\naltitude_km = 500.0\n'
SUITE = '[suite]\nname = "s"\nseed = 7\nestimators = ["ideal"]\n[defaults]\ncamera.file = "c.toml"\n'


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "c.toml").write_text(CAMERA + BAND)
    return tmp_path


@pytest.mark.parametrize(("load", "kind"), [(load_camera, "camera"), (load_scene, "scene"), (load_suite, "suite")])
def test_unknown_names_list_what_exists(load, kind):
    known = shipped_names(kind)
    wrong = known[-1][:-1] + "x"
    with pytest.raises(UserError) as caught:
        load(wrong)
    listed = re.search(r"one of (.*)$", str(caught.value)).group(1).split(", ")
    assert sorted(listed) == known
    assert listed[0] == known[-1], "nearest first"


def test_missing_file_and_folder(tmp_path):
    for path in (tmp_path / "none.toml", tmp_path):
        with pytest.raises(UserError) as caught:
            load_camera(path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("kind", ["camera", "scene", "suite"])
def test_every_shipped_file_loads(kind):
    load = {"camera": load_camera, "scene": load_scene, "suite": load_flown_suite}[kind]
    names = shipped_names(kind)
    assert names
    for name in names:
        load(name)


def test_a_path_wins_over_a_name(folder, monkeypatch):
    monkeypatch.chdir(folder)
    name = shipped_names("camera")[0]
    (folder / name).write_text(CAMERA)
    assert load_camera(name).camera.name == "c"


def test_relative_camera_is_looked_for_beside_the_scene(folder, monkeypatch, tmp_path_factory):
    (folder / "s.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    scene, camera = load_scene(folder / "s.toml")
    assert (camera.camera.width, scene.platform.altitude_km) == (64, 500.0)


def test_epoch_in_quotes_and_without(folder):
    for text in ('"2026-03-20T12:00:00Z"', "2026-03-20T12:00:00Z", "2026-03-20T14:00:00+02:00", "2026-03-20 12:00:00"):
        (folder / "s.toml").write_text(SCENE + f"epoch_utc = {text}\n")
        assert load_scene(folder / "s.toml")[0].platform.epoch_utc == datetime(2026, 3, 20, 12, tzinfo=UTC)


def test_files_of_air_are_looked_for_beside_the_scene(folder, monkeypatch, tmp_path_factory):
    for name in ("a.json", "air.csv"):
        (folder / name).write_text("{}")
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    for key, name, path in [
        ("file", "a.json", folder / "a.json"),
        ("file", "us76", shipped_root() / "atmospheres/us76.json"),
        ("profile_file", "air.csv", folder / "air.csv"),
    ]:
        (folder / "s.toml").write_text(SCENE + f'[atmosphere]\n{key} = "{name}"\n')
        assert getattr(load_scene(folder / "s.toml")[0].atmosphere, key) == str(path.resolve())


@pytest.mark.parametrize(
    ("table", "aerosol"),
    [
        ("", "background"),
        ('profile = "by_latitude_month"', "background"),
        ('profile_file = "air.csv"', "background"),
        ('profile = "tropical"\naerosol = "volcanic_high"', "volcanic_high"),
        ('profile = "tropical"\naerosol = "none"', "none"),
        ('profile = "none"', "none"),
        ('file = "us76"', "none"),
        ('profile = "none"\naerosol = "none"', "none"),
    ],
)
def test_air_with_gases_has_haze_unless_it_is_told_otherwise(folder, table, aerosol):
    (folder / "air.csv").write_text("")
    (folder / "s.toml").write_text(SCENE + f"[atmosphere]\n{table}\n")
    scene, _ = load_scene(folder / "s.toml")
    assert scene.atmosphere.aerosol == aerosol
    # What a frame's truth keeps must read back.
    assert Atmosphere.model_validate(scene.atmosphere.model_dump(mode="json")) == scene.atmosphere


def test_frames_lie_over_defaults(folder):
    (folder / "s.toml").write_text(
        SUITE
        + "platform = { altitude_km = 500.0, latitude_deg = 3.0 }\nattitude.roll_deg = 1.0\n"
        + '[[frame]]\nscene.name = "a"\nplatform.altitude_km = 600.0\n'
        + '[[frame]]\nscene = { name = "b", seed = 9 }\nattitude = { pitch_deg = 2.0 }\n'
    )
    suite = load_suite(folder / "s.toml")
    a, b = suite.cases
    assert (a.name, a.scene.platform.altitude_km, a.scene.platform.latitude_deg) == ("a", 600.0, 3.0)
    assert (b.scene.platform.altitude_km, b.scene.attitude.roll_deg, b.scene.attitude.pitch_deg) == (500.0, 1.0, 2.0)
    assert (a.scene.scene.seed, b.scene.scene.seed) == (7, 9), "the suite's seed is the default"


def test_deep_merge_leaves_its_arguments_alone():
    below, above = {"a": {"x": 1, "y": [1, 2]}, "b": 1}, {"a": {"y": [3]}, "b": {"z": 2}}
    assert deep_merge(below, above) == {"a": {"x": 1, "y": [3]}, "b": {"z": 2}}
    assert below == {"a": {"x": 1, "y": [1, 2]}, "b": 1}


def test_a_camera_without_detector_may_have_both_kinds_of_band(folder):
    (folder / "both.toml").write_text(CAMERA + BAND + THERMAL_BAND)
    assert [band.kind for band in load_camera(folder / "both.toml").band] == ["solar", "thermal"]
    (folder / "one.toml").write_text(CAMERA + THERMAL_BAND + BOLOMETER)
    assert load_camera(folder / "one.toml").detector is not None


@pytest.mark.parametrize("number", ["0x" + "f" * 5000, "0o" + "7" * 5000, "0b" + "1" * 64, "-9223372036854775809"])
def test_an_integer_beyond_64_bits_is_one_line(folder, number):
    (folder / "s.toml").write_text(f"{SCENE}pair = [1, {{ long = {number} }}]\n")
    with pytest.raises(UserError, match=r"s\.toml: platform\.pair\[2\]\.long: an integer of more than 64") as found:
        load_scene(folder / "s.toml")
    assert len(found.value.line()) < 300
