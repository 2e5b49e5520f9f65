"""Attitude ephemeris messages (CCSDS 504.0-B-1 and -2): KVN and XML are read, KVN is written.

**Quaternions.** ``q = (e sin(phi/2), cos(phi/2))`` turns the *frame* A about ``e`` by ``phi`` into B, so that its
matrix ``M`` takes components in A to components in B (504.0-B-1, annex)::

    M_11 = q1^2 - q2^2 - q3^2 + qc^2,    M_12 = 2 (q1 q2 + q3 qc),    M_13 = 2 (q1 q3 - q2 qc), ...

That is the conjugate of our ``q_B_from_A``, which turns vectors.

**Euler angles** turn the frame about its own axes, in the order of ``EULER_ROT_SEQ`` from left to right. The columns
have this order too, whatever the first version calls them (504.0-B-1, 3.2.5.4.4: 312 has Z, X, Y).

**Versions.** The first has ``ATTITUDE_DIR = B2A``, which is the inverse, and ``QUATERNION_TYPE``, the place of the
scalar. The second turns A into B with the scalar last, and refuses other values of these keys.

**Rates** are not used: a body turns evenly from one attitude to the next. There is a warning where derivatives or
angular velocities contradict the slope of the attitudes. The rates of ``QUATERNION/RATE``, ``EULER_ANGLE/RATE`` and
``EULER_ANGLE/DERIVATIVE`` are not compared, since programs disagree about their meaning.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.attitude import KNOWN, AttitudeHistory, AttitudePiece, Axes, attitudes_of, axes_of, check_length
from horizonval.formats.ndm import Fields, Segment, check_order, one_message
from horizonval.geometry.clock import epoch_at, seconds_after

EXPECTED = "an attitude ephemeris message, KVN or XML"
_Q, _Q_DOT = ("Q1", "Q2", "Q3", "QC"), ("Q1_DOT", "Q2_DOT", "Q3_DOT", "QC_DOT")
_ANGLES, _RATES = ("ANGLE_1", "ANGLE_2", "ANGLE_3"), ("RATE_1", "RATE_2", "RATE_3")
_ANGVEL = ("ANGVEL_X", "ANGVEL_Y", "ANGVEL_Z")
COLUMNS = {
    "1.0": {
        "QUATERNION": _Q,
        "QUATERNION/DERIVATIVE": _Q + _Q_DOT,
        "QUATERNION/RATE": _Q + _RATES,
        "EULER_ANGLE": _ANGLES,
        "EULER_ANGLE/RATE": _ANGLES + _RATES,
    },
    "2.0": {
        "QUATERNION": _Q,
        "QUATERNION/DERIVATIVE": _Q + _Q_DOT,
        "QUATERNION/ANGVEL": _Q + _ANGVEL,
        "EULER_ANGLE": _ANGLES,
        "EULER_ANGLE/DERIVATIVE": (*_ANGLES, "ANGLE_1_DOT", "ANGLE_2_DOT", "ANGLE_3_DOT"),
        "EULER_ANGLE/ANGVEL": _ANGLES + _ANGVEL,
    },
}
"""Columns after the time, by version and ``ATTITUDE_TYPE``; types of spin are not read."""
_BODY = re.compile(r"SC_BODY(_[A-Z0-9]+)?")
_OTHER_VERSION = {
    "1.0": {"ANGVEL_FRAME": ""},
    "2.0": {"ATTITUDE_DIR": "A2B", "QUATERNION_TYPE": "LAST", "RATE_FRAME": ""},
}
"""Keys that only the other version has, and the values that this version has without them."""


def attitude_of_aem(path: Path, satellite: str | None = None) -> AttitudeHistory:
    """Return the attitudes in a message of one segment, or of several without a change of axes.

    Nothing is known between segments, and outside what they call usable. ``satellite`` chooses one by name or
    designator. UserError names file, line and key.
    """
    segments = one_message(path, "aem", EXPECTED, satellite)
    for segment in segments:
        segment.fields.check_earth(needed=False)
    instants = [segment.instants() for segment in segments]
    epoch = epoch_at(instants[0][0])
    pieces: list[AttitudePiece] = []
    doubts: list[str] = []
    first: tuple[Axes, str] | None = None
    for segment, times in zip(segments, instants, strict=True):
        fields = segment.fields
        axes, body, turned = _frames(fields, segment.version)
        if first not in (None, (axes, body)):
            raise UserError(
                f"{body} against {axes}", where=fields.where, expected=f"{first[1]} against {first[0]}, as before"
            )
        first = axes, body
        seconds = seconds_after(epoch, times)
        q, doubt = _quaternions(segment, seconds)
        if turned:
            q = q * [-1.0, -1.0, -1.0, 1.0]
        doubts.append(doubt)
        pieces.append(attitudes_of(seconds, q, fields.where, fields.usable_s(epoch), segment.place))
    assert first is not None
    check_order([piece.coverage for piece in pieces], segments)
    return AttitudeHistory(epoch, tuple(pieces), first[0], str(path), "; ".join(filter(None, doubts)))


def _frames(fields: Fields, version: str) -> tuple[Axes, str, bool]:
    """Return the axes, the body's frame, and whether the conjugate of the rows takes components in axes to the body."""
    names = [fields.needed(f"REF_FRAME_{letter}", f"SC_BODY_1 or {KNOWN}").upper() for letter in "AB"]
    is_body = [_BODY.fullmatch(name) is not None for name in names]
    if is_body[0] == is_body[1]:
        raise UserError(
            f"{names[0]} and {names[1]}",
            where=f"{fields.at('REF_FRAME_A')}, REF_FRAME_B",
            expected=f"SC_BODY_1 and one of {KNOWN}",
            fix="" if is_body[0] else "the attitude of a unit or against local axes is not read",
        )
    for key, value in _OTHER_VERSION[version].items():
        if fields.text(key, value).upper() != value:
            raise UserError(
                f'found "{fields.text(key)}", a key of another version',
                where=fields.at(key),
                expected=f"{value}, as version {version} has without the key" if value else f"no such key in {version}",
                fix="declare the version that the rows follow in CCSDS_AEM_VERS",
            )
    forward = version != "1.0" or fields.one_of("ATTITUDE_DIR", ("A2B", "B2A")) == "A2B"
    for key in ("RATE_FRAME", "ANGVEL_FRAME"):
        if fields.text(key):
            fields.one_of(key, ("REF_FRAME_A", "REF_FRAME_B", *names))
    letter = "B" if is_body[0] else "A"
    axes = axes_of(fields.text(f"REF_FRAME_{letter}"), fields.at(f"REF_FRAME_{letter}"))
    # The frame's turn towards the body is the conjugate of ours; away from it, it is ours.
    return axes, names[0 if is_body[0] else 1], forward == is_body[1]


def _quaternions(segment: Segment, seconds: FloatArray) -> tuple[FloatArray, str]:
    """Return the quaternions of the rows, scalar last, shape (n, 4), that turn frame A or B as the message says.

    With them a warning about the rates, or nothing.
    """
    fields = segment.fields
    kind = fields.one_of("ATTITUDE_TYPE", tuple(COLUMNS[segment.version]))
    columns = COLUMNS[segment.version][kind]
    sequence = _sequence(fields) if kind.startswith("EULER") or fields.text("EULER_ROT_SEQ") else ""
    _check_axes(segment, sequence)
    if kind.startswith("EULER"):
        numbers = segment.numbers(columns)
        q = np.asarray(Rotation.from_euler(sequence, numbers[:, :3], degrees=True).as_quat())
    else:
        # In XML the components have names, and the key may be left out.
        named = isinstance(segment.rows[0].values, dict)
        place = fields.one_of("QUATERNION_TYPE", ("FIRST", "LAST"), "LAST" if named or segment.version != "1.0" else "")
        if place == "FIRST" and not named:
            columns = tuple(key for k in (0, 4) for key in columns[k + 3 : k + 4] + columns[k : k + 3])
        numbers = segment.numbers(columns)
        q = numbers[:, [columns.index(key) for key in _Q]]
        check_length(q, segment.place)
    columns_of = {key: numbers[:, k] for k, key in enumerate(columns)}
    return q, _rates_doubt(segment, kind, columns_of, q, np.diff(seconds)[:, None]) if len(seconds) > 1 else ""


LARGEST_MISFIT = 0.5
"""Median difference of rates and slopes of the attitudes, relative to the larger, beyond which there is a warning."""
SMALLEST_TURN, LARGEST_TURN = 1e-3, 1.0
"""Turns between two rows [rad] that are compared: smaller ones are rounding, larger ones have no slope."""


def _rates_doubt(segment: Segment, kind: str, columns: dict[str, FloatArray], q: FloatArray, steps: FloatArray) -> str:
    """Return a warning if rates contradict the slopes of the attitudes, else nothing."""
    turns = Rotation.from_quat(q)
    slope = (turns[:-1].inv() * turns[1:]).as_rotvec()
    angle = np.linalg.norm(slope, axis=1)
    slope = np.degrees(slope) / steps
    if kind.endswith("ANGVEL"):
        fields = segment.fields
        if not (name := fields.text("ANGVEL_FRAME").upper()):
            return ""
        if name in ("REF_FRAME_A", fields.text("REF_FRAME_A").upper()):
            slope = turns[:-1].apply(slope)
    elif kind == "QUATERNION/DERIVATIVE":
        slope = (np.sign(np.sum(q[1:] * q[:-1], axis=1))[:, None] * q[1:] - q[:-1]) / steps
    else:
        return ""
    rates = np.stack([columns[key] for key in (_ANGVEL if kind.endswith("ANGVEL") else _Q_DOT)], axis=1)[:-1]
    larger = np.maximum(np.linalg.norm(slope, axis=1), np.linalg.norm(rates, axis=1))
    use = (angle > SMALLEST_TURN) & (angle < LARGEST_TURN)
    misfit = np.linalg.norm(slope - rates, axis=1)[use] / larger[use]
    if not len(misfit) or float(np.median(misfit)) < LARGEST_MISFIT:
        return ""
    return (
        f"{segment.place(int(np.flatnonzero(use)[0]) + 1)}: the rates contradict the attitudes, and are not used: "
        "is the scalar at the other end, the direction the inverse, or the unit of the rates another one?"
    )


def _sequence(fields: Fields) -> str:
    """Return the axes of Euler angles as letters, in the order of the turns."""
    expected = "three axes as 321 or ZYX, neighbours different"
    found = fields.needed("EULER_ROT_SEQ", expected).upper().translate(str.maketrans("123", "XYZ"))
    if not re.fullmatch("[XYZ]{3}", found) or found[0] == found[1] or found[1] == found[2]:
        raise UserError(f'found "{fields.text("EULER_ROT_SEQ")}"', where=fields.at("EULER_ROT_SEQ"), expected=expected)
    return found


def _check_axes(segment: Segment, sequence: str) -> None:
    """Refuse rows whose turns name other axes than the sequence (XML of the first version); no sequence fits all."""
    for row in segment.rows:
        if isinstance(row.values, dict):
            for number in range(3):
                for key in (f"ANGLE_{number + 1}", f"RATE_{number + 1}"):
                    found, axis = row.values.pop(f"{key}_AXIS", ""), sequence[number : number + 1]
                    if found and axis and found != axis:
                        where = f"{segment.at(row)}: {key}"
                        raise UserError(f"is about {found}", where=where, expected=f"{axis}, by EULER_ROT_SEQ")


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
