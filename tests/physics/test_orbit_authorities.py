"""Two-line elements against SGP4's own verification vectors and Astropy's frames."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import astropy.units as units
import numpy as np
import pytest
import sgp4
from astropy.coordinates import GCRS, ITRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.time import Time
from astropy.utils import iers

from horizonval.geometry.orbit import ElementSet, gcrs_states, itrs_states, teme_states

ENVISAT = ElementSet(
    "1 27386U 02009A   20001.54192287  .00000005  00000-0  15038-4 0  9994",
    "2 27386  98.1404  17.3951 0001257  86.5901  84.8559 14.37967408934480",
)
START = datetime(2019, 11, 26, 14, 38, 38, tzinfo=UTC)


def _verification_case(number: str) -> tuple[ElementSet, datetime, np.ndarray]:
    folder = Path(sgp4.__file__).parent
    lines = (folder / "SGP4-VER.TLE").read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith(f"1 {number}"))
    elements = ElementSet(lines[at][:69], lines[at + 1][:69])
    year, day = int(elements.line1[18:20]), float(elements.line1[20:32])
    epoch = datetime(1900 + year if year > 56 else 2000 + year, 1, 1, tzinfo=UTC) + timedelta(days=day - 1.0)
    rows = []
    blocks = (folder / "tcppver.out").read_text().splitlines()
    at = next(i for i, line in enumerate(blocks) if line.split()[:2] == [str(int(number)), "xx"])
    for line in blocks[at + 1 :]:
        if line.strip().endswith("xx"):
            break
        rows.append([float(word) for word in line.split()[:7]])
    return elements, epoch, np.array(rows)


@pytest.mark.parametrize("number", ["00005", "06251", "28057"])
def test_states_equal_the_published_verification_vectors(number: str) -> None:
    """Near-Earth cases over days: 1 m and 1 mm/s; an epoch in whole microseconds is wrong by up to 4 mm."""
    elements, epoch, table = _verification_case(number)
    assert len(table) > 5
    r, v = teme_states(elements, epoch, table[:, 0] * 60.0)
    assert np.abs(r - 1e3 * table[:, 1:4]).max() < 1.0
    assert np.abs(v - 1e3 * table[:, 4:7]).max() < 1e-3


def test_earth_fixed_and_celestial_states_equal_astropys() -> None:
    """With UT1 = UTC and no polar motion on both sides: 0.2 m Earth-fixed, and celestial 5 m: the two nutations."""
    seconds = np.array([0.0, 60.0, 120.0])
    r_teme, v_teme = teme_states(ENVISAT, START, seconds)
    times = Time(START) + seconds * units.s
    times.delta_ut1_utc = np.zeros(3)
    with iers.conf.set_temp("auto_download", False):
        pole = iers.earth_orientation_table.get().pm_xy(times)
        teme = TEME(
            CartesianRepresentation(
                r_teme.T * units.m, differentials=CartesianDifferential(v_teme.T * units.m / units.s)
            ),
            obstime=times,
        )
        itrs = teme.transform_to(ITRS(obstime=times))
    theirs = itrs.cartesian.xyz.to_value(units.m).T
    x, y = (angle.to_value(units.rad) for angle in pole)
    # their polar motion taken out again: r_pef = r_itrs turned by -x about y and -y about x
    theirs_pef = theirs + np.stack([-x * theirs[:, 2], y * theirs[:, 2], x * theirs[:, 0] - y * theirs[:, 1]], axis=1)
    ours, velocity = itrs_states(ENVISAT, START, seconds)
    assert np.abs(ours - theirs_pef).max() < 0.2
    v_theirs = itrs.velocity.d_xyz.to_value(units.m / units.s).T
    assert np.abs(velocity - v_theirs).max() < 0.05, "polar motion turns the velocity by 2e-6: 0.015 m/s"
    celestial, _ = gcrs_states(ENVISAT, START, seconds)
    with iers.conf.set_temp("auto_download", False):
        gcrs = itrs.transform_to(GCRS(obstime=times)).cartesian.xyz.to_value(units.m).T
    assert np.abs(celestial - gcrs).max() < 5.0


def test_celestial_velocity_is_the_derivative_of_the_position() -> None:
    """1 cm/s: the frame's own turning (precession and nutation) is 1e-11 rad/s."""
    r, v = gcrs_states(ENVISAT, START, np.array([-0.5, 0.0, 0.5]))
    assert np.abs(r[2] - r[0] - v[1]).max() < 0.01
    r, v = itrs_states(ENVISAT, START, np.array([-0.5, 0.0, 0.5]))
    assert np.abs(r[2] - r[0] - v[1]).max() < 0.01
