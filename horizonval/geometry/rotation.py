"""The Earth's rotation at many instants: matrices between celestial, mean-equinox and Earth-fixed axes.

The same time scales as :mod:`horizonval.geometry.ephemeris`: UT1 is taken as UTC and the pole as fixed, for both need
a measured table. UT1 - UTC stays below 0.9 s; it turns every celestial direction made from Earth-fixed measurements
about the pole by up to 13.5 arcsec, alike for truth and measurement, so no difference of two of them feels it.

``teme`` (true equator, mean equinox) is the frame of two-line elements: one turn by the mean sidereal time of 1982
about the axis leads to Earth-fixed axes (Vallado et al., "Revisiting Spacetrack Report #3", AIAA 2006-6753,
appendix C). The way on to ``gcrs`` is IAU 2006/2000A, so the pole's nutation of 1980 in the elements is kept by theory
and not by the formula; the two poles differ by some 0.05 arcsec.
"""

from __future__ import annotations

import warnings
from datetime import UTC, datetime

import erfa
import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError


def julian_utc(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[float, FloatArray]:
    """Return instants as two-part Julian dates: the day's begin, and the fraction of a day, shape (...).

    Parameters
    ----------
    epoch_utc : datetime
        UTC where it has no time zone.
    seconds : array_like, shape (...)
        After the epoch. A leap second between epoch and instant is not counted.

    Raises
    ------
    UserError
        If the year lies outside 1960 to 2099.
    """
    if epoch_utc.tzinfo is not None:
        epoch_utc = epoch_utc.astimezone(UTC)
    if not 1960 <= epoch_utc.year < 2100:
        raise UserError(f"epoch {epoch_utc.isoformat()}", expected="a year between 1960 (first UTC) and 2099")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        second = epoch_utc.second + epoch_utc.microsecond * 1e-6
        day, fraction = erfa.dtf2d(
            "UTC", epoch_utc.year, epoch_utc.month, epoch_utc.day, epoch_utc.hour, epoch_utc.minute, second
        )
    return float(day), float(fraction) + np.asarray(seconds, float) / erfa.DAYSEC


def itrs_from_gcrs(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take celestial components to Earth-fixed ones."""
    utc1, utc2 = julian_utc(epoch_utc, seconds)
    with warnings.catch_warnings():
        # Beyond the table of leap seconds the newest offset is kept, as for the Sun.
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        tt1, tt2 = erfa.taitt(*erfa.utctai(utc1, utc2))
        ut1, ut2 = erfa.utcut1(utc1, utc2, 0.0)
    return np.asarray(erfa.c2t06a(tt1, tt2, ut1, ut2, 0.0, 0.0), float)


def tod_from_gcrs(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take celestial components to true equator and equinox of date."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        tt1, tt2 = erfa.taitt(*erfa.utctai(*julian_utc(epoch_utc, seconds)))
    return np.asarray(erfa.pnm06a(tt1, tt2), float)


def itrs_from_teme(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take components in the frame of two-line elements to Earth-fixed."""
    sidereal = np.asarray(erfa.gmst82(*julian_utc(epoch_utc, seconds)), float)
    cos, sin = np.cos(sidereal), np.sin(sidereal)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = [np.stack(row, axis=-1) for row in ((cos, sin, zero), (-sin, cos, zero), (zero, zero, one))]
    return np.stack(rows, axis=-2)


def turn(matrices: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Return ``matrix @ vector`` item by item, shape (..., 3)."""
    return np.einsum("...ij,...j->...i", np.asarray(matrices, float), np.asarray(vectors, float))
