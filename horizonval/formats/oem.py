"""Orbit ephemeris messages (CCSDS 502.0-B), KVN and XML, read by the library ``oem``.

The states are interpolated as those of every file, whatever method a message names; states outside the usable span
serve for that alone. Covariances are not read.
"""

from __future__ import annotations

import warnings
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.formats.attitude import axes_of, states_in_gcrs
from horizonval.formats.ccsds import MAX_FILE_BYTES, check_earth, seconds_after
from horizonval.formats.trajectory import Trajectory, TrajectoryPiece, piece_of

OEM_EXPECTED = "an orbit ephemeris message, KVN or XML"


def orbit_of_oem(path: Path) -> Trajectory:
    """Return the orbit in a message; UserError names file and key, or that ``oem`` is not installed."""
    try:
        from oem import OrbitEphemerisMessage
    except ImportError:
        raise UserError("oem is not installed", where=str(path), fix='run `pip install "horizonval[ccsds]"`') from None
    files.read_bytes(path, largest=MAX_FILE_BYTES, expected=OEM_EXPECTED)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            message = OrbitEphemerisMessage.open(str(path))
            segments = list(message)
            read = [(segment.metadata, *_states(segment)) for segment in segments]
        except Exception as error:
            text = " ".join(str(error).split())[:120] or type(error).__name__
            raise UserError(f"cannot be read: {text}", where=str(path), expected=OEM_EXPECTED) from error
    epoch = read[0][1][0]
    pieces = tuple(_piece(path, number, epoch, *one) for number, one in enumerate(read, 1))
    return Trajectory(epoch, pieces, str(path))


def _states(segment: Any) -> tuple[list[datetime], np.ndarray, np.ndarray]:
    """Return times, positions [m] and velocities [m/s] of all states."""
    states = list(segment.states)
    times = [state.epoch.utc.to_datetime(timezone=UTC) for state in states]
    r_km, v_km_s = (np.array([getattr(state, name) for state in states]) for name in ("position", "velocity"))
    return times, 1e3 * r_km, 1e3 * v_km_s


def _piece(
    path: Path, number: int, epoch: datetime, metadata: Any, times: list[datetime], r: np.ndarray, v: np.ndarray
) -> TrajectoryPiece:
    where = f"{path}: segment {number}"
    check_earth({"CENTER_NAME": str(metadata["CENTER_NAME"])}, where)
    axes = axes_of(str(metadata["REF_FRAME"]), f"{where}: REF_FRAME")
    seconds = seconds_after(epoch, times)
    usable = [
        (time.utc.to_datetime(timezone=UTC) - epoch).total_seconds()
        for time in (metadata.useable_start_time, metadata.useable_stop_time)
    ]
    return piece_of(seconds, *states_in_gcrs(axes, epoch, seconds, r, v), where, (usable[0], usable[1]))
