"""Every command does its work, and meets bad input with one clear line or a typed outcome, never a traceback."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import cv2
import numpy as np
import OpenEXR
import pytest
from conftest import MINI_CAMERA, assert_one_line

from horizonval.api.info import LISTS
from horizonval.scoring.row import read_results
from horizonval.spec.files import shipped_names
from horizonval.store import exr

NAME = "altitude-free"
CONTRACT_KEYS = [
    "estimator", "status", "reason", "nadir_cam", "roll_deg", "pitch_deg", "altitude_km", "angular_radius_deg",
    "sigma_nadir_arcsec", "n_points", "seconds", "assumed", "nadir_error_arcsec", "roll_error_arcsec",
    "pitch_error_arcsec", "altitude_error_km", "false_valid", "bound_noise_arcsec", "bound_arcsec",
]  # fmt: skip

MINI_SCENE = """
[scene]
name = "one"
[camera]
file = "mini-camera.toml"
mount_roll_deg = 65.0
[platform]
altitude_km = 500.0
"""

RAYS = """tag,obs_x_km,obs_y_km,obs_z_km,dir_x,dir_y,dir_z,sun_x,sun_y,sun_z
a,-2572.5,0,6372.0,1,0,0,0,0,1
b,-2572.5,0,6391.0,1,0,0,0,0,1
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    (tmp_path / "one.toml").write_text(MINI_SCENE)
    return tmp_path


def _estimate(done):
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    report = json.loads(done.stdout)
    assert list(report) == CONTRACT_KEYS
    return report


def test_the_program_itself(program):
    assert program("--version").stdout.startswith("horizonval ")
    assert program("list", "suites").returncode == 0
    assert_one_line(program("rendr"), "rendr")


WRONG = {
    "run --wrokers 2": ["--wrokers"],
    "run quick --out o --workers 0": ["--workers"],
    "run quick --out f.exr": ["f.exr"],
    "list camera": ["'camera'", "one of cameras"],
    "render one.toml -o no/where.exr": ["no: no such folder"],
    "render one.toml -o .": ["is a folder"],
    "render one.toml -o one.toml": ["one.toml: is read by this command"],
    "render one.toml -o mini-camera.toml": ["mini-camera.toml: is read by this command"],
    "render one.toml -o r.exr --reference --spp 0": ["--spp", "2"],
    "render one.toml -o r.exr --spp 9": ["--spp", "without --reference"],
    "render one.toml -o r.exr --reference-size 24x20": ["--reference-size", "without --reference"],
    "render one.toml -o r.exr --reference --reference-size 24x24": ["out of proportion", "24x20"],
    "render weather-limb-15um -o r.exr --reference --reference-size 10x8": ["atmosphere.profile", "weather:ec2008-12"],
    "render limb-non-vis -o r.exr --reference": ["limb-noon-vis"],
    "mitsuba limb-non-vis -o m": ["limb-noon-vis"],
    "mitsuba one.toml -o no/where": ["no: no such folder"],
    "mitsuba one.toml -o one.toml": ["is a file", "empty folder"],
    "mitsuba one.toml -o .": ["is not empty"],
    "observe f.exr -o f.exr": ["is read by this command"],
    "observe f.exr -o i.exr --band visible": ["no band 'visible'", "vis"],
    "observe f.exr -o i.exr --camera wode.toml": ["no camera named"],
    "observe f.exr -o i.exr --camera wide.toml": ["camera's fx", "render"],
    "observe f.exr -o i.exr --seed 0-9": ["10 images", "{seed}"],
    "observe f.exr -o no/{seed}.exr --seed 0-9": ["no: no such folder"],
    "observe f.exr -o i.exr --seed x": ["--seed: found 'x'"],
    "observe p.exr -o o.exr": ["p.exr", "PNG"],
    "observe i.exr -o o.exr": ["i.exr", "frame"],
    "sheet f.exr -o s.png": ["f.exr"],
    "estimate i.png --estimator altitude-free": ["i.png", "--camera"],
    "estimate i.png --camera vis-cmos-512-60deg --estimator altitude-free": ["96 x 80", "512 x 512"],
    "estimate i.png --camera mini-camera.toml --estimator ideal": ["pose"],
    "estimate i.png --camera mini-camera.toml --estimator altitud-free": ["altitud-free", "altitude-free, "],
    "estimate none.png --camera mini-camera.toml --estimator altitude-free": ["none.png"],
    "report nowhere": ["nowhere"],
    "report empty": ["empty"],
    "archive ls nowhere": ["nowhere"],
    "radiance rays.csv --atmosphere us76 -o out.csv --orders two": ["orders", "single or all"],
    "radiance none.csv --atmosphere us76 -o out.csv": ["none.csv"],
    "radiance rays.csv --atmosphere us67 -o out.csv": ["us67", "us76"],
    "radiance bad.csv --atmosphere us76 -o out.csv": ["bad.csv: line 3, column obs_z_km", '"six"'],
    "radiance low.csv --atmosphere us76 -o out.csv": ["low.csv", "ray 2", "below the ground"],
    "radiance rays.csv --atmosphere us76 -o out.csv --refraction": ["us76.json: refractivity", "missing"],
}


def test_wrong_use_is_one_line(horizonval, scene, frame_path, image_path):
    shutil.copy(frame_path, scene / "f.exr")
    shutil.copy(image_path, scene / "i.exr")
    (scene / "empty").mkdir()
    (scene / "wide.toml").write_text(MINI_CAMERA.replace("fov_deg = 60.0", "fov_deg = 70.0"))
    cv2.imwrite(str(scene / "i.png"), exr.read_image(image_path).dn)
    shutil.copy(scene / "i.png", scene / "p.exr")
    (scene / "rays.csv").write_text(RAYS)
    (scene / "bad.csv").write_text(RAYS.replace("6391.0", "six"))
    (scene / "low.csv").write_text(RAYS.replace("6391.0", "10"))
    before = sorted(scene.rglob("*"))
    for command, parts in WRONG.items():
        assert_one_line(horizonval(*command.split()), *parts)
    for size in ("24", "0x0", "24x", "-4x5", "24x20x2"):
        done = horizonval("render", "one.toml", "-o", "r.exr", "--reference", "--reference-size", size)
        assert_one_line(done, "--reference-size", "64x64")
    assert sorted(scene.rglob("*")) == before


@pytest.mark.parametrize("command", [["--help"], ["list", "cameras"], ["list", "estimators"]])
def test_light_commands_do_not_load_the_renderer(program, command):
    done = program(*command, PYTHONPROFILEIMPORTTIME="1")
    assert done.returncode == 0
    loaded = {line.rsplit("|", 1)[-1].strip() for line in done.stderr.splitlines()}
    assert "typer" in loaded
    assert not {"mitsuba", "drjit", "matplotlib", "duckdb"} & loaded


def test_list(horizonval):
    for kind in LISTS:
        described = json.loads(horizonval("list", kind, "--json").stdout)
        lines = horizonval("list", kind).stdout.splitlines()
        assert [tuple(line.split(maxsplit=1)) for line in lines] == list(described.items())
        if kind in ("cameras", "suites", "scenes"):
            assert list(described) == shipped_names(kind.removesuffix("s"))
    assert {"altitude-free", "ideal", "linear-heads"} <= set(
        json.loads(horizonval("list", "estimators", "--json").stdout)
    )


def test_render_and_observe_make_what_a_run_makes(horizonval, scene):
    for i in (1, 2):
        assert horizonval("render", "one.toml", "-o", f"{i}.exr").returncode == 0
        assert horizonval("observe", f"{i}.exr", "-o", f"{i}-dn.exr").returncode == 0
    assert (scene / "1.exr").read_bytes() == (scene / "2.exr").read_bytes()
    assert (scene / "1-dn.exr").read_bytes() == (scene / "2-dn.exr").read_bytes()
    assert horizonval("observe", "1.exr", "-o", "other.exr", "--seed", "5").returncode == 0
    one, other = exr.read_image(scene / "1-dn.exr"), exr.read_image(scene / "other.exr")
    assert (one.dn != other.dn).any()
    assert one.truth == other.truth == exr.read_frame(scene / "1.exr").truth


def test_observe_repeats_the_runs_image(horizonval, frame_path, image_path, tmp_path):
    assert horizonval("observe", frame_path, "-o", "dn.exr").returncode == 0
    assert (tmp_path / "dn.exr").read_bytes() == image_path.read_bytes()


def test_observe_many_images_of_one_frame(horizonval, frame_path, tmp_path):
    done = horizonval("observe", frame_path, "-o", "images", "--seeds", "0-1", "--exposure", "1e-4,2e-4")
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 4
    files = sorted((tmp_path / "images").iterdir())
    assert [file.name for file in files] == ["0.0001-0.exr", "0.0001-1.exr", "0.0002-0.exr", "0.0002-1.exr"]
    images = [exr.read_image(file) for file in files]
    assert [image.observation["camera"]["detector"]["exposure_s"] for image in images] == [1e-4, 1e-4, 2e-4, 2e-4]
    dark = images[0].observation["camera"]["detector"]["black_level_dn"]
    signal = [image.dn.mean() - dark for image in images]
    assert signal[2] / signal[0] == pytest.approx(2, rel=0.01), "twice the exposure; the limb saturates in neither"
    assert horizonval("observe", frame_path, "-o", "one.exr", "--seed", "1", "--exposure", "1e-4").returncode == 0
    assert (tmp_path / "one.exr").read_bytes() == files[1].read_bytes()
    done = horizonval("sheet", *files, "-o", "sheet.png", "--columns", "2")
    assert done.stdout == "sheet.png: 4 images\n", done.stderr
    assert cv2.imread(str(tmp_path / "sheet.png")) is not None
    assert_one_line(horizonval("sheet", "one.exr", "-o", "one.exr"), "is read by this command")


def test_observe_with_another_camera(horizonval, scene, frame_path, tmp_path):
    other = MINI_CAMERA.replace("bits = 10", "bits = 12").replace("full_well_e = 13500.0", "full_well_e = 27000.0")
    (tmp_path / "other.toml").write_text(other)
    assert horizonval("observe", frame_path, "-o", "i.exr", "--camera", "other.toml").returncode == 0
    assert exr.read_image(tmp_path / "i.exr").full_scale == 4095


def test_estimate_on_our_own_files_says_how_far_off_it_is(horizonval, mini_run, image_path, tmp_path):
    """The errors are those of the run's own row; an image without truth has none."""
    rows = read_results(mini_run / "results.parquet")
    row = next(row for row in rows if (row.case, row.estimator) == ("frame-0", NAME))
    report = _estimate(horizonval("estimate", image_path, "--estimator", NAME, "--json"))
    assert report["nadir_error_arcsec"] == row.nadir_error_arcsec > 1.0
    for key in CONTRACT_KEYS[-6:]:
        assert report[key] == getattr(row, key), key
    text = horizonval("estimate", image_path, "--estimator", NAME).stdout
    assert f"nadir_error_arcsec   {row.nadir_error_arcsec:.6f}" in text
    ideal = _estimate(horizonval("estimate", image_path, "--estimator", "ideal", "--json"))
    assert (ideal["estimator"], ideal["status"], len(ideal["nadir_cam"])) == ("ideal", "valid", 3)
    cv2.imwrite(str(tmp_path / "i.png"), exr.read_image(image_path).dn)
    (tmp_path / "mini-camera.toml").write_text(MINI_CAMERA)
    bare = horizonval("estimate", "i.png", "--camera", "mini-camera.toml", "--estimator", NAME, "--json")
    assert {_estimate(bare)[key] for key in CONTRACT_KEYS[-5:]} == {None}


def test_estimate_of_several_images_is_a_line_each(horizonval, frame_path, image_path, tmp_path):
    (tmp_path / "bad.exr").write_bytes(image_path.read_bytes()[:-9])
    done = horizonval("estimate", image_path, "bad.exr", frame_path, "--estimator", NAME)
    assert done.returncode == 1
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == [str(image_path), str(frame_path)]
    assert all("valid" in line and "off by" in line for line in done.stdout.splitlines())
    assert done.stderr.startswith("horizonval: bad.exr: truncated")
    assert len(done.stderr.splitlines()) == 1
    reports = json.loads(horizonval("estimate", image_path, frame_path, "--estimator", NAME, "--json").stdout)
    assert [list(report) for report in reports] == [["image", *CONTRACT_KEYS]] * 2


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_estimate_on_common_formats_is_the_same_as_on_ours(horizonval, image_path, scene, suffix):
    cv2.imwrite(str(scene / f"i.{suffix}"), exr.read_image(image_path).dn)
    call = ("--estimator", NAME, "--json")
    theirs = _estimate(horizonval("estimate", f"i.{suffix}", "--camera", "mini-camera.toml", *call))
    ours = _estimate(horizonval("estimate", image_path, *call))
    assert theirs["status"] == ours["status"] == "valid"
    assert (theirs["nadir_cam"], theirs["altitude_km"]) == (ours["nadir_cam"], ours["altitude_km"])


def _strange_images(folder, image_path):
    shape = (80, 96)
    cv2.imwrite(str(folder / "black.png"), np.zeros(shape, np.uint8))
    cv2.imwrite(str(folder / "white.png"), np.full(shape, 255, np.uint8))
    cv2.imwrite(str(folder / "white16.png"), np.full(shape, 65535, np.uint16))
    for name, value in (("nan", np.nan), ("inf", np.inf)):
        cv2.imwrite(str(folder / f"{name}.tif"), np.full(shape, value, np.float32))
    grey = exr.read_image(image_path).dn.astype(np.float32)
    grey[10, 10] = np.nan
    cv2.imwrite(str(folder / "one-nan.tif"), grey)
    OpenEXR.File({}, {"Y": grey}).write(str(folder / "one-nan.exr"))
    cv2.imwrite(str(folder / "png.exr.png"), exr.read_image(image_path).dn)
    (folder / "png.exr.png").rename(folder / "png.exr")
    cv2.imwrite(str(folder / "noise.png"), np.random.default_rng(0).integers(0, 256, shape, np.uint8))


def test_strange_images_get_a_typed_outcome(horizonval, image_path, scene):
    _strange_images(scene, image_path)
    expected = {
        "black.png": {"dark", "no_limb"},
        "white.png": {"saturated", "no_limb"},
        "white16.png": {"saturated", "no_limb"},
        "nan.tif": {"bad_input"},
        "inf.tif": {"bad_input"},
        "one-nan.tif": {"bad_input"},
        "one-nan.exr": {"bad_input"},
        "png.exr": {"valid"},
        "noise.png": {"no_limb", "short_arc", "ambiguous", "not_converged", "dark"},
    }
    for name, outcomes in expected.items():
        done = horizonval("estimate", name, "--camera", "mini-camera.toml", "--estimator", "altitude-free", "--json")
        report = _estimate(done)
        assert report["status"] in outcomes, (name, report)
        assert (report["reason"] is None) == (report["status"] == "valid")


def test_one_pixel(horizonval, scene):
    camera = MINI_CAMERA.replace("width = 96", "width = 1").replace("height = 80", "height = 1")
    (scene / "mini-camera.toml").write_text(camera)
    assert horizonval("render", "one.toml", "-o", "one.exr").returncode == 0
    assert horizonval("observe", "one.exr", "-o", "dn.exr").returncode == 0
    cv2.imwrite(str(scene / "tiny.png"), np.full((1, 1), 255, np.uint8))
    for image in (["dn.exr"], ["tiny.png", "--camera", "mini-camera.toml"]):
        assert _estimate(horizonval("estimate", *image, "--estimator", NAME, "--json"))["status"] != "valid"


def test_every_head_of_a_camera_is_a_frame(horizonval, scene):
    heads = "".join(f'[[head]]\nname = "{n}"\nmount_yaw_deg = {yaw}\n' for n, yaw in (("left", -30.0), ("right", 30.0)))
    camera = MINI_CAMERA.replace("width = 96", "width = 40").replace("height = 80", "height = 1")
    (scene / "mini-camera.toml").write_text(camera + heads)
    assert_one_line(horizonval("render", "one.toml", "-o", "one.exr"), "camera.head", "left, right")
    assert_one_line(horizonval("render", "one.toml", "--head", "up", "-o", "one.exr"), "--head", "'up'", "left, right")
    assert horizonval("render", "one.toml", "--head", "all", "-o", "one.exr").returncode == 0
    assert horizonval("render", "one.toml", "--head", "left", "-o", "again.exr").returncode == 0
    left, right = (exr.read_frame(scene / f"one.{name}.exr").truth for name in ("left", "right"))
    assert left.q_cam_from_body != right.q_cam_from_body
    assert left.q_body_from_lvlh == right.q_body_from_lvlh
    assert (scene / "again.exr").read_bytes() == (scene / "one.left.exr").read_bytes()


def test_radiance(horizonval, tmp_path):
    (tmp_path / "rays.csv").write_text(RAYS)
    done = horizonval("radiance", "rays.csv", "--atmosphere", "us76", "-o", "out.csv")
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "out.csv").read_text().splitlines()
    head = lines[0].split(",")
    assert head[: len(RAYS.splitlines()[0].split(","))] == RAYS.splitlines()[0].split(",")
    assert all(name.startswith("radiance_") for name in head[10:])
    for given, made in zip(RAYS.splitlines()[1:], lines[1:], strict=True):
        assert made.startswith(given + ",")
        assert all(float(x) > 0 for x in made.split(",")[10:])
    assert horizonval("radiance", "rays.csv", "--atmosphere", "us76", "-o", "hot.csv", "--thermal").returncode == 0
    assert (tmp_path / "hot.csv").read_text() != (tmp_path / "out.csv").read_text()


def test_every_mistake_of_an_atmosphere_is_a_line(horizonval, tmp_path):
    (tmp_path / "rays.csv").write_text(RAYS)
    (tmp_path / "bad.json").write_text('{"planet_radius_km": -1}')
    done = horizonval("radiance", "rays.csv", "--atmosphere", "bad.json", "-o", "out.csv")
    assert done.returncode == 2
    assert all(line.startswith("horizonval: error: bad.json: ") for line in done.stderr.splitlines())
    assert "planet_radius_km: is -1; expected greater than 0" in done.stderr
    assert "bands: missing" in done.stderr
    assert not (tmp_path / "out.csv").exists()


def test_render_by_reference(horizonval, scene):
    call = ("render", "one.toml", "--reference", "--reference-size", "24x20", "--spp", "9", "-o")
    done = horizonval(*call, "a.exr")
    assert done.returncode == 0, done.stderr
    assert "[16/16] vis:1, pass 8 of 8" in done.stderr
    frame = exr.read_frame(scene / "a.exr")
    assert (frame.render["kind"], frame.render["spp"], frame.render["orders"]) == ("reference", 16, "all")
    assert frame.render["sensor"] == "perspective"
    error = frame.maps["standard_error.vis"]
    assert error.shape == frame.radiance["vis"].shape == (20, 24)
    ground = frame.maps["hit"] == 1
    assert 0.0 < (error[ground] / frame.radiance["vis"][ground]).mean() < 0.5
    assert horizonval(*call, "b.exr").returncode == 0
    assert (scene / "a.exr").read_bytes() == (scene / "b.exr").read_bytes()


def test_a_smaller_reference_shows_the_same_picture(horizonval, scene):
    assert horizonval("render", "one.toml", "-o", "full.exr").returncode == 0
    small = ("--reference", "--reference-size", "24x20", "--spp", "2")
    assert horizonval("render", "one.toml", *small, "-o", "small.exr").returncode == 0
    full, low = exr.read_frame(scene / "full.exr"), exr.read_frame(scene / "small.exr")
    # a coarse pixel's centre is the corner of four fine ones
    height = full.maps["tangent_height"].reshape(20, 4, 24, 4)[:, 1:3, :, 1:3].mean(axis=(1, 3))
    limb = np.abs(height) < 2e5
    assert limb.sum() > 20
    assert np.abs(low.maps["tangent_height"] - height)[limb].max() < 2e3
    assert low.truth.nadir_geodetic_cam == full.truth.nadir_geodetic_cam


PLAIN_MITSUBA = """
import sys
import mitsuba as mi
import numpy as np
mi.set_variant(sys.argv[1])
image = np.array(mi.render(mi.load_file("reference.xml"), spp=4)).squeeze()
assert not any(name.startswith("horizonval") for name in sys.modules)
np.save("image.npy", image)
"""


def _python(folder, code, *arguments):
    call = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def test_exported_scenes_open_in_mitsuba(horizonval, scene):
    """The deterministic one with the very line its README gives, the stock one where nothing of ours is imported."""
    done = horizonval("mitsuba", "one.toml", "-o", "m")
    assert done.returncode == 0, done.stderr
    folder = scene / "m"
    names = {path.name for path in folder.iterdir()}
    air = {"sigma_t.vol", "albedo.vol", "particles.vol", *(f"asymmetry-{k}.vol" for k in (1, 2, 3))}
    assert names == {"scene.xml", "reference.xml", "README.txt", *air}
    for name in names:
        assert name in done.stdout
    text = (folder / "README.txt").read_text()
    assert len(text.splitlines()) == 2
    for part in (
        "W m-2 sr-1",
        "kilometres",
        "grid of",
        "without refraction, Sun's disc and glare, surface map, clouds",
    ):
        assert part in text
    line = text.split('python -c "')[1].split('"')[0]
    _python(folder, line + "; import numpy; numpy.save('ours.npy', numpy.array(image)[:, :, 0])")
    assert horizonval("render", "one.toml", "-o", "frame.exr").returncode == 0
    frame = exr.read_frame(scene / "frame.exr")
    assert np.load(folder / "ours.npy").tobytes() == frame.radiance["vis"].tobytes()
    _python(folder, PLAIN_MITSUBA, frame.render["variant"])
    image = np.load(folder / "image.npy")
    assert image.shape == frame.radiance["vis"].shape
    # W m-2 sr-1 um-1 against the same over a band 0.2 um wide; one scattering order against all of them
    ground = frame.maps["hit"] == 1
    assert 0.8 < 0.2 * image[ground].mean() / frame.radiance["vis"][ground].mean() < 1.6
    # the right way up: the same Earth against the same sky
    assert np.corrcoef(image.ravel(), frame.radiance["vis"].ravel())[0, 1] > 0.9
    assert np.corrcoef(image[::-1].ravel(), frame.radiance["vis"].ravel())[0, 1] < 0.5


def test_export_names_what_the_reference_cannot_show(horizonval, scene):
    camera = MINI_CAMERA.replace("fov_deg = 60.0", "fov_deg = 60.0\ndistortion = [-0.1]")
    (scene / "mini-camera.toml").write_text(camera)
    assert horizonval("mitsuba", "one.toml", "-o", "bent").returncode == 0
    assert "undistorted pinhole" in (scene / "bent" / "README.txt").read_text()
    assert horizonval("mitsuba", "limb-night-ir", "-o", "night").returncode == 0
    assert {path.name for path in (scene / "night").iterdir()} == {"scene.xml", "README.txt"}
    assert "No reference.xml" in (scene / "night" / "README.txt").read_text()


def test_scenes_without_air_have_no_grids(horizonval, scene):
    bare = MINI_SCENE + '[atmosphere]\nprofile = "none"\n'
    (scene / "one.toml").write_text(bare)
    assert horizonval("mitsuba", "one.toml", "-o", "m").returncode == 0
    assert {path.name for path in (scene / "m").iterdir()} == {"scene.xml", "reference.xml", "README.txt"}
    _python(scene / "m", PLAIN_MITSUBA, "llvm_ad_mono")
    small = ("--reference", "--reference-size", "24x20", "--spp", "2")
    assert horizonval("render", "one.toml", *small, "-o", "r.exr").returncode == 0


def test_doctor(horizonval):
    done = horizonval("doctor")
    assert done.returncode == 0, done.stdout
    for label in ("Python", "mitsuba", "llvm_ad_mono", "cache", "processors", "GPU", "ready"):
        assert label in done.stdout
    assert json.loads(horizonval("doctor", "--json").stdout)["can_render"] is True


def test_doctor_without_llvm_says_what_to_do(program, tmp_path):
    done = program(
        "doctor", DRJIT_LIBLLVM_PATH=str(tmp_path / "none.so"), HORIZONVAL_VARIANT="llvm_ad_mono",
        XDG_CACHE_HOME=str(tmp_path / "cache"),
    )  # fmt: skip
    assert done.returncode == 1
    assert "rendering is impossible" in done.stdout
    assert "install LLVM" in done.stdout
    done = program(
        "render", "limb-noon-vis", "-o", "f.exr", DRJIT_LIBLLVM_PATH=str(tmp_path / "none.so"),
        HORIZONVAL_VARIANT="llvm_ad_mono", XDG_CACHE_HOME=str(tmp_path / "cache"),
    )  # fmt: skip
    assert_one_line(done, "horizonval doctor")
