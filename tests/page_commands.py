"""Commands that a page prints for its reader, and running them as it says: in the run's folder, or one inside it."""

from __future__ import annotations

import html
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

_CODE = re.compile(r"<code>(horizonval [^<]*)</code>")
_CARD = re.compile(r'<div class="again">(.*?)</div>', flags=re.DOTALL)
_FILE = re.compile(r'download="([^"]*)" href="data:application/toml;charset=utf-8,([^"]*)"')
_LINES = re.compile(r"<pre>(.*?)</pre>", flags=re.DOTALL)


@dataclass(frozen=True)
class Card:
    """How a page makes one frame again: files to save, and command lines."""

    files: dict[str, str]
    commands: tuple[str, ...]


def commands_of(page: Path) -> list[str]:
    """Return the commands in the text of a page."""
    text = page.read_text(encoding="utf-8")
    return [html.unescape(command) for command in _CODE.findall(_CARD.sub("", text))]


def cards_of(page: Path) -> list[Card]:
    """Return how a page makes its frames again."""
    cards = _CARD.findall(page.read_text(encoding="utf-8"))
    return [
        Card(
            {html.unescape(name): unquote(html.unescape(text)) for name, text in _FILE.findall(card)},
            tuple(html.unescape("\n".join(_LINES.findall(card))).splitlines()),
        )
        for card in cards
    ]


def words_of(command: str) -> list[str]:
    """Return the arguments of a command, as a shell takes them apart."""
    program, *words = shlex.split(command)
    assert program == "horizonval", command
    return words
