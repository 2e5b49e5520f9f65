"""A satellite's way round the Earth from mean elements: two bodies, and the secular drifts of the oblate Earth.

Position and velocity are those of a Kepler ellipse whose node, perigee and mean anomaly drift at the constant rates
that J2 gives them (Vallado, *Fundamentals of Astrodynamics and Applications*, 4th ed., eqs. 9-37, 9-39, 9-41), with
p = a (1 - e^2) and n = sqrt(GM / a^3)::

    dOmega/dt = -3/2 n J2 (Re / p)^2 cos i
    domega/dt =  3/4 n J2 (Re / p)^2 (4 - 5 sin^2 i)
    dM/dt     =  n + 3/4 n J2 (Re / p)^2 sqrt(1 - e^2) (2 - 3 sin^2 i)

An orbit is Sun-synchronous where the node keeps pace with the mean Sun, 360 deg in a tropical year: its inclination
follows from dOmega/dt (Vallado, section 11.4.1). The axes are the true equator and equinox of date, ``tod``;
Earth-fixed axes follow from the apparent sidereal time.

**Neglected**: the periodic part of J2 (10 km along the orbit and across), drag, and the pull of Moon and Sun. A scene
needs a position that such a satellite could have and an exact truth for it.

**Two-line elements** are propagated by SGP4 as published with its corrections (the ``sgp4`` package, gravity constants
WGS72, with which the elements are fitted), in the frames of :mod:`horizonval.geometry.rotation`. Elements describe a
real satellite to about a kilometre at their epoch and some kilometres a day after it. Here they define the orbit and
are the truth. Time from their epoch is counted in SI seconds; programs that subtract Julian dates of UTC (as the
interface of ``sgp4`` does) are one second of flight, 7.6 km, behind after a leap second.
"""

from __future__ import annotations

import calendar
import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime

import erfa
import numpy as np
from numpy.typing import ArrayLike
from sgp4.api import SGP4_ERRORS, Satrec
from sgp4.conveniences import sat_epoch_datetime

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import clock
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme, turn

GM_M3_PER_S2 = 3.986004418e14
"""WGS84."""
J2 = 1.08262668e-3
"""EGM96."""
EARTH_RADIUS_M = WGS84.a_m
TROPICAL_YEAR_S = 365.2421897 * 86400.0
"""At J2000 (Simon et al. 1994)."""

_KEPLER_STEPS = 30
_JD_1970, _DAY_1970 = 2440587.5, datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True)
class Elements:
    """Mean elements at an epoch, against the true equator and equinox of that date."""

    semi_major_axis_m: float
    eccentricity: float
    inclination_rad: float
    raan_rad: float
    argument_of_perigee_rad: float
    mean_anomaly_rad: float

    @property
    def mean_motion_rad_s(self) -> float:
        """Two-body mean motion."""
        return math.sqrt(GM_M3_PER_S2 / self.semi_major_axis_m**3)


def secular_rates(elements: Elements) -> tuple[float, float, float]:
    """Return the rates [rad/s] of node, argument of perigee and mean anomaly."""
    n, e, i = elements.mean_motion_rad_s, elements.eccentricity, elements.inclination_rad
    p = elements.semi_major_axis_m * (1.0 - e**2)
    k = 0.75 * n * J2 * (EARTH_RADIUS_M / p) ** 2
    sin2 = math.sin(i) ** 2
    return -2.0 * k * math.cos(i), k * (4.0 - 5.0 * sin2), n + k * math.sqrt(1.0 - e**2) * (2.0 - 3.0 * sin2)


def sun_synchronous_inclination(semi_major_axis_m: float, eccentricity: float = 0.0) -> float:
    """Return the inclination [rad] at which the node turns once in a tropical year; UserError if there is none."""
    equatorial = Elements(semi_major_axis_m, eccentricity, 0.0, 0.0, 0.0, 0.0)
    cosine = (2.0 * math.pi / TROPICAL_YEAR_S) / secular_rates(equatorial)[0]
    if cosine < -1.0:
        raise UserError(
            f"no inclination makes an orbit of semi-major axis {semi_major_axis_m / 1e3:g} km Sun-synchronous",
            expected="a circular orbit below 5 970 km",
        )
    return math.acos(cosine)


def mean_from_true_anomaly(true_anomaly_rad: float, eccentricity: float) -> float:
    """Return the mean anomaly [rad] of a true anomaly."""
    half = math.sqrt((1.0 - eccentricity) / (1.0 + eccentricity)) * math.tan(true_anomaly_rad / 2.0)
    anomaly = 2.0 * math.atan(half)
    return anomaly - eccentricity * math.sin(anomaly)


def eccentric_anomaly(mean_anomaly_rad: ArrayLike, eccentricity: float) -> FloatArray:
    """Return the solution [rad] of Kepler's equation ``M = E - e sin E``, by Newton's steps."""
    mean = np.asarray(mean_anomaly_rad, dtype=np.float64)
    reduced = np.remainder(mean + np.pi, 2.0 * np.pi) - np.pi
    # Danby's start, from which Newton's steps converge for every eccentricity below 1.
    anomaly = reduced + 0.85 * eccentricity * np.sign(np.sin(reduced))
    for _ in range(_KEPLER_STEPS):
        step = (anomaly - eccentricity * np.sin(anomaly) - reduced) / (1.0 - eccentricity * np.cos(anomaly))
        anomaly = anomaly - step
        if np.all(np.abs(step) < 1e-14):
            break
    return np.asarray(anomaly + (mean - reduced), dtype=np.float64)


def tod_states(elements: Elements, seconds: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities [m/s], shape (..., 3) each, some seconds after the elements' epoch.

    The velocity is that of the Kepler ellipse; the drift of its plane (below 2e-7 rad/s) is left out of it.
    """
    t = np.asarray(seconds, dtype=np.float64)
    node_rate, perigee_rate, mean_rate = secular_rates(elements)
    node = elements.raan_rad + node_rate * t
    perigee = elements.argument_of_perigee_rad + perigee_rate * t
    e, a = elements.eccentricity, elements.semi_major_axis_m
    anomaly = eccentric_anomaly(elements.mean_anomaly_rad + mean_rate * t, e)
    cos_e, sin_e = np.cos(anomaly), np.sin(anomaly)
    flat = math.sqrt(1.0 - e**2)
    speed = elements.mean_motion_rad_s * a / (1.0 - e * cos_e)
    cn, sn, cp, sp = np.cos(node), np.sin(node), np.cos(perigee), np.sin(perigee)
    ci, si = math.cos(elements.inclination_rad), math.sin(elements.inclination_rad)
    to_perigee = np.stack([cn * cp - sn * sp * ci, sn * cp + cn * sp * ci, sp * si], axis=-1)
    across = np.stack([-cn * sp - sn * cp * ci, -sn * sp + cn * cp * ci, cp * si], axis=-1)

    def in_plane(x: FloatArray, y: FloatArray) -> FloatArray:
        return x[..., None] * to_perigee + y[..., None] * across

    return in_plane(a * (cos_e - e), a * flat * sin_e), in_plane(-speed * sin_e, speed * flat * cos_e)


def sidereal_time(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return Greenwich apparent sidereal time [rad], shape (...), some seconds after an epoch (UT1 taken as UTC)."""
    tt, ut1 = clock.julian_tt(epoch_utc, seconds), clock.julian_ut1(epoch_utc, seconds)
    return np.asarray(erfa.gst06a(*ut1, *tt), dtype=np.float64)


def _second_of_day(epoch_utc: datetime) -> float:
    return 60.0 * (60 * epoch_utc.hour + epoch_utc.minute) + (epoch_utc.second + epoch_utc.microsecond * 1e-6)


def raan_of_local_time(epoch_utc: datetime, local_time_h: float) -> float:
    """Return the node [rad] that is passed northwards at a mean local time [h]: UTC and longitude / 15 deg.

    The node's right ascension is its longitude and the sidereal time. The Sun's own hour differs from mean local time
    by the equation of time, up to 16.5 min.
    """
    epoch = clock.in_range(epoch_utc)
    utc_h = _second_of_day(epoch) / 86400.0 * 24.0
    longitude = math.radians(15.0 * (local_time_h - utc_h))
    return math.remainder(longitude + float(sidereal_time(epoch_utc)), math.tau)


def turn_about_pole(angle_rad: ArrayLike) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take ``tod`` components to Earth-fixed ones at a sidereal time."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rows = [[c, s, zero], [-s, c, zero], [zero, zero, zero + 1.0]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def heading(r_itrs: ArrayLike, v_itrs: ArrayLike) -> FloatArray:
    """Return the azimuth [rad] of celestial velocities, from north to east in the geocentric level plane, shape (...).

    Positions and velocities have the shape (..., 3) along Earth-fixed axes; the azimuth is that of x of ``lvlh``.
    """
    r, v = np.asarray(r_itrs, dtype=np.float64), np.asarray(v_itrs, dtype=np.float64)
    longitude = np.arctan2(r[..., 1], r[..., 0])
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros_like(longitude)], axis=-1)
    up = r / np.linalg.norm(r, axis=-1, keepdims=True)
    north = np.cross(up, east)
    return np.arctan2(np.sum(v * east, axis=-1), np.sum(v * north, axis=-1))


def lvlh_matrices(r: ArrayLike, v: ArrayLike) -> FloatArray:
    """Return matrices, shape (..., 3, 3), from the axes of states, shape (..., 3) each, to ``lvlh``."""
    r, v = np.asarray(r, dtype=np.float64), np.asarray(v, dtype=np.float64)
    z = -r / np.linalg.norm(r, axis=-1, keepdims=True)
    y = np.cross(z, v)
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-2)


EARTH_RATE_RAD_S = 7.292115146706979e-5
"""Rotation of the Earth, WGS84 (as in Vallado's ``teme2ecef``)."""


_NUMBER, _POWER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)", re.ASCII), re.compile(r"[+-]?\d{1,5}[+-]\d", re.ASCII)
_FIELDS: tuple[tuple[str, int, int, int, re.Pattern[str], float, float], ...] = (
    ("year of the epoch", 1, 19, 20, re.compile(r"\d+", re.ASCII), 0, 99),
    ("day of the epoch", 1, 21, 32, _NUMBER, 1.0, 367.0),
    ("derivative of the mean motion", 1, 34, 43, _NUMBER, -1.0, 1.0),
    ("second derivative of the mean motion", 1, 45, 52, _POWER, 0, 0),
    ("drag term", 1, 54, 61, _POWER, 0, 0),
    ("inclination", 2, 9, 16, _NUMBER, 0.0, 180.0),
    ("right ascension of the node", 2, 18, 25, _NUMBER, 0.0, 360.0),
    ("eccentricity", 2, 27, 33, re.compile(r"\d+", re.ASCII), 0, 9_999_999),
    ("argument of perigee", 2, 35, 42, _NUMBER, 0.0, 360.0),
    ("mean anomaly", 2, 44, 51, _NUMBER, 0.0, 360.0),
    ("mean motion", 2, 53, 63, _NUMBER, 1e-5, 20.0),
)
"""Fields of the two lines: name, line, first and last column, form, and range where it is a plain number."""
_BLANKS = {1: (2, 9, 18, 33, 44, 53, 62, 64), 2: (2, 8, 17, 26, 34, 43, 52)}
"""Columns between the fields."""
_CATALOGUE_NUMBER = re.compile(r"[A-HJ-NP-Z]\d{4}|\d{1,5}", re.ASCII)
"""Five digits, or a letter in place of the first two (Alpha-5, without I and O)."""
THEORIES = " 023"
"""Ephemeris types of SGP4, with SDP4 for high orbits; distributed elements have 0."""


@dataclass(frozen=True)
class ElementSet:
    """Two lines of 69 columns, as distributed; UserError names the line and the columns that are wrong."""

    line1: str
    line2: str

    def __post_init__(self) -> None:
        for number, line in enumerate((self.line1, self.line2), 1):
            # The line itself is not shown: it may be of a file that is something else.
            what = f"line {number} of the element set"
            if len(line) != 69 or line[0] != str(number):
                raise UserError(f"{what} has {len(line)} columns", expected=f"69 columns, the first of them {number}")
            total = sum(int(c) if c in "0123456789" else c == "-" for c in line[:68]) % 10
            if line[68] != str(total):
                raise UserError(
                    f"{what} is not what was distributed",
                    expected=f"checksum {total} in the last column",
                    fix="check the copied digits",
                )
            if stray := [column for column in _BLANKS[number] if line[column - 1] != " "]:
                raise UserError(f"{what}: column {stray[0]} is not blank", expected="the columns of the format")
        if self.line1[2:7].strip().lstrip("0") != self.line2[2:7].strip().lstrip("0"):
            raise UserError(
                f"element set of satellites {self.line1[2:7]} and {self.line2[2:7]}", expected="two lines of one"
            )
        if not _CATALOGUE_NUMBER.fullmatch(self.line1[2:7].strip()):
            raise UserError(
                "line 1 of the element set: columns 3 to 7, the catalogue number",
                expected="five digits, or a letter and four digits (Alpha-5)",
            )
        self._check_fields()
        try:
            satellite = self.satellite()
        except ValueError as e:
            raise UserError(
                f"element set of satellite {self.line1[2:7]}", expected="numbers in the columns of the format"
            ) from e
        if satellite.error:
            raise UserError(f"element set of satellite {self.line1[2:7]}: {SGP4_ERRORS[satellite.error]}")

    def _check_fields(self) -> None:
        if self.line1[62] not in THEORIES:
            theory = "SGP4-XP, another theory" if self.line1[62] == "4" else "another theory than SGP4"
            raise UserError(
                f"line 1 of the element set: column 63, ephemeris type {self.line1[62]!r}: elements of {theory}",
                expected="type 0, elements of SGP4",
            )
        for name, line, first, last, form, least, most in _FIELDS:
            text = (self.line1, self.line2)[line - 1][first - 1 : last]
            where = f"line {line} of the element set: columns {first} to {last}, {name}"
            if not form.fullmatch(text.strip()):
                raise UserError(where, expected="a number in the form of the format")
            if most > least and not least <= float(text) <= most:
                raise UserError(f"{where}: {text.strip()}", expected=f"{least:g} to {most:g}")
        year, day = int(self.line1[18:20]), float(self.line1[20:32])
        year += 1900 if year > 56 else 2000
        if day >= (last_day := 367 if calendar.isleap(year) else 366):
            raise UserError(
                f"line 1 of the element set: columns 21 to 32, day of the epoch: {day:g}",
                expected=f"below {last_day}, the end of {year}",
            )

    def satellite(self) -> Satrec:
        """Return the satellite as SGP4 reads it."""
        return Satrec.twoline2rv(self.line1, self.line2)


def teme_states(elements: ElementSet, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities [m/s] in the elements' frame, shape (..., 3) each, seconds after an epoch.

    UserError: the satellite has decayed, or the epoch (UTC without a time zone) is out of range.
    """
    return satellite_states(elements.satellite(), epoch_utc, seconds)


def epoch_of(satellite: Satrec) -> datetime:
    """Return the epoch (UTC) of a satellite's elements."""
    return sat_epoch_datetime(satellite).astimezone(UTC)


FARTHEST_DAYS, DRAG_ERROR = 7.0, 0.2
"""Days from the epoch of elements to a warning; relative error of the drag, whose source is the forecast density."""
LARGEST_DRAG_ERROR_M = 10e3


def far_from_epoch(satellite: Satrec, epoch_utc: datetime, seconds: FloatArray) -> str:
    """Return a warning if instants are so far from the epoch of the elements that SGP4 is far off; else nothing.

    Elements of low orbits are about 1 km off at their epoch and 1 to 3 km a day more (Vallado and Cefola, IAC-12;
    Kelso, AAS 07-127). Drag is uncertain by :data:`DRAG_ERROR`: that share of the
    way along the orbit that the derivative of the mean motion makes.
    """
    ages = (clock.elapsed_s(epoch_of(satellite), epoch_utc) + np.asarray(seconds, dtype=np.float64)) / 86400.0
    days = float(ages[int(np.argmax(np.abs(ages)))])
    axis_m = (GM_M3_PER_S2 / (satellite.no_kozai / 60.0) ** 2) ** (1.0 / 3.0)
    drag_m = DRAG_ERROR * axis_m * abs(satellite.ndot) * (1440.0 * days) ** 2
    if abs(days) <= FARTHEST_DAYS and drag_m <= LARGEST_DRAG_ERROR_M:
        return ""
    off_km = 1.0 + 2.0 * abs(days) + drag_m / 1e3
    lost = off_km * 1e3 > 0.5 * EARTH_RADIUS_M
    size = "anywhere on its orbit, or decayed" if lost else f"{off_km:.2g} km off"
    when = "after" if days > 0.0 else "before"
    epoch = epoch_of(satellite).replace(tzinfo=None).isoformat(timespec="seconds")
    far = f"up to {abs(days):.3g} days {when} the epoch of the elements, {epoch}"
    return f"{far}: the satellite is likely {size}; take elements of a nearer epoch"


def _days_of_sgp4(satellite: Satrec, epoch_utc: datetime, seconds: ArrayLike) -> tuple[float, FloatArray]:
    """Return instants as SGP4 counts them: days of 86400 s, in two parts, the difference to its epoch in SI seconds."""
    epoch, own = clock.in_range(epoch_utc), epoch_of(satellite)
    day = epoch.replace(hour=0, minute=0, second=0, microsecond=0)
    leap_seconds = clock.elapsed_s(own, epoch) - (epoch - own).total_seconds()
    fraction = (_second_of_day(epoch) + leap_seconds) / 86400.0
    return _JD_1970 + (day - _DAY_1970).days, fraction + np.asarray(seconds, float) / 86400.0


def satellite_states(satellite: Satrec, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return what :func:`teme_states` does, of elements that SGP4 has read."""
    day, fraction = np.broadcast_arrays(*_days_of_sgp4(satellite, epoch_utc, seconds))
    shape = fraction.shape
    codes, r_km, v_km_s = satellite.sgp4_array(
        np.ascontiguousarray(day, float).ravel(), np.ascontiguousarray(fraction, float).ravel()
    )
    if codes.any():
        first = int(np.flatnonzero(codes)[0])
        # A number that SGP4 cannot hold is 0.
        name = f"satellite {satellite.satnum_str}" if satellite.satnum else "the satellite"
        raise UserError(
            f"{name} at {clock.stamp_after(epoch_utc, np.ravel(seconds)[first])}: {SGP4_ERRORS[int(codes[first])]}",
            expected="an instant nearer to the elements' epoch",
        )
    return 1e3 * r_km.reshape(*shape, 3), 1e3 * v_km_s.reshape(*shape, 3)


def itrs_states(elements: ElementSet, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities against the turning Earth [m/s], Earth-fixed; see :func:`teme_states`."""
    r, v = teme_states(elements, epoch_utc, seconds)
    matrices = itrs_from_teme(epoch_utc, seconds)
    r_itrs = turn(matrices, r)
    spin = np.array([0.0, 0.0, EARTH_RATE_RAD_S])
    return r_itrs, turn(matrices, v) - np.cross(spin, r_itrs)


def gcrs_states(elements: ElementSet, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities [m/s] in celestial axes, shape (..., 3) each; see :func:`teme_states`."""
    r, v = teme_states(elements, epoch_utc, seconds)
    matrices = np.swapaxes(itrs_from_gcrs(epoch_utc, seconds), -1, -2) @ itrs_from_teme(epoch_utc, seconds)
    return turn(matrices, r), turn(matrices, v)
