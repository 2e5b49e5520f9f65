"""The first sentences: one for each estimator, or for the best and the worst of many, never all in one pool."""

from __future__ import annotations

from dataclasses import replace

import pytest
from synthetic import synthetic_cases, write_run

from horizonval.report.load import load_run
from horizonval.report.sentence import sentences
from horizonval.scoring.summary import summarise


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return load_run(write_run(tmp_path_factory.mktemp("sentence") / "run", synthetic_cases()))


def copies(run, factors):
    """The run with its judged estimator copied under other names, with errors so many times as large."""
    views = []
    for view in run.views:
        row = view.rows.get("altitude-free")
        rows = {}
        for name, factor in factors.items():
            if row is not None:
                error = row.nadir_error_arcsec
                rows[name] = replace(row, estimator=name, nadir_error_arcsec=error and error * factor)
        views.append(replace(view, rows=rows))
    return replace(run, views=tuple(views), estimators=tuple(factors), given_pose=())


def told(run):
    return sentences(run, summarise(run.rows, run.given_pose, run.orbit)["groups"])


def test_one_that_is_told_the_pose_has_no_sentence(run):
    (text,) = told(run)
    assert text.startswith("altitude-free is right in ")
    claims = [row.nadir_error_arcsec for row in run.judged_rows if row.is_claim]
    assert f"the worst {max(claims) / 3600:.3g}" in text


def test_two_have_a_sentence_each_the_better_one_first(run):
    first, second = told(copies(run, {"coarse": 3.0, "fine": 1.0}))
    assert first.startswith("fine ")
    assert second.startswith("coarse ")
    assert first.removeprefix("fine") != second.removeprefix("coarse")


def test_of_many_the_best_and_the_worst_are_named(run):
    first, last = told(copies(run, {"middle": 2.0, "worst": 3.0, "best": 1.0}))
    assert first.startswith("Of 3 estimators the best: best is right")
    assert last.startswith("The worst: worst is right")


def test_a_run_without_due_frames_says_so(run):
    empty = replace(run, views=(), given_pose=())
    assert told(empty) == ["No frame is due an answer."]
