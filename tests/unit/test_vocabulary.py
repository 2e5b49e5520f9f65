"""The package speaks its field's words: a glossary that the code bears out, and words that are not used for names."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import horizonval

PACKAGE = Path(horizonval.__file__).parent
GLOSSARY = Path(__file__).parents[2] / "docs" / "glossary.md"

AVOIDED = {
    "backward": "smoother",
    "book": "pages",
    "bow": "height perturbation",
    "borrowed": "interpolated",
    "dear": "expensive",
    "foretold": "predicted",
    "landing": "surface hit",
    "lasting": "consider (partials), systematic",
    "straightened": "apparent radius (Bouguer) coordinates",
    "told": "said, stated, compared",
    "wording": "formatting",
    "workshop": "task cache",
}
"""Words that are no terms of the field, and what to write instead."""


def _rows() -> dict[str, str]:
    lines = GLOSSARY.read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return {row[0]: row[3].strip("`") for row in cells[2:]}


def _words(name: str) -> set[str]:
    return {word.lower() for part in name.split("_") for word in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+", part)}


def _names(path: Path) -> set[str]:
    names = {path.stem}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names


def test_public_classes_are_in_the_glossary():
    words = {word.replace(" ", "").lower() for word in _rows()}
    classes = {name for name in horizonval.__all__ if name[0].isupper()}
    assert len(classes) > 8
    assert {name for name in classes if name.lower() not in words} == set()


@pytest.mark.parametrize(("word", "where"), sorted(_rows().items()))
def test_a_word_of_the_glossary_belongs_to_something_that_exists(word, where):
    parent, _, name = where.rpartition(".")
    module = import_module(parent)
    assert hasattr(module, name) or find_spec(where) is not None, f"{word}: there is no {where}"


def test_the_glossary_is_in_order():
    words = [word.lower().replace(",", "") for word in _rows()]
    assert words == sorted(words)


def test_names_avoid_words_that_are_no_terms():
    found = {
        f"{path.relative_to(PACKAGE)}: {name} ({AVOIDED[word]})"
        for path in PACKAGE.rglob("*.py")
        for name in _names(path)
        for word in _words(name) & AVOIDED.keys()
    }
    assert found == set()
