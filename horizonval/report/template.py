"""How pages are made of templates: the filters that every page has, style and code, and writing whole files."""

from __future__ import annotations

from pathlib import Path

import jinja2

from horizonval.core import atomic
from horizonval.report import formatting

FOLDER = Path(__file__).parent
_FILES = {
    "style": "page.css",
    "code": "page.js",
    "tables_code": "tables.js",
    "viewer_style": "viewer.css",
    "viewer_code": "viewer.js",
}


def environment(folder: Path = FOLDER) -> jinja2.Environment:
    """Return the environment of a folder's templates; by default of those beside this file."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, FOLDER]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {
        "number": formatting.number,
        "percent": formatting.percent,
        "interval": formatting.interval,
        "outcome": formatting.outcome,
        "count": formatting.count,
        "unbroken": _unbroken,
    }
    return made


def _unbroken(text: str) -> str:
    """Keep every number on the line of its per cent sign."""
    return text.replace(" %", "\u00a0%")


def shared_parts() -> dict[str, str]:
    """Return the style and the code of all pages."""
    return {name: (FOLDER / file).read_text(encoding="utf-8") for name, file in _FILES.items()}


def write(path: Path, text: str) -> None:
    """Write a page, whole or not at all."""
    atomic.write_text(path, text)
