"""Orbits from mean elements against published inclinations, the equation of time and conserved quantities; attitude."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import orbit
from horizonval.geometry.attitude_profile import AttitudeProfile, Slew, attitude_against_lvlh, pointing_error
from horizonval.geometry.frames import from_yaw_pitch_roll, inverse, lvlh_from_itrs, rotate
from horizonval.geometry.pose import Pose, pose_from_spec
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.spec.scene import SceneSpec

EPOCH = datetime(2026, 3, 20, 6, 30, tzinfo=UTC)


@pytest.mark.parametrize(("altitude_km", "published_deg"), [(500, 97.4), (600, 97.8), (700, 98.2), (800, 98.6)])
def test_sun_synchronous_inclinations_are_the_published_ones(altitude_km, published_deg):
    # Tables of Sun-synchronous orbits give a tenth of a degree.
    found = orbit.sun_synchronous_inclination(orbit.EARTH_RADIUS_M + altitude_km * 1e3)
    assert math.degrees(found) == pytest.approx(published_deg, abs=0.05)


def test_no_sun_synchronous_orbit_is_higher_than_six_thousand_kilometres():
    assert math.degrees(orbit.sun_synchronous_inclination(orbit.EARTH_RADIUS_M + 5.9e6)) > 160
    with pytest.raises(UserError, match="Sun-synchronous"):
        orbit.sun_synchronous_inclination(orbit.EARTH_RADIUS_M + 6.0e6)


@pytest.mark.parametrize(
    ("month", "day", "equation_of_time_min"), [(2, 11, -14.2), (4, 15, 0.0), (7, 26, -6.5), (11, 3, 16.4)]
)
def test_local_time_of_the_node_is_the_mean_suns(month, day, equation_of_time_min):
    # Almanacs: the true Sun is that much ahead of the mean one on these days, within a day's change of 0.3 min.
    epoch = datetime(2026, month, day, 7, 30, tzinfo=UTC)
    sun, _ = sun_itrs(epoch)
    right_ascension = math.atan2(sun[1], sun[0]) + float(orbit.sidereal_time(epoch))
    ahead = math.remainder(orbit.raan_of_local_time(epoch, 12.0) - right_ascension, math.tau)
    assert math.degrees(ahead) * 4 == pytest.approx(equation_of_time_min, abs=0.3)


def test_a_sun_synchronous_node_keeps_its_local_time_through_a_year():
    a = orbit.EARTH_RADIUS_M + 600e3
    elements = orbit.Elements(a, 0.0, orbit.sun_synchronous_inclination(a), 0.3, 0.0, 0.0)
    later = datetime(2027, 3, 20, 6, 30, tzinfo=UTC)
    drifted = 0.3 + orbit.secular_rates(elements)[0] * (later - EPOCH).total_seconds()
    began, ended = (orbit.raan_of_local_time(epoch, 10.5) for epoch in (EPOCH, later))
    # Two seconds of time: nutation in right ascension, which apparent sidereal time has and the mean Sun has not.
    assert abs(math.remainder((drifted - 0.3) - (ended - began), math.tau)) < math.radians(2 * 15 / 3600)


@pytest.mark.parametrize("eccentricity", [0.0, 0.1, 0.7])
def test_states_have_the_energy_and_the_momentum_of_their_ellipse(eccentricity):
    elements = orbit.Elements(2.5e7, eccentricity, 1.1, 0.4, 2.0, 0.7)
    r, v = orbit.tod_states(elements, np.linspace(0, 5e4, 40))
    distance = np.linalg.norm(r, axis=-1)
    energy = np.sum(v**2, axis=-1) / 2 - orbit.GM_M3_PER_S2 / distance
    assert energy == pytest.approx(-orbit.GM_M3_PER_S2 / (2 * 2.5e7), rel=1e-12)
    momentum = np.linalg.norm(np.cross(r, v), axis=-1)
    assert momentum == pytest.approx(math.sqrt(orbit.GM_M3_PER_S2 * 2.5e7 * (1 - eccentricity**2)), rel=1e-12)
    assert distance.min() >= 2.5e7 * (1 - eccentricity) * (1 - 1e-12)
    assert distance.max() <= 2.5e7 * (1 + eccentricity) * (1 + 1e-12)


def test_velocity_is_the_derivative_of_position():
    elements = orbit.Elements(2.5e7, 0.6, 1.1, 0.4, 2.0, 0.7)
    t = np.linspace(0, 4e4, 9)
    r0, r1 = (orbit.tod_states(elements, t + dt)[0] for dt in (-0.5, 0.5))
    # The drift of the plane, left out of the velocity, is 2e-7 rad/s x 40 000 km at most: 8 m/s.
    assert np.linalg.norm((r1 - r0) - orbit.tod_states(elements, t)[1], axis=-1).max() < 8.0


def test_heading_gives_the_same_lvlh_as_position_and_velocity():
    elements = orbit.Elements(7.1e6, 0.02, 1.7, 0.4, 2.0, 0.7)
    r, v = orbit.tod_states(elements, np.linspace(0, 5000, 7))
    for ri, vi, azimuth in zip(r, v, orbit.heading(r, v), strict=True):
        want = orbit.lvlh_matrices(ri[None], vi[None])[0]
        # Rounding of a turn: 1e-12 rad.
        assert np.abs(rotate(lvlh_from_itrs(ri, float(azimuth)), np.eye(3)).T - want).max() < 1e-12


def pose_of(latitude_deg: float, heading_deg: float) -> Pose:
    platform = {"altitude_km": 500.0, "latitude_deg": latitude_deg, "longitude_deg": 25.0, "heading_deg": heading_deg}
    return pose_from_spec(SceneSpec.model_validate({"camera": {"file": "test"}, "platform": platform}))


def axis_itrs(pose: Pose, axis: int) -> FloatArray:
    return rotate(inverse(pose.q_lvlh_from_itrs), np.eye(3)[axis])


@pytest.mark.parametrize("heading_deg", [-135.0, -20.0, 45.0, 100.0])
@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 45.0])
def test_orbit_of_the_heading_has_the_inclination_of_spherical_trigonometry(
    latitude_deg: float, heading_deg: float
) -> None:
    """Clairaut's relation, ``cos i = cos(geocentric latitude) sin(heading)``, for the plane of position and x."""
    pose = pose_of(latitude_deg, heading_deg)
    x, y, z = pose.r_itrs
    geocentric_latitude = math.atan2(z, math.hypot(x, y))
    inclination = math.acos(math.cos(geocentric_latitude) * math.sin(math.radians(heading_deg)))
    normal = np.cross(pose.r_itrs, axis_itrs(pose, 0))
    assert math.acos(normal[2] / np.linalg.norm(normal)) == pytest.approx(inclination, abs=1e-12)


ELEMENTS = orbit.Elements(6.9e6, 0.0, 1.7, 0.4, 0.0, 0.0)
SUN = np.array([0.6, 0.64, 0.48])


def _states(t):
    return orbit.tod_states(ELEMENTS, t)


def _fly(profile, t):
    return attitude_against_lvlh(profile, _states, SUN, np.asarray(t, float))


def test_stars_and_a_tumble_turn_at_their_rates():
    _, rates = _fly(AttitudeProfile(reference="inertial"), [0.0])
    # A body fixed among the stars turns against lvlh by the orbital rate about +y; J2 adds 2e-3 of it.
    assert rates[0] == pytest.approx([0.0, ELEMENTS.mean_motion_rad_s, 0.0], abs=3e-6)
    angles, rates = _fly(AttitudeProfile(tumble_rad_s=(0.0, 0.0, 0.01)), [0.0, 50.0])
    assert rates == pytest.approx(np.tile([0.0, 0.0, 0.01], (2, 1)), abs=1e-12)
    assert angles[1] == pytest.approx([0.5, 0.0, 0.0], abs=1e-12)


def test_the_sun_stays_on_its_axis():
    t = np.linspace(0, 5500, 23)
    angles, _ = _fly(AttitudeProfile(reference="sun", sun_axis=(0.0, 1.0, 1.0)), t)
    lvlh = orbit.lvlh_matrices(*_states(t))
    seen = np.array([rotate(from_yaw_pitch_roll(*a), m @ SUN) for a, m in zip(angles, lvlh, strict=True)])
    assert seen / np.linalg.norm(SUN) == pytest.approx(np.tile([0, 1, 1], (23, 1)) / math.sqrt(2), abs=1e-9)


def test_a_slew_goes_from_one_attitude_to_the_other_and_rests():
    profile = AttitudeProfile(offset_rad=(0.0, 0.1, 0.0), slew=Slew((0.4, 0.0, -0.3), start_s=10.0, duration_s=60.0))
    angles, rates = _fly(profile, [0.0, 40.0, 100.0])
    assert angles[0] == pytest.approx([0.0, 0.1, 0.0], abs=1e-12)
    assert angles[2] == pytest.approx([0.4, 0.0, -0.3], abs=1e-12)
    assert np.linalg.norm(rates[[0, 2]]) < 1e-12
    # Half way the smooth step is 15/8 times as fast as an even turn, whose angle is about 0.5 rad.
    assert 0.4 * 15 / 8 / 60 < np.linalg.norm(rates[1]) < 0.6 * 15 / 8 / 60


def test_a_pointing_error_has_its_rms_and_its_correlation():
    lags = np.array([0.0, 20.0])
    values = np.array(
        [pointing_error((1e-3, 2e-3, 0.0), 20.0, np.random.default_rng(seed)).at(lags) for seed in range(3000)]
    )
    rms = np.sqrt(np.mean(values**2, axis=(0, 1)))
    # 3000 draws give an rms to 1.3 %, a correlation to 0.02.
    assert rms[:2] == pytest.approx([1e-3, 2e-3], rel=0.05)
    assert rms[2] == 0.0
    correlation = np.mean(values[:, 0] * values[:, 1], axis=0)[:2] / rms[:2] ** 2
    assert correlation == pytest.approx(math.exp(-0.5), abs=0.06)


def test_rates_are_the_derivative_of_the_angles():
    error = pointing_error((1e-3, 1e-3, 1e-3), 10.0, np.random.default_rng(1))
    h = 0.01
    angles, rates = _fly(AttitudeProfile(error=error), [5.0 - h, 5.0, 5.0 + h])
    # Small angles: yaw is about z, pitch about y, roll about x, to 1e-3 of the rate.
    assert rates[1][::-1] == pytest.approx((angles[2] - angles[0]) / (2 * h), abs=1e-6)
