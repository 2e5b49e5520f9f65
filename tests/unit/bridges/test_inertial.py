"""States among the stars as requests, against formulas of others: astropy's frames and Schaub and Junkins' matrix."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from astropy import units
from astropy.coordinates import GCRS, ITRS, CartesianDifferential, CartesianRepresentation
from astropy.time import Time
from astropy.utils.iers import conf
from scipy.spatial.transform import Rotation

from horizonval.bridges.attitudes import mrp_of_quaternion, quaternion_of_mrp, request_of_state

conf.auto_download = False
EPOCH = datetime(2026, 3, 20, 12, 0, tzinfo=UTC)
SIGMA = np.array([0.3, -0.2, 0.5])


def matrix_of_mrp(sigma: np.ndarray) -> np.ndarray:
    """[BN], Schaub and Junkins, Analytical Mechanics of Space Systems, equation 3.147."""
    s = float(sigma @ sigma)
    cross = np.cross(np.eye(3), sigma)  # [sigma x], row by row.
    return np.eye(3) + (8.0 * cross @ cross - 4.0 * (1.0 - s) * cross) / (1.0 + s) ** 2


def test_attitude_parameters_are_those_of_the_book():
    q = quaternion_of_mrp(SIGMA)
    np.testing.assert_allclose(Rotation.from_quat(q).as_matrix(), matrix_of_mrp(SIGMA), atol=1e-15)
    np.testing.assert_allclose(mrp_of_quaternion(q), SIGMA, atol=1e-15)
    # The other set of the same attitude, a turn by more than half.
    shadow = -SIGMA / (SIGMA @ SIGMA)
    np.testing.assert_allclose(np.abs(quaternion_of_mrp(shadow) @ q), 1.0, atol=1e-15)


def test_position_and_velocity_are_those_of_astropy():
    r, v = np.array([4.1e6, -3.2e6, 4.5e6]), np.array([4.0e3, 6.1e3, 0.7e3])
    found = request_of_state(EPOCH, r, v, SIGMA)
    instant = Time(EPOCH)
    position = CartesianRepresentation(r * units.m, differentials=CartesianDifferential(v * units.m / units.s))
    fixed = GCRS(position, obstime=instant).transform_to(ITRS(obstime=instant))
    # UT1 - UTC and polar motion, which we leave out: below 0.9 s of the Earth's turn.
    turn_rad = 0.9 * 7.292115e-5
    r_km, v_km_s = fixed.cartesian.xyz.to_value(units.km), fixed.velocity.d_xyz.to_value(units.km / units.s)
    assert np.linalg.norm(np.array(found["position_itrs_km"]) - r_km) < turn_rad * 7e3
    assert np.linalg.norm(np.array(found["velocity_itrs_km_s"]) - v_km_s) < turn_rad * 8.0


def test_attitude_and_place_belong_together():
    """The nadir in body axes is the same among the stars and along Earth-fixed axes."""
    r = np.array([4.1e6, -3.2e6, 4.5e6])
    found = request_of_state(EPOCH, r, [4.0e3, 6.1e3, 0.7e3], SIGMA, [0.01, 0.0, -0.02])
    itrs = np.array(found["position_itrs_km"])
    nadir_body = Rotation.from_quat(found["q_body_from_itrs"]).apply(-itrs / np.linalg.norm(itrs))
    np.testing.assert_allclose(nadir_body, matrix_of_mrp(SIGMA) @ (-r / np.linalg.norm(r)), atol=1e-14)
    assert found["rate_deg_s"] == pytest.approx([0.572957795, 0.0, -1.14591559])
    assert found["hold"] == "inertial"
