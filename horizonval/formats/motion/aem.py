r"""Attitude ephemeris messages (CCSDS 504.0-B-1 and -2), KVN and XML: read, and written as KVN.

Read are quaternions, whatever rates or derivatives stand behind them. ``q = (e sin(phi/2), cos(phi/2))`` turns the
*frame* A about ``e`` by ``phi`` into B, so that its matrix ``M`` takes components in A to components in B (504.0-B-1,
annex)::

    M_11 = q1^2 - q2^2 - q3^2 + qc^2,    M_12 = 2 (q1 q2 + q3 qc),    M_13 = 2 (q1 q3 - q2 qc), ...

That is the conjugate of our ``q_B_from_A``, which turns vectors. ``ATTITUDE_DIR = B2A``, of the first version, is the
other way round; the second version has A to B alone, and the scalar last.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.formats.motion.attitude_history import AttitudeHistory, AttitudePiece, attitudes_of
from horizonval.formats.motion.axes import KNOWN, Axes, axes_of
from horizonval.formats.motion.kvn import check_utc, is_xml, lines_of, needed, xml_of
from horizonval.formats.motion.times import seconds_after, utc_of

EXPECTED = "an attitude ephemeris message, KVN or XML"
VERSIONS = ("1.0", "2.0")
TYPES = "QUATERNION, QUATERNION/RATE, QUATERNION/DERIVATIVE or QUATERNION/ANGVEL"


@dataclass
class _Segment:
    """Metadata, and rows of a time and numbers; ``scalar_last`` of the rows as they were read."""

    fields: dict[str, str] = field(default_factory=dict)
    rows: list[tuple[str, str, list[str]]] = field(default_factory=list)


def attitude_of_aem(path: Path) -> AttitudeHistory:
    """Return the attitudes in a message of one segment, or of several without a change of axes.

    Nothing is known between segments, and outside what they call usable.

    Raises
    ------
    UserError
        With file and key: axes that are not known, angles in place of quaternions, times that are not UTC.
    """
    with path.open("rb") as file:
        head = file.read(256).decode("utf-8", errors="replace")
    version, segments = _of_xml(path) if is_xml(head) else _of_kvn(path)
    if version not in VERSIONS:
        raise UserError(f"found {version!r}", where=f"{path}: CCSDS_AEM_VERS", expected=" or ".join(VERSIONS))
    if not segments:
        raise UserError("no segment", where=str(path), expected=EXPECTED)
    pieces: list[AttitudePiece] = []
    epoch: datetime | None = None
    axes_of_first: Axes | None = None
    for number, segment in enumerate(segments, 1):
        where = f"{path}: segment {number}"
        axes, turned = _meaning(segment.fields, version, where)
        if axes_of_first not in (None, axes):
            raise UserError(f"axes {axes}, and {axes_of_first} before", where=where, expected="one kind of axes")
        axes_of_first = axes
        first = segment.fields.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        times = [utc_of(time, place) for place, time, _ in segment.rows]
        late = next((k for k in range(1, len(times)) if times[k] <= times[k - 1]), None)
        if late is not None:
            raise UserError("is not after the one before", where=segment.rows[late][0], expected="rising times")
        if not times:
            raise UserError("no attitudes", where=where, expected=EXPECTED)
        epoch = epoch or times[0]
        q = np.array([_quaternion(numbers, place, first=first) for place, _, numbers in segment.rows])
        if not turned:
            q = q * [-1.0, -1.0, -1.0, 1.0]
        piece = attitudes_of(seconds_after(epoch, times), q, where, _usable(segment.fields, epoch, where))
        if pieces and piece.seconds[0] < pieces[-1].seconds[-1]:
            raise UserError("begins before the one before it ends", where=where, expected="rising times")
        pieces.append(piece)
    assert epoch is not None
    assert axes_of_first is not None
    return AttitudeHistory(epoch, tuple(pieces), axes_of_first, str(path))


def _usable(fields: dict[str, str], epoch: datetime, where: str) -> tuple[float, float]:
    """Return from when to when a segment says that it may be used; infinite where it does not."""
    ends = []
    for key, otherwise in (("USEABLE_START_TIME", -math.inf), ("USEABLE_STOP_TIME", math.inf)):
        text = fields.get(key, "").strip()
        ends.append((utc_of(text, f"{where}: {key}") - epoch).total_seconds() if text else otherwise)
    return ends[0], ends[1]


def aem_text(
    times: Iterable[datetime],
    q_body_from_gcrs: FloatArray,
    *,
    name: str,
    created_utc: datetime,
    comments: Iterable[str] = (),
) -> str:
    """Return attitudes as a message, KVN, version 1.0, which more programs read than the second.

    Parameters
    ----------
    times : iterable of datetime
        UTC, n of them.
    q_body_from_gcrs : ndarray, shape (n, 4)
        Scalar last.
    name : str
        Of the spacecraft.
    created_utc : datetime
    comments : iterable of str
    """
    stamps = [_stamp(time) for time in times]
    conjugate = np.asarray(q_body_from_gcrs) * [-1.0, -1.0, -1.0, 1.0]
    lines = [
        "CCSDS_AEM_VERS = 1.0",
        *(f"COMMENT {text}" for text in comments),
        f"CREATION_DATE = {_stamp(created_utc)}",
        "ORIGINATOR = HORIZONVAL",
        "",
        "META_START",
        f"OBJECT_NAME = {name}",
        "OBJECT_ID = 0000-000A",
        "CENTER_NAME = EARTH",
        "REF_FRAME_A = ICRF",
        "REF_FRAME_B = SC_BODY_1",
        "ATTITUDE_DIR = A2B",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}",
        f"STOP_TIME = {stamps[-1]}",
        "ATTITUDE_TYPE = QUATERNION",
        "QUATERNION_TYPE = LAST",
        "META_STOP",
        "",
        "DATA_START",
        *(f"{stamp} " + " ".join(f"{value:.12f}" for value in q) for stamp, q in zip(stamps, conjugate, strict=True)),
        "DATA_STOP",
    ]
    return "\n".join(lines) + "\n"


def _stamp(time: datetime) -> str:
    return time.replace(tzinfo=None).isoformat(timespec="microseconds")


def _meaning(fields: dict[str, str], version: str, where: str) -> tuple[Axes, bool]:
    """Return the axes that are not the body's, and whether the rows' conjugate takes the body's components to them."""
    check_utc(fields, where)
    kind = needed(fields, "ATTITUDE_TYPE", where, TYPES).upper()
    if not kind.startswith("QUATERNION"):
        raise UserError(f"found {kind!r}", where=f"{where}: ATTITUDE_TYPE", expected=TYPES)
    a, b = (needed(fields, f"REF_FRAME_{letter}", where, KNOWN) for letter in "AB")
    a_is_body, b_is_body = (name.upper().startswith("SC_") for name in (a, b))
    if a_is_body == b_is_body:
        raise UserError(
            f"{a} and {b}", where=f"{where}: REF_FRAME_A, REF_FRAME_B", expected=f"SC_BODY_1 and one of {KNOWN}"
        )
    direction = fields.get("ATTITUDE_DIR", "A2B").upper() if version == "1.0" else "A2B"
    if direction not in ("A2B", "B2A"):
        raise UserError(f"found {direction!r}", where=f"{where}: ATTITUDE_DIR", expected="A2B or B2A")
    axes = axes_of(b if a_is_body else a, f"{where}: REF_FRAME_{'B' if a_is_body else 'A'}")
    # The frame's turn towards the body is the conjugate of ours; away from it, it is ours.
    return axes, (direction == "A2B") == a_is_body


def _quaternion(numbers: list[str], place: str, *, first: bool) -> FloatArray:
    try:
        q = np.array([float(text) for text in numbers[:4]])
    except ValueError:
        q = np.empty(0)
    if len(q) != 4 or not np.isfinite(q).all():
        raise UserError(f'found "{excerpt(" ".join(numbers))}"', where=place, expected="four numbers")
    return np.roll(q, -1) if first else q


def _of_kvn(path: Path) -> tuple[str, list[_Segment]]:
    version, segments, inside = "", [], ""
    for number, line in lines_of(path, EXPECTED):
        if line in ("META_START", "DATA_START"):
            inside = line
            if line == "META_START":
                segments.append(_Segment())
            elif not segments:
                raise UserError("data without metadata", where=f"{path}: line {number}", expected="META_START before")
        elif line in ("META_STOP", "DATA_STOP"):
            inside = ""
        elif inside == "DATA_START":
            time, *numbers = line.split()
            segments[-1].rows.append((f"{path}: line {number}", time, numbers))
        else:
            key, equals, value = line.partition("=")
            if not equals:
                raise UserError(
                    f'found "{excerpt(line)}"', where=f"{path}: line {number}", expected="a key and a value"
                )
            if inside:
                segments[-1].fields[key.strip()] = value.strip()
            elif key.strip() == "CCSDS_AEM_VERS":
                version = value.strip()
    return version, segments


def _of_xml(path: Path) -> tuple[str, list[_Segment]]:
    root = xml_of(path, EXPECTED)
    message = root if root.tag == "aem" else root.find("aem")
    if message is None:
        raise UserError(f"<{root.tag}>", where=str(path), expected="<aem>")
    segments = []
    for one in message.iter("segment"):
        segment = _Segment()
        metadata = one.find("metadata")
        if metadata is not None:
            segment.fields = {e.tag: (e.text or "").strip() for e in metadata.iter() if len(e) == 0}
        for number, state in enumerate(one.iter("attitudeState"), 1):
            values = {e.tag: (e.text or "").strip() for e in state.iter() if len(e) == 0}
            place = f"{path}: attitudeState {number}"
            numbers = [needed(values, key, place, "a component") for key in ("Q1", "Q2", "Q3", "QC")]
            segment.rows.append((place, needed(values, "EPOCH", place, "a time"), numbers))
        # The components have names in XML, so that no order is to be told.
        segment.fields["QUATERNION_TYPE"] = "LAST"
        segments.append(segment)
    return message.get("version", ""), segments
