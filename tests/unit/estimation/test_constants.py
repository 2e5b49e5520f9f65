"""Numbers that a search or a method has been given by name: they may become fewer, never more."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import horizonval.estimation

ROOT = Path(horizonval.estimation.__file__).parent


def _numbers(folder: Path) -> list[str]:
    """Return the module-level names in capitals whose value has a number in it."""
    found = []
    for path in sorted(folder.rglob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
                continue
            values = [one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
            if any(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
                found += [f"{path.name}: {name}" for name in names if name.isupper()]
    return found


@pytest.mark.parametrize(("folder", "most"), [("limb", 136), ("methods", 17)])
def test_constants_only_become_fewer(folder: str, most: int) -> None:
    """Whoever takes one away lowers the number here with it, so that none comes back in its place."""
    found = _numbers(ROOT / folder)
    assert len(found) == most, found
