r"""A claimed nadir is tested against the pixels: the limb that it predicts is fitted to them, and asked three times.

From the claim's nadir and angular radius, or altitude, a limb is predicted, and the most probable one near it fitted to
the pixels across it (:mod:`horizonval.estimation.likelihood.fit`): a sphere's, of free altitude, with the flattening
and the uneven height of the limb as unknowns with priors. Of that fit is asked:

1. *chi-squared*: across the edge the pixels may miss the fitted profile by the noise that the pixels to both sides of
   it show, and by :data:`PROFILE_SHARE` of the limb's step, as a single exponential misses the air's light::

       chi^2 / m = beyond / (PROFILE_SHARE^2 step^2) < Q(chi^2_m, CHANCE) / m

   for ``m`` pieces of limb: within a piece what the model leaves out is alike, between pieces it is not.
2. *explained share*: of the pieces of the predicted limb that are in view and lit
   (:mod:`horizonval.estimation.guard.limb_pieces`) so many must show the edge, with its sign, as tosses of a coin would
   not, and no other place may show one in as many.
3. *consistency*: the fitted limb must be the claimed one, to the height of the air and the Earth's flattening, and of
   what is known: the air's scale height, the altitude, the attitude, each by the Mahalanobis distance, :data:`SIGMAS`
   standard deviations of both sides together.

A picture passes that shows a disc, evenly bright, of a size that nothing known forbids: from some altitude the Earth is
one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.guard import guard_limits as limits
from horizonval.estimation.guard.limb_pieces import LimbPieces, limb_pieces
from horizonval.estimation.guard.wider_pixels import in_wider_pixels
from horizonval.estimation.likelihood.air import SCALE_HEIGHT_M, SCALE_SIGMA_M, knowledge_in_air
from horizonval.estimation.likelihood.claim import limb_scale
from horizonval.estimation.likelihood.fit import LimbLikelihoodFit, fit_limb
from horizonval.estimation.likelihood.knowledge import LOCAL_RADIUS_SHARE, LimbPose, sphere_knowledge
from horizonval.estimation.likelihood.limb_pixels import MISPLACED_PX
from horizonval.estimation.likelihood.pixels import pixel_at_limb_m
from horizonval.estimation.limb.finder import LARGEST_RHO_RAD
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import unproject
from horizonval.geometry.horizon import Cone
from horizonval.geometry.rotation import angle_between, off_axis_angle, tangent_basis

PROFILE_SHARE = 0.15
"""Root mean square by which the light across a limb departs from an exponential through lens and pixel, of its step:
0.01 to 0.08 under a high Sun and in the infrared, up to 0.16 towards the terminator, on frames of the default and the
nightly suite. Chosen after seeing those."""
CHANCE = 1e-6
"""Of a limb's own chi-squared to be refused."""
COIN = 0.1
"""Chance of as many pieces of one sign by tosses of a coin, below which they are a limb. It need not be rarer: a
picture without a limb fails the search for one, and the other tests. Four pieces can reach it, the shortest limb that a
search takes."""
SIGMAS = 5.0
"""Of all consistency: two Gaussian degrees of freedom go beyond it in four of a million."""
TAIL_PX = 1.0
"""Of a limb's softness that need not be air: the wings of a lens and a bolometer's lag reach as far. In pixels of 40 km
they are more than any air."""
PLACED_PX = 3.0
"""By which a method of whole pixels, or the fit where a sector shows little, may place a piece of limb otherwise."""


@dataclass(frozen=True)
class SeenLimb:
    """The limb that a method of points has found, as the image has it.

    ``nadir_cam``, ``rho_rad``: axis and half-angle of the cone through it; ``variance``: of the half-angle [rad^2], for
    noise and for all that makes the limb no circle.
    """

    nadir_cam: FloatArray
    rho_rad: float
    variance: float


def doubted(claim: Fit, observation: Observation, seen: SeenLimb | None = None) -> Refusal | None:
    """Return why a claim is not believed, or None.

    Parameters
    ----------
    claim : Fit
        With an angular radius or an altitude, unless its limb is given.
    observation : Observation
    seen : SeenLimb, optional
        Where the claim comes from points: its limb may have been lowered by a height that is known of it. Without, the
        claim is of the limb itself, and must agree with the fitted one in its nadir, too.
    """
    rho = _angular_radius(claim, observation) if seen is None else seen.rho_rad
    if rho is None:
        return Refusal(Outcome.NOT_CONVERGED, "the claim predicts no limb: it has no angular radius", claim.points)
    # Where the altitude is known its own test decides how large a disc must be.
    smallest = 0.0 if observation.prior.angular_radius is not None else limits.SMALLEST_RHO_RAD
    if not smallest < rho <= LARGEST_RHO_RAD:
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is no orbit's horizon", claim.points)
    radius = observation.prior.sphere_radius_m
    distance = radius / float(np.sin(rho))
    nadir = np.asarray(claim.nadir_cam) if seen is None else seen.nadir_cam
    planet, mean, information = sphere_knowledge(nadir, radius, distance - radius)
    knowledge = knowledge_in_air(observation, planet, mean, information, observation.prior.flattening * radius)
    start = LimbPose(np.eye(3), -distance * nadir)
    # A limb many pixels deep is no edge in the image's own pixels: it is asked for where the fits see it.
    scale = limb_scale(observation.camera, start, knowledge)
    observation, knowledge = in_wider_pixels(observation, scale), knowledge.in_wider_pixels(scale)
    image = np.asarray(observation.image, dtype=np.float64)
    try:
        found = fit_limb(image, observation.camera, start, knowledge)
        pieces = limb_pieces(image, observation, found, knowledge)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the limb that the claim predicts: {e}", claim.points)
    for refusal in (_by_chi_squared(pieces, claim), _by_share(pieces, claim)):
        if refusal is not None:
            return refusal
    predicted = Cone(nadir, float(np.cos(rho)))
    for refusal in (
        _by_place(found, predicted, observation, claim),
        None if seen is not None else _by_nadir(found, observation, claim),
        _by_altitude(found, observation, claim, seen),
        _by_attitude(observation, claim),
    ):
        if refusal is not None:
            return refusal
    return None


def _angular_radius(claim: Fit, observation: Observation) -> float | None:
    if claim.angular_radius_rad is not None:
        return float(claim.angular_radius_rad)
    if claim.altitude_m is None or not claim.altitude_m > 0.0:
        return None
    radius = observation.prior.sphere_radius_m
    return float(np.arcsin(radius / (radius + claim.altitude_m)))


def _by_chi_squared(pieces: LimbPieces, claim: Fit) -> Refusal | None:
    count = len(pieces.steps)
    square = pieces.edge_misfit / PROFILE_SHARE**2
    if square <= float(chi2.isf(CHANCE, count)) / count:
        return None
    share = np.sqrt(pieces.edge_misfit)
    return Refusal(Outcome.NO_LIMB, f"the pixels miss the limb's profile by {share:.0%} of its step", claim.points)


def _by_share(pieces: LimbPieces, claim: Fit) -> Refusal | None:
    due, shown = int(pieces.due.sum()), pieces.shown
    needed = int(binom.isf(COIN, due, 0.5)) + 1
    if shown < needed:
        reason = f"{shown} of {due} pieces of the predicted limb show an edge; {needed} are needed"
        return Refusal(Outcome.NO_LIMB, reason, claim.points)
    if pieces.rival_shown >= needed:
        reason = f"{pieces.rival_shown} of {due} pieces show a second limb beside the first"
        return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
    return None


def _by_place(found: LimbLikelihoodFit, predicted: Cone, observation: Observation, claim: Fit) -> Refusal | None:
    """Refuse a limb that is too soft for air, and one that is not where the claim has it.

    Along a short arc tilt and altitude can hardly be told apart: what can be compared is the limb in view. A claim may
    be of any height in the air, of an ellipsoid, and of whole pixels.
    """
    pixel_m = pixel_at_limb_m(observation.camera, found.pose.r_itrs, observation.prior.sphere_radius_m)
    if found.scale_height_m > max(SCALE_HEIGHT_M + SIGMAS * SCALE_SIGMA_M, TAIL_PX * pixel_m):
        reason = f"the edge is soft as air of a scale height of {found.scale_height_m / 1e3:.0f} km"
        return Refusal(Outcome.NO_LIMB, reason, claim.points)
    los = unproject(observation.camera, found.uv)
    rho = float(np.arccos(predicted.cos_rho))
    px_per_rad = max(observation.camera.fx, observation.camera.fy)
    off_px = float(np.abs(off_axis_angle(los, predicted.axis_cam) - rho).max()) * px_per_rad
    radius = observation.prior.sphere_radius_m
    low, high = limb_height_m(observation.band_kind)
    heights = high - low + observation.prior.flattening * radius
    if off_px <= heights * np.tan(rho) / radius * px_per_rad + PLACED_PX:
        return None
    return Refusal(Outcome.AMBIGUOUS, f"the most probable limb lies {off_px:.1f} px from the claimed one", claim.points)


def _by_nadir(found: LimbLikelihoodFit, observation: Observation, claim: Fit) -> Refusal | None:
    nadir = np.asarray(claim.nadir_cam)
    basis = tangent_basis(nadir)
    by_nadir = found.by_nadir
    claimed = basis.T @ claim.total_covariance_nadir_cam @ basis
    fitted = basis.T @ by_nadir @ found.covariance @ by_nadir.T @ basis
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    off = basis.T @ (found.pose.nadir_cam - nadir)
    if off @ np.linalg.solve(claimed + fitted + floor, off) <= SIGMAS**2:
        return None
    apart = np.degrees(angle_between(found.pose.nadir_cam, nadir))
    reason = f"the most probable limb has its nadir {apart:.2f} deg from the claimed one"
    return Refusal(Outcome.AMBIGUOUS, reason, claim.points)


def _by_altitude(
    found: LimbLikelihoodFit, observation: Observation, claim: Fit, seen: SeenLimb | None
) -> Refusal | None:
    """Refuse an angular radius that is not that of the known altitude: of the points, else of the fit of free altitude.

    A limb higher by ``h`` has the angular radius ``h tan(rho) / R`` larger.
    """
    if (known := _known_altitude(observation)) is None:
        return None
    expected, variance = known
    radius = observation.prior.sphere_radius_m
    if seen is None:
        distance = float(np.linalg.norm(found.pose.r_itrs))
        up = found.pose.r_itrs / distance
        rho = float(np.arcsin(radius / distance))
        of_distance = float(up @ found.covariance[3:6, 3:6] @ up) * (np.tan(rho) / distance) ** 2
        variance += of_distance
    else:
        rho = seen.rho_rad
        variance += seen.variance
    low, high = (h * np.tan(expected) / radius for h in limb_height_m(observation.band_kind))
    # In coarse pixels points lie in the limb's light, not at its edge: by 0.11 px in pixels of 350 km, and the fit of
    # free altitude, which has an exponential for that light, by 0.07.
    variance += (MISPLACED_PX / max(observation.camera.fx, observation.camera.fy)) ** 2
    slack = SIGMAS * float(np.sqrt(variance))
    if low - slack <= rho - expected <= high + slack:
        return None
    reason = f"the angular radius is {np.degrees(rho - expected):+.2f} deg from that of the known altitude"
    return Refusal(Outcome.AMBIGUOUS, reason, claim.points)


def _known_altitude(observation: Observation) -> tuple[float, float] | None:
    """Return the angular radius of the known altitude and its variance [rad^2]; of a known position else."""
    prior = observation.prior
    if prior.angular_radius is not None:
        return prior.angular_radius
    if prior.r_itrs is None or prior.position_sigma_m is None:
        return None
    radius, distance = prior.sphere_radius_m, float(np.linalg.norm(prior.r_itrs))
    if distance <= radius:
        return None
    rho = float(np.arcsin(radius / distance))
    # The Earth's radius below the satellite is that of the sphere to so much.
    local = LOCAL_RADIUS_SHARE * prior.flattening * radius
    return rho, (np.tan(rho) / distance) ** 2 * (prior.position_sigma_m**2 + local**2)


def _by_attitude(observation: Observation, claim: Fit) -> Refusal | None:
    prior = observation.prior
    basis = tangent_basis(np.asarray(claim.nadir_cam))
    claimed = basis.T @ claim.total_covariance_nadir_cam @ basis
    if prior.r_itrs is None or prior.q_cam_from_itrs is None:
        return None
    assert prior.position_sigma_m is not None
    assert prior.attitude_sigma_rad is not None
    distance = float(np.linalg.norm(prior.r_itrs))
    known = -Rotation.from_quat(prior.q_cam_from_itrs).as_matrix() @ prior.r_itrs / distance
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body).as_matrix()
    turn = cam_from_body @ np.diag(prior.attitude_sigma_rad**2) @ cam_from_body.T
    n = known
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    spread = basis.T @ (cross @ turn @ cross.T) @ basis + (prior.position_sigma_m / distance) ** 2 * np.eye(2)
    off = basis.T @ (known - np.asarray(claim.nadir_cam))
    # Beyond a right angle the difference of two unit vectors gets no longer across the first one.
    if known @ claim.nadir_cam > 0.0 and off @ np.linalg.solve(claimed + spread, off) <= SIGMAS**2:
        return None
    apart = np.degrees(angle_between(known, np.asarray(claim.nadir_cam)))
    return Refusal(Outcome.AMBIGUOUS, f"the nadir lies {apart:.1f} deg from that of the known attitude", claim.points)
