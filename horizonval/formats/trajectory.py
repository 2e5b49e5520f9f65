"""Orbits from files: states, and between them the polynomial through the nearest states.

With velocities it is Hermite's through the four nearest states, of degree 7, else Lagrange's through the eight nearest
positions, whose derivative is the velocity. For a circular orbit of 6 928 km and states a minute apart the error is
0.1 um with velocities and 40 um without. For states five minutes apart it is 7 mm in the middle of a piece and 2 cm at
its ends, without velocities 1 m and 12 m. Pieces are independent: a manoeuvre lies between two.

An interval in which the polynomial may be more than 100 m off is a gap, and positions in it are refused. The error is
the remainder of interpolation for a circular orbit: in low orbit the largest steps are 16 minutes with velocities and 8
without, near the ends of a piece 14 and 6.

* **Tables of text.** An orbit has ``time_utc`` and ``x_gcrs_km``, ``y_gcrs_km``, ``z_gcrs_km``, or the same with
  ``itrs``; with ``vx_gcrs_km_s`` and so on the velocities. An attitude has ``time_utc`` and ``q_body_from_gcrs_x``,
  ``_y``, ``_z``, ``_w`` (the scalar), or the same with ``itrs``.
* **SPICE kernels** are read by ``spiceypy``: SPK, and CK with clock and frame kernels. States are geometric, about the
  Earth in ``J2000``, which is taken as ``gcrs``. Kernels are a state of the whole process: they are loaded for each
  question and unloaded after it.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import KroghInterpolator
from scipy.spatial.transform import Rotation

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.formats import contradiction
from horizonval.formats.attitude import AttitudeHistory, Axes, attitudes_of, states_in_gcrs
from horizonval.formats.coverage import Coverage, coverage_of, outside, together
from horizonval.formats.csv_table import CsvTable, read_csv
from horizonval.geometry import clock
from horizonval.geometry.orbit import EARTH_RATE_RAD_S, GM_M3_PER_S2
from horizonval.geometry.rotation import itrs_from_gcrs

WITH_VELOCITY, WITHOUT = 4, 8
"""Nearest states that a polynomial goes through."""
FEWEST = 2
LARGEST_OFF_M = 100.0
"""Three arc seconds of the way round the Earth, in low orbit."""
LOWEST_KM, FARTHEST_KM = 6200.0, 2e6
"""Distances from the Earth's centre that a state may have; beyond, its unit is another one."""


@dataclass(frozen=True)
class TrajectoryPiece:
    """States without a manoeuvre between them.

    ``seconds`` after the trajectory's epoch, shape (m,), rising; ``r_gcrs`` [m] and ``v_gcrs`` [m/s], shape (m, 3).
    ``coverage``: spans of time with values. ``earth_fixed``: whether the states come from Earth-fixed axes.
    """

    seconds: FloatArray
    r_gcrs: FloatArray
    v_gcrs: FloatArray | None
    coverage: Coverage
    earth_fixed: bool = False


@dataclass(frozen=True)
class Trajectory:
    """Where a satellite is; ``where`` names the file for messages."""

    epoch_utc: datetime
    pieces: tuple[TrajectoryPiece, ...]
    where: str

    @cached_property
    def coverage(self) -> Coverage:
        """Spans of time with values."""
        return together([piece.coverage for piece in self.pieces])

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time with values."""
        if not len(self.coverage.begins):
            raise UserError("no state that may be used", where=self.where, expected="states in the usable span")
        return float(self.coverage.begins[0]), float(self.coverage.ends[-1])

    def states(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] in ``gcrs``, shape (n, 3) each, at times (n,) after the epoch.

        Raises
        ------
        UserError
            A time outside all pieces, or in a gap.
        """
        t = np.asarray(seconds, dtype=np.float64)
        r, v = np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan)
        for piece in self.pieces:
            inside = np.isfinite(piece.coverage.around(t)[0])
            if inside.any():
                r[inside], v[inside] = _between(piece, t[inside])
                if piece.earth_fixed and (turns := _turns_at_leap_seconds(self.epoch_utc, t[inside])) is not None:
                    r[inside], v[inside] = (turns.inv().apply(x[inside]) for x in (r, v))
        if np.isnan(r).any():
            first = float(t[int(np.flatnonzero(np.isnan(r[:, 0]))[0])])
            raise outside("state", self.epoch_utc, first, self.coverage, self.where)
        return r, v


def piece_of(
    axes: Axes,
    epoch_utc: datetime,
    seconds: FloatArray,
    r: FloatArray,
    v: FloatArray | None,
    where: str,
    usable_s: tuple[float, float] | None = None,
    place: Callable[[int], str] | None = None,
) -> TrajectoryPiece:
    """Return a piece, or a :class:`UserError` where its states are no way round the Earth or contradict each other.

    ``r`` [m] and ``v`` [m/s], shape (m, 3), are along ``axes``; Earth-fixed velocities are relative. States outside
    ``usable_s`` are interpolated through, and not flown. ``place``: name of a state, by its index, for messages.
    """
    named = place or (lambda k: f"{where}: state {k + 1}")
    if len(seconds) < FEWEST:
        raise UserError(f"{len(seconds)} states", where=where, expected=f"{FEWEST} and more")
    check_rising(seconds, named)
    distance_km = np.linalg.norm(r, axis=1) / 1e3
    for k, wrong in ((int(np.argmin(distance_km)), "below"), (int(np.argmax(distance_km)), "above")):
        if (distance_km[k] < LOWEST_KM) if wrong == "below" else (distance_km[k] > FARTHEST_KM):
            raise UserError(
                f"a state {distance_km[k]:.6g} km from the Earth's centre",
                where=named(k),
                expected=f"a position {LOWEST_KM:g} to {FARTHEST_KM:g} km from it; are these kilometres?",
            )
    r_gcrs, v_gcrs = states_in_gcrs(axes, epoch_utc, seconds, r, v)
    if axes == "itrs" and (turns := _turns_at_leap_seconds(epoch_utc, seconds)) is not None:
        r_gcrs, v_gcrs = turns.apply(r_gcrs), None if v_gcrs is None else turns.apply(v_gcrs)
    contradiction.check_positions(axes, seconds, r_gcrs, where, named)
    gaps = _gaps(seconds, r_gcrs, v is not None)
    if v_gcrs is not None:
        assert v is not None
        contradiction.check(axes, (seconds, r, v), (r_gcrs, v_gcrs), named)
    return TrajectoryPiece(seconds, r_gcrs, v_gcrs, coverage_of(seconds, gaps, usable_s), axes == "itrs")


def check_rising(seconds: FloatArray, place: Callable[[int], str]) -> None:
    """Refuse a time that is not after the one before it."""
    steps = np.diff(seconds)
    if (steps <= 0.0).any():
        k = int(np.flatnonzero(steps <= 0.0)[0]) + 1
        what = "the time of the row before" if steps[k - 1] == 0.0 else f"{-steps[k - 1]:g} s before the row before"
        raise UserError(what, where=place(k), expected="rising times")


def _turns_at_leap_seconds(epoch_utc: datetime, seconds: FloatArray) -> Rotation | None:
    """Return the turns, in celestial axes, by which UT1, taken as UTC, steps at leap seconds since the epoch.

    Earth-fixed states have no steps, but turned to celestial axes they would. None if there is no leap second.
    """
    steps = clock.leap_seconds(epoch_utc, seconds)
    if not steps.any():
        return None
    pole = itrs_from_gcrs(epoch_utc, seconds)[:, 2]
    return Rotation.from_rotvec(EARTH_RATE_RAD_S * steps[:, None] * pole)


def _nodes(total: int, interval: NDArray[np.intp], with_velocity: bool) -> tuple[int, NDArray[np.intp]]:
    """Return how many states the polynomials of intervals go through, and the first of them."""
    count = min(WITH_VELOCITY if with_velocity else WITHOUT, total)
    return count, np.clip(interval - (count // 2 - 1), 0, total - count)


def _gaps(seconds: FloatArray, r_gcrs: FloatArray, with_velocity: bool) -> NDArray[np.bool_]:
    """Return whether the polynomial of each interval, shape (m - 1,), may be too far off.

    A circle of radius R and rate w has n-th derivatives of R w^n, so that the remainder of a polynomial through n
    values is ``R prod|w (t - t_i)| / n!``, here at the middle. The rate is that of a circular orbit as high.
    """
    interval = np.arange(len(seconds) - 1)
    count, first = _nodes(len(seconds), interval, with_velocity)
    middle = (seconds[1:] + seconds[:-1]) / 2.0
    lowest = np.minimum(np.linalg.norm(r_gcrs[1:], axis=1), np.linalg.norm(r_gcrs[:-1], axis=1))
    rate = np.sqrt(GM_M3_PER_S2 / lowest**3)
    turns = np.abs(rate[:, None] * (middle[:, None] - seconds[first[:, None] + np.arange(count)]))
    values = 2 if with_velocity else 1
    off = lowest * np.prod(turns, axis=1) ** values / math.factorial(values * count)
    return np.asarray(off > LARGEST_OFF_M)


def _between(piece: TrajectoryPiece, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the states at times (n,) within a piece: those between the same two states by one polynomial."""
    interval = np.clip(np.searchsorted(piece.seconds, t, side="right") - 1, 0, len(piece.seconds) - 2)
    count, first = _nodes(len(piece.seconds), interval, piece.v_gcrs is not None)
    r, v = np.empty((len(t), 3)), np.empty((len(t), 3))
    for start in np.unique(first):
        here = first == start
        rows = slice(int(start), int(start) + count)
        origin, scale = piece.seconds[rows][0], float(np.ptp(piece.seconds[rows]))
        x = (piece.seconds[rows] - origin) / scale
        if piece.v_gcrs is None:
            polynomial = KroghInterpolator(x, piece.r_gcrs[rows])
        else:
            # A repeated node has its derivative as the second value.
            values = np.stack([piece.r_gcrs[rows], scale * piece.v_gcrs[rows]], axis=1).reshape(-1, 3)
            polynomial = KroghInterpolator(np.repeat(x, 2), values)
        at = (t[here] - origin) / scale
        r[here], v[here] = polynomial.derivatives(at, der=2)[:2] / np.array([1.0, scale])[:, None, None]
    return r, v


AXES: tuple[Axes, ...] = ("gcrs", "itrs")
LIKE_STATES = re.compile(r"(v?[xyz](_|\d|$|km)|v[xyz]|r[xyz](_|$)|pos|vel|time|epoch|utc|date)", re.IGNORECASE)
LIKE_ATTITUDES = re.compile(r"(q(_|\d|$|[wxyzs]|uat)|time|epoch|utc|date)", re.IGNORECASE)
"""Names that look like columns of ours."""


def orbit_of_csv(path: Path) -> Trajectory:
    """Return the orbit in a table; a mistake is a :class:`UserError` with line and column."""
    moving = [("time_utc", *_place(axes), *_velocity(axes)) for axes in AXES]
    table = read_csv(
        path, *moving, *(("time_utc", *_place(axes)) for axes in AXES), texts=("time_utc",), like=LIKE_STATES
    )
    axes: Axes = "gcrs" if "x_gcrs_km" in table.numbers else "itrs"
    epoch, seconds = _times(table)
    r = 1e3 * table.together(*_place(axes))
    v = 1e3 * table.together(*_velocity(axes)) if f"vx_{axes}_km_s" in table.numbers else None
    piece = piece_of(axes, epoch, seconds, r, v, str(path), place=lambda k: f"{path}: line {table.lines[k]}")
    return Trajectory(epoch, (piece,), str(path))


def attitude_of_csv(path: Path) -> AttitudeHistory:
    """Return the attitudes in a table; a mistake is a :class:`UserError` with line and column."""
    table = read_csv(
        path, *(("time_utc", *_quaternion(axes)) for axes in AXES), texts=("time_utc",), like=LIKE_ATTITUDES
    )
    axes: Axes = "gcrs" if "q_body_from_gcrs_x" in table.numbers else "itrs"
    epoch, seconds = _times(table)
    lines = [f"{path}: line {line}" for line in table.lines]
    check_rising(seconds, lines.__getitem__)
    piece = attitudes_of(seconds, table.together(*_quaternion(axes)), str(path), place=lines.__getitem__)
    return AttitudeHistory(epoch, (piece,), axes, str(path))


def _place(axes: Axes) -> tuple[str, ...]:
    return tuple(f"{letter}_{axes}_km" for letter in "xyz")


def _velocity(axes: Axes) -> tuple[str, ...]:
    return tuple(f"v{letter}_{axes}_km_s" for letter in "xyz")


def _quaternion(axes: Axes) -> tuple[str, ...]:
    return tuple(f"q_body_from_{axes}_{letter}" for letter in "xyzw")


def _times(table: CsvTable) -> tuple[datetime, FloatArray]:
    """Return the epoch of a table, its first time, and the seconds from it to all its rows."""
    texts = enumerate(table.texts["time_utc"])
    instants = [clock.instant_of(text, table.place(row, "time_utc")) for row, text in texts]
    epoch = clock.epoch_at(instants[0])
    return epoch, clock.seconds_after(epoch, instants)


RECORD_BYTES = 1024
"""Size of a record of a binary kernel."""


@dataclass(frozen=True)
class SpiceOrbit:
    """A spacecraft, by name or number, in kernels; ``body_axes`` names the frame of its attitude."""

    kernels: tuple[Path, ...]
    spacecraft: str
    epoch_utc: datetime
    body_axes: str | None = None

    def states(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] in ``gcrs``, shape (n, 3) each, at times (n,) after the epoch."""
        with _loaded(self.kernels) as spice:
            found = [
                spice.spkezr(self.spacecraft, et, "J2000", "NONE", "EARTH")[0] for et in self._times(spice, seconds)
            ]
        states = 1e3 * np.array(found)
        return states[:, :3], states[:, 3:]

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after an epoch."""
        offset = clock.elapsed_s(self.epoch_utc, epoch_utc)
        with _loaded(self.kernels) as spice:
            times = self._times(spice, np.asarray(seconds) + offset)
            return np.array([spice.pxform("J2000", self.body_axes, et) for et in times])

    def _times(self, spice: Any, seconds: FloatArray) -> list[float]:
        times = [spice.str2et(clock.stamp_after(self.epoch_utc, float(t))) for t in seconds]
        for et, t in zip(times[:: max(len(times) - 1, 1)], seconds[:: max(len(times) - 1, 1)], strict=True):
            tt = clock.julian_tt(self.epoch_utc, float(t))
            # TDB is within 2 ms of TT.
            late = et - ((tt[0] - 2451545.0) + tt[1]) * 86400.0
            if abs(late) > 0.1:
                raise UserError(
                    f"{clock.stamp_after(self.epoch_utc, float(t))} is {late:+.0f} s off: leap seconds other than "
                    "those of IERS",
                    where=_names(self.kernels),
                    expected="an up-to-date kernel of leap seconds (LSK)",
                )
        return times

    def check(self, begin_s: float, end_s: float) -> None:
        """Refuse velocities that contradict the positions, at five short spans between two times."""
        h = min(30.0, (end_s - begin_s) / 4.0)
        if h <= 0.0:
            return
        for start in np.linspace(begin_s, end_s - 4.0 * h, 5):
            seconds = start + h * np.arange(5.0)
            try:
                r, v = self.states(seconds)
            except UserError:
                # A gap, or an error that the flight itself finds.
                continue
            stamps = [clock.stamp_after(self.epoch_utc, float(t)) for t in seconds]
            places = [f"{_names(self.kernels)}: {self.spacecraft} at {stamp}" for stamp in stamps]
            contradiction.check("gcrs", (seconds, r, v), (r, v), places.__getitem__)


def span_of(kernels: Sequence[Path], spacecraft: str) -> tuple[int, int]:
    """Return first and last instant [ns, TAI] of the spacecraft's states in the kernels, a microsecond within them."""
    with _loaded(kernels) as spice:
        number = spice.bods2c(spacecraft)
        window: Any = None
        for index in range(spice.ktotal("SPK")):
            path = spice.kdata(index, "SPK")[0]
            if number in list(spice.spkobj(path)):
                window = spice.spkcov(path, number) if window is None else spice.spkcov(path, number, window)
        if window is None or spice.wncard(window) == 0:
            raise UserError(f"no states of {spacecraft!r}", where=_names(kernels), expected="an SPK of the spacecraft")
        first, last = spice.wnfetd(window, 0)[0], spice.wnfetd(window, spice.wncard(window) - 1)[1]
        stamps = [spice.et2utc(et, "ISOC", 6) for et in (first, last)]
    # The last digit is rounded, and may lie outside.
    begin, end = (clock.instant_of(stamp, _names(kernels)) for stamp in stamps)
    return begin + 1000, end - 1000


@contextlib.contextmanager
def _loaded(kernels: Sequence[Path]) -> Iterator[Any]:
    """Load kernels, and turn what the library says of them into one line."""
    where = _names(kernels)
    try:
        import spiceypy
    except ImportError:
        raise UserError("spiceypy is not installed", where=where, fix='run `pip install "horizonval[spice]"`') from None
    for path in kernels:
        _check_summaries(path)
    loaded: list[str] = []
    try:
        for path in kernels:
            _refuse_named_elsewhere(spiceypy, path)
        for path in kernels:
            spiceypy.furnsh(str(path))
            loaded.append(str(path))
        yield spiceypy
    except spiceypy.utils.exceptions.SpiceyError as error:
        short = " ".join(str(getattr(error, "short", "") or error).split())
        long = " ".join(str(getattr(error, "long", "") or "").split())
        raise UserError(f"SPICE: {short} {long}"[:300], where=where, expected="kernels that cover the orbit") from error
    finally:
        for name in loaded:
            spiceypy.unload(name)


def _check_summaries(path: Path) -> None:
    """Refuse a binary kernel whose chain of summary records is wrong: the library would follow a ring for ever.

    Each record (1024 bytes) of a DAF's chain begins with the next, the previous and the number of its summaries.
    """
    expected = "a SPICE kernel (SPK, CK, PCK or text)"
    with files.open_file(path, expected=expected) as file:
        head = file.read(RECORD_BYTES)
        if head[:4] == b"DAS/":
            raise UserError("is a shape or a table of events", where=str(path), expected=expected, fix="leave it out")
        if head[:4] != b"DAF/" and head[:8] != b"NAIF/DAF":
            return
        if len(head) < RECORD_BYTES:
            raise UserError("is truncated: it ends inside its first record", where=str(path), expected=expected)
        order = ">" if head[88:96] == b"BIG-IEEE" else "<"
        (n_double, n_integer), (first, last) = (struct.unpack_from(f"{order}2i", head, at) for at in (8, 76))
        if not (0 <= n_double <= 124 and 2 <= n_integer <= 250 and (n_integer + 1) // 2 <= 125 - n_double):
            raise UserError("its first record gives summaries of a wrong size", where=str(path), expected=expected)
        size = os.fstat(file.fileno()).st_size
        doubles = n_double + (n_integer + 1) // 2
        record, previous, seen = float(first), 0.0, set[float]()
        while record:
            where = f"{path}: summary record {record:g}"
            if not (record.is_integer() and 2 <= record <= size // RECORD_BYTES):
                raise UserError(f"is not in the file, after {previous:g}", where=where, expected=expected)
            seen.add(record)
            file.seek(int(record - 1) * RECORD_BYTES)
            data = file.read(RECORD_BYTES)
            following, back, count = struct.unpack_from(f"{order}3d", data)
            if following in seen:
                what = f"is followed by record {following:g} again: the summaries go round in a ring"
                raise UserError(what, where=where, expected=expected)
            if back != previous:
                raise UserError(f"names {back:g} as the one before, not {previous:g}", where=where, expected=expected)
            if count not in range(125 // doubles + 1):
                raise UserError(f"has {count:g} summaries", where=where, expected=f"at most {125 // doubles}")
            for k in range(int(count)):
                at = 24 + 8 * (k * doubles + n_double) + 4 * (n_integer - 2)
                begin, end = struct.unpack_from(f"{order}2i", data, at)
                if not 1 <= begin <= end <= size // 8:
                    what = f"segment {k + 1} has numbers {begin} to {end} of {size // 8}"
                    raise UserError(what, where=where, expected="numbers within the file")
            record, previous = following, record
        if last != previous:
            raise UserError(f"names {last} as the last summary record, not {previous:g}", where=str(path))


def _refuse_named_elsewhere(spice: Any, path: Path) -> None:
    """Refuse a meta-kernel that names anything but kernels of its own folder: the library would wait for a FIFO.

    Names are relative to the working folder, as the library takes them.
    """
    expected = "a kernel in the meta-kernel's folder"
    for name in _named_by(spice, path):
        if not files.is_inside(Path(name), path.parent):
            what = f"names {excerpt(name)!r}"
            if not Path(name).is_absolute():
                what += ", and SPICE starts such a path from the working folder"
            raise UserError(what, where=str(path), expected=expected, fix="list it in `kernels`")
        if files.is_same(name, path):
            raise UserError("names itself", where=str(path), expected=expected)
        _check_summaries(Path(name))
        if _named_by(spice, Path(name)):
            what = f"names {excerpt(name)!r}, which is a meta-kernel itself"
            raise UserError(what, where=str(path), expected=expected)


def _named_by(spice: Any, path: Path) -> list[str]:
    """Return the kernels that a text kernel names."""
    if spice.getfat(str(path))[0] != "KPL":
        return []
    spice.ldpool(str(path))
    try:
        pool = {}
        for key in ("KERNELS_TO_LOAD", "PATH_SYMBOLS", "PATH_VALUES"):
            try:
                pool[key] = list(spice.gcpool(key, 0, 10_000))
            except spice.utils.exceptions.NotFoundError:
                pool[key] = []
    finally:
        spice.clpool()
    if not pool["KERNELS_TO_LOAD"]:
        return []
    names = "\n".join(pool["KERNELS_TO_LOAD"]).replace("+\n", "").split("\n")
    for symbol, value in zip(pool["PATH_SYMBOLS"], pool["PATH_VALUES"], strict=False):
        names = [name.replace(f"${symbol}", value) for name in names]
    return names


def _names(kernels: Sequence[Path]) -> str:
    return ", ".join(str(path) for path in kernels)
