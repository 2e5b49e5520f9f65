"""Two-line elements as text: one satellite, or a catalogue of which one is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from horizonval.core.errors import UserError
from horizonval.formats.ndm import one_element_set, plain_name
from horizonval.geometry.orbit import ElementSet

SHORTEST = 60
"""Columns from which a line that begins with 1 is one of elements, perhaps cut off; names have up to 24."""
EXPECTED = "two lines of 69 columns, or three with a name"


def elements_of(lines: Sequence[str], satellite: str | None = None) -> ElementSet:
    """Return the element set in lines of text; blank lines, and blanks around a line, do not count.

    A line before the two is a name. ``satellite`` chooses by name, catalogue number or international designator. Raises
    ``UserError``: no or several sets, a line without its other, or what :class:`ElementSet` refuses.
    """
    found: list[_Set] = []
    name, first = "", ""
    texts = [text for line in lines if (text := line.strip().lstrip("\ufeff"))]
    for text in texts:
        if first:
            found.append(_Set(name, first, text))
            name, first = "", ""
        elif text.startswith("1 ") and len(text) >= SHORTEST:
            first = text
        elif name:
            break
        else:
            name = text.removeprefix("0 ")
    if not found or name or first:
        raise UserError(f"found {len(texts)} lines", expected=EXPECTED)
    one = one_element_set(found, satellite, "", lambda one: f"{one.line1[18:32].strip()} (year and day)")
    return ElementSet(one.line1, one.line2)


@dataclass(frozen=True)
class _Set:
    """Two lines, and the line before them."""

    title: str
    line1: str
    line2: str

    @property
    def name(self) -> str:
        """Catalogue number and name."""
        number = self.line1[2:7].strip()
        return f"{number} ({self.title})" if self.title else number

    def is_of(self, satellite: str) -> bool:
        """Whether a satellite's name, number or designator is the set's."""
        number, designator = self.line1[2:7], self.line1[9:17].strip()
        names = {self.title, number, designator}
        if number[:1].isalpha() and number[1:].isdigit():
            # Alpha-5 leaves out I and O.
            names.add(f"{'ABCDEFGHJKLMNPQRSTUVWXYZ'.find(number[0].upper()) + 10}{number[1:]}")
        if designator[:5].isdigit():
            names.add(f"{'19' if int(designator[:2]) > 56 else '20'}{designator[:2]}-{designator[2:]}")
        return plain_name(satellite) in {plain_name(text) for text in names} - {""}
