"""Where the Moon is, against complete theories and against eclipses that were seen."""

from __future__ import annotations

from datetime import UTC, datetime

import erfa
import numpy as np
import pytest

from horizonval.geometry.ellipsoid import itrs_from_geodetic
from horizonval.geometry.sun_and_moon import AU_M, moon_itrs, phase_angle, sun_itrs

ARCSEC = np.pi / 180 / 3600


def test_the_series_agrees_with_the_complete_elp() -> None:
    """Meeus, *Astronomical Algorithms*, example 47.a, and ELP 2000-82 beside it: 15 arcsec, 10 km.

    1992 April 12, 0 h TD: apparent longitude 133 deg 10' 00", latitude -3 deg 13' 45", distance 368 405.6 km.
    """
    position = np.asarray(erfa.moon98(2448724.5, 0.0)["p"]) * AU_M
    of_date = erfa.ecm06(2448724.5, 0.0) @ position
    nutation = erfa.nut06a(2448724.5, 0.0)[0]
    longitude, latitude = np.arctan2(of_date[1], of_date[0]) + nutation, np.arcsin(of_date[2] / np.linalg.norm(of_date))
    assert abs(longitude - np.radians(133 + 10 / 60)) < 15 * ARCSEC
    assert abs(latitude + np.radians(3 + 13 / 60 + 45 / 3600)) < 15 * ARCSEC
    assert abs(np.linalg.norm(position) - 368_405.6e3) < 10e3


@pytest.mark.parametrize(
    ("instant", "latitude_deg", "longitude_deg"),
    [
        (datetime(1999, 8, 11, 11, 3, 7, tzinfo=UTC), 45 + 4.8 / 60, 24 + 17.3 / 60),
        (datetime(2017, 8, 21, 18, 25, 32, tzinfo=UTC), 36 + 58.0 / 60, -(87 + 40.3 / 60)),
        (datetime(2024, 4, 8, 18, 17, 18, tzinfo=UTC), 25 + 17.4 / 60, -(104 + 8.3 / 60)),
    ],
)
def test_total_eclipses_of_the_sun(instant: datetime, latitude_deg: float, longitude_deg: float) -> None:
    """Greatest eclipse (Espenak, NASA TP-2006-214141): Moon before the Sun within 30 arcsec, seen from the ground."""
    observer = itrs_from_geodetic(np.radians(latitude_deg), np.radians(longitude_deg), 0.0)
    sun, distance = sun_itrs(instant)
    to_moon, to_sun = moon_itrs(instant) - observer, sun * distance - observer
    assert phase_angle(to_moon, to_sun) < 30 * ARCSEC


@pytest.mark.parametrize("year", [1970, 2000, 2026])
def test_from_a_satellite_the_moon_is_where_astropy_sees_it(year: int) -> None:
    """30 arcsec: the same series inside, but astropy's own frames, light time, aberration and topocentric place."""
    astropy = pytest.importorskip("astropy")
    from astropy import units
    from astropy.coordinates import ITRS, EarthLocation, get_body
    from astropy.time import Time
    from astropy.utils import iers

    assert astropy
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("iers_degraded_accuracy", "ignore"):
        for month in (1, 5, 9):
            instant = datetime(year, month, 17, 7, 30, tzinfo=UTC)
            observer = itrs_from_geodetic(np.radians(-33.0), np.radians(70.0), 600e3)
            time = Time(instant, scale="utc")
            place = EarthLocation.from_geocentric(*(observer * units.m))
            body = get_body("moon", time, place, ephemeris="builtin")
            theirs = body.transform_to(ITRS(obstime=time, location=place)).cartesian.xyz.to_value(units.m)
            ours = moon_itrs(instant) - observer
            assert phase_angle(ours, theirs) < 30 * ARCSEC
            assert np.linalg.norm(theirs) == pytest.approx(np.linalg.norm(ours), rel=2e-4)
