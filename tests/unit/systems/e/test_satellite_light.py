"""Brightness of a satellite, its eclipse, and refraction on the way down."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import erfa
import numpy as np
import pytest

from horizonval.geometry.orbit import ElementSet, itrs_states
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.systems.e.ground.frames import Pass, standard_air
from horizonval.systems.e.ground.sky import (
    Brightness,
    apparent_elevation,
    box_cross_section_m2,
    magnitude,
    sunlight_share,
    true_elevation,
)
from horizonval.systems.e.localisation.stations import Station

ARCSEC = np.pi / 648000
STATION = Station("S1", np.radians(48.3358), np.radians(35.7061), 1000.0)
ELEMENTS = ElementSet(
    "1 27386U 02009A   20001.54192287  .00000005  00000-0  15038-4 0  9994",
    "2 27386  98.1404  17.3951 0001257  86.5901  84.8559 14.37967408934480",
)
EPOCH = datetime(2019, 11, 26, 14, 38, 38, tzinfo=UTC)


def test_a_lambert_sphere_sends_all_it_does_not_swallow():
    """The law over all phase angles: reflected power is albedo x cross-section x irradiance."""
    phase = np.linspace(0.0, np.pi, 20001)
    share = sunlight_share(Brightness((2.0,), (0.5,)), phase, 1000.0)
    total = np.trapezoid(share * 2 * np.pi * np.sin(phase), phase) * 1000.0**2
    # Lommel-Seeliger and the like would miss this by tens of per cent; the trapezoid's error is 1e-8.
    assert total == pytest.approx(0.5 * 2.0, rel=1e-6)


def test_a_white_sphere_of_a_square_metre():
    # Observers' rule: a white sphere of 1 m2 cross-section is of magnitude +6.4 at 1000 km half lit; they round.
    assert magnitude(sunlight_share(Brightness((1.0,), (1.0,)), np.pi / 2, 1e6)) == pytest.approx(6.4, abs=0.3)


def test_cauchy():
    """A box of random attitude shows a quarter of its surface on average."""
    rng = np.random.default_rng(1)
    n = np.abs(rng.standard_normal((200_000, 3)))
    n /= np.linalg.norm(n, axis=1)[:, None]
    shown = n @ [4.6 * 4.6, 10.0 * 4.6, 10.0 * 4.6]
    # One sigma of the mean is 0.02 m2.
    assert box_cross_section_m2(10.0, 4.6, 4.6) == pytest.approx(shown.mean(), abs=0.1)


def test_eclipse_is_the_earths_shadow():
    """Against the cylinder behind the Earth, on the space station's orbit of September 2008."""
    elements = ElementSet(
        "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
        "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
    )
    epoch = datetime(2008, 9, 20, 12, 0, tzinfo=UTC)
    seconds = np.arange(0.0, 5500.0, 20.0)
    _, share = Pass(elements, STATION, epoch).light(seconds)
    # Earth-fixed: the Sun's direction is that of the middle of the times asked for, so one revolution turns by 11 deg
    # from end to end in celestial axes; the cylinder is laid the same way.
    r, _ = itrs_states(elements, epoch, seconds)
    sun, _ = sun_itrs(epoch + timedelta(seconds=float(np.mean(seconds))))
    across = np.linalg.norm(np.cross(r, sun), axis=1)
    in_cylinder = (r @ sun < 0.0) & (across < 6.371e6)
    # Penumbra and flattening: within 60 km of the cylinder's wall nothing is said.
    clear = np.abs(across - 6.371e6) > 6e4
    assert 50 < np.count_nonzero(in_cylinder) < 150
    # The disc's quadrature is good to 1e-5.
    np.testing.assert_allclose(share[clear & in_cylinder], 0.0, atol=1e-5)
    np.testing.assert_allclose(share[clear & ~in_cylinder], 1.0, atol=1e-5)


@pytest.mark.parametrize("elevation_deg", [30.0, 48.0, 70.0, 89.0])
def test_refraction_of_a_star_is_the_almanacs(elevation_deg):
    """From far away, ray integration through the standard air gives the refraction of ``erfa.refco``."""
    air, _ = standard_air(STATION, EPOCH)
    elevation = np.radians(elevation_deg)
    lifted = float(apparent_elevation(air, 1000.0, elevation, 1e13))
    # US76 at 1000 m: 898.76 hPa, 281.65 K. refco claims 0.1 arcsec at 75 deg from the zenith.
    a, b = erfa.refco(898.76, 8.5, 0.0, 0.62)
    z = np.pi / 2 - lifted
    assert lifted - elevation == pytest.approx(a * np.tan(z) + b * np.tan(z) ** 3, abs=0.05 * ARCSEC)


@pytest.mark.parametrize("distance_m", [8e5, 1.2e6])
def test_what_was_lifted_is_put_back(distance_m):
    air, correction = standard_air(STATION, EPOCH)
    elevation = np.radians(np.arange(45.0, 90.0, 5.0))
    back = true_elevation(correction, apparent_elevation(air, 1000.0, elevation, distance_m), distance_m)
    # Two ways that share no formula; without the term for the finite distance they are 0.4 arcsec apart at 45 deg.
    np.testing.assert_allclose(back, elevation, atol=0.05 * ARCSEC)
    without = true_elevation(correction, apparent_elevation(air, 1000.0, elevation[:1], distance_m), 1e13)
    assert abs(without[0] - elevation[0]) > 0.2 * ARCSEC


def test_light_time():
    """In 2.9 ms the satellite moves by 20 m: the direction lags by the ratio of speeds, 5 arcsec."""
    path = Pass(ELEMENTS, STATION, EPOCH)
    now, seen, later = path.geometric_enu(60.0), path.retarded_enu(60.0), path.geometric_enu(60.1)
    lag = now - seen
    speed = np.linalg.norm(later - now) / 0.1
    distance = np.linalg.norm(now)
    # The speed over 0.1 s differs from that at the instant by its change, a part in 1e3.
    assert np.linalg.norm(lag) == pytest.approx(speed * distance / 299_792_458.0, rel=2e-3)
    assert lag @ (later - now) > 0.0
