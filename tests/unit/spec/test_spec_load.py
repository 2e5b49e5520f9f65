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


def _refusal(load, folder, text, name="x.toml"):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UserError) as caught:
        load(path)
    line = caught.value.line()
    assert "\n" not in line
    assert str(folder) in line, "names the file"
    return line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[camera]\nwidth = "64"\nheight = 48\nfov_deg = 60.0\n', ["camera.width", 'found "64"', "whole number"]),
        ("[camera]\nwidth = true\nheight = 48\nfov_deg = 60.0\n", ["camera.width", "found true", "whole number"]),
        ("[camera]\nwidth = 64.5\nheight = 48\nfov_deg = 60.0\n", ["camera.width", "found 64.5", "whole number"]),
        ("[camera]\nwidth = 0\nheight = 48\nfov_deg = 60.0\n", ["camera.width", "found 0", "from 1 to 16384"]),
        ("[camera]\nwidht = 64\nheight = 48\nfov_deg = 60.0\n", ["camera.widht", "unknown key", "one of width, "]),
        ("[camera]\nwidth = 64\nfov_deg = 60.0\n", ["camera.height", "missing", "whole number from 1"]),
        (CAMERA + "fx = 50.0\n", ["camera:", "exactly one of fov_deg and fx"]),
        (CAMERA + "cx = inf\n", ["camera.cx", "found inf", "a finite number"]),
        (CAMERA + "distortion = [0.1, 'x']\n", ["camera.distortion[2]", 'found "x"', "a number"]),
        (
            CAMERA + '[detector]\nkind = "cmso"\n',
            ["detector.kind", 'found "cmso"', '"cmos" or "linear" or "microbolometer"'],
        ),
        (CAMERA + "[detector]\nbits = 8\n", ["detector.kind", "missing", '"cmos" or "linear" or "microbolometer"']),
        (CAMERA + '[detector]\nkind = "cmos"\nbits = 8\n', ["detector.pixel_pitch_um", "missing", "from 0.1"]),
        (CAMERA + "[optics]\ntransmission = nan\n", ["optics.transmission", "found nan"]),
        (CAMERA + BAND + BAND, ["band names must differ"]),
        (
            CAMERA + BAND + THERMAL_BAND + BOLOMETER,
            [
                "one [detector] cannot see solar and thermal bands",
                "got vis (solar), co2 (thermal); make two camera files",
            ],
        ),
        (CAMERA + BAND.replace("0.5", "0.9"), ["band[1]", "lo_um must be below hi_um"]),
        (CAMERA.replace('"c"', "3"), ["camera.name", "found 3", "text in quotes"]),
        ("[camera\n", ["not valid TOML", "line 1"]),
        (b"\xff\xfe[camera]", ["not text"]),
        ("camera = 3\n", ["camera", "found 3", "a table"]),
        ("", ["camera", "missing", "a table"]),
    ],
)
def test_bad_camera(folder, text, parts):
    line = _refusal(load_camera, folder, text)
    for part in parts:
        assert part in line, line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (SCENE.replace("c.toml", "vis-cmos-512-60dge"), ["camera.file", "one of vis-cmos-512-60deg, "]),
        (SCENE + "latitude_deg = 91.0\n", ["platform.latitude_deg", "found 91", "from -90 to 90"]),
        (SCENE + "latitude_deg = nan\n", ["platform.latitude_deg", "found nan"]),
        (SCENE + 'epoch_utc = "noon"\n', ["platform.epoch_utc", 'found "noon"', "date and time"]),
        (SCENE + '[scene]\nname = "a b"\n', ["scene.name", 'found "a b"', "characters"]),
        (SCENE + "[scene]\nseed = -1\n", ["scene.seed", "found -1", "at least 0"]),
        (SCENE + "[earth]\nradius_km = 6000.0\n", ["earth", "sphere"]),
        (SCENE + "[render]\nnodes = 4\n", ["render.nodes", "found 4", "from 8 to 4096"]),
        (SCENE + '[surface]\nkind = "erth"\n', ["surface.kind", 'found "erth"', '"uniform" or "earth"']),
        (
            SCENE + '[surface]\nkind = "earth"\nalbedo = 0.2\n',
            ["surface", 'albedo applies to kind = "uniform" and "chequered" only'],
        ),
        (
            SCENE + '[surface]\nkind = "earth"\nemissivity = 0.9\n',
            ["surface", 'emissivity applies to kind = "uniform"'],
        ),
        (SCENE + "[clouds]\ncover = 0.5\nemissivity = 1.1\n", ["clouds.emissivity", "from 0 to 1"]),
        (SCENE + "[atmosphere]\nco2_ppm = 200.0\n", ["atmosphere.co2_ppm", "found 200", "from 280 to 560"]),
        (SCENE + '[atmosphere]\nprofile = "none"\nco2_ppm = 400.0\n', ["atmosphere:", "co2_ppm applies to"]),
        (SCENE + "[surface]\nwind_speed_m_s = 5.0\n", ["surface", 'wind_speed_m_s applies to kind = "earth" only']),
        (SCENE + '[surface]\nkind = "earth"\nwind_speed_m_s = -1.0\n', ["surface.wind_speed_m_s", "from 0 to 40"]),
        (SCENE + '[clouds]\npattern = "uniform"\n', ["clouds", "needs a cover"]),
        (SCENE + "[clouds]\nscale_km = 50.0\n", ["clouds", "mean_top_km and scale_km belong to"]),
        (SCENE + "[clouds]\ncover = 1.5\n", ["clouds.cover", "found 1.5"]),
        (SCENE + "[clouds]\ncover = 0.5\ntop_km = 20.0\n", ["clouds.top_km", "found 20", "from 1 to 17"]),
        (SCENE + "[clouds]\ncover = 0.5\nmean_top_km = 12.0\n", ["clouds", "mean_top_km must be below top_km"]),
        (SCENE + "[clouds]\ncover = 0.5\nseed = -1\n", ["clouds.seed", "found -1"]),
        (SCENE + "[clouds]\ncover = 0.5\ncolor = 1\n", ["clouds.color", "unknown key"]),
        (SCENE + '[atmosphere]\nfile = "nope.json"\n', ["atmosphere.file", "nope.json", "one of us76"]),
        (SCENE + '[atmosphere]\nprofile_file = "nope.csv"\n', ["atmosphere.profile_file", "nope.csv", "CSV or JSON"]),
        (SCENE + '[atmosphere]\nprofile_file = "a.csv"\nfile = "us76"\n', ["atmosphere:", "file and profile_file"]),
        (SCENE + '[atmosphere]\naerosol = "smoke"\n', ["atmosphere.aerosol", 'found "smoke"', '"volcanic_high"']),
        (SCENE + '[atmosphere]\naerosol = "background"\nfile = "us76"\n', ["atmosphere:", 'set aerosol = "none"']),
        (SCENE + '[atmosphere]\naerosol = "background"\nprofile = "none"\n', ["atmosphere:", 'set aerosol = "none"']),
        (
            SCENE + '[atmosphere]\naerosol = "none"\naerosol_optical_depth_550nm = 0.1\n',
            ["atmosphere:", "aerosol_optical_depth_550nm needs particles"],
        ),
        (SCENE + "[atmosphere]\naerosol_optical_depth_550nm = -0.1\n", ["aerosol_optical_depth_550nm", "from 0 to 5"]),
        (SCENE + "[atmosphere]\nmonth = 13\n", ["atmosphere.month", "found 13", "from 1 to 12"]),
        (SCENE + "[atmosphere]\nmonth = 7\n", ["atmosphere:", 'month applies to profile = "by_latitude_month"']),
        (SCENE + "[atmosphere]\nlatitude_deg = 40.0\n", ["atmosphere:", "latitude_deg applies to"]),
        (SCENE + "[render]\nband_error = 0.0\n", ["render.band_error", "found 0", "from 0.0001 to 0.1"]),
        ('[camera]\nfile = "bandless.toml"\n[platform]\naltitude_km = 500.0\n', ["camera.file", "band"]),
    ],
)
def test_bad_scene(folder, text, parts):
    (folder / "bandless.toml").write_text(CAMERA)
    line = _refusal(load_scene, folder, text)
    for part in parts:
        assert part in line, line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["suite", "missing"]),
        (SUITE, ["frame", "missing"]),
        (SUITE + "[[frame]]\nplatform.altitude_km = 500.0\n", ["frame 1 has no scene.name"]),
        (SUITE + '[[frame]]\nscene.name = "a"\n' * 2, ["two frames are named 'a'"]),
        (SUITE + '[[frame]]\nscene.name = "a"\n', ["frame[1] (a): platform", "missing"]),
        (SUITE + '[[frame]]\nscene.name = "a"\nplatform.altitude = 5.0\n', ["frame[1] (a): platform.altitude", "km"]),
        (SUITE.replace('["ideal"]', "[]") + '[[frame]]\nscene.name = "a"\n', ["suite.estimators", "at least 1"]),
    ],
)
def test_bad_suite(folder, text, parts):
    line = _refusal(load_suite, folder, text)
    for part in parts:
        assert part in line, line


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


def test_atmosphere_file_becomes_an_absolute_path(folder):
    (folder / "a.json").write_text("{}")
    (folder / "s.toml").write_text(SCENE + '[atmosphere]\nfile = "a.json"\n')
    assert load_scene(folder / "s.toml")[0].atmosphere.file == str((folder / "a.json").resolve())
    (folder / "s.toml").write_text(SCENE + '[atmosphere]\nfile = "us76"\n')
    assert load_scene(folder / "s.toml")[0].atmosphere.file == str((shipped_root() / "atmospheres/us76.json").resolve())


def test_profile_file_is_looked_for_beside_the_scene(folder, monkeypatch, tmp_path_factory):
    (folder / "air.csv").write_text("")
    (folder / "s.toml").write_text(SCENE + '[atmosphere]\nprofile_file = "air.csv"\n')
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    scene, _ = load_scene(folder / "s.toml")
    assert scene.atmosphere.profile_file == str((folder / "air.csv").resolve())


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


def test_a_band_need_not_say_how_many_nodes(folder):
    assert load_camera(folder / "c.toml").band[0].nodes is None


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
