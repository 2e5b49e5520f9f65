"""Attitudes from files: quaternions, and one turn at a constant rate from each to the next.

An interval in which the body turns by more than 90 deg is a gap, since the sense of the turn is unknown. So is one ten
times as long as most, if the body turns by more than 5 deg in it. Attitudes in a gap are refused.

**Attitude ephemeris messages** (CCSDS 504.0-B-1 and -2), KVN and XML, are read, and written as KVN. Only quaternions
are read. ``q = (e sin(phi/2), cos(phi/2))`` turns the *frame* A about ``e`` by ``phi`` into B, so that its matrix ``M``
takes components in A to components in B (504.0-B-1, annex)::

    M_11 = q1^2 - q2^2 - q3^2 + qc^2,    M_12 = 2 (q1 q2 + q3 qc),    M_13 = 2 (q1 q3 - q2 qc), ...

That is the conjugate of our ``q_B_from_A``, which turns vectors. ``ATTITUDE_DIR = B2A``, of the first version, is the
inverse; the second version has A to B alone, and the scalar last.

**Axes** are celestial (``GCRF``, ``ICRF``, ``EME2000``, ``J2000``), Earth-fixed (``ITRF`` of any year), ``TOD``, the
true equator and equinox of date by IAU 2006/2000A, or ``TEME``, that of two-line elements. ``EME2000`` differs from
``GCRF`` by 23 milliarcseconds (0.8 m in low orbit), the pole and equinox of older theories from ``TOD`` by some 0.05
arcsec, and the realisations of ``ITRF`` from each other by centimetres: each is taken as one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.formats.ccsds import (
    Coverage,
    check_utc,
    coverage_of,
    is_xml,
    lines_of,
    needed,
    outside,
    seconds_after,
    together,
    utc_of,
    xml_of,
)
from horizonval.geometry import clock
from horizonval.geometry.orbit import EARTH_RATE_RAD_S
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme, tod_from_gcrs, turn

Axes = Literal["gcrs", "itrs", "tod", "teme"]
KNOWN = "GCRF, ICRF, EME2000, J2000, ITRF (of any year), TOD or TEME"
_CELESTIAL = ("GCRF", "ICRF", "EME2000", "J2000", "GCRS")
_EARTH_FIXED = re.compile(r"ITR[FS]([-_ ]?\d+)?")


def axes_of(name: str, where: str) -> Axes:
    """Return the kind of axes of a name; another one is a :class:`UserError` at ``where``."""
    upper = name.strip().upper()
    if upper in _CELESTIAL:
        return "gcrs"
    if upper == "TEME":
        return "teme"
    if upper == "TOD":
        return "tod"
    if _EARTH_FIXED.fullmatch(upper):
        return "itrs"
    raise UserError(f"axes {name!r}", where=where, expected=KNOWN)


def gcrs_from(axes: Axes, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
    """Return matrices, shape (n, 3, 3), from axes to ``gcrs`` at times after an epoch."""
    if axes == "gcrs":
        return np.broadcast_to(np.eye(3), (len(seconds), 3, 3))
    if axes == "tod":
        return np.swapaxes(tod_from_gcrs(epoch_utc, seconds), -1, -2)
    to_gcrs = np.swapaxes(itrs_from_gcrs(epoch_utc, seconds), -1, -2)
    return to_gcrs if axes == "itrs" else to_gcrs @ itrs_from_teme(epoch_utc, seconds)


def states_in_gcrs(
    axes: Axes, epoch_utc: datetime, seconds: FloatArray, r: FloatArray, v: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return positions and velocities, shape (n, 3) each, turned to ``gcrs``; Earth-fixed velocities are relative."""
    matrices = gcrs_from(axes, epoch_utc, seconds)
    if v is not None and axes == "itrs":
        v = v + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r)
    return turn(matrices, r), None if v is None else turn(matrices, v)


LONGEST_OFF = 1e-3
"""Of a unit quaternion's length, by how much a file's may be off: four digits are written at least."""
LARGEST_TURN = math.radians(90.0)
GAP_STEPS, GAP_TURN = 10.0, math.radians(5.0)


@dataclass(frozen=True)
class AttitudePiece:
    """Attitudes at ``seconds`` (m,) after the history's epoch; ``q_body_from_axes`` (m, 4), scalar last."""

    seconds: FloatArray
    q_body_from_axes: FloatArray
    coverage: Coverage


@dataclass(frozen=True)
class AttitudeHistory:
    """How a body was turned against ``axes``; ``where`` names the file for messages. Pieces do not know each other."""

    epoch_utc: datetime
    pieces: tuple[AttitudePiece, ...]
    axes: Axes
    where: str

    @cached_property
    def coverage(self) -> Coverage:
        """The times that may be asked for."""
        return together([piece.coverage for piece in self.pieces])

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after another epoch.

        Raises
        ------
        UserError
            A time outside all pieces, or in a gap.
        """
        t = np.asarray(seconds, dtype=np.float64) + clock.elapsed_s(self.epoch_utc, epoch_utc)
        matrices = np.full((len(t), 3, 3), np.nan)
        for piece in self.pieces:
            inside = np.isfinite(piece.coverage.around(t)[0])
            if inside.any():
                turns = Slerp(piece.seconds, Rotation.from_quat(piece.q_body_from_axes))
                matrices[inside] = turns(np.clip(t[inside], piece.seconds[0], piece.seconds[-1])).as_matrix()
        if np.isnan(matrices).any():
            first = float(t[int(np.flatnonzero(np.isnan(matrices[:, 0, 0]))[0])])
            raise outside("attitude", self.epoch_utc, first, self.coverage, self.where)
        return np.asarray(matrices @ np.swapaxes(gcrs_from(self.axes, self.epoch_utc, t), -1, -2))

    def around(self, epoch_utc: datetime, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begin and end, shape (n,) each, of the spans that times after another epoch lie in; NaN outside."""
        offset = clock.elapsed_s(self.epoch_utc, epoch_utc)
        lo, hi = self.coverage.around(seconds + offset)
        return lo - offset, hi - offset


def attitudes_of(
    seconds: FloatArray, q_body_from_axes: FloatArray, where: str, usable_s: tuple[float, float] | None = None
) -> AttitudePiece:
    """Return a piece, or a :class:`UserError` for what is no history of attitudes."""
    if len(seconds) < 2:
        raise UserError(f"{len(seconds)} attitudes", where=where, expected="2 and more")
    steps = np.diff(seconds)
    if (steps <= 0.0).any():
        number = int(np.flatnonzero(steps <= 0.0)[0]) + 2
        raise UserError(f"attitude {number} is not after the one before", where=where, expected="rising times")
    length = np.linalg.norm(q_body_from_axes, axis=1)
    off = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[off] - 1.0) > LONGEST_OFF:
        raise UserError(
            f"quaternion {off + 1} has the length {length[off]:.6g}", where=where, expected="unit quaternions"
        )
    return AttitudePiece(seconds, q_body_from_axes, coverage_of(seconds, _gaps(steps, q_body_from_axes), usable_s))


def _gaps(steps: FloatArray, q: FloatArray) -> NDArray[np.bool_]:
    """Return whether each interval, shape (m - 1,), is one between whose ends nothing is known."""
    turns = Rotation.from_quat(q)
    angle = (turns[1:] * turns[:-1].inv()).magnitude()
    long = steps > GAP_STEPS * float(np.median(steps))
    return np.asarray((angle > LARGEST_TURN) | (long & (angle > GAP_TURN)))


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

    Nothing is known between segments, and outside what they call usable. UserError, with file and key: unknown axes,
    angles in place of quaternions, times that are not UTC.
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
    """Return attitudes, quaternions (n, 4) at n times in UTC, as a message in KVN.

    The version is 1.0, which more programs read than the second.
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
