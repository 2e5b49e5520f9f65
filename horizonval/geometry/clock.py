"""Instants, elapsed time and Julian dates: everything is counted in SI seconds, through TAI.

An instant is either a ``datetime`` in UTC, as users write it, or an integer, *nanoseconds of TAI since
1970-01-01T00:00:00 TAI*. The integer can hold an instant within a leap second, which a ``datetime`` cannot. "Seconds
after an epoch" are SI seconds everywhere: 2016-12-31T12:00:00 and 2017-01-01T12:00:00 are 86 401 s apart.

* **Before 1972** a second of UTC was up to 3e-8 longer than that of SI, and UTC had steps of 0.05 and 0.1 s. The
  table of ERFA (IERS, from 1960) is followed, so that elapsed seconds are SI seconds there too.
* **After the last entry of ERFA's table** the newest offset is kept. A leap second announced later makes instants one
  second wrong until pyerfa is updated.
* **UT1** is taken as UTC. It is below 0.9 s off, and has a step of one second at the end of a leap second.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from typing import Any, Literal, TypeAlias

import erfa
import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt

_ORIGIN = datetime(1970, 1, 1, tzinfo=UTC)
_ORIGIN_JD = 2440587.5
_S, _DAY = 10**9, 86400 * 10**9
_MICROSECOND = timedelta(microseconds=1)
_FIRST_WHOLE_YEAR = 1972
"""First year in which TAI - UTC is a whole number of seconds."""
YEARS = "a year between 1960 (first UTC) and 2099"
Julian: TypeAlias = tuple[Any, Any]
"""A Julian date in two parts, numbers or arrays."""


def _quietly(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call ERFA without its warning of a "dubious year", which says that the newest offset is kept."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        return function(*arguments)


@lru_cache(maxsize=4096)
def _offset_ns(year: int, month: int, day: int = 1, fraction: float = 0.0) -> int:
    return round(float(_quietly(erfa.dat, year, month, day, fraction)) * _S)


def _tai_minus_utc(utc_ns: int) -> int:
    """Return TAI - UTC [ns] where the UTC clock shows ``utc_ns`` since 1970, in days of 86400 s."""
    day, rest = divmod(utc_ns, _DAY)
    try:
        date = _ORIGIN + timedelta(days=day)
    except OverflowError:
        raise UserError("an instant in another age", expected=YEARS) from None
    if not 1960 <= date.year < 2100:
        raise UserError(f"an instant in the year {date.year}", expected=YEARS)
    if date.year >= _FIRST_WHOLE_YEAR:
        return _offset_ns(date.year, date.month)
    return _offset_ns(date.year, date.month, date.day, rest / _DAY)


def in_range(epoch_utc: datetime) -> datetime:
    """Return an epoch with the time zone UTC, which it has if it names none; UserError outside 1960 to 2099."""
    try:
        found = epoch_utc.replace(tzinfo=UTC) if epoch_utc.tzinfo is None else epoch_utc.astimezone(UTC)
    except OverflowError:
        found = epoch_utc.replace(tzinfo=UTC)
    if not 1960 <= found.year < 2100:
        raise UserError(f"epoch {epoch_utc.isoformat()}", expected=YEARS)
    return found


def tai_of(epoch_utc: datetime) -> int:
    """Return the instant [ns, TAI] of an epoch in UTC."""
    shown = (in_range(epoch_utc) - _ORIGIN) // _MICROSECOND * 1000
    return shown + _tai_minus_utc(shown)


def _shown(tai_ns: int) -> tuple[int, bool]:
    """Return what the UTC clock shows [ns since 1970], and whether the instant lies within a leap second.

    There the clock is at 86400 s and more of its day, so that the number is also one of the next day.
    """
    offset = _tai_minus_utc(tai_ns)
    for _ in range(4):
        previous, offset = offset, _tai_minus_utc(tai_ns - offset)
        if previous == offset:
            return tai_ns - offset, False
    return tai_ns - min(previous, offset), abs(previous - offset) > _S // 1000


def utc_at(tai_ns: int) -> datetime:
    """Return an instant as a UTC ``datetime``, to the microsecond; UserError within a leap second."""
    shown, leaping = _shown(tai_ns)
    if leaping:
        raise UserError(
            f"{stamp(tai_ns)} lies within a leap second",
            expected="an instant that an epoch can hold",
            fix="move the epoch by a second",
        )
    found = _ORIGIN + timedelta(microseconds=round(shown / 1000) if shown % 1000 else shown // 1000)
    # Rounding up must not jump over a leap second.
    return found if tai_of(found) - tai_ns < _S // 1000 else found - _MICROSECOND


def stamp(tai_ns: int) -> str:
    """Return an instant as text, ``2016-12-31T23:59:60.5``, in UTC, to the microsecond."""
    shown, leaping = _shown(tai_ns)
    second = timedelta(seconds=1 if leaping else 0)
    text = (_ORIGIN + timedelta(microseconds=shown // 1000) - second).replace(tzinfo=None).isoformat()
    return text.replace(":59:59", ":59:60") if leaping else text


def epoch_at(tai_ns: int) -> datetime:
    """Return the last UTC ``datetime`` that is not after an instant: within a leap second the one before it."""
    shown, leaping = _shown(tai_ns)
    if leaping:
        shown = shown // _DAY * _DAY - 1
    return _ORIGIN + timedelta(microseconds=shown // 1000)


def _after(epoch_utc: datetime, seconds: float) -> int:
    if not abs(seconds) < 1e10:
        raise UserError(f"an instant {seconds:g} s from the epoch", expected=YEARS)
    return tai_of(epoch_utc) + round(seconds * _S)


def utc_after(epoch_utc: datetime, seconds: float) -> datetime:
    """Return the UTC ``datetime`` so many SI seconds after an epoch; UserError within a leap second."""
    return utc_at(_after(epoch_utc, seconds))


def stamp_after(epoch_utc: datetime, seconds: float) -> str:
    """Return the instant so many SI seconds after an epoch as text; see :func:`stamp`."""
    return stamp(_after(epoch_utc, seconds))


def elapsed_s(first_utc: datetime, second_utc: datetime) -> float:
    """Return the SI seconds from one epoch to another."""
    return (tai_of(second_utc) - tai_of(first_utc)) / _S


def seconds_after(epoch_utc: datetime, instants: Iterable[int]) -> FloatArray:
    """Return the SI seconds from an epoch to instants [ns, TAI], shape (n,)."""
    origin = tai_of(epoch_utc)
    return np.array([(instant - origin) / _S for instant in instants], dtype=np.float64)


# ---- Clocks of other files ----------------------------------------------------------------------------------------

_TEXT = re.compile(
    r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))[T ](\d\d):(\d\d):(\d\d)(?:\.(\d*))?\s*(?:Z|([+-])(\d\d):?(\d\d))?", re.I
)
EXPECTED = "a time as 2026-03-20T12:00:00.25 or 2026-079T12:00:00.25"


def _tdb_minus_tt(jd: float) -> float:
    return float(erfa.dtdb(_ORIGIN_JD, jd, 0.0, 0.0, 0.0, 0.0))


def _of_tdb(shown: int) -> int:
    return shown - 32_184_000_000 - round(_tdb_minus_tt(shown / _DAY) * _S)


def _of_coordinate_time(convert: Callable[..., Any], then: Callable[[int], int], shown: int) -> int:
    # Of the second parts only: the first, a whole day, would cost the nanoseconds.
    day, rest = divmod(shown, _DAY)
    one, two = convert(_ORIGIN_JD + day, rest / _DAY)
    return then(round((float(one) - _ORIGIN_JD - day) * _DAY) + day * _DAY + round(float(two) * _DAY))


def _of_tt(shown: int) -> int:
    return shown - 32_184_000_000


_TAI_FROM: dict[str, Callable[[int], int]] = {
    "TAI": lambda shown: shown,
    "GPS": lambda shown: shown + 19 * _S,
    "TT": _of_tt,
    "TDB": _of_tdb,
    "TCG": lambda shown: _of_coordinate_time(erfa.tcgtt, _of_tt, shown),
    "TCB": lambda shown: _of_coordinate_time(erfa.tcbtdb, _of_tdb, shown),
}
"""Instants [ns, TAI] of what clocks of other systems show."""
SYSTEMS = ("UTC", *_TAI_FROM)
"""Time systems of CCSDS that can be read. UT1 needs a table of measured values, and the others a spacecraft's clock."""


def check_system(name: str, where: str) -> str:
    """Return the name of a time system in capitals; UserError for one that cannot be read."""
    found = name.strip().upper()
    if found not in SYSTEMS:
        why = "UT1 - UTC is measured, and no table of it is read" if found == "UT1" else ""
        raise UserError(f'found "{excerpt(name)}"', where=where, expected=" or ".join(SYSTEMS), fix=why)
    return found


def instant_of(text: str, where: str, system: str = "UTC") -> int:
    """Return the instant [ns, TAI] of ``2026-03-20T12:00:00.25``, or with the day of the year, ``2026-079T...``.

    A ``Z`` or, in UTC, a time zone as ``+00:00`` may follow. ``2016-12-31T23:59:60.5`` is read where the table has a
    leap second. ``system``: one of :data:`SYSTEMS`.
    """
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=EXPECTED)
    year, month, day, of_year, hour, minute, second, part, sign, zone_h, zone_min = found.groups()
    if system != "UTC" and sign is not None:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=f"a time of {system} without a time zone")
    sixty = second == "60"
    try:
        begin = datetime(int(year), int(month or 1), int(day or 1), int(hour), int(minute), tzinfo=UTC)
        if of_year is not None:
            begin += timedelta(days=int(of_year) - 1)
            if begin.year != int(year) or of_year == "000":
                raise ValueError
        if int(second) > 60 or (sign is not None and int(zone_min) > 59):
            raise ValueError
    except (ValueError, OverflowError):
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=EXPECTED) from None
    zone = 0 if sign is None else (int(zone_h) * 60 + int(zone_min)) * 60 * _S * (1 if sign == "+" else -1)
    shown = (begin - _ORIGIN) // _MICROSECOND * 1000 + int(second) * _S + round(float(f"0.{part or 0}") * _S) - zone
    try:
        if system != "UTC":
            if sixty:
                raise UserError(f'found "{excerpt(text)}"', expected=f"seconds below 60: {system} has no leap seconds")
            return _TAI_FROM[system](shown)
        before = _tai_minus_utc(shown - _S) if sixty else _tai_minus_utc(shown)
        if sixty and _tai_minus_utc(shown) - before != _S:
            raise UserError(
                f'found "{excerpt(text)}"', expected="seconds below 60: no leap second is known at this instant"
            )
        return shown + before
    except UserError as error:
        raise error.at(where) from error


# ---- Julian dates -------------------------------------------------------------------------------------------------


def julian_utc(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> Julian:
    """Return instants, SI seconds after an epoch, as two-part Julian dates of UTC: a day, and days after it.

    A day that ends in a leap second is divided into 86401 parts, as in ERFA (its "quasi-JD").
    """
    epoch = in_range(epoch_utc)
    second = epoch.second + epoch.microsecond * 1e-6
    day, fraction = _quietly(erfa.dtf2d, "UTC", epoch.year, epoch.month, epoch.day, epoch.hour, epoch.minute, second)
    t = np.asarray(seconds, dtype=np.float64)
    kind = _days(epoch, t)
    if kind == "uniform":
        return float(day), float(fraction) + t / erfa.DAYSEC
    if kind == "stretched":
        tai = _quietly(erfa.utctai, day, fraction)
        whole, part = _quietly(erfa.taiutc, tai[0], float(tai[1]) + t / erfa.DAYSEC)
        return np.asarray(whole, dtype=np.float64), np.asarray(part, dtype=np.float64)
    # Exact, so that rounding moves no instant to the other side of the step.
    origin = tai_of(epoch)
    days = np.array([_quasi_day(origin + round(x * _S)) for x in t.ravel().tolist()])
    return days[:, 0].reshape(t.shape), days[:, 1].reshape(t.shape)


def _quasi_day(tai_ns: int) -> tuple[float, float]:
    shown, leaping = _shown(tai_ns)
    day, rest = divmod(shown, _DAY)
    if leaping:
        day, rest = day - 1, rest + _DAY
    length = _DAY + _tai_minus_utc((day + 1) * _DAY) - _tai_minus_utc(day * _DAY)
    return _ORIGIN_JD + day, rest / length


def _days(epoch: datetime, t: FloatArray) -> Literal["uniform", "stretched", "leap"]:
    """Return what the days from the epoch to times [s] after it are: of 86400 s, stretched, or with a leap."""
    if not t.size or not t.any():
        return "uniform"
    try:
        first = epoch + timedelta(seconds=float(min(t.min(), 0.0)))
        # A leap second belongs to the day before the step of the table.
        last = epoch + timedelta(seconds=float(max(t.max(), 0.0)) + 86401.0)
    except (OverflowError, ValueError):
        raise UserError(f"an instant {float(np.abs(t).max()):g} s from the epoch", expected=YEARS) from None
    if first.year < _FIRST_WHOLE_YEAR:
        return "stretched"
    return "uniform" if _offset_ns(first.year, first.month) == _offset_ns(last.year, last.month) else "leap"


def leap_seconds(epoch_utc: datetime, seconds: ArrayLike) -> FloatArray:
    """Return by how much TAI - UTC [s] has grown from an epoch to instants, SI seconds after it, shape (...)."""
    epoch, t = in_range(epoch_utc), np.asarray(seconds, dtype=np.float64)
    if _days(epoch, t) == "uniform":
        return np.zeros_like(t)
    origin = tai_of(epoch)
    shown = np.array([_shown(origin + round(x * _S))[0] - (origin + round(x * _S)) for x in t.ravel().tolist()])
    return (_shown(origin)[0] - origin - shown.reshape(t.shape)) / _S


def julian_tai(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> Julian:
    """Return instants, SI seconds after an epoch, as two-part Julian dates of TAI."""
    one, two = _quietly(erfa.utctai, *julian_utc(epoch_utc, seconds))
    return one, two


def julian_tt(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> Julian:
    """Return instants, SI seconds after an epoch, as two-part Julian dates of terrestrial time."""
    one, two = erfa.taitt(*julian_tai(epoch_utc, seconds))
    return one, two


def julian_ut1(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> Julian:
    """Return instants, SI seconds after an epoch, as two-part Julian dates of UT1, taken as UTC."""
    one, two = _quietly(erfa.utcut1, *julian_utc(epoch_utc, seconds), 0.0)
    return one, two
