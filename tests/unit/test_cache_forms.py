"""A cache that holds another version's form, validly sealed, is made anew by each of its users."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from horizonval.core.cache import cached_arrays, keep_arrays, keep_json
from horizonval.earth.clouds import earth_pattern
from horizonval.renderer import backend
from horizonval.renderer.scattering import multiple_scattering as scattering
from horizonval.renderer.scattering.shells import DiffuseField, MultipleScattering
from horizonval.tables import modes

QUALITY: Any = SimpleNamespace(n_height=3, n_sun=4)
N_VALUES = earth_pattern.MAP_ROWS * earth_pattern.MAP_COLUMNS * earth_pattern.CHANNELS


def _coarse(*_: object) -> earth_pattern.Coarse:
    return earth_pattern.Coarse(np.zeros(N_VALUES, np.float32), 0.0, 1.0, np.zeros(earth_pattern.RANK_STEPS + 1))


def _solution(*_: object) -> list[MultipleScattering]:
    field = DiffuseField(1e5, 6.4e6, 1, np.zeros((3, 4, len(scattering.pairs(1)))), np.zeros(4))
    return [MultipleScattering(field, field, 0.1)]


@pytest.fixture(params=["backend", "clouds", "scattering", "templates"])
def user(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A call that uses the cache, and how often it had to compute."""
    made: list[int] = []

    def counted(make: Callable[..., Any]) -> Callable[..., Any]:
        def counting(*arguments: object) -> Any:
            made.append(1)
            return make(*arguments)

        return counting

    for module in (backend, earth_pattern, scattering):
        monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(scattering, "_memory", {})
    monkeypatch.setattr(backend, "_try", counted(lambda variant, library: backend.Attempt(variant, "", True, "")))
    monkeypatch.setattr(earth_pattern, "coarse_map", counted(_coarse))

    def solved() -> object:
        found = scattering._read("k", 1e5, 6.4e6, 1, QUALITY, None)
        if found is None:
            found = counted(_solution)()[0]
            scattering._write(scattering._path("k"), "k", found)
        return found

    calls = {
        "backend": backend.probe,
        "clouds": lambda: earth_pattern.kept_coarse_map.__wrapped__(1, 1, None),
        "scattering": solved,
        "templates": lambda: modes.kept_arrays(tmp_path / "t.npz", ["a"], counted(lambda: {"a": np.ones(3)})),
    }
    return calls[request.param], made


def _arrays(path: Path) -> list[dict[str, Any]]:
    kept = cached_arrays(path, dict) or {}
    first = next(name for name in kept if name != "key")
    others = [{}, {f"{name}2": values for name, values in kept.items()}, {**kept, "key": np.asarray(["other"])}]
    if path.name != "t.npz":
        values = kept[first]
        others += [{**kept, first: value} for value in (np.zeros(2), values.astype("U8"), values.astype("f2"))]
    return others if "key" in kept else others[:2] + others[3:]


def _objects(path: Path) -> list[dict[str, Any]]:
    attempt = json.loads(path.read_bytes())["attempts"][0]
    others: list[Any] = [[], None, 5, [1], ["text"], [{}], [{**attempt, "new": 1}], [{**attempt, "library": 7}]]
    return [{}, *({"attempts": value} for value in others), {"attempts": [{**attempt, "works": "yes"}]}]


def test_another_form_is_made_anew(user: Any, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    call, made = user
    call()
    call()
    assert len(made) == 1
    path = next(path for path in tmp_path.rglob("*") if path.is_file())
    forms = _objects(path) if path.suffix == ".json" else _arrays(path)
    for form in forms:
        made.clear()
        caplog.clear()
        (keep_json if path.suffix == ".json" else keep_arrays)(path, form)
        call()
        call()
        assert len(made) == 1, form
        assert len(caplog.messages) == 1
        assert caplog.messages[0].endswith("; it is made anew")
