"""Ellipsoid, horizon, Sun and eclipse against Astropy, closed forms and brute force."""

from __future__ import annotations

from datetime import UTC, datetime

import astropy.units as units
import numpy as np
import pytest
from astropy.coordinates import EarthLocation, get_sun
from astropy.time import Time
from astropy.utils import iers

from horizonval.geometry.ellipsoid import WGS84, geodetic_from_itrs, itrs_from_geodetic, sphere, tangent_height
from horizonval.geometry.ellipsoid import geodetic_height as height_of
from horizonval.geometry.frames import body_from_lvlh, lvlh_from_itrs, roll_pitch_of_nadir, rotate
from horizonval.geometry.horizon import angular_radius, horizon_directions
from horizonval.geometry.sun_and_moon import AU_M, sun_angular_radius, sun_gcrs, sun_visible_fraction

ALTITUDES_KM = (300.0, 500.0, 800.0, 3000.0, 20_200.0, 35_786.0)


def test_geodetic_coordinates_equal_astropys() -> None:
    """1e-4 m and 1e-11 rad, its own rounding."""
    rng = np.random.default_rng(np.random.SeedSequence(2))
    longitude, latitude = rng.uniform(-np.pi, np.pi, 200), rng.uniform(-np.pi / 2, np.pi / 2, 200)
    height = rng.uniform(0.0, 4e7, 200)
    theirs = EarthLocation.from_geodetic(longitude * units.rad, latitude * units.rad, height * units.m)
    expected = np.stack([theirs.x.value, theirs.y.value, theirs.z.value], axis=1)
    ours = itrs_from_geodetic(latitude, longitude, height)
    assert np.abs(ours - expected).max() < 1e-4
    back = geodetic_from_itrs(expected)
    assert np.abs(np.asarray(back[2]) - height).max() < 1e-4


def _hits(o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Whether rays meet WGS84: the quadratic in the stretched space, in extended precision."""
    stretch = np.array([1.0, 1.0, WGS84.a_m / WGS84.b_m], dtype=np.longdouble) / np.longdouble(WGS84.a_m)
    o1, d1 = o.astype(np.longdouble) * stretch, d.astype(np.longdouble) * stretch
    od, dd = (o1 * d1).sum(axis=-1), (d1 * d1).sum(axis=-1)
    return (od < 0) & (od * od - dd * ((o1 * o1).sum(axis=-1) - 1) > 0)


@pytest.mark.parametrize("altitude_km", ALTITUDES_KM)
def test_horizon_of_the_ellipsoid_equals_bisection(altitude_km: float) -> None:
    """1e-9 rad, 0.2 milliarcsec."""
    r = np.array([0.5, -0.3, 0.7])
    r *= (6.37e6 + altitude_km * 1e3) / np.linalg.norm(r)
    exact = horizon_directions(r, WGS84, np.linspace(0.0, 2 * np.pi, 40, endpoint=False))
    nadir = -r / np.linalg.norm(r)
    across = exact - (exact @ nadir)[:, None] * nadir
    across /= np.linalg.norm(across, axis=1)[:, None]
    low, high = np.zeros(40), np.full(40, np.pi / 2)
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = _hits(r, np.cos(middle)[:, None] * nadir + np.sin(middle)[:, None] * across)
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    angle = np.arctan2((exact * across).sum(axis=1), exact @ nadir)
    assert np.abs(angle - low).max() < 1e-9


@pytest.mark.parametrize("altitude_km", ALTITUDES_KM)
def test_angular_radius_of_a_sphere_is_the_arc_sine(altitude_km: float) -> None:
    r = np.array([0.0, 6.4e6 + altitude_km * 1e3, 0.0])
    assert angular_radius(r, sphere(6.4e6)) == pytest.approx(np.arcsin(6.4e6 / r[1]), abs=1e-12)


def test_tangent_height_is_the_least_height_along_the_ray() -> None:
    """1 mm: brute force over a dense stretch of the ray."""
    o = np.array([7.0e6, 1.0e5, 5.0e5])
    d = np.array([-0.36, 0.9, 0.25])
    d /= np.linalg.norm(d)
    t = np.linspace(0.0, 8e6, 4_000_001)
    coarse = height_of(o + t[::4000, None] * d, WGS84)
    near = t[::4000][int(np.argmin(coarse))]
    fine = near + np.linspace(-8000.0, 8000.0, 200_001)
    least = height_of(o + fine[:, None] * d, WGS84).min()
    assert float(tangent_height(o, d, WGS84)) == pytest.approx(float(least), abs=1e-3)


def test_sun_direction_equals_astropys() -> None:
    """0.1 arcsec against the built-in ephemeris: both come from ERFA's series, the light-time treatment differs."""
    iers.conf.auto_download = False
    for epoch in (datetime(2026, 3, 20, 12, tzinfo=UTC), datetime(2026, 12, 21, 3, tzinfo=UTC)):
        direction, distance_m = sun_gcrs(epoch)
        theirs = get_sun(Time(epoch)).cartesian.xyz.to_value(units.au)
        apart = np.linalg.norm(np.cross(direction, theirs / np.linalg.norm(theirs)))
        assert np.degrees(apart) * 3600.0 < 0.1
        assert distance_m / AU_M == pytest.approx(float(np.linalg.norm(theirs)), rel=1e-6)


def test_eclipse_from_light_to_umbra() -> None:
    """A sphere and a small Sun: half the disc when its centre is on the limb, to a thousandth (the limb is curved)."""
    ball, radius = sphere(6.371e6), float(sun_angular_radius(AU_M))
    r = np.array([7.0e6, 0.0, 0.0])
    rho = np.arcsin(6.371e6 / 7.0e6)

    def seen(off_limb_rad: float) -> float:
        angle = rho + off_limb_rad
        return float(sun_visible_fraction(r, np.array([-np.cos(angle), np.sin(angle), 0.0]), radius, ball))

    assert seen(1.01 * radius) == 1.0
    assert seen(-1.01 * radius) == 0.0
    assert seen(0.0) == pytest.approx(0.5, abs=1e-3)
    assert 0.0 < seen(-0.5 * radius) < 0.5 < seen(0.5 * radius) < 1.0


def test_attitude_angles_have_the_sign_the_design_gives_them() -> None:
    q = body_from_lvlh(0.3, 0.2, -0.4)
    nadir_body = rotate(q, np.array([0.0, 0.0, 1.0]))
    expected = [-np.sin(0.2), np.cos(0.2) * np.sin(-0.4), np.cos(0.2) * np.cos(-0.4)]
    assert nadir_body == pytest.approx(expected, abs=1e-15)
    roll, pitch = roll_pitch_of_nadir(nadir_body)
    assert (float(roll), float(pitch)) == pytest.approx((-0.4, 0.2))


def test_lvlh_looks_down_and_ahead() -> None:
    r = np.array([7e6, 0.0, 0.0])
    q = lvlh_from_itrs(r, np.pi / 2)
    assert rotate(q, [-1.0, 0.0, 0.0]) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert rotate(q, [0.0, 1.0, 0.0]) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
