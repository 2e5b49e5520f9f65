"""Every printed figure of a source, and all that a page shows as published, belongs to a judged claim."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from horizonval.systems.published import published
from horizonval.systems.quick import SYSTEMS
from horizonval.systems.result import Status

PAGES = Path(__file__).parents[3] / "results" / "published"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
CONDITIONS = {
    "D": {"earth_radius", "nadir_angle", "altitude", "inclination", "element", "elements"},
    "E": {"start", "length", "step", "noise_rounding", "stations"},
    "G": {"altitude", "raised", "inclination"},
}
"""What the sources say of the experiment itself; we do the same, and there is nothing to judge."""
COUNTS = {
    "A": {"published set-ups that the published method answers": 5},
    "B": {"hardware in the loop: RMS over that of the perfect bench": 19.8},
    "D": {"figures on the printed step": 53, "figures of an untilted axis that are not zero": 5},
    "E": {"published proposed figures matched or beaten": 18},
}
"""In the published column, but counted or divided by us from printed figures that have claims; by the row's start."""


def content_of(system: str) -> dict[str, Any]:
    return json.loads((PAGES / f"{system}.json").read_text())


def numbers_in(text: str) -> list[float]:
    return [float(found) for found in NUMBER.findall(text)]


def judges(claim: dict[str, str], figure: float | str) -> bool:
    """Whether a claim's printed figures hold this one, shortened as they may be there: to two digits."""
    if isinstance(figure, str):
        return figure in claim["printed"] or numbers_in(figure)[:1] == numbers_in(claim["printed"])[:1] != []
    return any(math.isclose(figure, one, rel_tol=0.025, abs_tol=1e-12) for one in numbers_in(claim["printed"]))


def unclaimed_rows(system: str, content: dict[str, Any]) -> Iterator[str]:
    """Yield the rows whose published figure is in no claim."""
    for row in content["rows"]:
        figure = row["published"]
        if figure is None:
            continue
        counted = [value for name, value in COUNTS.get(system, {}).items() if row["name"].startswith(name)]
        if counted != [figure] and not any(judges(claim, figure) for claim in content["claims"]):
            yield f"{row['name']}: {figure}"


def unclaimed_entries(system: str, content: dict[str, Any]) -> Iterator[str]:
    """Yield what the source prints and no claim of the same place judges."""
    source = published(system)
    for key, entry in (*source.figures.items(), *source.tables.items()):
        if key not in CONDITIONS.get(system, ()) and not any(entry.where in c["where"] for c in content["claims"]):
            yield f"{key}: {entry.where}"
    for key, table in source.tables.items():
        own = [claim for claim in content["claims"] if table.where in claim["where"]]
        for quantity, figures in table.printed.items():
            for figure in figures:
                if figure is not None and not any(judges(claim, figure) for claim in own):
                    yield f"table {key}, {quantity}: {figure}"
        for quantity, moments in table.errors.items():
            for name, figure in moments.items():
                if not any(judges(claim, figure) for claim in own):
                    yield f"table {key}, {name} of the errors of {quantity}: {figure}"


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_printed_figure_belongs_to_a_claim(system: str) -> None:
    content = content_of(system)
    assert list(unclaimed_rows(system, content)) == []
    assert list(unclaimed_entries(system, content)) == []


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_claim_says_all_that_a_judgement_needs(system: str) -> None:
    for claim in content_of(system)["claims"]:
        assert set(claim) == {"what", "where", "printed", "reading", "measured", "fails", "status"}
        assert all(isinstance(text, str) and text.strip() for text in claim.values()), claim["what"]
        assert claim["status"] in list(Status)


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_page_and_the_book_show_every_claim(system: str) -> None:
    content, page = content_of(system), (PAGES / f"{system}.md").read_text()
    for claim in content["claims"]:
        lines = [line for line in page.splitlines() if claim["what"] in line and claim["printed"] in line]
        assert any(claim["status"] in line for line in lines), claim["what"]


def test_conditions_and_counts_are_what_the_files_hold() -> None:
    """An exception for something that is no longer there would hide the next one."""
    for system, keys in CONDITIONS.items():
        assert keys <= {*published(system).figures, *published(system).tables}
    for system, counts in COUNTS.items():
        rows = content_of(system)["rows"]
        for name, value in counts.items():
            assert [row for row in rows if row["name"].startswith(name) and row["published"] == value], name


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_claim_that_is_missing_is_noticed(system: str) -> None:
    """Every claim is taken away in turn; where others quote the same place and figure, that shows nothing.

    C's source prints one thing, which all four of its claims quote.
    """
    content = content_of(system)
    assert list(unclaimed_entries(system, {**content, "claims": []}))
    noticed = 0
    for gone in content["claims"]:
        left = [claim for claim in content["claims"] if claim is not gone]
        short = {**content, "claims": left}
        noticed += bool([*unclaimed_rows(system, short), *unclaimed_entries(system, short)])
    assert noticed >= (0 if system == "C" else len(content["claims"]) / 2)
