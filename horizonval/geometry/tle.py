"""A satellite's position and velocity from two-line elements.

The propagation is SGP4 as published with its corrections (the ``sgp4`` package, gravity constants WGS72, which the
elements are fitted with); the frames are those of :mod:`horizonval.geometry.rotation`. Elements describe a real
satellite to about a kilometre at their epoch and some kilometres a day after it. Here they define the orbit, and the
truth is what they say.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import ArrayLike
from sgp4.api import SGP4_ERRORS, Satrec

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme, julian_utc, turn

EARTH_RATE_RAD_S = 7.292115146706979e-5
"""Rotation of the Earth, WGS84 (as in Vallado's ``teme2ecef``)."""


@dataclass(frozen=True)
class ElementSet:
    """Two lines of 69 columns, as distributed.

    Raises
    ------
    UserError
        If a line is not 69 columns long, its number, its checksum or its fields are wrong, or the two lines are of
        different satellites.
    """

    line1: str
    line2: str

    def __post_init__(self) -> None:
        for number, line in enumerate((self.line1, self.line2), 1):
            # The line itself is not shown: it may be of a file that is something else.
            what = f"line {number} of the element set"
            if len(line) != 69 or line[0] != str(number):
                raise UserError(f"{what} has {len(line)} columns", expected=f"69 columns, the first of them {number}")
            total = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
            if line[68] != str(total):
                raise UserError(
                    f"{what} is not what was distributed",
                    expected=f"checksum {total} in the last column",
                    fix="check the copied digits",
                )
        if self.line1[2:7] != self.line2[2:7]:
            raise UserError(
                f"element set of satellites {self.line1[2:7]} and {self.line2[2:7]}", expected="two lines of one"
            )
        try:
            satellite = self._satellite()
        except ValueError as e:
            raise UserError(
                f"element set of satellite {self.line1[2:7]}", expected="numbers in the columns of the format"
            ) from e
        if satellite.error:
            raise UserError(f"element set of satellite {self.line1[2:7]}: {SGP4_ERRORS[satellite.error]}")

    def _satellite(self) -> Satrec:
        return Satrec.twoline2rv(self.line1, self.line2)


def teme_states(elements: ElementSet, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return positions [m] and velocities [m/s] in the elements' own frame, shape (..., 3) each.

    Parameters
    ----------
    elements : ElementSet
    epoch_utc : datetime
        UTC where it has no time zone.
    seconds : array_like, shape (...)
        After the epoch.

    Raises
    ------
    UserError
        If the elements cannot be carried to an instant (the satellite has decayed), or the epoch is out of range.
    """
    return satellite_states(elements._satellite(), epoch_utc, seconds)


def satellite_states(satellite: Satrec, epoch_utc: datetime, seconds: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return what :func:`teme_states` does, of elements that SGP4 has read."""
    day, fraction = np.broadcast_arrays(*julian_utc(epoch_utc, seconds))
    shape = fraction.shape
    codes, r_km, v_km_s = satellite.sgp4_array(
        np.ascontiguousarray(day, float).ravel(), np.ascontiguousarray(fraction, float).ravel()
    )
    if codes.any():
        first = int(np.flatnonzero(codes)[0])
        raise UserError(
            f"satellite {satellite.satnum_str} at {epoch_utc.isoformat()} + {np.ravel(seconds)[first]} s: "
            f"{SGP4_ERRORS[int(codes[first])]}",
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
