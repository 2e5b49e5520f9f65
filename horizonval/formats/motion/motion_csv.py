"""Orbits and attitudes as tables of text, whose columns say axes, units, direction and order.

An orbit has ``time_utc`` and ``x_gcrs_km``, ``y_gcrs_km``, ``z_gcrs_km``, or the same with ``itrs``; with
``vx_gcrs_km_s`` and so on the velocities. An attitude has ``time_utc`` and ``q_body_from_gcrs_x``, ``_y``, ``_z``,
``_w`` (the scalar), or the same with ``itrs``: the turn that takes components in those axes to those in the body's.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from horizonval.formats.csv_table import CsvTable, read_csv
from horizonval.formats.motion.attitude_history import AttitudeHistory, attitudes_of
from horizonval.formats.motion.axes import Axes, states_in_gcrs
from horizonval.formats.motion.times import seconds_after, utc_of
from horizonval.formats.motion.trajectory import Trajectory, piece_of

AXES: tuple[Axes, ...] = ("gcrs", "itrs")


def orbit_of_csv(path: Path) -> Trajectory:
    """Return the orbit in a table; a mistake is a :class:`UserError` with line and column."""
    moving = [("time_utc", *_place(axes), *_velocity(axes)) for axes in AXES]
    table = read_csv(path, *moving, *(("time_utc", *_place(axes)) for axes in AXES), texts=("time_utc",))
    axes: Axes = "gcrs" if "x_gcrs_km" in table.numbers else "itrs"
    times = _times(table)
    seconds = seconds_after(times[0], times)
    r = 1e3 * table.together(*_place(axes))
    v = 1e3 * table.together(*_velocity(axes)) if f"vx_{axes}_km_s" in table.numbers else None
    return Trajectory(
        times[0], (piece_of(seconds, *states_in_gcrs(axes, times[0], seconds, r, v), str(path)),), str(path)
    )


def attitude_of_csv(path: Path) -> AttitudeHistory:
    """Return the attitudes in a table; a mistake is a :class:`UserError` with line and column."""
    table = read_csv(path, *(("time_utc", *_quaternion(axes)) for axes in AXES), texts=("time_utc",))
    axes: Axes = "gcrs" if "q_body_from_gcrs_x" in table.numbers else "itrs"
    times = _times(table)
    q = table.together(*_quaternion(axes))
    piece = attitudes_of(seconds_after(times[0], times), q, str(path))
    return AttitudeHistory(times[0], (piece,), axes, str(path))


def _place(axes: Axes) -> tuple[str, ...]:
    return tuple(f"{letter}_{axes}_km" for letter in "xyz")


def _velocity(axes: Axes) -> tuple[str, ...]:
    return tuple(f"v{letter}_{axes}_km_s" for letter in "xyz")


def _quaternion(axes: Axes) -> tuple[str, ...]:
    return tuple(f"q_body_from_{axes}_{letter}" for letter in "xyzw")


def _times(table: CsvTable) -> list[datetime]:
    return [utc_of(text, table.place(row, "time_utc")) for row, text in enumerate(table.texts["time_utc"])]
