"""Positions of a satellite from azimuths and elevations that ground stations measure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.csv_table import read_csv
from horizonval.geometry import clock, sightings
from horizonval.geometry.ellipsoid import geodetic_from_itrs
from horizonval.geometry.rotation import itrs_from_gcrs, turn
from horizonval.geometry.sightings import Station

COLUMNS = ("time_utc", "station", "longitude_deg", "latitude_deg", "height_m", "azimuth_deg", "elevation_deg")
"""Columns of a file of angles, one row for each station and instant."""


@dataclass(frozen=True)
class Located:
    """Positions of a satellite at n instants; an instant without a position has nan.

    Attributes
    ----------
    times_utc : tuple of str
        Empty if no times were given, and then there are no celestial coordinates.
    r_itrs_m : ndarray, shape (n, 3)
        Earth-fixed position [m].
    miss_m : ndarray, shape (n,)
        Root mean square distance of the lines of sight from the position, before any filter [m].
    right_ascension_deg, declination_deg, distance_km : ndarray, shape (n,)
        Celestial coordinates (GCRS), seen from the Earth's centre.

    Examples
    --------
    >>> import horizonval as hv
    >>> stations = [(48.3358, 35.7061, 1000.0), (54.7458, 35.7161, 200.0)]
    >>> found = hv.locate([[[127.9, 48.2], [200.2, 59.4]]], stations, ["2019-11-26T14:38:38"])
    >>> found.distance_km.round(-1)
    array([7140.])
    """

    times_utc: tuple[str, ...]
    r_itrs_m: FloatArray
    miss_m: FloatArray
    right_ascension_deg: FloatArray
    declination_deg: FloatArray
    distance_km: FloatArray

    def rows(self) -> Iterator[dict[str, str | float]]:
        """Yield one row of plain data for each instant that has a position."""
        latitude, longitude, height = geodetic_from_itrs(self.r_itrs_m)
        for k in np.flatnonzero(np.isfinite(self.miss_m)):
            row: dict[str, str | float] = {"time_utc": self.times_utc[k]} if self.times_utc else {}
            row |= {f"{axis}_itrs_km": float(self.r_itrs_m[k, i]) / 1e3 for i, axis in enumerate("xyz")}
            row |= {"latitude_deg": float(np.degrees(latitude[k])), "longitude_deg": float(np.degrees(longitude[k]))}
            row |= {"altitude_km": float(height[k]) / 1e3, "miss_m": float(self.miss_m[k])}
            if self.times_utc:
                row |= {key: float(getattr(self, key)[k]) for key in ("right_ascension_deg", "declination_deg")}
                row["distance_km"] = float(self.distance_km[k])
            yield row


def locate(
    angles: ArrayLike,
    stations: Sequence[Station | Sequence[float]],
    times: Sequence[str | datetime] | None = None,
    *,
    smooth_s: float | None = None,
    forgetting: float | None = None,
) -> Located:
    """Locate a satellite by the directions in which ground stations see it at the same instants.

    The position is the point nearest to the lines of sight in the least-squares sense. Angles are geometric: refraction
    and light time have to be removed before.

    Parameters
    ----------
    angles : array_like, shape (n, m, 2)
        Azimuth, from north through east, and elevation [deg] of m stations at n instants; nan where a station has none.
    stations : sequence of m
        Longitude, geodetic latitude [deg] and height [m] on WGS84, of at least two stations.
    times : sequence of n, optional
        Instants, text or ``datetime`` in UTC, rising; for celestial coordinates and for both options below.
    smooth_s : float, optional
        Standard deviation [s] of a Gaussian mean of each station's directions over time; at most the pass's length.
    forgetting : float, optional
        Forgetting factor, above 0 and at most 1, of an adaptive Kalman filter of the positions (Akhlaghi, Zhou & Huang
        2017); 0.3 is that paper's, 1 adapts nothing. For steps of at most a few seconds.

    Raises
    ------
    UserError
        Shapes or values that do not fit; smoothing or the filter without a position at every instant, or smoothing with
        unequal steps.

    Examples
    --------
    >>> import horizonval as hv
    >>> stations = [(48.3358, 35.7061, 1000.0), (54.7458, 35.7161, 200.0)]
    >>> found = hv.locate([[[127.9, 48.2], [200.2, 59.4]]], stations)
    >>> [round(row["altitude_km"]) for row in found.rows()]
    [770]
    """
    degrees = np.asarray(angles, float)
    places = [one if isinstance(one, Station) else Station(*map(float, one)) for one in stations]
    _check(degrees, places)
    instants = [clock.instant_of(t if isinstance(t, str) else t.isoformat(), "times") for t in times or ()]
    seconds = clock.seconds_after(clock.epoch_at(instants[0]), instants) if instants else np.empty(0)
    if times is not None and (len(seconds) != len(degrees) or (np.diff(seconds) <= 0.0).any()):
        raise UserError(f"{len(seconds)} instants", where="times", expected=f"{len(degrees)}, rising")
    u = np.stack([one.directions(np.radians(degrees[:, k])) for k, one in enumerate(places)], axis=1)
    origins = np.array([one.r_itrs for one in places])
    raw, miss = sightings.intersection(origins, u)
    position = raw
    for name, value in (("smooth_s", smooth_s), ("forgetting", forgetting)):
        if value is None:
            continue
        if len(seconds) < 3 or not np.isfinite(raw).all():
            raise UserError("too little is measured", where=name, expected="at least 3 instants, all with a position")
        most = 1.0 if name == "forgetting" else float(np.ptp(seconds))
        if not 0.0 < value <= most:
            raise UserError(f"{value:g}", where=name, expected=f"above 0, at most {most:g}")
    if smooth_s is not None:
        steps = np.diff(seconds)
        if np.ptp(steps) > 1e-3 * steps[0] or not np.isfinite(u).all():
            raise UserError("unequal steps, or a station without an angle", where="smooth_s", expected="equal steps")
        position, miss = sightings.intersection(origins, sightings.smoothed(u, smooth_s / float(steps[0])))
    if not instants:
        nothing = np.empty(0)
        return Located((), position, miss, nothing, nothing, nothing)
    turns = itrs_from_gcrs(clock.epoch_at(instants[0]), seconds)
    r_gcrs = turn(np.swapaxes(turns, -1, -2), position)
    if forgetting is not None:
        r_gcrs = sightings.adaptive_filter(seconds, r_gcrs, sightings.scatter(raw), forgetting)
        position = turn(turns, r_gcrs)
    right, declination, distance = np.moveaxis(sightings.celestial(r_gcrs), -1, 0)
    stamps = tuple(clock.stamp(instant) for instant in instants)
    return Located(stamps, position, miss, np.degrees(right), np.degrees(declination), distance / 1e3)


def _check(degrees: FloatArray, places: Sequence[Station]) -> None:
    if len(places) < 2:
        raise UserError(f"{len(places)} stations", where="stations", expected="at least two")
    for k, one in enumerate(places):
        if not (abs(one.latitude_deg) <= 90.0 and abs(one.longitude_deg) <= 360.0 and abs(one.height_m) < 1e5):
            raise UserError(f"found {one}", where=f"stations: {k}", expected="longitude, latitude [deg] and height [m]")
    if len({one.r_itrs.tobytes() for one in places}) < len(places):
        raise UserError("two stations at one place", where="stations", expected="different places")
    if degrees.ndim != 3 or degrees.shape[1:] != (len(places), 2):
        raise UserError(f"shape {degrees.shape}", where="angles", expected=f"(n, {len(places)}, 2)")
    if not len(degrees) or (np.abs(degrees[..., 1]) > 90.0).any() or (np.abs(degrees[..., 0]) > 360.0).any():
        raise UserError("no angles, or one out of range", where="angles", expected="azimuth and elevation in degrees")


def read_angles(path: Path) -> tuple[FloatArray, list[Station], list[str]]:
    """Return angles, stations and times for :func:`locate` from a file of the columns :data:`COLUMNS`.

    Rows are in any order; an instant with one station alone is left out. ``UserError`` names file, line and column.
    """
    table = read_csv(path, COLUMNS, texts=COLUMNS[:2])
    names = list(dict.fromkeys(table.texts["station"]))
    instants = [
        clock.instant_of(text, table.place(row, "time_utc")) for row, text in enumerate(table.texts["time_utc"])
    ]
    places = [Station(*map(float, place)) for place in table.together(*COLUMNS[2:5])]
    stations: dict[str, Station] = {}
    found: dict[int, FloatArray] = {}
    for row, (instant, name, angles) in enumerate(
        zip(instants, table.texts["station"], table.together(*COLUMNS[5:]), strict=True)
    ):
        at, column = found.setdefault(instant, np.full((len(names), 2), np.nan)), names.index(name)
        if stations.setdefault(name, places[row]) != places[row]:
            raise UserError(f"another place of {name}", where=table.place(row, "longitude_deg"), expected="one place")
        if np.isfinite(at[column]).all():
            raise UserError(f"a second row of {name}", where=table.place(row, "time_utc"), expected="one per instant")
        if abs(angles[1]) > 90.0 or abs(angles[0]) > 360.0:
            raise UserError(
                f"found {angles[0]:g}, {angles[1]:g}", where=table.place(row, "azimuth_deg"), expected="deg"
            )
        at[column] = angles
    both = {instant: one for instant, one in sorted(found.items()) if np.isfinite(one).sum() >= 4}
    if not both:
        raise UserError("no instant with two stations", where=str(path), expected="the same time_utc in two rows")
    return np.array(list(both.values())), list(stations.values()), [clock.stamp(instant) for instant in both]
