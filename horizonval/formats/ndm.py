"""Navigation data messages of CCSDS: text in KVN or XML, taken apart into messages, segments, keys and rows.

One mechanism for orbit ephemerides (OEM, 502.0-B-1 to -3), mean elements (OMM, 502.0-B-2 and -3) and attitude
ephemerides (AEM, 504.0-B-1 and -2). A file holds one message or several, in KVN one after the other, in XML inside any
other element (``<ndm>``) and with any name space.

**Every key is known.** A key of the tables below is read, or has no meaning for the orbit or the attitude
(:data:`HARMLESS`). Any other key is refused by name and line. Comments and user-defined keys are skipped.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar
from xml.parsers import expat

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt, nearest
from horizonval.formats.coverage import ROUNDING_S, Coverage
from horizonval.formats.csv_table import MAX_FILE_BYTES, number_of, numbers_of
from horizonval.geometry.clock import check_system, instant_of, seconds_after

LONGEST_KEY = 80
"""Characters of a key that are compared with those of the standard."""

KINDS = {
    "oem": "an orbit ephemeris message",
    "omm": "an orbit mean-elements message",
    "aem": "an attitude ephemeris message",
    "opm": "an orbit parameter message",
    "ocm": "an orbit comprehensive message",
    "apm": "an attitude parameter message",
    "acm": "an attitude comprehensive message",
    "tdm": "a tracking data message",
    "cdm": "a conjunction data message",
    "rdm": "a re-entry data message",
    "tle": "two-line elements",
}
"""Kinds of messages; the first three are read, and two-line elements elsewhere."""
VERSIONS = {"oem": ("1.0", "2.0", "3.0"), "omm": ("2.0", "3.0"), "aem": ("1.0", "2.0")}

# ---- Keys of the standards ----------------------------------------------------------------------------------------

_STATE = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
_OBJECT = frozenset({"OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "TIME_SYSTEM"})
_SPANS = frozenset({"START_TIME", "STOP_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME"})
READ: Mapping[str, frozenset[str]] = {
    "oem": _OBJECT | _SPANS | {"REF_FRAME", "REF_FRAME_EPOCH"},
    "aem": _OBJECT
    | _SPANS
    | {"REF_FRAME_A", "REF_FRAME_B", "ATTITUDE_DIR", "ATTITUDE_TYPE", "QUATERNION_TYPE", "EULER_ROT_SEQ"}
    | {"RATE_FRAME", "ANGVEL_FRAME"},
    "omm": _OBJECT
    | {"REF_FRAME", "REF_FRAME_EPOCH", "MEAN_ELEMENT_THEORY", "EPOCH", "SEMI_MAJOR_AXIS", "MEAN_MOTION"}
    | {"ECCENTRICITY", "INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY", "GM", "EPHEMERIS_TYPE"}
    | {"NORAD_CAT_ID", "BSTAR", "BTERM", "AGOM", "MEAN_MOTION_DOT", "MEAN_MOTION_DDOT"},
}
"""Keys that are read, by the kind of message."""
HEADER = frozenset({"CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID"})
HARMLESS = (
    HEADER
    | {"INTERPOLATION", "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE"}
    | {"MASS", "SOLAR_RAD_AREA", "SOLAR_RAD_COEFF", "DRAG_AREA", "DRAG_COEFF", "CLASSIFICATION_TYPE"}
    | {"ELEMENT_SET_NO", "REV_AT_EPOCH", "COV_REF_FRAME"}
    | {f"C{a}_{b}" for k, a in enumerate(_STATE) for b in _STATE[: k + 1]}
)
"""Keys that change neither orbit nor attitude here, and may have any value.

Files are interpolated by our own polynomial whatever method they name, covariances are not read, and the propagator
SGP4 takes its drag from BSTAR: masses and areas are not terms of it.
"""
UNITS = {
    **dict.fromkeys(("X", "Y", "Z", "SEMI_MAJOR_AXIS"), "km"),
    **dict.fromkeys(("X_DOT", "Y_DOT", "Z_DOT"), "km/s"),
    **dict.fromkeys(("X_DDOT", "Y_DDOT", "Z_DDOT"), "km/s**2"),
    **dict.fromkeys(("INCLINATION", "RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY"), "deg"),
    **dict.fromkeys(("ANGLE_1", "ANGLE_2", "ANGLE_3"), "deg"),
    **dict.fromkeys(("ANGLE_1_DOT", "ANGLE_2_DOT", "ANGLE_3_DOT", "ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z"), "deg/s"),
    **dict.fromkeys(("Q1_DOT", "Q2_DOT", "Q3_DOT", "QC_DOT"), "1/s"),
    "MEAN_MOTION": "rev/day",
    "MEAN_MOTION_DOT": "rev/day**2",
    "MEAN_MOTION_DDOT": "rev/day**3",
    "BSTAR": "1/er",
    "GM": "km**3/s**2",
}
"""Units of values that are read, in small letters; a message may leave them out."""


# ---- Parts of a message -------------------------------------------------------------------------------------------


class Value(NamedTuple):
    """Text of a key, and its position in the file for messages."""

    text: str
    where: str


class Row(NamedTuple):
    """A line of data: values in the order of the standard (KVN), or by key (XML, where keys may have any order)."""

    line: int
    values: list[str] | dict[str, str]


@dataclass
class Fields:
    """Keys of one block, each once; ``where`` is the position of the block."""

    where: str
    values: dict[str, Value] = field(default_factory=dict)

    def add(self, key: str, text: str, where: str) -> None:
        """Add a key; UserError if the block has it already."""
        if key in self.values:
            raise UserError("is given twice in one block", where=f"{where}: {key}", expected="each key once")
        self.values[key] = Value(text, f"{where}: {key}")

    def text(self, key: str, default: str = "") -> str:
        """Return the text of a key that may be missing or empty."""
        found = self.values.get(key)
        return found.text if found is not None and found.text else default

    def at(self, key: str) -> str:
        """Return the position of a key, or of the block and the key if it is missing."""
        return self.values[key].where if key in self.values else f"{self.where}: {key}"

    def needed(self, key: str, expected: str) -> str:
        """Return the text of a key that the block must have."""
        if not self.text(key):
            raise UserError("is empty" if key in self.values else "is missing", where=self.at(key), expected=expected)
        return self.text(key)

    def one_of(self, key: str, names: Sequence[str], default: str = "") -> str:
        """Return the text of a key, in capitals: one of ``names``."""
        expected = " or ".join(names)
        found = (self.text(key, default) or self.needed(key, expected)).upper()
        if found not in names:
            raise UserError(f'found "{excerpt(found)}"', where=self.at(key), expected=expected)
        return found

    def number(self, key: str, expected: str = "a number", default: float | None = None) -> float:
        """Return the number of a key."""
        if default is not None and not self.text(key):
            return default
        return number_of(self.needed(key, expected), self.at(key), expected)

    def instant(self, key: str) -> int | None:
        """Return the instant [ns, TAI] of a key in the time system of the block; None without the key."""
        return instant_of(self.text(key), self.at(key), self.time_system()) if self.text(key) else None

    def time_system(self) -> str:
        """Return the time system of the block."""
        return check_system(self.needed("TIME_SYSTEM", "UTC"), self.at("TIME_SYSTEM"))

    def check_earth(self, *, needed: bool = True) -> None:
        """Refuse a centre that is not the Earth's."""
        if needed or self.text("CENTER_NAME"):
            self.one_of("CENTER_NAME", ("EARTH",))

    def usable_s(self, epoch_utc: datetime) -> tuple[float, float]:
        """Return the span after an epoch [s] that the block calls usable; infinite where it does not say."""
        begin: int | None = None
        end: int | None = None
        for first, last in (("START_TIME", "STOP_TIME"), ("USEABLE_START_TIME", "USEABLE_STOP_TIME")):
            begin, end = self.instant(first), self.instant(last)
            if begin is not None and end is not None and end < begin:
                raise UserError(f"is before {first}", where=self.at(last), expected="a later time")
        lo, hi = ([] if one is None else seconds_after(epoch_utc, [one]).tolist() for one in (begin, end))
        return (lo or [-math.inf])[0], (hi or [math.inf])[0]

    @property
    def name(self) -> str:
        """Name and number of the object, for lists."""
        number = self.text("NORAD_CAT_ID") or self.text("OBJECT_ID")
        return f"{self.text('OBJECT_NAME', 'unnamed')} ({number})" if number else self.text("OBJECT_NAME", "unnamed")

    def is_of(self, satellite: str) -> bool:
        """Whether a satellite's name, number or designator is the block's; capitals and leading zeros do not count."""
        wanted = plain_name(satellite)
        return wanted in {plain_name(self.text(key)) for key in ("OBJECT_NAME", "OBJECT_ID", "NORAD_CAT_ID")} - {""}


def plain_name(name: str) -> str:
    """Return a name or number without what does not count: capitals, zeros before a number, and ``.0`` after it."""
    return name.strip().upper().removesuffix(".0").lstrip("0")


@dataclass
class Segment:
    """Keys of a block of metadata, and the rows of data after it; ``version`` of the standard, ``path`` of the file."""

    path: Path
    version: str
    fields: Fields
    rows: list[Row] = field(default_factory=list)

    def at(self, row: Row) -> str:
        """Return the position of a row."""
        return f"{self.path}: line {row.line}"

    def place(self, index: int) -> str:
        """Return the position of a row by its index."""
        return self.at(self.rows[index])

    def instants(self) -> list[int]:
        """Return the instants [ns, TAI] of all rows; UserError unless they rise."""
        system = self.fields.time_system()
        found: list[int] = []
        for row in self.rows:
            text = row.values.get("EPOCH", "") if isinstance(row.values, dict) else row.values[0]
            found.append(instant_of(text, self.at(row), system))
            if len(found) > 1 and found[-1] <= found[-2]:
                raise UserError("is not after the row before", where=self.at(row), expected="rising times")
        return found

    def numbers(self, columns: Sequence[str], optional: Sequence[str] = ()) -> FloatArray:
        """Return the numbers of all rows behind their times, shape (n, k), in the order of ``columns``.

        ``optional`` columns follow in all rows or in none.
        """
        full = (*columns, *optional)
        found: list[FloatArray] = []
        for row in self.rows:
            texts = self._texts(row, columns, full)
            if found and len(texts) != len(found[0]):
                expected = f"{len(found[0])}, as in the first row"
                raise UserError(f"{len(texts)} numbers", where=self.at(row), expected=expected)
            keys = full[: len(texts)]
            numbers = numbers_of(texts, lambda k, row=row, keys=keys: f"{self.at(row)}: {keys[k]}")  # type: ignore[misc]
            found.append(numbers)
        return np.array(found)

    def _texts(self, row: Row, columns: Sequence[str], full: Sequence[str]) -> list[str]:
        """Return the values of a row behind its time, as many as ``columns`` or ``full``."""
        if isinstance(row.values, dict):
            keys = full if any(key in row.values for key in full[len(columns) :]) else columns
            for key in dict.fromkeys((*row.values, *keys)):
                if key != "EPOCH" and (key not in keys or not row.values.get(key)):
                    raise UserError(
                        "is missing" if key in keys else "is not a key of these rows",
                        where=f"{self.at(row)}: {key}",
                        expected=f"EPOCH, {', '.join(keys)}",
                    )
            return [row.values[key] for key in keys]
        if len(row.values) - 1 not in (len(columns), len(full)):
            raise UserError(
                f"{len(row.values) - 1} values after the time",
                where=self.at(row),
                expected=f"a time and {', '.join(columns)}",
            )
        return row.values[1:]


@dataclass
class Message:
    """A message: its kind, the version of its standard, and its segments."""

    kind: str
    version: str
    where: str
    header: Fields
    segments: list[Segment] = field(default_factory=list)


# ---- Reading ------------------------------------------------------------------------------------------------------


def messages_of(path: Path, kind: str, expected: str) -> list[Message]:
    """Return all messages of a kind in a file, in their order.

    Raises
    ------
    UserError
        No message of this kind, an unknown version, and with key and line: a key that the standard does not have, one
        that is given twice, a unit other than the standard's.
    """
    data = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=expected)
    every = _of_xml(path, data, expected) if _is_xml(data) else _of_kvn(path, _text_of(path, data, expected), expected)
    found = [message for message in every if message.kind == kind]
    if not found:
        others = " and ".join(dict.fromkeys(KINDS[message.kind] for message in every))
        raise UserError(f"holds {others or 'no message'}", where=str(path), expected=expected)
    for message in found:
        if message.version not in VERSIONS[kind]:
            raise UserError(
                f'found "{excerpt(message.version)}"',
                where=f"{message.where}: CCSDS_{kind.upper()}_VERS",
                expected=" or ".join(VERSIONS[kind]),
            )
        check_keys(message.header, HEADER, f"the header of {KINDS[kind]}")
        for segment in message.segments:
            check_keys(segment.fields, READ[kind] | HARMLESS, KINDS[kind])
    return found


def check_keys(fields: Fields, known: frozenset[str], what: str) -> None:
    """Refuse a key that is not known, by name and line."""
    for key, value in fields.values.items():
        if key not in known:
            close = ", ".join(nearest(key[:LONGEST_KEY], sorted(known))[:3])
            raise UserError(f"is not a key of {what}", where=value.where, expected=f"a key of the standard, as {close}")


def is_user_defined(key: str) -> bool:
    """Whether a key is a comment or a user-defined one, which has no meaning in the standard."""
    return key.startswith("USER_DEFINED") or key == "COMMENT"


_TAG = re.compile(rb"<(?:[\w.-]+:)?(" + "|".join(KINDS).encode() + rb")[\s/>]")
_HEADING = re.compile(rb"^[ \t]*CCSDS_([A-Z]+)_VERS[ \t]*=", re.MULTILINE)
_LINES = re.compile(rb"(?:^|\n)1 [ 0-9A-Z]{5}[A-Z ].*\r?\n2 [ 0-9A-Z]{5} ")


def kinds_of(path: Path, expected: str = "an orbit or attitude file") -> list[str]:
    """Return the kinds of messages in a file, of :data:`KINDS`, in their order; empty if it holds none.

    Mean elements as JSON or CSV are ``omm``; two-line elements are ``tle``.
    """
    data = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=expected)
    if _is_xml(data):
        first, *rest = data.replace(b"\0", b"").split(b"<!--")
        plain = b"".join([first, *(text.partition(b"-->")[2] for text in rest)])
        return [kind.decode() for kind in dict.fromkeys(_TAG.findall(plain))]
    if found := [kind.lower().decode() for kind in dict.fromkeys(_HEADING.findall(data.removeprefix(b"\xef\xbb\xbf")))]:
        return [kind for kind in found if kind in KINDS]
    if form_of_elements(data[:HEAD_BYTES]):
        return ["omm"]
    if b"META_START" in (start := data[: 1 << 16]):
        return ["aem" if b"ATTITUDE_TYPE" in start else "oem"]  # The readers refuse the missing version.
    return ["tle"] if _LINES.search(start) else []


HEAD_BYTES = 4096
"""Bytes that show the form of elements."""


def form_of_elements(head: bytes) -> str:
    """Return ``json`` or ``csv`` for mean elements in that form, by the begin of a file; else nothing."""
    text = head.decode("utf-8-sig", errors="replace").lstrip()
    if text[:1] in ("[", "{"):
        return "json"
    return "csv" if "MEAN_MOTION" in text.split("\n", 1)[0].upper() and text[0] != "<" else ""


def _is_xml(data: bytes) -> bool:
    # Of UTF-16 the zero bytes go, of UTF-8 and UTF-16 the byte-order marks.
    return data[:64].replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n").startswith(b"<")


def _text_of(path: Path, data: bytes, expected: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise UserError("is not text in UTF-8", where=f"{path}: line {line}", expected=expected) from None


_VERSION = re.compile(r"CCSDS_([A-Z]+)_VERS\s*=\s*(.*)")
_KEY = re.compile(r"([A-Za-z][A-Za-z0-9_]*)\s*=\s*(.*)")
_BLOCKS = {"META": "META_STOP", "DATA": "DATA_STOP", "COVARIANCE": "COVARIANCE_STOP"}


def _of_kvn(path: Path, text: str, expected: str) -> list[Message]:
    found: list[Message] = []
    block, opened = "", 0
    for number, raw in enumerate(io.StringIO(text, newline=None), 1):
        line = raw.strip()
        if not line or line == "COMMENT" or line.startswith(("COMMENT ", "COMMENT\t")):
            continue
        where = f"{path}: line {number}"
        if version := _VERSION.match(line):
            if block:
                raise UserError(f"{block}_START without {_BLOCKS[block]}", where=f"{path}: line {opened}")
            if version[1].lower() not in KINDS:
                raise UserError(f"message of the unknown kind {version[1]}", where=where, expected=expected)
            found.append(Message(version[1].lower(), version[2].strip(), where, Fields(where)))
            if found[-1].kind == "omm":
                found[-1].segments.append(Segment(path, found[-1].version, Fields(where)))
            continue
        if not found:
            raise UserError(
                f'found "{excerpt(line)}"', where=where, expected=f"{expected}, which begins with its version"
            )
        message = found[-1]
        if message.kind not in VERSIONS:
            continue
        name, _, edge = line.partition("_")
        if edge in ("START", "STOP") and name in _BLOCKS:
            if message.kind == "omm" or (edge == "START") == bool(block) or (edge == "STOP" and name != block):
                blocks = _BLOCKS[block] if block else "keys alone" if message.kind == "omm" else "blocks in order"
                raise UserError(f"found {line}", where=where, expected=blocks)
            if name == "META" and edge == "START":
                message.segments.append(Segment(path, message.version, Fields(where)))
            elif not message.segments:
                raise UserError("data without metadata", where=where, expected="META_START before")
            block, opened = (name, number) if edge == "START" else ("", 0)
        elif key := _KEY.fullmatch(line):
            _add_of_kvn(message, block, key[1], key[2], where)
        elif block == "COVARIANCE":
            for value in line.split():
                number_of(value, where)
        elif message.segments and (block == "DATA" or (message.kind == "oem" and not block)):
            message.segments[-1].rows.append(Row(number, line.split()))
        else:
            raise UserError(f'found "{excerpt(line)}"', where=where, expected="a key and a value")
    if block:
        raise UserError(f"{block}_START without {_BLOCKS[block]}", where=f"{path}: line {opened}")
    return found


def _add_of_kvn(message: Message, block: str, key: str, value: str, where: str) -> None:
    """Add a line ``KEY = value [unit]`` to its block."""
    if is_user_defined(key):
        return
    if block == "COVARIANCE":
        if key not in ("EPOCH", "COV_REF_FRAME"):
            raise UserError("is not a key of a covariance", where=f"{where}: {key}", expected="EPOCH or COV_REF_FRAME")
        return
    if message.kind != "omm" and block != "META" and message.segments:
        raise UserError("is a key between rows of data", where=f"{where}: {key}", expected="keys before META_STOP")
    if key in UNITS and value.endswith("]"):
        value, _, unit = value[:-1].partition("[")
        check_unit(key, unit, f"{where}: {key}")
    fields = message.segments[-1].fields if message.segments else message.header
    fields.add(key, value.strip(), where)


def check_unit(key: str, unit: str, where: str) -> None:
    """Refuse a unit that is not the standard's; one that is left out is."""
    found = "".join(unit.split()).lower().replace("^", "**")
    if found and key in UNITS and found != UNITS[key]:
        raise UserError(f"in {unit.strip()!r}", where=where, expected=UNITS[key])


class _Tree:
    """Messages of an XML file; expat counts the lines and knows name spaces, and entities are refused."""

    def __init__(self, path: Path, expected: str) -> None:
        self.path, self.expected = path, expected
        self.messages: list[Message] = []
        self._stack: list[str] = []
        self._text: list[str] = []
        self._attributes: dict[str, str] = {}
        self._leaf = False
        self._row: Row | None = None
        self._depth = 0

    def parse(self, data: bytes) -> None:
        parser = self._parser = expat.ParserCreate(namespace_separator=" ")
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._text.append
        parser.StartDoctypeDeclHandler = self._refuse
        try:
            parser.Parse(data, True)
        except expat.ExpatError as error:
            where = f"{self.path}: line {error.lineno}"
            raise UserError(f"not XML: {expat.ErrorString(error.code)}", where=where, expected=self.expected) from None
        except (LookupError, ValueError):
            raise UserError("in an encoding that is not read", where=str(self.path), expected="XML in UTF-8") from None

    @property
    def _where(self) -> str:
        return f"{self.path}: line {self._parser.CurrentLineNumber}"

    def _refuse(self, *_: object) -> None:
        raise UserError(
            "an XML file with a document type (DOCTYPE) or entities of its own",
            where=self._where,
            expected=self.expected,
        )

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        tag = name.rpartition(" ")[2]
        self._stack.append(tag)
        self._text.clear()
        self._attributes, self._leaf = attributes, True
        if tag in KINDS and not self._depth:
            self._depth = len(self._stack)
            self.messages.append(Message(tag, attributes.get("version", "").strip(), self._where, Fields(self._where)))
        elif tag == "segment" and self._depth:
            message = self.messages[-1]
            message.segments.append(Segment(self.path, message.version, Fields(self._where)))
        elif tag in ("stateVector", "attitudeState") and self._depth and self.messages[-1].segments:
            self._row = Row(self._parser.CurrentLineNumber, {})
            self.messages[-1].segments[-1].rows.append(self._row)

    def _end(self, _: str) -> None:
        tag = self._stack.pop()
        text = "".join(self._text).strip()
        if self._depth and self._leaf and self.messages[-1].kind in VERSIONS and len(self._stack) >= self._depth:
            self._add(tag, text)
        self._leaf = False
        self._text.clear()
        if tag in ("stateVector", "attitudeState"):
            self._row = None
        if len(self._stack) < self._depth:
            self._depth = 0

    def _add(self, tag: str, text: str) -> None:
        message, where = self.messages[-1], self._where
        key = tag
        if rotation := re.fullmatch(r"rotation([123])", tag):
            # The first version of attitudes writes the axis as an attribute: <rotation1 angle="X_ANGLE">.
            kind = "ANGLE" if self._stack[-1] == "rotationAngles" else "RATE"
            key = f"{kind}_{rotation[1]}"
        elif not text and tag != tag.upper():
            return  # An empty group, as <userDefinedParameters/>.
        if is_user_defined(key) or (message.kind == "oem" and "covarianceMatrix" in self._stack):
            return
        check_unit(key, self._attributes.get("units", ""), f"{where}: {key}")
        if self._row is not None:
            values = self._row.values
            assert isinstance(values, dict)
            if key in values:
                raise UserError("is given twice in one row", where=f"{where}: {key}", expected="each key once")
            values[key] = text
            if rotation and (axis := self._attributes.get("angle") or self._attributes.get("rate")):
                values[f"{key}_AXIS"] = axis[:1].upper()
        else:
            fields = message.segments[-1].fields if message.segments else message.header
            fields.add(key, text, where)


def _of_xml(path: Path, data: bytes, expected: str) -> list[Message]:
    tree = _Tree(path, expected)
    tree.parse(data)
    return tree.messages


# ---- One satellite ------------------------------------------------------------------------------------------------

MOST_NAMES = 10
"""Largest number of names that an error lists."""


def listed(names: Iterable[str]) -> str:
    """Return the first names, each once, as text."""
    every = list(dict.fromkeys(names))
    return ", ".join(every[:MOST_NAMES]) + (f" and {len(every) - MOST_NAMES} more" if len(every) > MOST_NAMES else "")


class Named(Protocol):
    """What belongs to a satellite."""

    @property
    def name(self) -> str:
        """Name for messages."""

    def is_of(self, satellite: str) -> bool:
        """Whether it belongs to the satellite of a name, number or designator."""


S = TypeVar("S")
T = TypeVar("T", bound=Named)


def one_element_set(found: Sequence[T], satellite: str | None, where: str, epoch: Callable[[T], str]) -> T:
    """Return the only element set of one satellite; see :func:`of_satellite`."""
    chosen = of_satellite(found, satellite, where, lambda one: one, "elements")
    if len(chosen) > 1:
        raise UserError(
            f"{len(chosen)} element sets of {chosen[0].name}, of {listed(map(epoch, chosen))}",
            where=where,
            expected="one set for a satellite",
            fix="keep the one whose epoch is nearest to the flight",
        )
    return chosen[0]


def of_satellite(
    found: Sequence[S], satellite: str | None, where: str, named: Callable[[S], Named], what: str
) -> list[S]:
    """Return what belongs to one satellite.

    ``satellite`` is its name, catalogue number or international designator; None: the file must hold only one.
    """
    chosen = [one for one in found if satellite is None or named(one).is_of(satellite)]
    names = list(dict.fromkeys(named(one).name for one in chosen or found))
    if not chosen:
        raise UserError(f"no {what} of {satellite!r}", where=where, expected=f"one of {listed(names)}")
    if len(names) > 1:
        raise UserError(
            f"{what} of {len(names)} satellites: {listed(names)}",
            where=where,
            expected="one satellite",
            fix="choose one with `satellite`, by a name or number that only it has",
        )
    return chosen


def one_message(path: Path, kind: str, expected: str, satellite: str | None) -> list[Segment]:
    """Return the segments of the only message about a satellite; UserError if there are several, or no rows."""
    parts = [(message, segment) for message in messages_of(path, kind, expected) for segment in message.segments]
    if not parts:
        raise UserError("no segment", where=str(path), expected=expected)
    if kind == "aem" and len({segment.fields.name for _, segment in parts}) == 1:
        satellite = None  # Attitudes of one object may name it otherwise than its elements.
    chosen = of_satellite(parts, satellite, str(path), lambda part: part[1].fields, "ephemerides")
    messages = list({id(message): message for message, _ in chosen}.values())
    if len(messages) > 1:
        created = listed(f"{m.where} of {m.header.text('CREATION_DATE', 'no date')}" for m in messages)
        raise UserError(
            f"{len(messages)} messages about {chosen[0][1].fields.name}: {created}",
            where=str(path),
            expected="one message about a satellite",
            fix="keep the one that is valid",
        )
    for _, segment in chosen:
        if not segment.rows:
            raise UserError("no rows of data", where=segment.fields.where, expected=expected)
    return [segment for _, segment in chosen]


def check_order(coverages: Sequence[Coverage], segments: Sequence[Segment]) -> None:
    """Refuse segments whose usable spans overlap: which of two states is right, is unknown."""
    end = -math.inf
    for coverage, segment in zip(coverages, segments, strict=True):
        if len(coverage.begins) and coverage.begins[0] < end - ROUNDING_S:
            raise UserError(
                "begins before the usable span of the segment before it ends",
                where=segment.fields.where,
                expected="segments one after the other, or USEABLE_START_TIME and USEABLE_STOP_TIME",
            )
        end = max(end, coverage.ends[-1]) if len(coverage.ends) else end
