"""What is published is made by this package's estimators, whatever else is installed where it is made."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hostile import STEADY, install

import horizonval
from horizonval.plugins import registry
from horizonval.spec.files import shipped_root
from horizonval.systems.c import frames

PACKAGE = Path(horizonval.__file__).parent
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


def test_published_systems_have_fixed_lists() -> None:
    asks = re.compile(r"\b(registry|supervisor)\.(names|is_foreign|load)\b|import supervisor|list_estimators")
    found = [path for path in (PACKAGE / "systems").rglob("*.py") if asks.search(path.read_text(encoding="utf-8"))]
    assert not found
    assert len(frames.ESTIMATORS) == 4
    assert not any(registry.is_foreign(name) for name in frames.ESTIMATORS)


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
