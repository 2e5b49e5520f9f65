"""The names that flight dynamics has for axes, and states in them turned to those of the stars.

Four kinds are told apart: celestial (``GCRF``, ``ICRF``, ``EME2000``, ``J2000``), Earth-fixed (``ITRF`` of any year),
``TOD``, the true equator and equinox of date by IAU 2006/2000A, and ``TEME``, that of two-line elements. ``EME2000``
differs from ``GCRF`` by 23 milliarcseconds, 0.8 m in low orbit, the pole and equinox of older theories from ``TOD`` by
some 0.05 arcsec, and the realisations of ``ITRF`` from each other by centimetres: they are taken for one.
"""

from __future__ import annotations

import re
from datetime import datetime
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme, tod_from_gcrs, turn
from horizonval.geometry.tle import EARTH_RATE_RAD_S

Axes = Literal["gcrs", "itrs", "tod", "teme"]
KNOWN = "GCRF, ICRF, EME2000, J2000, ITRF (of any year), TOD or TEME"
_CELESTIAL = ("GCRF", "ICRF", "EME2000", "J2000", "GCRS")
_EARTH_FIXED = re.compile(r"ITR[FS]([-_ ]?\d+)?")


def axes_of(name: str, where: str) -> Axes:
    """Return the kind of axes of a name; another one is a :class:`UserError` at ``where``."""
    upper = name.strip().upper()
    if upper in _CELESTIAL:
        return "gcrs"
    if upper == "TEME":
        return "teme"
    if upper == "TOD":
        return "tod"
    if _EARTH_FIXED.fullmatch(upper):
        return "itrs"
    raise UserError(f"axes {name!r}", where=where, expected=KNOWN)


def gcrs_from(axes: Axes, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
    """Return matrices, shape (n, 3, 3), from axes to ``gcrs`` at times after an epoch."""
    if axes == "gcrs":
        return np.broadcast_to(np.eye(3), (len(seconds), 3, 3))
    if axes == "tod":
        return np.swapaxes(tod_from_gcrs(epoch_utc, seconds), -1, -2)
    to_gcrs = np.swapaxes(itrs_from_gcrs(epoch_utc, seconds), -1, -2)
    return to_gcrs if axes == "itrs" else to_gcrs @ itrs_from_teme(epoch_utc, seconds)


def states_in_gcrs(
    axes: Axes, epoch_utc: datetime, seconds: FloatArray, r: FloatArray, v: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return positions and velocities, shape (n, 3) each, turned to ``gcrs``; Earth-fixed velocities are relative."""
    matrices = gcrs_from(axes, epoch_utc, seconds)
    if v is not None and axes == "itrs":
        v = v + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r)
    return turn(matrices, r), None if v is None else turn(matrices, v)
