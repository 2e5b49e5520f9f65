"""Plug-ins that attack: each harms itself alone, and nothing of it is left."""

from __future__ import annotations

import os
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hostile import HOSTILE, STEADY, install

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit, Observation, OraclePose
from horizonval.geometry.camera import CameraModel
from horizonval.plugins import registry, supervisor
from horizonval.plugins.supervisor import Limits, Supervisor

OBSERVATION = Observation(
    np.add.outer(np.arange(48.0), np.arange(64.0)),
    CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5),
    full_scale=1023.0,
    oracle=OraclePose(np.array([6.9e6, 0.0, 1e5]), np.array([0.0, 0.0, 0.0, 1.0]), 6371008.8),
)
WITNESSES = ("ideal", "altitude-free-closed-form", STEADY)
MARK = "HORIZONVAL_TEST_OF_PLUGINS"


def _same(a: Fit | Refusal, b: Fit | Refusal) -> bool:
    return type(a) is type(b) and all(
        np.array_equal(value, vars(b)[key]) if isinstance(value, np.ndarray) else value == vars(b)[key]
        for key, value in vars(a).items()
    )


def _survivors(mark: str) -> list[str]:
    found = []
    for place in Path("/proc").iterdir():
        try:
            if place.name.isdigit() and f"{MARK}={mark}".encode() in (place / "environ").read_bytes():
                found.append((place / "cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return found


@pytest.fixture
def mark(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    word = uuid.uuid4().hex
    monkeypatch.setenv(MARK, word)
    yield word
    registry._points.cache_clear()


def _attack(names: list[str], place: Path, mark: str, patch: pytest.MonkeyPatch) -> None:
    install(place, names)
    patch.setenv("PYTHONPATH", str(place), prepend=":")
    patch.syspath_prepend(place)
    patch.setattr(supervisor, "IMPORT_LIMIT_S", 5.0)
    patch.setattr(supervisor, "CLOCK_FACTOR", 2.0)
    patch.setattr(supervisor, "LEAST_CLOCK_S", 0.0)
    registry._points.cache_clear()
    folder, modules = os.getcwd(), set(sys.modules)
    processes = Supervisor(Limits(time_s=20.0, memory_mb=512))
    before = {name: processes.run(name, OBSERVATION) for name in WITNESSES}
    assert isinstance(before["ideal"], Fit)
    assert isinstance(before[STEADY], Fit)
    processes._limits = Limits(time_s=4.0, memory_mb=512)
    for name in names:
        result = processes.run(name, OBSERVATION)
        result.__repr__()
        if HOSTILE[name].crashes:
            assert result.status is Outcome.CRASHED, name
        if isinstance(result, Refusal):
            assert result.reason.encode(), name
            assert len(result.reason) <= 500, name
            assert len(result.output.encode()) <= 4 * 4096, name
        for witness in WITNESSES:
            assert _same(processes.run(witness, OBSERVATION), before[witness]), f"{name} changed {witness}"
    processes.close()
    time.sleep(0.5)
    assert _survivors(mark) == []
    assert os.getcwd() == folder
    assert not [name for name in set(sys.modules) - modules if name.startswith("hostile_")]


@pytest.mark.slow
def test_a_hundred_plug_ins_harm_nobody_but_themselves(
    tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(HOSTILE) >= 100
    _attack(list(HOSTILE), tmp_path, mark, monkeypatch)


def test_what_an_estimate_starts_ends_with_it(tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _attack(["child-deaf", "many-children", "kill-parent", "points-flat"], tmp_path, mark, monkeypatch)


def test_what_is_to_be_known_of_a_plug_in_is_asked_of_its_process(
    tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, ["import-exit"])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.syspath_prepend(tmp_path)
    registry._points.cache_clear()
    assert {"import-exit", STEADY, "ideal"} <= set(registry.names())
    estimator = supervisor.get(STEADY)
    assert (estimator.title, estimator.needs, estimator.estimates) == ("Hostile", "image", "geocentric")
    assert isinstance(registry.run_safely(estimator, OBSERVATION), Fit)
    broken = supervisor.get("import-exit")
    answer = registry.run_safely(broken, OBSERVATION)
    assert answer.status is Outcome.CRASHED
    assert "ended with status 0" in repr(answer)
    assert not [name for name in sys.modules if name.startswith("hostile_")]
