"""Key figures of the published systems: the committed ones again, and a fault in each system's estimator is named."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation.methods import altitude_free_published, linear_heads
from horizonval.jobs import engine
from horizonval.systems.b.rig.frames import tilt
from horizonval.systems.c import poses
from horizonval.systems.e import trials
from horizonval.systems.f import errors as f_errors
from horizonval.systems.g import errors as g_errors
from horizonval.systems.key_figures import INPUTS, KeyFigure, key_figures
from horizonval.systems.systems import SYSTEMS
from horizonval.systems.task_cache import TaskCache

PAGES = Path(__file__).parents[2] / "results" / "published"
OFF = math.radians(0.001)
"""A thousandth of a degree: 3.6 arcsec, at least ten times below what any of the systems claims."""


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskCache:
    """Work is done in this process, where a fault can be put in."""
    monkeypatch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
    return TaskCache(tmp_path, workers=1)


def _rolled(function: Callable[..., Any]) -> Callable[..., Any]:
    def off(*args: Any, **kwargs: Any) -> Any:
        fit = function(*args, **kwargs)
        return fit if isinstance(fit, Refusal) else replace(fit, roll_rad=fit.roll_rad + OFF)

    return off


def _tilted(function: Callable[..., float | None]) -> Callable[..., float | None]:
    def off(*args: Any) -> float | None:
        found = function(*args)
        return None if found is None else found + OFF

    return off


def _turned(function: Callable[..., Any]) -> Callable[..., Any]:
    def off(*args: Any) -> Any:
        reading = function(*args)
        return replace(reading, roll_error_rad=reading.roll_error_rad + OFF)

    return off


def _moved(function: Callable[..., Any]) -> Callable[..., Any]:
    def off(*args: Any, **kwargs: Any) -> Any:
        found = function(*args, **kwargs)
        return replace(found, proposed=found.proposed * (1.0 + 1e-6))

    return off


def _shifted(function: Callable[..., Any]) -> Callable[..., Any]:
    def off(*args: Any) -> Any:
        pitch, roll = function(*args)
        return pitch, roll + OFF

    return off


FAULTS: dict[str, tuple[Any, str, Callable[..., Any]]] = {
    "A": (altitude_free_published, "fit_pixels", _rolled),
    "B": (tilt, "tilt_rad", _tilted),
    "C": (poses, "ideal_horizon_sensor", _turned),
    "D": (linear_heads, "published_angles", _shifted),
    "E": (trials, "locate", _moved),
    "F": (f_errors, "attitude_over_ellipsoid", _rolled),
    "G": (g_errors, "attitude_of_quadrants", _rolled),
}
"""What is replaced in which module, and by what, by the system's letter."""


def _failed(found: list[dict[str, Any]]) -> list[str]:
    return [one["name"] for one in found if one["verdict"] == "FAIL"]


def _put_in(system: str, patch: pytest.MonkeyPatch) -> None:
    module, name, fault = FAULTS[system]
    patch.setattr(module, name, fault(getattr(module, name)))


def test_every_system_has_a_fault() -> None:
    assert set(FAULTS) == set(SYSTEMS)


def test_a_fault_in_one_estimator_is_named_and_without_it_all_is_quiet(
    cache: TaskCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The quickest system, from stored scans, in place of all."""
    quiet = key_figures(cache, PAGES, ["F"])
    assert len(quiet) == 16
    assert _failed(quiet) == []
    _put_in("F", monkeypatch)
    loud = key_figures(cache, PAGES, ["F"])
    assert {one["system"] for one in loud} == {"F"}
    assert _failed(loud)


@pytest.mark.slow
@pytest.mark.parametrize("system", [s for s in SYSTEMS if s != "F"])
def test_a_fault_in_every_estimator_is_named(cache: TaskCache, monkeypatch: pytest.MonkeyPatch, system: str) -> None:
    quiet = key_figures(cache, PAGES, [system])
    assert quiet
    assert _failed(quiet) == []
    _put_in(system, monkeypatch)
    # What was computed without the fault must not be taken for what is computed with it.
    other = cache.folder / "again"
    other.mkdir()
    assert _failed(key_figures(replace(cache, folder=other), PAGES, [system]))


def test_a_figure_that_its_page_has_not_is_no_pass() -> None:
    assert not KeyFigure("A", "new", "deg", None, 1.0).is_same
    assert KeyFigure("A", "old", "deg", 1.0, 1.0 + 1e-7).is_same
    assert not KeyFigure("A", "old", "deg", 1.0, 1.0 + 1e-5).is_same
    assert not KeyFigure("A", "old", "deg", 1.0, math.nan).is_same


def test_what_is_missing_or_damaged_is_said_in_one_line(cache: TaskCache, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no such file"):
        key_figures(cache, tmp_path)
    (tmp_path / INPUTS).write_bytes(b"no archive")
    with pytest.raises(DamagedFileError, match="cannot be read"):
        key_figures(cache, tmp_path)
    shutil.copy(PAGES / INPUTS, tmp_path / INPUTS)
    with pytest.raises(UserError, match="no such page"):
        key_figures(cache, tmp_path, ["F"])
