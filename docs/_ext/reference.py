"""Sphinx extension: the pages of the reference that follow from the code, written before the pages are read."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx

GENERATED = Path(__file__).parents[1] / "reference" / "generated"
"""Not kept in the repository."""


def pages() -> dict[str, str]:
    """Return the Markdown of every generated page by its name."""
    return {}


def _write(_app: Sphinx) -> None:
    GENERATED.mkdir(exist_ok=True)
    made = pages()
    for old in GENERATED.glob("*.md"):
        if old.stem not in made:
            old.unlink()
    for name, text in made.items():
        path = GENERATED / f"{name}.md"
        # An unchanged page keeps its time, so that a second build is quick.
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
