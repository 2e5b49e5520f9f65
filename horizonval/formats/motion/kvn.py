"""CCSDS messages as keys and values, a line each: what is alike in all of them.

A message is a header, then for each part a block of metadata and one of data. Keys stand in capitals before ``=``;
``COMMENT`` lines say nothing to a program.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path

from horizonval.core import files
from horizonval.core.errors import UserError

MAX_FILE_BYTES = 256 * 1024 * 1024


def is_xml(text: str) -> bool:
    """Whether a text is XML."""
    return text.lstrip("\ufeff \t\r\n").startswith("<")


def kind_of(path: Path) -> str:
    """Return the kind of message in a file, ``oem``, ``omm`` or ``aem``; empty where it is none of CCSDS."""
    head = files.read_bytes(path, largest=MAX_FILE_BYTES, expected="an orbit or attitude file")[:4096]
    text = head.decode("utf-8", errors="replace")
    for kind in ("oem", "omm", "aem"):
        if f"CCSDS_{kind.upper()}_VERS" in text or (is_xml(text) and f"<{kind}" in text):
            return kind
    return ""


def lines_of(path: Path, expected: str) -> Iterator[tuple[int, str]]:
    """Yield number and content of the lines that say something."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected)
    for number, line in enumerate(text.splitlines(), 1):
        if (content := line.strip()) and not content.startswith("COMMENT"):
            yield number, content


def xml_of(path: Path, expected: str) -> ElementTree.Element:
    """Return the root of an XML message."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UserError("an XML file with entities of its own", where=str(path), expected=expected)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"not XML: {error}", where=str(path), expected=expected) from error


def needed(fields: Mapping[str, str], key: str, where: str, expected: str) -> str:
    """Return the value of a key that a message must have."""
    value = fields.get(key, "").strip()
    if not value:
        raise UserError("is missing", where=f"{where}: {key}", expected=expected)
    return value


def check_utc(fields: Mapping[str, str], where: str) -> None:
    """Refuse times that are not UTC."""
    system = needed(fields, "TIME_SYSTEM", where, "UTC")
    if system.upper() != "UTC":
        raise UserError(f"found {system!r}", where=f"{where}: TIME_SYSTEM", expected="UTC")


def check_earth(fields: Mapping[str, str], where: str) -> None:
    """Refuse a centre that is not the Earth's."""
    centre = needed(fields, "CENTER_NAME", where, "EARTH")
    if centre.upper() != "EARTH":
        raise UserError(f"found {centre!r}", where=f"{where}: CENTER_NAME", expected="EARTH")
