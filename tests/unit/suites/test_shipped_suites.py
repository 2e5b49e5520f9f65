"""Every shipped suite can be run as it lies there, and what a user is told of its size is true."""

from __future__ import annotations

from pathlib import Path

import pytest

from horizonval.core.errors import UserError
from horizonval.suites.axes import figure_plans
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import of_heads, plan_of, units_of
from horizonval.suites.suite import load_suite

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


def test_an_estimator_that_is_not_there_is_noticed(tmp_path):
    text = next(path for path in SUITES if path.stem == "moon").read_text()
    (tmp_path / "moon.toml").write_text(text.replace('"guarded-altitude-free"]', '"guarded-nobody"]'))
    suite = load_suite(tmp_path / "moon.toml")
    with pytest.raises(UserError, match="guarded-nobody"):
        refuse_mistakes(suite, plan_of(suite))
