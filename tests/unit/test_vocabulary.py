"""The package's vocabulary: one meaning for every name."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import horizonval

PACKAGE = Path(horizonval.__file__).parent


def test_no_class_name_is_defined_twice():
    names = Counter(
        node.name
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert not [name for name, count in names.items() if count > 1]
    assert len(names) > 200
