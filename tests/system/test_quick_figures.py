"""Key figures of the published systems: the committed ones; a fault in each system's estimator is named."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation.methods import altitude_free_published, linear_heads
from horizonval.geometry import sightings
from horizonval.jobs import engine
from horizonval.sensor.conical_scanner import ConicalScanner
from horizonval.sensor.quadrant import QuadrantSensor
from horizonval.systems import quick
from horizonval.systems.b import experiment as pair
from horizonval.systems.c import experiment as module
from horizonval.systems.quick import SYSTEMS
from horizonval.systems.task_cache import TaskCache

PAGES = Path(__file__).parents[2] / "results" / "published"
OFF = math.radians(0.001)
"""A thousandth of a degree: 3.6 arcsec, at least ten times below what any of the systems claims."""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskCache:
    """Work is done in this process, where a fault can be put in."""
    monkeypatch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
    return TaskCache(tmp_path, workers=1)


FAULTS: dict[str, tuple[Any, str, Callable[[Any], Any]]] = {
    "A": (altitude_free_published, "fit_of_cone", lambda fit: replace(fit, nadir_cam=fit.nadir_cam + OFF)),
    "B": (pair, "error_deg", lambda found: found + OFF),
    "C": (module, "horizon_sensor", lambda one: replace(one, roll_error_rad=one.roll_error_rad + OFF)),
    "D": (linear_heads, "published_angles", lambda angles: (angles[0], angles[1] + OFF)),
    "E": (sightings, "adaptive_filter", lambda found: found * (1.0 + 1e-6)),
    "F": (ConicalScanner, "attitude", lambda fit: replace(fit, roll_rad=fit.roll_rad + OFF)),
    "G": (QuadrantSensor, "attitude", lambda fit: replace(fit, roll_rad=fit.roll_rad + OFF)),
}
"""In which module which function is wrong, and how, by the system's letter."""


def _faulty(function: Callable[..., Any], change: Callable[[Any], Any]) -> Callable[..., Any]:
    def off(*args: Any, **kwargs: Any) -> Any:
        found = function(*args, **kwargs)
        return found if found is None or isinstance(found, Refusal) else change(found)

    return off


def _failed(found: list[dict[str, Any]]) -> list[str]:
    return [one["name"] for one in found if one["verdict"] == "FAIL"]


def test_every_system_has_a_fault_and_committed_figures() -> None:
    committed = json.loads((PAGES / quick.FILE).read_text())["rows"]
    assert set(FAULTS) == set(SYSTEMS) == {row["system"] for row in committed}
    # Those of full size are the figures of the pages.
    for system in "ACDE":
        page = {row["name"]: row["measured"] for row in json.loads((PAGES / f"{system}.json").read_text())["rows"]}
        own = {row["name"]: row["measured"] for row in committed if row["system"] == system}
        assert all(quick.is_same(value, page[name]) for name, value in own.items())


@pytest.mark.parametrize("system", [pytest.param(s, marks=() if s == "C" else pytest.mark.slow) for s in SYSTEMS])
def test_a_fault_in_an_estimator_is_named_and_without_it_all_is_quiet(
    cache: TaskCache, monkeypatch: pytest.MonkeyPatch, system: str
) -> None:
    quiet = quick.quick_figures(cache, PAGES, [system])
    assert quiet
    assert _failed(quiet) == []
    module, name, fault = FAULTS[system]
    monkeypatch.setattr(module, name, _faulty(getattr(module, name), fault))
    # What was computed without the fault must not be taken for what is computed with it.
    other = cache.folder / "again"
    other.mkdir()
    loud = quick.quick_figures(replace(cache, folder=other), PAGES, [system])
    assert {one["system"] for one in loud} == {system}
    assert _failed(loud)


def test_a_figure_that_is_not_committed_does_not_pass(cache: TaskCache, tmp_path: Path) -> None:
    assert quick.is_same(1.0 + 1e-7, 1.0)
    assert not any(quick.is_same(value, known) for value, known in ((1.0, None), (1.0 + 1e-5, 1.0), (math.nan, 1.0)))
    with pytest.raises(UserError, match="no such file"):
        quick.quick_figures(cache, tmp_path)
