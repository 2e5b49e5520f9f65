"""Which estimators a case gets, and which cases are made together."""

from __future__ import annotations

from dataclasses import replace

import pytest

from horizonval.core.errors import UserError
from horizonval.earth import optical
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.suite import load_suite

HEAD = """
[suite]
name = "s"
estimators = ["altitude-free", "video-vertical"]
[defaults]
camera = { file = "vis-pair-1024-60deg", camera = { width = 64, height = 64 } }
platform.altitude_km = 500.0
"""
TABLE = '[[cases]]\nname = "%s"\ngrid = { attitude.yaw_deg = [5.0, 6.0] }\n'
SINGLE = 'base.camera.file = "vis-cmos-512-60deg"\n'
HEADS = 'estimators = ["video-vertical"]\n'
IMAGE = 'estimators = ["altitude-free"]\n'


@pytest.fixture
def load(tmp_path):
    def build(text: str):
        (tmp_path / "s.toml").write_text(HEAD + text)
        return load_suite(tmp_path / "s.toml")

    return build


def test_heads_are_made_together_only_where_a_method_wants_them(load):
    suite = load(TABLE % "all" + TABLE % "heads" + HEADS + TABLE % "image" + IMAGE + TABLE % "single" + SINGLE)
    plan = plan_of(suite)
    refuse_mistakes(suite, plan)
    units = {unit.name: unit for unit in units_of(suite.cases, plan)}
    assert {name for name, unit in units.items() if unit.heads} == {
        f"{table}_yaw_deg_{yaw}" for table in ("all", "heads") for yaw in (5, 6)
    }
    assert plan.alone(units["all_yaw_deg_5"].cases[0]) == ("altitude-free",)
    assert plan.alone(units["heads_yaw_deg_5"].cases[0]) == ()
    assert plan.together(units["image_yaw_deg_5.left"].cases[0]) == ()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (TABLE % "g" + SINGLE + HEADS + TABLE % "h", ["s.toml: g_yaw_deg_5: estimators", "video-vertical", "heads"]),
        (TABLE % "g" + SINGLE, ["s.toml: suite.estimators", "video-vertical", "heads"]),
        (TABLE % "g" + HEADS, ["s.toml: suite.estimators", "no frame runs 'altitude-free'", "[[cases]]"]),
    ],
)
def test_a_method_without_a_frame_is_one_line(load, text, parts):
    suite = load(text)
    with pytest.raises(UserError) as e:
        refuse_mistakes(suite, plan_of(suite))
    assert all(part in e.value.line() for part in parts), e.value.line()


def test_a_camera_without_a_detector_is_refused_once_for_all_its_frames(tmp_path):
    camera = '[camera]\nname = "bare"\nwidth = 64\nheight = 64\nfov_deg = 60.0\n'
    camera += '[[band]]\nname = "vis"\nkind = "solar"\nlo_um = 0.5\nhi_um = 0.6\n'
    (tmp_path / "bare.toml").write_text(camera)
    table = '[[cases]]\nname = "a"\ngrid = { attitude.yaw_deg = [5.0, 6.0] }\n'
    head = '[suite]\nname = "s"\nestimators = ["altitude-free"]\n[defaults]\nplatform.altitude_km = 500.0\n'
    (tmp_path / "s.toml").write_text(head + 'camera = { file = "bare.toml" }\n' + table)
    suite = load_suite(tmp_path / "s.toml")
    with pytest.raises(UserError) as e:
        refuse_mistakes(suite, plan_of(suite))
    assert "has no detector" in str(e.value)


@pytest.mark.parametrize(
    ("draw", "looked_at"),
    [
        ('sobol = { n = 8, ranges = { "atmosphere.aerosol_optical_depth_550nm" = [0.05, 0.55] } }', "ends"),
        (
            "list = [{ atmosphere.co2_ppm = 400.0 }, { atmosphere.co2_ppm = 410.0 }, { atmosphere.co2_ppm = 420.0 }]",
            "ends",
        ),
        ('grid = { atmosphere.profile = ["us-standard", "tropical", "midlatitude-summer"] }', "all"),
        ("grid = { attitude.yaw_deg = [1.0, 2.0, 3.0] }", "one"),
    ],
)
def test_of_a_drawn_number_the_air_at_both_ends_is_looked_at(load, monkeypatch, draw, looked_at):
    """A thousand draws of the haze's depth are a thousand atmospheres, half a second to two seconds each."""
    suite = load('[[cases]]\nname = "a"\nestimators = ["altitude-free"]\n' + SINGLE + draw)
    suite = replace(suite, estimators=("altitude-free",))
    seen = []
    monkeypatch.setattr(optical, "optical_model", lambda scene, camera: seen.append(scene.atmosphere))
    refuse_mistakes(suite, plan_of(suite))
    numbers = [
        case.scene.atmosphere.aerosol_optical_depth_550nm or case.scene.atmosphere.co2_ppm for case in suite.cases
    ]
    if looked_at == "ends":
        assert {one.aerosol_optical_depth_550nm or one.co2_ppm for one in seen} == {min(numbers), max(numbers)}
        assert len(seen) == 2
    else:
        assert len(seen) == (len(suite.cases) if looked_at == "all" else 1)
