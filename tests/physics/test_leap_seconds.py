"""Orbits, rotation and interpolation across the leap seconds of 2012, 2015 and 2016, against sgp4 and Astropy."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path

import astropy.units as units
import erfa
import numpy as np
import pytest
from astropy.coordinates import ITRS, TEME, CartesianRepresentation
from astropy.time import Time
from astropy.utils import iers
from sgp4.api import Satrec

from horizonval.core.errors import UserError
from horizonval.formats.trajectory import orbit_of_csv
from horizonval.geometry import clock
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.orbit import ElementSet, epoch_of, itrs_states, sidereal_time, teme_states
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme
from horizonval.geometry.sun_and_moon import sun_gcrs, sun_itrs
from horizonval.spec.orbit import OrbitSpec
from horizonval.suites.flight import fly

DAYS = {"2012-06-30": "12182", "2015-06-30": "15181", "2016-12-31": "16366"}
SECONDS = np.array([0.0, 43199.5, 43201.5, 86401.0, 5 * 86400.0])
ARCSEC = math.radians(1.0 / 3600.0)


def elements(day: str) -> ElementSet:
    lines = (
        f"1 25544U 98067A   {DAYS[day]}.50000000  .00010000  00000-0  10000-3 0  999",
        "2 25544  51.6400 123.4567 0005000  40.0000 320.0000 15.5000000012345",
    )
    return ElementSet(*(line + str(sum(int(c) if c.isdigit() else c == "-" for c in line) % 10) for line in lines))


@pytest.mark.parametrize("day", DAYS)
def test_elements_of_a_leap_day_fly_in_si_seconds(day: str) -> None:
    """At the elements' epoch and days later: 1 cm from sgp4 at SI minutes, 0.2 m Earth-fixed from Astropy."""
    given = elements(day)
    satellite = Satrec.twoline2rv(given.line1, given.line2)
    noon = datetime.fromisoformat(f"{day}T12:00:00+00:00")
    assert epoch_of(satellite) == noon
    for epoch in (noon, datetime.fromisoformat(f"{day}T06:00:00+00:00")):
        since = SECONDS + (epoch - noon).total_seconds()
        r, _ = teme_states(given, epoch, SECONDS)
        theirs = 1e3 * np.array([satellite.sgp4_tsince(t / 60.0)[1] for t in since])
        assert np.abs(r - theirs).max() < 0.01
        times = Time(epoch.replace(tzinfo=None), scale="utc") + SECONDS * units.s
        times.delta_ut1_utc = np.zeros(len(SECONDS))
        with iers.conf.set_temp("auto_download", False):
            x, y = (angle.to_value(units.rad) for angle in iers.earth_orientation_table.get().pm_xy(times))
            teme = TEME(CartesianRepresentation(theirs.T * units.m), obstime=times)
            itrs = teme.transform_to(ITRS(obstime=times)).cartesian.xyz.to_value(units.m).T
        pef = itrs + np.stack([-x * itrs[:, 2], y * itrs[:, 2], x * itrs[:, 0] - y * itrs[:, 1]], axis=1)
        assert np.abs(itrs_states(given, epoch, SECONDS)[0] - pef).max() < 0.2
    samples, _ = fly(OrbitSpec(tle=[given.line1, given.line2], n=1), WGS84, 1, "o", Path())
    assert samples[0]["platform"]["epoch_utc"] == noon


@pytest.mark.parametrize("day", DAYS)
def test_the_earth_is_turned_alike_by_every_route(day: str) -> None:
    """From an epoch before the leap second, or from the instant: 1e-4 arcsec; from Astropy's UT1 0.01 arcsec."""
    noon = datetime.fromisoformat(f"{day}T12:00:00+00:00")
    long = itrs_from_gcrs(noon, SECONDS), itrs_from_teme(noon, SECONDS), sidereal_time(noon, SECONDS)
    for k, t in enumerate(SECONDS):
        here = clock.utc_after(noon, t)
        assert np.abs(itrs_from_gcrs(here) - long[0][k]).max() < 1e-4 * ARCSEC
        assert np.abs(itrs_from_teme(here) - long[1][k]).max() < 1e-4 * ARCSEC
        assert abs(math.remainder(float(sidereal_time(here)) - long[2][k], math.tau)) < 1e-4 * ARCSEC
        assert np.abs(sun_itrs(here)[0] - long[0][k] @ sun_gcrs(here)[0]).max() < 1e-4 * ARCSEC
        time = Time(here.replace(tzinfo=None), scale="utc")
        time.delta_ut1_utc = 0.0
        theirs = erfa.c2t06a(time.tt.jd1, time.tt.jd2, time.ut1.jd1, time.ut1.jd2, 0.0, 0.0)
        assert np.abs(theirs - long[0][k]).max() < 0.01 * ARCSEC


RADIUS_KM, RATE = 6928.0, math.sqrt(398600.4418 / 6928.0**3)


@pytest.mark.parametrize("day", DAYS)
@pytest.mark.parametrize("axes", ["gcrs", "itrs"])
@pytest.mark.parametrize("velocities", [True, False])
def test_states_across_a_leap_second_are_interpolated_in_si_seconds(
    tmp_path: Path, day: str, axes: str, velocities: bool
) -> None:
    """1 cm, with a row within the leap second; Earth-fixed states keep their Earth-fixed positions."""
    epoch = datetime.fromisoformat(f"{day}T23:50:00.5+00:00")
    turning = 7.292115146706979e-5 if axes == "itrs" else 0.0

    def truth(t: np.ndarray) -> np.ndarray:
        u, w = RATE * t, turning * t
        x, y, z = np.cos(u), np.sin(u) * 0.6, np.sin(u) * 0.8
        return RADIUS_KM * np.stack([x * np.cos(w) + y * np.sin(w), y * np.cos(w) - x * np.sin(w), z], axis=-1)

    t = 60.0 * np.arange(21.0)
    columns = [truth(t), (truth(t + 0.05) - truth(t - 0.05)) / 0.1][: 2 if velocities else 1]
    names = [f"{x}_{axes}_km" for x in "xyz"] + [f"v{x}_{axes}_km_s" for x in "xyz"][: 3 if velocities else 0]
    rows = [
        ",".join([clock.stamp_after(epoch, s), *(f"{x:.9f}" for x in row)])
        for s, row in zip(t, np.hstack(columns), strict=True)
    ]
    assert sum(":60.5" in row for row in rows) == 1
    path = tmp_path / "sat.csv"
    path.write_text("\n".join([",".join(["time_utc", *names]), *rows]))
    between = np.linspace(0.0, 1200.0, 97)
    r, _ = orbit_of_csv(path).states(between)
    if axes == "itrs":
        r = np.einsum("nij,nj->ni", itrs_from_gcrs(epoch, between), r)
    assert np.abs(r - 1e3 * truth(between)).max() < 0.01
    spec = {"ephemeris": "sat.csv", "n": 2, "duration_s": 1198.0}
    late = fly(OrbitSpec(**spec), WGS84, 1, "o", tmp_path)[0][1]["platform"]["epoch_utc"]
    assert clock.elapsed_s(epoch, late) == 599.0
    with pytest.raises(UserError, match=r"23:59:60.500000 lies within a leap second"):
        fly(OrbitSpec(**{**spec, "duration_s": 1200.0}), WGS84, 1, "o", tmp_path)
