"""CCSDS messages: lines of keys and values, times as text, and the spans of time that a file covers.

A message is a header, then for each part a block of metadata and one of data. Keys are in capitals before ``=``;
``COMMENT`` lines are skipped.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.geometry import clock

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


EXPECTED = "a UTC time as 2026-03-20T12:00:00.25"


def utc_of(text: str, where: str) -> datetime:
    """Return the time of ``2026-03-20T12:00:00`` or ``2026-079T12:00:00``; a Z and parts of a second may follow."""
    plain = text.strip().removesuffix("Z")
    try:
        whole, _, part = plain.partition(".")
        form = "%Y-%jT%H:%M:%S" if len(whole.split("T")[0].split("-")) == 2 else "%Y-%m-%dT%H:%M:%S"
        found = datetime.strptime(whole.replace(" ", "T"), form).replace(tzinfo=UTC)
        if part:
            found = found.replace(microsecond=min(round(float(f"0.{part}") * 1e6), 999_999))
    except ValueError:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=EXPECTED) from None
    return found


def seconds_after(epoch_utc: datetime, times: Sequence[datetime]) -> FloatArray:
    """Return how long after an epoch some times are, shape (n,) [s]; leap seconds between them are not counted."""
    return np.array([(time - epoch_utc).total_seconds() for time in times])


ROUNDING_S = 1e-6
"""Times are whole microseconds."""


@dataclass(frozen=True)
class Coverage:
    """Spans in rising order: ``begins`` and ``ends``, shape (k,) each [s]."""

    begins: FloatArray
    ends: FloatArray

    def around(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begin and end, shape (n,) each, of the spans that times (n,) lie in; NaN outside all."""
        lo, hi = np.full(len(seconds), np.nan), np.full(len(seconds), np.nan)
        for begin, end in zip(self.begins, self.ends, strict=True):
            inside = (seconds >= begin - ROUNDING_S) & (seconds <= end + ROUNDING_S)
            lo[inside], hi[inside] = begin, end
        return lo, hi


def outside(what: str, epoch_utc: datetime, seconds: float, coverage: Coverage, where: str) -> UserError:
    """Return the error for a time outside the spans of a file, the first three of which it names."""

    def stamp(t: float) -> str:
        return clock.stamp_after(epoch_utc, float(t))

    spans = [f"{stamp(begin)} to {stamp(end)}" for begin, end in zip(coverage.begins, coverage.ends, strict=True)]
    more = ", ..." if len(spans) > 3 else ""
    return UserError(f"no {what} for {stamp(seconds)}", where=where, expected=", ".join(spans[:3]) + more)


def coverage_of(seconds: FloatArray, gaps: NDArray[np.bool_], usable_s: tuple[float, float] | None = None) -> Coverage:
    """Return the spans between rising times (m,), without those intervals (m - 1,) that are gaps.

    A state between two gaps is a span of no length. ``usable_s``: what lies outside is left out.
    """
    begins, ends = seconds[np.concatenate([[True], gaps])], seconds[np.concatenate([gaps, [True]])]
    if usable_s is not None:
        begins, ends = np.maximum(begins, usable_s[0]), np.minimum(ends, usable_s[1])
    kept = ends >= begins
    return Coverage(begins[kept], ends[kept])


def together(spans: Sequence[Coverage]) -> Coverage:
    """Return the spans of several parts as one, in their order."""
    return Coverage(np.concatenate([s.begins for s in spans]), np.concatenate([s.ends for s in spans]))
