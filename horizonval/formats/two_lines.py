"""Two-line elements as text: one satellite, or a catalogue of which one is chosen."""

from __future__ import annotations

from collections.abc import Sequence

from horizonval.core.errors import UserError
from horizonval.geometry.orbit import ElementSet

EXPECTED = "two lines of 69 columns, or three with a name"
MOST_NAMES = 5


def elements_of(lines: Sequence[str], satellite: str | None = None) -> ElementSet:
    """Return the element set in lines of text; blank lines, and blanks around a line, do not count.

    A line before the two is a name. ``satellite`` chooses by name, catalogue number or international designator. Raises
    ``UserError``: no or several sets, a line without its other, or what :class:`ElementSet` refuses.
    """
    found: list[tuple[str, str, str]] = []
    name, first = "", ""
    texts = [text for line in lines if (text := line.strip().lstrip("\ufeff"))]
    for text in texts:
        if first:
            found.append((name, first, text))
            name, first = "", ""
        elif text.startswith("1 "):
            first = text
        elif name:
            break
        else:
            name = text.removeprefix("0 ")
    if not found or name or first:
        raise UserError(f"found {len(texts)} lines", expected=EXPECTED)
    chosen = [one for one in found if satellite is None or _plain(satellite) in _names(one)]
    if len(chosen) == 1:
        return ElementSet(chosen[0][1], chosen[0][2])
    if not chosen:
        raise UserError(f"no elements of {satellite!r}", expected=f"one of {_listed(found)}")
    if len({one[1][2:7] for one in chosen}) == 1:
        epochs = ", ".join(one[1][18:32].strip() for one in chosen[:MOST_NAMES])
        raise UserError(
            f"{len(chosen)} element sets of satellite {chosen[0][1][2:7]}, of {epochs} (year and day)",
            expected="one set",
            fix="keep the one whose epoch is nearest to the flight",
        )
    raise UserError(
        f"elements of {len(chosen)} satellites: {_listed(chosen)}",
        expected="one satellite",
        fix="choose one with `satellite`, by its name or catalogue number",
    )


def _plain(name: str) -> str:
    return name.strip().upper().lstrip("0")


def _names(one: tuple[str, str, str]) -> set[str]:
    name, first, _ = one
    number, designator = first[2:7], first[9:17].strip()
    names = {name, number, designator}
    if number[:1].isalpha() and number[1:].isdigit():
        # Alpha-5 leaves out I and O.
        names.add(f"{'ABCDEFGHJKLMNPQRSTUVWXYZ'.find(number[0].upper()) + 10}{number[1:]}")
    if designator[:5].isdigit():
        names.add(f"{'19' if int(designator[:2]) > 56 else '20'}{designator[:2]}-{designator[2:]}")
    return {_plain(text) for text in names} - {""}


def _listed(found: Sequence[tuple[str, str, str]]) -> str:
    names = [f"{first[2:7].strip()} ({name})" if name else first[2:7].strip() for name, first, _ in found]
    return ", ".join(names[:MOST_NAMES]) + (", ..." if len(names) > MOST_NAMES else "")
