"""The nights before: kept, replaced, sorted, searched for steps."""

from __future__ import annotations

import numpy as np

from horizonval.studies.regression import history


def night(label, value, verdict="PASS"):
    level = {"value": value, "unit": "arcsec", "n": 384}
    return {
        "night": label,
        "environment": {"version": "0.1.0+abc", "commit": None},
        "verdict": verdict,
        "complete": True,
        "gates": [],
        "levels": {"fixed method: median nadir error": level},
    }


def labels(n):
    return [f"2026-{1 + i // 28:02d}-{1 + i % 28:02d}" for i in range(n)]


def test_a_night_done_again_replaces_the_first(tmp_path):
    path = tmp_path / history.FILE
    for label in ("2026-11-02", "2026-11-01", "2026-11-02"):
        history.append(path, night(label, 1.0))
    history.append(path, night("2026-11-02", 7.0))
    path.write_text(path.read_text() + '{"torn')
    found = history.read(path)
    assert [line["night"] for line in found] == ["2026-11-01", "2026-11-02"]
    assert history.series(found)["fixed method: median nadir error"]["values"] == [1.0, 7.0]


def test_a_step_is_found_in_its_night_and_60_nights_are_shown(tmp_path):
    path = tmp_path / history.FILE
    noise = np.random.default_rng(5).normal(0, 2.0, 70)
    names = labels(70)
    for i, label in enumerate(names):
        history.append(path, night(label, 400 + noise[i] + (15.0 if i >= 50 else 0.0)))
    found = history.read(path)
    assert [line["night"] for line in found] == names[10:]
    (step,) = history.steps_of(found)
    assert step["night"] == names[50]
    assert abs(step["after"] - step["before"] - 15.0) < 2.0
    assert history.steps_of(found[:35]) == []
