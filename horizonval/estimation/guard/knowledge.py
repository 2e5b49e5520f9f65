"""Whether a claim agrees with what is known of altitude and attitude."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.known import LOCAL_RADIUS_SHARE
from horizonval.estimation.guard import limits
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.rotation import angle_between, tangent_basis


def contradicted(claim: Fit, observation: Observation, rho_rad: float, variance: float) -> Refusal | None:
    """Refuse a claim at :data:`limits.AGREEMENT` standard deviations from the known altitude or attitude.

    ``rho_rad``: half-angle of the limb as it is seen, ``variance``: its variance [rad^2].
    """
    off = _altitude_off(observation, rho_rad, variance)
    if off is not None:
        reason = f"the angular radius is {np.degrees(off):+.2f} deg from that of the known altitude"
        return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
    known = _known_nadir(observation)
    if known is None:
        return None
    there, spread = known
    basis = tangent_basis(np.asarray(claim.nadir_cam))
    apart = basis.T @ (there - np.asarray(claim.nadir_cam))
    spread = basis.T @ (claim.total_covariance_nadir_cam + spread) @ basis
    # Beyond a right angle the difference of two unit vectors gets no longer across the first one.
    if there @ claim.nadir_cam > 0.0 and apart @ np.linalg.solve(spread, apart) <= limits.AGREEMENT**2:
        return None
    degrees = np.degrees(angle_between(there, np.asarray(claim.nadir_cam)))
    return Refusal(Outcome.AMBIGUOUS, f"the nadir lies {degrees:.1f} deg from that of the known attitude", claim.points)


def _altitude_off(observation: Observation, rho_rad: float, variance: float) -> float | None:
    """Return the departure of an angular radius from that of the known altitude, None if nothing contradicts it."""
    prior, camera = observation.prior, observation.camera
    radius = prior.sphere_radius_m
    if prior.angular_radius is not None:
        expected, of_altitude = prior.angular_radius
    elif prior.r_itrs is not None and prior.position_sigma_m is not None and np.linalg.norm(prior.r_itrs) > radius:
        distance = float(np.linalg.norm(prior.r_itrs))
        expected = float(np.arcsin(radius / distance))
        # The Earth's radius below the satellite is that of the sphere to so much.
        local = LOCAL_RADIUS_SHARE * prior.flattening * radius
        of_altitude = float(np.tan(expected) / distance) ** 2 * (prior.position_sigma_m**2 + local**2)
    else:
        return None
    # In coarse pixels points lie in the limb's light, not at its edge.
    misplaced = (MISPLACED_PX / max(camera.fx, camera.fy)) ** 2
    slack = limits.AGREEMENT * float(np.sqrt(variance + of_altitude + misplaced))
    # A limb h higher adds h tan(rho) / R.
    low, high = (height * np.tan(expected) / radius for height in limb_height_m(observation.band_kind))
    off = rho_rad - expected
    return None if low - slack <= off <= high + slack else off


def _known_nadir(observation: Observation) -> tuple[FloatArray, FloatArray] | None:
    """Return the nadir of a known attitude and position, and its covariance (3, 3); None without them."""
    prior = observation.prior
    if prior.r_itrs is None or prior.q_cam_from_itrs is None:
        return None
    assert prior.position_sigma_m is not None
    assert prior.attitude_sigma_rad is not None
    distance = float(np.linalg.norm(prior.r_itrs))
    known = -Rotation.from_quat(prior.q_cam_from_itrs).as_matrix() @ prior.r_itrs / distance
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body).as_matrix()
    turn = cam_from_body @ np.diag(prior.attitude_sigma_rad**2) @ cam_from_body.T
    moved = np.cross(known, np.eye(3))
    return known, moved.T @ turn @ moved + (prior.position_sigma_m / distance) ** 2 * np.eye(3)
