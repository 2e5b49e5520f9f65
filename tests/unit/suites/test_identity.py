"""What makes two cases the same."""

from __future__ import annotations

import json

import pytest

from horizonval.spec.load import Suite, load_suite
from horizonval.suites import identity
from horizonval.suites.plan import plan_of, units_of

SUITE = """
[suite]
name = "s"
estimators = ["ideal"]
[defaults]
camera.file = "c.toml"
platform.altitude_km = 500.0
[[frame]]
scene.name = "a"
"""
CAMERA = '[camera]\nwidth = 64\nheight = 48\nfov_deg = 60.0\n[[band]]\nname="v"\nkind="solar"\nlo_um=0.5\nhi_um=0.7\n'


@pytest.fixture
def load(tmp_path):
    def build(suite: str = SUITE, camera: str = CAMERA, atmosphere: str = "{}", folder: str = "one") -> Suite:
        place = tmp_path / folder
        place.mkdir(exist_ok=True)
        (place / "c.toml").write_text(camera)
        (place / "a.json").write_text(atmosphere)
        (place / "a.csv").write_text(atmosphere)
        (place / "s.toml").write_text(suite)
        return load_suite(place / "s.toml")

    return build


def _all(suite: Suite) -> tuple[str, str, str]:
    case = suite.cases[0]
    return (
        identity.frame_identity(case),
        identity.unit_identity(units_of([case], plan_of(suite))[0], plan_of(suite)),
        identity.suite_identity(suite),
    )


@pytest.mark.parametrize(
    "change",
    [
        {"suite": SUITE.replace("500.0", "500.0000001")},
        {"suite": SUITE.replace('"a"', '"b"')},
        {"suite": SUITE.replace('name = "s"', 'name = "s"\nseed = 1')},
        {"camera": CAMERA.replace("60.0", "61.0")},
        {"camera": CAMERA + "[optics]\npsf_sigma_px = 1.0\n"},
    ],
)
def test_every_input_counts(load, change):
    for before, after in zip(_all(load()), _all(load(**change)), strict=True):
        assert before != after


@pytest.mark.parametrize("key", ['file = "a.json"', 'profile_file = "a.csv"'])
def test_an_atmosphere_counts_by_content_not_by_place(load, key):
    text = SUITE + f"[frame.atmosphere]\n{key}\n"
    here = _all(load(text, atmosphere=json.dumps({"x": 1})))
    assert here == _all(load(text, atmosphere=json.dumps({"x": 1}), folder="two"))
    assert here != _all(load(text, atmosphere=json.dumps({"x": 2})))


def test_estimators_do_not_change_a_frame(load):
    one, two = load(), load(SUITE.replace('["ideal"]', '["ideal", "altitude-free"]'))
    frame, case, suite = zip(_all(one), _all(two), strict=True)
    assert frame[0] == frame[1]
    assert case[0] != case[1]
    assert suite[0] != suite[1]


def test_draws_of_the_noise_count_where_there_are_several(load):
    suites = [load(), load(SUITE.replace('"s"', '"s"\ndraws = 1')), load(SUITE.replace('"s"', '"s"\ndraws = 2'))]
    plans = [plan_of(suite) for suite in suites]
    units = [identity.unit_identity(units_of(s.cases, p)[0], p) for s, p in zip(suites, plans, strict=True)]
    whole = [identity.suite_identity(suite) for suite in suites]
    for one, same, other in (units, whole):
        assert one == same
        assert one != other
    assert len({identity.frame_identity(suite.cases[0]) for suite in suites}) == 1


CASES = SUITE + '[[cases]]\nname = "g"\ngrid = { attitude.yaw_deg = [0.0, 1.0] }\n'


def test_estimators_of_a_table_count_for_its_cases_and_the_suite(load):
    two = CASES.replace('["ideal"]', '["ideal", "altitude-free"]')
    one = two.replace('name = "g"', 'name = "g"\nestimators = ["ideal"]')
    before, after = load(two), load(one)
    assert identity.suite_identity(before) != identity.suite_identity(after)
    units = [units_of(suite.cases, plan_of(suite)) for suite in (before, after)]
    same = [
        identity.unit_identity(old, plan_of(before)) == identity.unit_identity(new, plan_of(after))
        for old, new in zip(*units, strict=True)
    ]
    assert same == [True, False, False]


def test_a_method_more_in_another_table_leaves_a_case_as_it_is(load):
    one = CASES.replace('name = "g"', 'name = "g"\nestimators = ["ideal"]')
    more = one.replace('["ideal"]', '["ideal", "altitude-free"]', 1)
    units = [(plan_of(suite), units_of(suite.cases, plan_of(suite))[1]) for suite in (load(one), load(more))]
    assert len({identity.unit_identity(unit, plan) for plan, unit in units}) == 1


STUDY = """
[stability]
altitude_km = 900.0
months = [1]
[[stability.band]]
name = "co2"
lo_um = 14.0
hi_um = 16.3
"""


def test_a_study_counts_for_the_suite_and_not_for_its_frames(load):
    one, two, three = load(), load(SUITE + STUDY), load(SUITE + STUDY.replace("900.0", "901.0"))
    assert len({identity.suite_identity(suite) for suite in (one, two, three)}) == 3
    assert len({identity.frame_identity(suite.cases[0]) for suite in (one, two, three)}) == 1
