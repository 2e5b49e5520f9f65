"""Orbit ephemeris messages (CCSDS 502.0-B-1 to -3), KVN and XML.

The states are interpolated as those of every file, whatever method a message names; states outside the usable span
serve for that alone. Accelerations and covariances are not read.
"""

from __future__ import annotations

from pathlib import Path

from horizonval.core.errors import UserError
from horizonval.formats.attitude import axes_of
from horizonval.formats.ndm import check_order, one_message
from horizonval.formats.trajectory import Trajectory, TrajectoryPiece, piece_of
from horizonval.geometry.clock import epoch_at, seconds_after

EXPECTED = "an orbit ephemeris message, KVN or XML"
STATE = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
ACCELERATION = ("X_DDOT", "Y_DDOT", "Z_DDOT")


def orbit_of_oem(path: Path, satellite: str | None = None) -> Trajectory:
    """Return the orbit in a message; ``satellite`` chooses one by name or designator.

    Raises
    ------
    UserError
        With file, line and key: no message that can be read, several satellites or several messages of one, another
        centre than the Earth, unknown axes or time system, states that are no orbit.
    """
    segments = one_message(path, "oem", EXPECTED, satellite)
    for segment in segments:
        segment.fields.check_earth()
    instants = [segment.instants() for segment in segments]
    epoch = epoch_at(instants[0][0])
    pieces: list[TrajectoryPiece] = []
    for segment, times in zip(segments, instants, strict=True):
        fields, numbers = segment.fields, segment.numbers(STATE, ACCELERATION)
        axes = axes_of(fields.needed("REF_FRAME", "the axes of the states"), fields.at("REF_FRAME"))
        if fields.instant("REF_FRAME_EPOCH") is not None and axes != "gcrs":
            at = fields.at("REF_FRAME_EPOCH")
            raise UserError("axes of a fixed epoch are not read", where=at, expected=f"{axes.upper()} of date")
        r, v = 1e3 * numbers[:, :3], 1e3 * numbers[:, 3:6]
        where, usable = fields.where, fields.usable_s(epoch)
        pieces.append(piece_of(axes, epoch, seconds_after(epoch, times), r, v, where, usable, segment.place))
    check_order([piece.coverage for piece in pieces], segments)
    return Trajectory(epoch, tuple(pieces), str(path))
