"""The parts of a report that can be right or wrong by themselves."""

from __future__ import annotations

import base64
import math
import re
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from synthetic import SOLAR_CAMERA, THERMAL_CAMERA, result_row, synthetic_cases, toy_image, truth_at

from horizonval.core.outcome import Outcome
from horizonval.frame import DetectorImage
from horizonval.geometry.ellipsoid import sphere
from horizonval.report import formatting, rerun
from horizonval.report.angle_unit import ARCSEC, DEG, unit_of
from horizonval.report.figures import overlay, picture, plots
from horizonval.report.load import CaseView
from horizonval.report.pages import infrared_section
from horizonval.report.verdict import (
    BONUS,
    BROKEN,
    CRASHED,
    FALSE_VALID,
    MISSED,
    NONE,
    OTHER,
    REFUSED,
    VALID,
    verdict_of,
)
from horizonval.spec.load import load_scene
from horizonval.truth.frame_truth import truth_of


def vertices(path: str) -> np.ndarray:
    return np.array([[float(x) for x in pair.split()] for pair in re.findall(r"[-\d.]+ [-\d.]+", path)])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.0, "0"),
        (-3e-12, "0"),
        (140.4, "140"),
        (-0.01234, "−0.0123"),
        (9.996, "10.0"),
        (123456.0, "123000"),
        (2e7, "2.00e+07"),
        (math.inf, "inf"),
    ],
)
def test_numbers(value, text):
    assert formatting.number(value) == text


def test_a_page_has_one_unit():
    assert unit_of([0.0, None, 3600.0]) is DEG
    assert unit_of([0.0, 35.9]) is ARCSEC
    assert unit_of([None]) is unit_of([]) is DEG
    assert (DEG.text(619.2), ARCSEC.text(12.0), DEG.text(None)) == ("0.172°", "12.0 arcsec", "–")


def test_every_outcome_has_words():
    assert {formatting.meaning(str(outcome)) for outcome in Outcome} == set(formatting.OUTCOME_WORDS.values())


HORIZON = {
    "kind": "opaque",
    "azimuth_deg": [0.0, 90.0, 180.0, 270.0],
    "half_plateau_height_m": [40e3] * 4,
    "maximum_gradient_height_m": [38e3] * 4,
    "accuracy": {
        "heights_km": [[None, 0.0], [0.0, 7.0], [60.0, None]],
        "relative": [0.05, 0.123, None],
        "half_height_km": 2.0,
        "sentences": ["Only of this band.", "Of all bands."],
    },
}


def infrared_truth(**changes):
    """A thermal frame over a sphere whose infrared horizon stands 40 km high all round."""
    ball = sphere(6371008.8)
    truth = truth_at(THERMAL_CAMERA, roll_deg=66.0, ellipsoid=ball)
    distance = math.hypot(*truth.r_itrs)

    def angles(height):
        return [math.asin((ball.a_m + height) / distance)] * 4

    found = HORIZON | {
        "geometric_angle_rad": angles(0.0),
        "half_plateau_angle_rad": angles(40e3),
        "maximum_gradient_angle_rad": angles(38e3),
    }
    return replace(truth, infrared_horizon={"lwir": found | changes})


def test_the_infrared_horizon_is_the_cone_of_its_height():
    """Over a sphere it is the limb of a sphere larger by its height: 0.02 px, printed to 0.01."""
    truth = infrared_truth()
    rho = math.asin((6371008.8 + 40e3) / math.hypot(*truth.r_itrs))
    drawn = vertices(overlay.infrared_path(truth, "lwir"))
    cone = vertices(overlay.limb_path(truth.camera_model, truth.nadir_geocentric_cam, rho))
    assert len(drawn) > 50
    row = np.interp(drawn[2:-2, 0], *cone[np.argsort(cone[:, 0])].T)
    np.testing.assert_allclose(drawn[2:-2, 1], row, atol=0.02)
    # 40 km as seen from 500 km over a limb 2570 km away: 0.9 deg, 2.3 px.
    hard = vertices(overlay.horizon_path(truth))
    above = np.interp(drawn[2:-2, 0], *hard[np.argsort(hard[:, 0])].T) - drawn[2:-2, 1]
    assert np.all((above > 2.0) & (above < 2.7))
    assert overlay.infrared_path(truth, "other") == ""
    assert overlay.infrared_path(truth_at(THERMAL_CAMERA), "lwir") == ""


def view_of(truth, case="made"):
    return CaseView(case, "lwir", {}, {}, toy_image(truth), "", False, "")


def test_the_infrared_section_says_what_is_stored():
    section = infrared_section.section_of([view_of(infrared_truth())])
    assert section["places"] == ["ground", "0–7", "above 60"]
    assert section["rows"] == [
        {
            "band": "lwir",
            "range": "8 to 14 um",
            "kind": "opaque",
            "radiance": ["5 %", "12.3 %", "–"],
            "height": "2 km",
        }
    ]
    assert section["uri"].startswith("data:image/svg+xml")
    facts = dict(infrared_section.facts_of(infrared_truth(), "lwir"))
    assert facts == {"infrared horizon in view": "half of the plateau at 40.0 km, steepest fall at 38.0 km, on average"}
    bare = infrared_section.section_of([view_of(infrared_truth(accuracy=None))])
    assert (bare["places"], bare["notes"], bare["rows"][0]["height"]) == ([], [], "–")


def test_runs_without_an_infrared_horizon_have_no_such_section():
    assert infrared_section.section_of([view_of(truth_at(THERMAL_CAMERA, roll_deg=66.0))]) is None
    assert infrared_section.facts_of(truth_at(THERMAL_CAMERA), "lwir") == []


def test_notes_of_several_bands():
    told = {"b": ["Of b.", "Of all."], "a": ["Of a.", "Of all."]}
    assert infrared_section._notes(told) == ["a: Of a.", "b: Of b.", "Of all."]
    assert infrared_section._notes({}) == []


@pytest.mark.parametrize(
    ("expected", "status", "false", "verdict"),
    [
        ("valid", "valid", False, VALID),
        ("valid", "valid", True, FALSE_VALID),
        ("dark", "valid", False, BONUS),
        ("dark", "valid", True, FALSE_VALID),
        ("valid", "dark", False, MISSED),
        ("dark", "dark", False, REFUSED),
        ("dark", "no_limb", False, OTHER),
        ("dark", "crashed", False, CRASHED),
    ],
)
def test_verdicts(expected, status, false, verdict):
    assert verdict_of(result_row(expected=expected, status=status, false_valid=false)) is verdict


def test_verdicts_without_a_result():
    assert verdict_of(None) is NONE
    assert verdict_of(result_row(status="bad_input"), broken=True) is BROKEN


def test_the_fitted_limb_of_a_perfect_fit_lies_on_the_true_horizon():
    """On a sphere the horizon is a cone; both curves are drawn to 0.01 px and thinned at different places."""
    truth = truth_at(roll_deg=66.0, ellipsoid=sphere(6371008.8))
    camera = truth.camera_model
    true = vertices(overlay.horizon_path(truth))
    fitted = vertices(overlay.limb_path(camera, truth.nadir_geocentric_cam, truth.angular_radius_rad))
    middle = true[(true[:, 0] > 5) & (true[:, 0] < 634)]
    order = np.argsort(fitted[:, 0])
    assert len(middle) > 100
    assert np.abs(np.interp(middle[:, 0], fitted[order, 0], fitted[order, 1]) - middle[:, 1]).max() < 0.05


def test_a_limb_that_leaves_and_enters_again_is_not_joined_across():
    """A far Earth larger than the image's height: two arcs, no line from one to the other."""
    truth = truth_at(THERMAL_CAMERA, altitude_km=10_000.0, ellipsoid=sphere(6371008.8))
    path = overlay.limb_path(truth.camera_model, truth.nadir_geocentric_cam, truth.angular_radius_rad)
    for piece in path.split("M")[1:]:
        assert np.linalg.norm(np.diff(vertices(piece), axis=0), axis=1).max() < 5
    assert path.count("M") >= 2


def test_a_limb_outside_the_image_is_no_path():
    truth = truth_at(roll_deg=150.0)
    assert overlay.horizon_path(truth) == ""
    assert overlay.limb_path(truth.camera_model, truth.nadir_geocentric_cam, truth.angular_radius_rad) == ""


def test_points_are_dots_and_bad_ones_are_left_out():
    assert overlay.points_path([[1.0, 2.25], [np.nan, 1.0], [-0.001, 3.0]]) == "M1 2.25h0M0 3h0"


def test_the_sun_does_not_take_the_greys():
    image = toy_image(truth_at(roll_deg=66.0, sun_zenith_deg=100.0, sun_azimuth_deg=270.0))
    assert (image.dn == image.full_scale).sum() > 5
    grey, _, white = picture.tone_mapped(image)
    assert white < 0.7 * image.full_scale
    assert np.percentile(grey, 75) > 120


def test_noise_of_a_dark_frame_stays_in_its_place():
    noise = np.random.default_rng(2).normal(32, 0.5, (120, 160)).round().astype(np.uint16)
    grey, black, white = picture.tone_mapped(DetectorImage(noise, "vis", truth_at(), 1023))
    assert white - black >= 0.04 * 1023
    assert grey.mean() < 60


@pytest.mark.parametrize("level", [0, 1023])
def test_flat_images_have_a_picture(level):
    grey, _, _ = picture.tone_mapped(DetectorImage(np.full((3, 4), level, np.uint16), "vis", truth_at(), 1023))
    assert set(np.unique(grey)) <= {0, 255}


@pytest.mark.parametrize(("reduced", "kind"), [(False, "png"), (True, "jpeg")])
def test_pictures_decode_to_the_image(reduced, kind):
    image = toy_image(truth_at(roll_deg=66.0))
    made = picture.picture_of(image, reduced=reduced)
    head, data = made.uri.split(",")
    assert head == f"data:image/{kind};base64"
    back = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    if reduced:
        assert back.shape == (288, 384)
    else:
        np.testing.assert_array_equal(back, picture.tone_mapped(image)[0])


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


def test_the_written_scene_gives_the_same_frame(tmp_path):
    """The scene's hash names the frame and seeds its noise: it must survive the trip through the page."""
    (tmp_path / "cam.toml").write_text(rerun.toml(SOLAR_CAMERA))
    (tmp_path / "scene.toml").write_text(
        'camera.file = "cam.toml"\nscene.name = "x"\nplatform = { altitude_km = 512.3456789, latitude_deg = -3e-7 }\n'
        "attitude.roll_deg = 66.1\nsun = { zenith_deg = 33.3 }\n"
    )
    truth = truth_of(*load_scene(tmp_path / "scene.toml"))
    again = rerun.rerun_of(truth, "x", "red", {"": "archive/ab/abc.exr"}, ["one", "two"], {"one": "../my suite.toml"})
    folder = tmp_path / "again"
    folder.mkdir()
    for name, text in again.files:
        (folder / name).write_text(text)
    assert [name for name, _ in again.files] == ["x.toml", "cam.toml"]
    assert truth_of(*load_scene(folder / "x.toml")) == truth
    assert again.commands[-1] == (
        "horizonval estimate ../archive/ab/abc.exr --estimator one --suite '../../my suite.toml'"
    )


@pytest.mark.parametrize(
    ("changes", "files"),
    [("", ["x.toml"]), (", camera = { width = 96, height = 96 }", ["x.toml", "vis-cmos-512-60deg"])],
    ids=["as shipped", "changed"],
)
def test_a_shipped_camera_is_written_where_its_keys_were_changed(tmp_path, changes, files):
    (tmp_path / "scene.toml").write_text(
        f'scene.name = "x"\nplatform.altitude_km = 500.0\ncamera = {{ file = "vis-cmos-512-60deg"{changes} }}\n'
    )
    truth = truth_of(*load_scene(tmp_path / "scene.toml"))
    again = rerun.rerun_of(truth, "x", "vis", {}, ["one"], {})
    assert [name for name, _ in again.files] == files
    folder = tmp_path / "again"
    folder.mkdir()
    for name, text in again.files:
        (folder / name).write_text(text)
    assert truth_of(*load_scene(folder / "x.toml")) == truth


def test_figures_are_the_same_twice_and_hold_no_date():
    views = [
        CaseView(c.truth.scene["scene"]["name"], "red", {}, {}, None, "", False, "") for c in synthetic_cases()[:2]
    ]
    made = [plots.figure_uri(plots.error_by_frame(views, ["a", "b"], DEG), 6, 3) for _ in range(2)]
    assert made[0] == made[1]
    svg = base64.b64decode(made[0].split(",")[1]).decode()
    assert "<svg" in svg
    assert "dc:date" not in svg
