"""The scaffold of every page: one template, one style sheet, one table sorter, and the writing of whole files.

A page is a template that extends ``base.html`` and fills its blocks ``opening`` (below the heading) and ``main``::

    {% extends "base.html" %}
    {% from "parts.html" import plot, viewer %}
    {% block opening %}<p>What to know first.</p>{% endblock %}
    {% block main %}
    {% call viewer(frames, estimators) %}<p class="note">About these frames.</p>{% endcall %}
    <section><h2>Errors</h2><div class="figures">{{ plot(figure) }}</div></section>
    <table class="sortable">...</table>
    {% endblock %}

and is made by :func:`render`. A page is one file without any address in it: style, code and figures are inside, so it
opens anywhere and asks for nothing. What there is:

- ``table.sortable`` sorts by a click on a heading; ``td.num`` aligns right; rows ``tr.why`` stay with the row above.
- ``p.verdict`` and ``span.word`` with class ``valid``, ``false``, ``missed`` or ``none`` have the colours of verdicts.
- ``plot(figure)`` shows what :func:`horizonval.report.plots.figure` returns.
- ``viewer(frames, estimators)`` shows frames as :func:`horizonval.report.viewer.one_frame` returns them, above a note.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from horizonval.core import atomic
from horizonval.report import words

FOLDER = Path(__file__).parent


def render(
    template: str,
    *,
    title: str,
    heading: str,
    version: str = "",
    about: Sequence[str] = (),
    links: Sequence[tuple[str, str]] = (),
    again: str = "",
    folder: Path = FOLDER,
    filters: Mapping[str, Callable[..., Any]] | None = None,
    **content: Any,
) -> str:
    """Return a page as text.

    ``template``: file name, in ``folder`` or in this package. ``title``: of the browser's tab. ``version``: of the
    package that made the results. ``about``: lines above the heading. ``links``: text and address of the other pages of
    the folder. ``again``: command that repeats the work. ``filters``: additional template filters. ``content``:
    variables of the template's blocks.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, FOLDER]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "number": words.number,
        "percent": words.percent,
        "interval": words.interval,
        "outcome": words.outcome,
        "count": words.count,
        "unbroken": _unbroken,
        **(filters or {}),
    }
    environment.globals["file"] = _file
    return environment.get_template(template).render(
        title=title,
        heading=heading,
        version=version,
        about=about,
        links=links,
        again=again,
        **content,
    )


def write(path: Path, text: str) -> None:
    """Write a page atomically."""
    atomic.write_text(path, text)


def _file(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _unbroken(text: str) -> str:
    """Keep every number on the line of its per cent sign."""
    return text.replace(" %", "\u00a0%")
