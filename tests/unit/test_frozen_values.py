"""Results and settings that rooms hand to each other are values: nobody changes them behind another's back."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from pathlib import Path

import pytest

import horizonval

PACKAGE = Path(horizonval.__file__).parent
ROOMS = ("scoring", "estimation", "plugins", "store", "jobs", "suites", "studies/regression")

WITH_STATE = {"Stopwatch", "Observed", "_Made"}
"""What gathers while one item is made, and is handed to nobody."""


@pytest.mark.parametrize("room", ROOMS)
def test_dataclasses_are_frozen(room: str) -> None:
    changeable, count = set(), 0
    for path in sorted((PACKAGE / room).rglob("*.py")):
        if path.name == "__main__.py":
            continue
        name = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        module = importlib.import_module(name)
        for _, found in inspect.getmembers(module, inspect.isclass):
            if found.__module__ == name and dataclasses.is_dataclass(found):
                count += 1
                if not found.__dataclass_params__.frozen:  # type: ignore[attr-defined]
                    changeable.add(found.__name__)
    assert count > 0
    assert changeable <= WITH_STATE
