"""The plan of a suite, the shipped suites, and the lists of estimators."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hostile import STEADY, install

from horizonval.core.errors import UserError
from horizonval.earth import optical
from horizonval.plugins import registry
from horizonval.spec.files import shipped_root
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import of_heads, plan_of, units_of
from horizonval.suites.record import figure_plans
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


SLOW = {"unseen-air"}
"""Whose weather in four thermal bands takes ten seconds to check."""
SUITES = sorted((Path(__file__).parents[3] / "scenes" / "suites").glob("*.toml"))
OF_FAILURES = (
    "shadow",
    "sun-in-frame",
    "terminator",
    "moon",
    "applicability",
    "altitude",
    "optics",
    "cloud",
    "gallery-of-failures",
)


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=pytest.mark.slow if path.stem in SLOW else ()) for path in SUITES],
    ids=lambda path: path.stem,
)
def test_it_loads_and_checks(path):
    suite = load_suite(path)
    refuse_mistakes(suite, plan_of(suite))
    assert suite.name == path.stem


@pytest.mark.parametrize("name", OF_FAILURES)
def test_every_figure_has_frames_and_every_method_its_guarded_twin(name):
    suite = load_suite(name)
    plans = figure_plans(suite)
    assert all(plan["cases"] for plan in plans)
    bare = {estimator for estimator in suite.estimators if not estimator.startswith("guarded-")}
    # Behind the guard the published method takes the points of altitude-free, and would be it under another name.
    twins = {f"guarded-{estimator}" for estimator in bare - {"altitude-free-published"}}
    assert twins <= set(suite.estimators)
    # A minute or three on two processors; a suite of thousands belongs to who enlarges it.
    assert len(units_of(suite.cases, plan_of(suite))) <= 200


@pytest.mark.parametrize("name", OF_FAILURES)
def test_methods_run_only_where_they_belong(name):
    suite = load_suite(name)
    plan = plan_of(suite)
    for case in suite.cases:
        # A method of one camera says nothing about a head of a pair, nor the other way round.
        assert bool(plan.alone(case)) != bool(plan.together(case)), case.name
        assert bool(plan.together(case)) == of_heads(case), case.name


FILES = sorted(shipped_root().glob("s*/*.toml"))


def _listed(tree: Any) -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key == "estimators":
                yield from ([value] if isinstance(value, str) else value)
            else:
                yield from _listed(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _listed(value)


def test_shipped_suites_and_studies_name_ours() -> None:
    listed = {name for path in FILES for name in _listed(tomllib.loads(path.read_text(encoding="utf-8")))}
    assert len(listed) > 5
    assert {name for name in listed if name not in registry.names() or registry.is_foreign(name)} == set()


def test_ours_keep_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another package's estimator of the same name is not taken for it."""
    install(tmp_path, [])
    info = tmp_path / "hostile_steady-1.0.dist-info" / "entry_points.txt"
    info.write_text(
        "[horizonval.estimators]\nideal = hostile_steady:ESTIMATOR\nsteady = hostile_steady:ESTIMATOR\n"
        "zzz = horizonval.estimation.methods.ideal:ESTIMATOR\nno place = 5 5\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    registry._points.cache_clear()
    try:
        assert not registry.is_foreign("ideal")
        assert registry.module_of("ideal") == "horizonval.estimation.methods.ideal"
        assert registry.is_foreign(STEADY)
        assert registry.is_foreign("zzz")
    finally:
        registry._points.cache_clear()
