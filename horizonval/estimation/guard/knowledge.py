"""Whether a claim agrees with what is known of altitude and attitude."""

from __future__ import annotations

import numpy as np

from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.guard import SIGMAS
from horizonval.estimation.fit.known import LOCAL_RADIUS_SHARE
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.rotation import angle_between, tangent_basis


def contradicted(claim: Fit, observation: Observation, rho_rad: float, variance: float) -> Refusal | None:
    """Refuse a claim at :data:`SIGMAS` standard deviations from the known altitude or attitude.

    ``rho_rad``: half-angle of the limb as it is seen, ``variance``: its variance [rad^2].
    """
    off = _altitude_off(observation, rho_rad, variance)
    if off is not None:
        reason = f"the angular radius is {np.degrees(off):+.2f} deg from that of the known altitude"
        return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
    if observation.prior.rough_nadir is None:
        return None
    known, sigma = observation.prior.rough_nadir
    nadir = np.asarray(claim.nadir_cam)
    basis = tangent_basis(nadir)
    apart = basis.T @ (known - nadir)
    spread = basis.T @ claim.total_covariance_nadir_cam @ basis + sigma**2 * np.eye(2)
    # Beyond a right angle the difference of two unit vectors gets no longer across the first one.
    if known @ nadir > 0.0 and apart @ np.linalg.solve(spread, apart) <= SIGMAS**2:
        return None
    degrees = np.degrees(angle_between(known, nadir))
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
    slack = SIGMAS * float(np.sqrt(variance + of_altitude + misplaced))
    # A limb h higher adds h tan(rho) / R.
    low, high = (height * np.tan(expected) / radius for height in limb_height_m(observation.band_kind))
    off = rho_rad - expected
    return None if low - slack <= off <= high + slack else off
