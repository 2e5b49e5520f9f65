"""The estimator: a start in closed form, profiles about its horizon, the network on each, one fit through all.

Twice: what the first round finds is where the second one looks. Refused are visible bands (it has seen none), images
without a cone of steep pixels, limbs whose profiles are unlike those of the training, contradict each other or stand at
another height, arcs that are too short, and answers that are not sure to :data:`LARGEST_SIGMA_RAD`. Profiles that
contradict each other a little widen what is claimed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import horizonval as hv
from horizonval.geometry.frames import inverse, roll_pitch_of_nadir, rotate
from horizonval.geometry.rotation import tangent_basis
from horizonval_learned.first_cone import first_cone
from horizonval_learned.fit import rows_of, solve
from horizonval_learned.network import Network, features
from horizonval_learned.patch import AZIMUTHS, Patch, Sampler, horizon_rad

EARTH_KM = 6371.0
ROUNDS = 2
SHORTEST_ARC = 12
"""Azimuths, of 360, whose profiles are in the image and known."""
LEAST_KNOWN = 0.6
"""Share of the profiles in the image that must be like those of the training."""
LARGEST_SIGMA_RAD = np.radians(0.25)
MOST_SCATTER = 25.0
"""Of the squared residuals of profiles over those of nearly all frames of the validation: five times as far off."""
MOST_HEIGHTS = 5.0
"""Sigmas by which the limb may stand higher or lower than those of the training, where the place is known."""
LEAST_HEIGHT_KM = 1.0
"""Of that sigma; no air is known better."""


@dataclass(frozen=True)
class Seen:
    """The rows of one round, and what they are about.

    ``known``: which profiles are like those of the training; ``rows``, ``offset`` and ``weight`` are of those.
    """

    patch: Patch
    known: np.ndarray
    rows: np.ndarray
    offset: np.ndarray
    weight: np.ndarray
    rho_rad: float
    limb_km: float
    radius_sigma_rad: float
    placed: bool

    @property
    def normal(self) -> np.ndarray:
        """Normal matrix, shape (5, 5)."""
        return self.rows.T @ (self.weight[:, None] * self.rows)

    @property
    def right(self) -> np.ndarray:
        """Right side of the normal equations, shape (5,)."""
        return self.rows.T @ (self.weight * self.offset)

    def scatter(self, unknowns: np.ndarray) -> float:
        """Return the mean squared residual in sigmas of the profiles' own."""
        return float((self.weight * (self.offset - self.rows @ unknowns) ** 2).mean())


def run(observation: hv.Observation, network: Network) -> hv.Fit | hv.Refusal:
    """Return the nadir that the limb says, or why it says none."""
    if observation.band_kind == "solar":
        return hv.Refusal(hv.Outcome.BAD_INPUT, "has learned from infrared frames alone")
    start = first_cone(observation)
    if isinstance(start, hv.Refusal):
        return start
    settled = settle(observation, network, *start)
    if isinstance(settled, hv.Refusal):
        return settled
    thought, seen = settled
    unknowns, covariance = solve_of(seen, network)
    scatter = seen.scatter(unknowns) / network.scatter
    if scatter > MOST_SCATTER:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"profiles contradict each other: {scatter:.3g} times what is usual")
    if scatter > 1.0:
        unknowns, covariance = solve_of(seen, network, scatter)
    heights = height_sigmas(seen, network, scatter)
    if heights > MOST_HEIGHTS:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"the limb stands {heights:.3g} sigma off the known place's")
    basis = tangent_basis(thought)
    nadir = turned(thought, unknowns)
    sigma = float(np.sqrt(np.trace(covariance[:2, :2])))
    if not sigma < LARGEST_SIGMA_RAD:
        return hv.Refusal(hv.Outcome.SHORT_ARC, f"sure to no more than {np.degrees(sigma):.2g} deg")
    across = np.eye(3) - np.outer(nadir, nadir)
    roll, pitch = roll_pitch_of_nadir(rotate(inverse(observation.q_cam_from_body), nadir))
    return hv.Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=across @ basis @ covariance[:2, :2] @ basis.T @ across,
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        angular_radius_rad=seen.rho_rad + float(unknowns[2]),
    )


def settle(
    observation: hv.Observation, network: Network, nadir: np.ndarray, rho: float
) -> tuple[np.ndarray, Seen] | hv.Refusal:
    """Return the nadir about which the last round looks, and what it sees; or why a round says nothing."""
    sampler = Sampler(observation)
    for number in range(ROUNDS):
        seen = look(sampler, network, nadir, rho)
        count, known = len(seen.known), int(seen.known.sum())
        if count < SHORTEST_ARC:
            return hv.Refusal(hv.Outcome.SHORT_ARC, f"{count} deg of limb with both sides in the image")
        if known < max(SHORTEST_ARC, LEAST_KNOWN * count):
            return hv.Refusal(hv.Outcome.NO_LIMB, f"{known} of {count} profiles are like those of the training")
        if number + 1 < ROUNDS:
            unknowns, _ = solve_of(seen, network)
            nadir, rho = turned(nadir, unknowns), seen.rho_rad + float(unknowns[2])
    return nadir, seen


def solve_of(seen: Seen, network: Network, scatter: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the five unknowns of a round and their covariance, of profiles that scatter by more than is usual."""
    model = network.placed if seen.placed else network.free
    wider = replace(model, spread=model.spread * max(scatter, 1.0))
    return solve(seen.normal, seen.right, wider, seen.limb_km, seen.radius_sigma_rad)


def height_sigmas(seen: Seen, network: Network, scatter: float) -> float:
    """Return by how many sigmas the limb stands off the known radius, told by the image alone; 0 without a radius."""
    if not seen.placed:
        return 0.0
    unknowns, covariance = solve_of(replace(seen, radius_sigma_rad=np.inf), network, scatter)
    known = np.hypot(max(network.placed.height_km, LEAST_HEIGHT_KM) / seen.limb_km, seen.radius_sigma_rad)
    return float(abs(unknowns[2]) / np.hypot(np.sqrt(covariance[2, 2]), known))


def turned(nadir: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Return a nadir tilted by the first two unknowns."""
    there = nadir + tangent_basis(nadir) @ unknowns[:2]
    return there / np.linalg.norm(there)


def look(sampler: Sampler, network: Network, nadir: np.ndarray, rho: float) -> Seen:
    """Return what the network says of the limb about a nadir; of an unknown place the horizon is a cone of ``rho``."""
    observation = sampler.observation
    horizon = horizon_rad(observation, nadir)
    placed = horizon is not None
    if horizon is None:
        horizon = np.full(AZIMUTHS, rho)
    mean = float(horizon.mean())
    distance_km = EARTH_KM / np.sin(mean)
    limb_km = EARTH_KM / np.tan(mean)
    patch = sampler.patch(nadir, horizon)
    known = (network.strangeness(patch.profiles) < network.unlike) & (patch.contrast > 0.0)
    offset, sigma = network.horizon(features(patch, limb_km))
    rows = rows_of(patch.azimuth_rad[known])
    radius_sigma = np.inf
    if placed:
        radius_sigma = np.tan(mean) * (observation.prior.position_sigma_m or 0.0) / (1e3 * distance_km)
    return Seen(patch, known, rows, offset[known], sigma[known] ** -2.0, mean, limb_km, float(radius_sigma), placed)
