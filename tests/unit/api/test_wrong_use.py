"""Wrong use is a ``UserError`` of one line, the same line as on the command line where there is one."""

from __future__ import annotations

import numpy as np
import pytest

import horizonval as hv
from horizonval import cli
from horizonval.report.rerun import toml

CAMERA = "vis-cmos-512-60deg"


def line_of(call) -> str:
    with pytest.raises(hv.UserError) as error:
        call()
    text = error.value.line()
    assert text == str(error.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize(
    ("arguments", "call"),
    [
        (["render", "limb-non-vis", "-o", "x.exr"], lambda: hv.render("limb-non-vis")),
        (["render", "broken.toml", "-o", "x.exr"], lambda: hv.render("broken.toml")),
        (["run", "quik", "--out", "o"], lambda: hv.run("quik", out="o")),
        (["run", "orbit.toml", "--out", "o", "--keep", "some"], lambda: hv.run("orbit.toml", out="o", keep="some")),
        (["run", "orbit.toml", "--out", "o", "--shard", "3/2"], lambda: hv.run("orbit.toml", out="o", shard="3/2")),
        (["observe", "image.exr", "-o", "x.exr"], lambda: hv.open_frame("image.exr")),
        (
            ["observe", "frame.exr", "-o", "x.exr", "--band", "ir"],
            lambda: hv.open_frame("frame.exr").observe(band="ir"),
        ),
        (["estimate", "image.exr", "--estimator", "ideel"], lambda: hv.estimate("image.exr", "ideel")),
        (
            ["estimate", "image.exr", "--estimator", "ideal", "--camera", CAMERA],
            lambda: hv.estimate("image.exr", "ideal", camera=CAMERA),
        ),
    ],
)
def test_the_line_is_that_of_the_command(arguments, call, in_user_folder, capsys):
    if "broken.toml" in arguments:
        (in_user_folder / "broken.toml").write_text("[platform]\naltitude_km = -5\n[camera]\nfile = 'mycam.toml'\n")
    assert cli.run_command_line(arguments) == 2
    printed = capsys.readouterr().err.strip().splitlines()[-1]
    assert printed == f"horizonval: error: {line_of(call)}"


@pytest.mark.parametrize(
    ("keywords", "parts"),
    [
        ({"altitude_k": 500}, ["Scene: altitude_k: unknown keyword; expected one of altitude_km,"]),
        ({"altitude_km": -5}, ["Scene: altitude_km: found -5; expected a number above 0"]),
        ({}, ["Scene: platform.altitude_km: missing; expected a number above 0"]),
        ({"altitude_km": "high"}, ['Scene: altitude_km: found "high"; expected a number']),
        ({"altitude_km": 500, "latitude_deg": 91}, ["Scene: latitude_deg: found 91"]),
        ({"altitude_km": 500, "epoch_utc": "noon"}, ["Scene: epoch_utc", "a date and time such as"]),
        (
            {"altitude_km": 500, "surface": {"albdo": 0.1}},
            ["Scene: surface.albdo: unknown key; expected one of albedo"],
        ),
        ({"altitude_km": 500, "surface": 3}, ["Scene: surface: found 3; expected a table"]),
        ({"altitude_km": 500, "camera": "vis-cmos"}, ["no camera named 'vis-cmos'"]),
        ({"altitude_km": 500, "camera": None}, ["Scene: camera: missing"]),
        ({"altitude_km": 500, "camera": "ir-linear-160-four-heads"}, ["Scene: camera.head"]),
    ],
)
def test_a_wrong_scene_names_the_key(keywords, parts):
    line = line_of(lambda: hv.Scene(**{"camera": CAMERA, **keywords}))
    for part in parts:
        assert part in line, line


def test_numbers_of_numpy_are_numbers():
    scene = hv.Scene(
        camera=CAMERA, altitude_km=np.float32(500), latitude_deg=np.int64(5), attitude={"rate_deg_s": np.zeros(3)}
    )
    assert scene == hv.Scene(camera=CAMERA, altitude_km=500, latitude_deg=5, attitude={"rate_deg_s": [0.0, 0.0, 0.0]})


def test_a_scene_of_keywords_is_the_scene_of_a_file(in_user_folder):
    (in_user_folder / "scene.toml").write_text(
        '[scene]\nname = "one"\n[camera]\nfile = "mycam.toml"\nmount_roll_deg = 65.0\n'
        '[platform]\naltitude_km = 550.0\nepoch_utc = 2026-03-20T12:00:00Z\n[surface]\nkind = "earth"\n'
    )
    by_file = hv.Scene.from_file("scene.toml")
    by_keywords = hv.Scene(
        camera=hv.Camera.from_file("mycam.toml"),
        name="one",
        mount_roll_deg=65,
        altitude_km=550,
        epoch_utc="2026-03-20T12:00Z",
        surface={"kind": "earth"},
    )
    assert by_keywords == by_file
    assert by_keywords.spec.model_dump_json() == by_file.spec.model_dump_json()
    assert hv.Scene.from_dict(by_file.to_dict()) == by_file
    assert by_file.changed(altitude_km=600).changed(altitude_km=550.0) == by_file


def test_a_frame_knows_its_scene_and_camera(in_user_folder):
    frame = hv.open_frame("frame.exr")
    assert frame.camera.spec == hv.Camera.from_file("mycam.toml").spec
    assert frame.scene.spec.platform.altitude_km == 550
    again = hv.render(frame.scene, progress=False)
    assert again.truth.scene_id == frame.truth.scene_id
    np.testing.assert_array_equal(again.radiance["vis"], frame.radiance["vis"])


@pytest.mark.parametrize(
    ("call", "part"),
    [
        (lambda: hv.estimate(np.zeros((4, 4, 4, 4)), "ideal"), "image: found a ndarray of shape (4, 4, 4, 4)"),
        (lambda: hv.estimate(np.zeros((64, 64)), "altitude-free"), "does not say which camera took it"),
        (lambda: hv.estimate("image.exr", 3), "estimator: found a int"),
        (lambda: hv.estimate(["image.exr", "image.exr"], "ideal"), "takes one image, not"),
        (lambda: hv.render_reference("limb-noon-vis", samples=1), "samples: found 1"),
        (lambda: hv.open_run("."), "there is no run here"),
        (lambda: hv.Camera.from_dict({"camera": {"width": 3}}), "Camera: camera.height: missing"),
        (lambda: hv.Camera.from_file(CAMERA).changed(lens={}), "Camera: lens: unknown key"),
    ],
)
def test_other_mistakes_say_what_was_wrong(call, part, in_user_folder):
    assert part in line_of(call)


def test_objects_are_one_line_and_pictures_in_a_notebook(in_user_folder):
    frame = hv.open_frame("frame.exr")
    image = frame.observe(seed=2)
    fit = hv.estimate(image, "ideal")
    run = hv.open_run("out")
    things = [frame, image, fit, hv.score(fit, frame), run, frame.camera, frame.scene, hv.check(frame.scene)]
    for thing in things:
        assert len(repr(thing).splitlines()) == 1
        assert len(repr(thing)) < 160
    for thing in (frame, image):
        assert thing._repr_html_().startswith('<img src="data:image/png;base64,iVBOR')
    assert "report" in run._repr_html_()


def test_geodetic_claims_are_scored_as_such(in_user_folder):
    """The fit says which vertical it is; nobody names the estimator again."""
    frame = hv.open_frame("frame.exr").scene.changed(latitude_deg=45)
    frame = hv.render(frame, progress=False)
    ideal = hv.estimate(frame, "ideal")
    method = hv.Estimator("geodetic", "The ideal sensor's answer under another name", lambda _: ideal, "geodetic")
    assert hv.score(ideal, frame).nadir_error_deg < 1e-6
    assert 0.16 < hv.score(hv.estimate(frame, method), frame).nadir_error_deg < 0.20


@pytest.mark.parametrize("name", hv.list_scenes())
def test_a_shipped_scene_survives_plain_data(name):
    for scene in hv.Scene.each_head(name):
        again = hv.Scene.from_dict(scene.to_dict(), camera=hv.Camera.from_dict(scene.camera.to_dict()))
        assert again.camera.spec.model_dump() == scene.camera.spec.model_dump()
        assert again.spec.model_dump() == scene.spec.model_dump()


@pytest.mark.parametrize(
    ("camera", "detector", "attitude", "most_deg_s"),
    [
        # 0.1 rad while an image is taken, 128 px (1452 px per radian), or a pixel in a second where nothing lags.
        (CAMERA, {"exposure_s": 1e-3}, {"rate_deg_s": [0, 6e3, 0]}, np.degrees(0.1) / 1e-3),
        (CAMERA, {"exposure_s": 1.0}, {"hold": "inertial", "rate_deg_s": [0, 0, 1e308]}, np.degrees(0.1)),
        (CAMERA, {"shutter": "rolling", "row_time_s": 1.0}, {"rate_deg_s": [0, 1, 0]}, np.degrees(0.1) / 511),
        (CAMERA, {"auto_exposure": {"min_s": 0.1, "max_s": 1.0}}, {"rate_deg_s": [99, 0, 0]}, np.degrees(0.1) / 0.1),
        ("vis-cmos-512-20deg", {"exposure_s": 1e-2}, {"rate_deg_s": [999, 0, 0]}, np.degrees(128 / 1452) / 1e-2),
        ("ir-bolometer-160-57deg-full", {}, {"rate_deg_s": [0, 1e6, 0]}, np.degrees(0.05) / 0.012),
        ("ir-bolometer-160-57deg", {}, {"rate_deg_s": [0, 1, 0]}, 57.0 / 160),
    ],
)
def test_a_rate_that_no_image_shows_is_refused_wherever_it_is_given(tmp_path, camera, detector, attitude, most_deg_s):
    use = {"file": camera, "mount_roll_deg": 65.0, "detector": detector}
    tables = {"camera": use, "platform": {"altitude_km": 550.0}, "attitude": attitude}
    scene = hv.Scene.from_dict(tables)
    line = line_of(lambda: hv.render(scene, progress=False))
    assert line.startswith("attitude.rate_deg_s: the camera turns at ")
    assert float(line.split("expected at most ")[1].split()[0]) == pytest.approx(most_deg_s, rel=0.1)
    session = hv.Session(scene.camera, altitude_km=550, mount_roll_deg=65)
    assert line_of(lambda: session.image(attitude)) == line
    assert line in str(hv.check(scene))
    cases = {"name": "a", "grid": {"platform": {"latitude_deg": [0.0]}}}
    suite = {"suite": {"name": "s", "estimators": ["altitude-free"]}, "defaults": tables, "cases": [cases]}
    (tmp_path / "s.toml").write_text(toml(suite))
    assert line in line_of(lambda: hv.run(tmp_path / "s.toml", out=tmp_path / "o", progress=False))
