"""Where Sun and Moon are, and how large they look.

Direction: the Earth's heliocentric position from ERFA's VSOP2000 series (``epv00``, 5e-8 au), aberrated with the
Earth's barycentric velocity, taken to Earth-fixed axes with the IAU 2006/2000A matrix (``c2t06a``). This is the
apparent direction from the geocentre. Neglected, with sizes:

* UT1 - UTC (below 0.9 s: 13.5 arcsec about the pole, 0.014 deg of longitude of the terminator), polar motion (0.6
  arcsec): both need a measured table, and a scene's epoch is not known better than that matters;
* the Sun's own motion during the light time (0.01 arcsec), TDB - TT (2 ms: 1e-4 arcsec), light bending (Sun's own
  direction: none at its centre);
* parallax of the observer (9 arcsec from low orbit, 58 arcsec from geostationary orbit) and aberration by orbital
  motion (5 arcsec): the Sun is a direction at infinity, one for the whole scene.

The Moon: ERFA's series ``moon98`` (Meeus 1998 after ELP 2000-82; 10 arcsec in longitude, 4 in latitude, 18 km), brought
to Earth-fixed axes with the same matrix. It is near: its direction is taken from where the camera is. Its annual
aberration and the light time leave the observer's motion about the Earth's centre (5 arcsec from low orbit).
"""

from __future__ import annotations

import warnings
from datetime import UTC, datetime

import erfa
import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.directions import off_axis_angle

SUN_RADIUS_M = 6.957e8
"""IAU 2015 resolution B3 nominal solar radius."""

AU_M = float(erfa.DAU)

MOON_RADIUS_M = 1.7374e6
"""IAU mean radius (Archinal et al. 2018)."""


def _tt_ut(epoch_utc: datetime) -> tuple[float, float, float, float]:
    if epoch_utc.tzinfo is not None:
        epoch_utc = epoch_utc.astimezone(UTC)
    if not 1960 <= epoch_utc.year < 2100:
        raise UserError(
            f"epoch {epoch_utc.isoformat()}",
            where="platform.epoch_utc",
            expected="a year between 1960 (first UTC) and 2099 (end of the Sun's series)",
        )
    with warnings.catch_warnings():
        # "Dubious year" beyond the table of leap seconds: the newest offset is kept, which the docstring's 0.9 s
        # understates by a few seconds at the end of the century.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        seconds = epoch_utc.second + epoch_utc.microsecond * 1e-6
        utc = erfa.dtf2d(
            "UTC", epoch_utc.year, epoch_utc.month, epoch_utc.day, epoch_utc.hour, epoch_utc.minute, seconds
        )
        tt = erfa.taitt(*erfa.utctai(*utc))
        ut1 = erfa.utcut1(*utc, 0.0)
    return float(tt[0]), float(tt[1]), float(ut1[0]), float(ut1[1])


def sun_gcrs(epoch_utc: datetime) -> tuple[FloatArray, float]:
    """Return the apparent direction of the Sun from the geocentre, unit vector shape (3,), and its distance [m].

    Raises
    ------
    UserError
        If the epoch lies outside 1960 to 2099. An epoch without a time zone is UTC.
    """
    tt1, tt2, _, _ = _tt_ut(epoch_utc)
    heliocentric, barycentric = erfa.epv00(tt1, tt2)
    towards = -np.asarray(heliocentric["p"], float)
    distance_au = float(np.linalg.norm(towards))
    velocity_c = np.asarray(barycentric["v"], float) * (erfa.DAU / erfa.DAYSEC / erfa.CMPS)
    direction = erfa.ab(towards / distance_au, velocity_c, distance_au, np.sqrt(1.0 - velocity_c @ velocity_c))
    return np.asarray(direction, float) / np.linalg.norm(direction), distance_au * AU_M


def sun_itrs(epoch_utc: datetime) -> tuple[FloatArray, float]:
    """Return the apparent direction of the Sun in Earth-fixed axes, unit vector shape (3,), and its distance [m].

    See the module text for what is neglected; raises as :func:`sun_gcrs`.
    """
    direction, distance = sun_gcrs(epoch_utc)
    matrix = np.asarray(erfa.c2t06a(*_tt_ut(epoch_utc), 0.0, 0.0), float)
    turned = matrix @ direction
    return turned / np.linalg.norm(turned), distance


def moon_itrs(epoch_utc: datetime) -> FloatArray:
    """Return the Moon's centre in Earth-fixed axes [m], seen from the geocentre, shape (3,); raises as the Sun's."""
    times = _tt_ut(epoch_utc)
    position = np.asarray(erfa.moon98(times[0], times[1])["p"], float) * AU_M
    return np.asarray(erfa.c2t06a(*times, 0.0, 0.0), float) @ position


def phase_angle(from_moon_to_sun: ArrayLike, from_moon_to_observer: ArrayLike) -> float:
    """Return the angle [rad] at the Moon between Sun and observer: 0 for a full Moon."""
    a, b = np.asarray(from_moon_to_sun, float), np.asarray(from_moon_to_observer, float)
    return float(off_axis_angle(a, b))


def sun_angular_radius(distance_m: ArrayLike) -> FloatArray:
    """Return the angular radius of the Sun's disc [rad] at a distance [m] from its centre."""
    return np.arcsin(SUN_RADIUS_M / np.asarray(distance_m, float))
