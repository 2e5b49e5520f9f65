"""A guard around any method: it tests what published methods take for granted, before and after the method runs.

1. *Points* of the limb that may be trusted are found in every image (:mod:`horizonval.estimation.guard.points`). Rows
   of linear arrays have one crossing each (:mod:`horizonval.estimation.guard.rows`).
2. *Sufficiency*: the points of all images together must determine the nadir to the accuracy of a claim, given noise and
   all that makes the limb no circle (:mod:`horizonval.estimation.guard.limits`). The body must be too large for the
   Moon.
3. *The method* runs on these points (``Estimator.from_points``, ``Estimator.from_heads``); of rows, on the images.
4. *The answer* must agree with the cone through the points, and with what is known of altitude and attitude, each by
   the Mahalanobis distance. No second limb may run beside the first.

Fits of the pixels have their guard within (:mod:`horizonval.estimation.fit.guard`).

Where the calibration states errors of the lens, they are part of the claim (:mod:`horizonval.estimation.lens_error`). A
claim that becomes too uncertain is refused.

The covariance of a fit from points of one image is that of the detector's noise; ``systematic_nadir_cam`` is the
covariance of what the method's model leaves out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import reliefs, systematic_covariance
from horizonval.estimation.fit.guard import LARGEST_RELIEF_M, LARGEST_RELIEF_PX, examined, too_uncertain, too_wide
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.knowledge import contradicted
from horizonval.estimation.guard.limits import model_covariance
from horizonval.estimation.guard.points import MUCH_LOST, TrustedPoints, trusted_points
from horizonval.estimation.guard.rows import RowLimb, is_row, misfit, row_limb
from horizonval.estimation.lens_error import WithLensError, lens_errors, with_lens_error
from horizonval.estimation.limb.cone import arc_order, cone_gain, cone_uncertainty, inwards_of
from horizonval.estimation.limb.finder import SIGMAS, largest_rho_rad
from horizonval.estimation.limb.locate import noise_covariance, pixel_noise
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.camera import project
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import angle_between, off_axis_angle, tangent_basis


def guarded(estimator: Estimator) -> Estimator:
    """Return the estimator behind the guard, named ``guarded-<name>``.

    One that is given the pose is only renamed.
    """
    run: Callable[[Observation], Fit | Refusal] = estimator.run
    if estimator.from_points or estimator.needs == "heads":
        run = partial(_run, estimator)
        run = with_lens_error(run, estimator.run.axis_of if isinstance(estimator.run, WithLensError) else None)
        run = partial(_not_too_wide, run)
    elif estimator.needs == "image":
        run = partial(_run_on_pixels, estimator)
    return replace(estimator, name=f"guarded-{estimator.name}", title=f"{estimator.title}, guarded", run=run)


def _not_too_wide(run: Callable[[Observation], Fit | Refusal], observation: Observation) -> Fit | Refusal:
    """Return what a guarded method claims, if it is enough for a claim with the errors of its lenses too."""
    result = run(observation)
    if isinstance(result, Refusal) or not any(lens_errors(observation)):
        return result
    refusal = too_wide(result, observation.prior.accept_rad)
    return result if refusal is None else refusal


def _run(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    if estimator.needs != "heads":
        return _run_on_points(estimator, observation)
    if observation.heads and all(is_row(head) for head in observation.heads.values()):
        return _run_on_rows(estimator, observation)
    return _run_on_arcs(estimator, observation)


@dataclass(frozen=True)
class GuardLimb:
    """The cone through the limb of all images, in the first camera's axes.

    ``axis``: without the known height of a sunlit limb, ``seen_rho_rad``: with it; ``noise``, ``systematic``:
    covariances (3, 3) [rad^2] of (axis along the tangent basis, half-angle).
    """

    axis: FloatArray
    seen_rho_rad: float
    noise: FloatArray
    systematic: FloatArray

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the nadir in its worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh((self.noise + self.systematic)[:2, :2])[-1]))


def _run_on_points(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    assert estimator.from_points is not None
    found = trusted_points(observation)
    if isinstance(found, Refusal):
        return found
    determined = _best_reach(found, estimator.estimates)
    if isinstance(determined, Refusal):
        return determined
    points, limb = determined
    result = estimator.from_points(points.ground, project(observation.camera, points.seen)[0], points.observation)
    if isinstance(result, Refusal):
        return result
    confirmed = _confirmed(replace(result, systematic_nadir_cam=None), limb, observation, limb.systematic[:2, :2])
    if isinstance(confirmed, Refusal):
        return confirmed
    seen, uv = points.observation, project(points.observation.camera, points.seen)[0]
    refusal = _unlike_a_limb(points.picture.grey, seen, points.seen_cone().axis_cam, limb.seen_rho_rad, uv)
    return _noise_apart(confirmed, points) if refusal is None else refusal


def _unlike_a_limb(
    image: FloatArray,
    observation: Observation,
    nadir_cam: FloatArray,
    rho_rad: float,
    points: FloatArray,
    *,
    by_pixels: bool = False,
) -> Refusal | None:
    """Return why the pixels about a cone's limb are not those of a limb in air, or None."""
    radius = observation.prior.sphere_radius_m
    pose = LimbPose(np.eye(3), -radius / float(np.sin(rho_rad)) * nadir_cam)
    return examined(image, observation, pose, sphere(radius), in_air=True, points=points, by_pixels=by_pixels).refusal


def _best_reach(points: TrustedPoints, estimates: str) -> tuple[TrustedPoints, GuardLimb] | Refusal:
    """Return the points under the Sun's zenith angles up to which they determine the nadir best, and their limb."""
    if points.zenith_rad is None:
        return _determined(points, estimates)
    found: dict[int, tuple[TrustedPoints, GuardLimb] | Refusal] = {}
    for reach in REACHES_RAD:
        within = points.zenith_rad <= reach
        much_lost = points.cause is None and within.mean() < 1.0 - MUCH_LOST
        some = replace(points, cause=Outcome.DARK) if much_lost else points
        if (count := int(within.sum())) not in found:
            found[count] = _determined(some.take(within), estimates)
    good = [one for one in found.values() if not isinstance(one, Refusal)]
    return min(good, key=lambda one: one[1].sigma_rad) if good else next(iter(found.values()))


def _determined(points: TrustedPoints, estimates: str) -> tuple[TrustedPoints, GuardLimb] | Refusal:
    """Return points without outliers and the cone through them; refuse points that leave the nadir open."""
    points = points.without_outliers()
    observation, los = points.observation, points.ground
    uv = project(observation.camera, points.seen)[0]
    status = points.cause or Outcome.SHORT_ARC
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(status, f"{len(los)} limb points are left", uv)
    axis = fit_cone(los).axis_cam
    rho = float(off_axis_angle(los, axis).mean())
    if observation.prior.angular_radius is None and rho < limits.SMALLEST_RHO_RAD:
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is not the Earth", uv)
    try:
        noise = cone_uncertainty(los, axis, rho).covariance
        systematic = model_covariance(los, axis, rho, observation, estimates, points.patterns_m)
    except np.linalg.LinAlgError:
        return Refusal(status, "the points do not determine a cone", uv)
    radius = observation.prior.sphere_radius_m
    pixel_m = radius / np.tan(rho) / max(observation.camera.fx, observation.camera.fy)
    relief_m = limits.seen_relief(los, axis, rho, radius).sigma_m
    if relief_m > max(LARGEST_RELIEF_M, LARGEST_RELIEF_PX * pixel_m):
        return Refusal(Outcome.NO_LIMB, f"the points bend by {1e-3 * relief_m:.0f} km along the limb", uv)
    seen_rho = float(off_axis_angle(points.seen, points.seen_cone().axis_cam).mean())
    limb = GuardLimb(axis, seen_rho, noise, systematic)
    if (reason := too_uncertain(limb.sigma_rad, observation.prior.accept_rad)) is not None:
        return Refusal(status, f"the limb that can be trusted {reason}", uv)
    return points, limb


def _noise_apart(fit: Fit, points: TrustedPoints) -> Fit:
    """Move the scatter beyond the detector's noise from the noise covariance to the systematic one."""
    image, camera, cone = points.picture.grey, points.observation.camera, points.seen_cone()
    rho = float(off_axis_angle(points.seen, cone.axis_cam).mean())
    of_pixels = pixel_noise(image, camera, cone.axis_cam, rho, points.observation.full_scale)
    try:
        noise = noise_covariance(image, camera, points.seen, cone.axis_cam, of_pixels)
    except np.linalg.LinAlgError:
        return fit
    basis = tangent_basis(fit.nadir_cam)
    turned = basis.T @ tangent_basis(cone.axis_cam)
    noise = turned @ noise[:2, :2] @ turned.T
    values, vectors = np.linalg.eigh(basis.T @ fit.covariance_nadir_cam @ basis - noise)
    rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    assert fit.systematic_nadir_cam is not None
    systematic = rest + basis.T @ fit.systematic_nadir_cam @ basis
    return replace(
        fit,
        covariance_nadir_cam=basis @ noise @ basis.T,
        systematic_nadir_cam=basis @ systematic @ basis.T,
    )


REACHES_RAD = tuple(float(np.deg2rad(angle)) for angle in (83.0, 86.0, 88.0, 90.0, 91.0, 92.0, 93.0, 94.0))
"""Sun's zenith angles up to which points may be used; the one that determines the nadir best is taken."""
HEAD_LOWEST_SUN_RAD = REACHES_RAD[0]
"""Sun's zenith angle at which the limb has risen by 0.7 km (5 km at 91 deg). Short arcs cannot tell a rise from a
tilt."""
HEAD_ARC_SHARE = 0.15
"""Smallest arc in every head, relative to the image's shorter side; less is a chord of a few pixels."""
HEADS_MISFIT_RAD = float(np.deg2rad(0.25))
HEADS_MISFIT_PX = 1.5
"""Root mean square by which the limbs of all heads may miss one cone: oblateness, and the search's scatter."""
HEAD_KNOTS = 6
"""Places along a head's arc at which the limb is moved to see what the method makes of it."""
MOVED_RAD = 1e-4
"""How far the limb is moved for that: a hundredth of a pixel and more, a hundredth of rho."""
MISFIT_CHANCE = 1e-6
"""Probability of the crossings' misfit below which they are not of one limb."""


def _turns(observation: Observation) -> dict[str, Rotation]:
    """Return the turns from the axes of the first head to those of each one, by way of the body."""
    first = Rotation.from_quat(next(iter(observation.heads.values())).q_cam_from_body)
    return {name: Rotation.from_quat(head.q_cam_from_body) * first.inv() for name, head in observation.heads.items()}


def _run_on_rows(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    rows: dict[str, RowLimb] = {}
    for name, head in observation.heads.items():
        found = row_limb(head)
        if isinstance(found, Refusal):
            return found.of_head(name)
        rows[name] = found
    result = estimator.run(observation)
    if isinstance(result, Refusal):
        return result
    turns = _turns(observation)
    down = {name: row.bright_side_down(turns[name].apply(result.nadir_cam)) for name, row in rows.items()}
    # If the band is unknown, the Earth may be the darker side, in all heads.
    wanted = observation.band_kind is not None or 2 * sum(down.values()) >= len(down)
    for name, one in down.items():
        if one != wanted:
            return Refusal(Outcome.NO_LIMB, f"head {name}: the bright side lies away from the Earth", result.points)
    los = np.array([turns[name].inv().apply(row.los_cam) for name, row in rows.items()])
    sigma = np.array([row.sigma_rad for row in rows.values()])
    axis = fit_cone(los).axis_cam
    rho = float(off_axis_angle(los, axis).mean())
    if misfit(los, axis, rho, sigma, observation) < MISFIT_CHANCE:
        return Refusal(Outcome.AMBIGUOUS, "the crossings of the heads do not lie on one limb", result.points)
    systematic = _systematic(los, axis, rho, observation, estimator.estimates)
    if systematic is None:
        return Refusal(Outcome.SHORT_ARC, "the heads' crossings do not determine a cone", result.points)
    gain = cone_gain(los, axis)
    limb = GuardLimb(axis, rho, (gain * sigma**2) @ gain.T, systematic)
    return _confirmed(result, limb, observation, systematic[:2, :2])


def _run_on_arcs(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    if estimator.from_heads is None:
        return Refusal(Outcome.BAD_INPUT, "the guard of several images needs a method of points (from_heads)")
    seen: dict[str, FloatArray] = {}
    for name, head in observation.heads.items():
        found = _arc_in_head(head)
        if isinstance(found, Refusal):
            return found.of_head(name)
        seen[name] = found
    turns = _turns(observation)
    los = np.concatenate([turns[name].inv().apply(one) for name, one in seen.items()])
    axis = fit_cone(los).axis_cam
    off = off_axis_angle(los, axis)
    rho, missed = float(off.mean()), float(off.std())
    if missed > HEADS_MISFIT_PX / max(observation.camera.fx, observation.camera.fy) + HEADS_MISFIT_RAD:
        return Refusal(Outcome.AMBIGUOUS, f"the limbs of the heads miss one cone by {np.degrees(missed):.2f} deg")
    systematic = _systematic(los, axis, rho, observation, estimator.estimates)
    if systematic is None:
        return Refusal(Outcome.SHORT_ARC, "the heads' limbs do not determine a cone")
    limb = GuardLimb(axis, rho, cone_uncertainty(los, axis, rho).covariance, systematic)
    points = {name: project(observation.heads[name].camera, one)[0] for name, one in seen.items()}
    result = estimator.from_heads(points, observation)
    if isinstance(result, Refusal):
        return result
    of_method = _of_method(estimator, result, seen, limb, observation)
    if of_method is None:
        return Refusal(Outcome.NOT_CONVERGED, "the method jumps where the limb is moved a little", result.points)
    return _confirmed(result, limb, observation, of_method)


def _arc_in_head(head: Observation) -> FloatArray | Refusal:
    """Return lines of sight to a head's limb in its own axes, shape (n, 3), or why there is none to trust."""
    points = trusted_points(head)
    if isinstance(points, Refusal):
        return points
    if head.band_kind is not None and not points.bright_inside:
        return Refusal(Outcome.NO_LIMB, "the limb has its bright side in space")
    rho = float(off_axis_angle(points.seen, points.seen_cone().axis_cam).mean())
    uv = project(head.camera, points.seen)[0]
    refusal = _unlike_a_limb(points.picture.grey, points.observation, points.seen_cone().axis_cam, rho, uv)
    if refusal is not None:
        return refusal
    if points.zenith_rad is not None:
        points = points.take(points.zenith_rad <= HEAD_LOWEST_SUN_RAD)
    # Limbs of several heads have no common height to be lowered by.
    points = replace(points, ground=points.seen, patterns_m=None).without_outliers()
    los, uv = points.seen, project(head.camera, points.seen)[0]
    shortest = HEAD_ARC_SHARE * min(head.camera.width, head.camera.height)
    length = float(np.linalg.norm(np.ptp(uv, axis=0))) if len(uv) else 0.0
    if len(los) < limits.FEWEST_POINTS or length < shortest:
        reason = f"{length:.0f} px of limb are to be trusted, {shortest:.0f} are needed"
        return Refusal(points.cause or Outcome.SHORT_ARC, reason, uv)
    return los[arc_order(los, fit_cone(los).axis_cam)]


def _systematic(
    los: FloatArray,
    axis: FloatArray,
    rho: float,
    observation: Observation,
    estimates: str,
    gain: FloatArray | None = None,
) -> FloatArray | None:
    try:
        return systematic_covariance(
            los,
            axis,
            rho,
            flattening=observation.prior.flattening,
            reliefs=reliefs(observation.band_kind, observation.prior.limb_relief_m),
            earth_radius_m=observation.prior.sphere_radius_m,
            estimates="geodetic" if estimates == "geodetic" else "geocentric",
            gain=gain,
        )
    except np.linalg.LinAlgError:
        return None


def _of_method(
    estimator: Estimator, fit: Fit, seen: Mapping[str, FloatArray], limb: GuardLimb, observation: Observation
) -> FloatArray | None:
    """Return the covariance (2, 2) of a method's nadir from oblateness and relief, in the limb's basis.

    A method may weigh its points differently from a cone fit. The limb is therefore raised at one place of each arc
    after another, falling to zero at the next place, and the method runs again each time.
    """
    assert estimator.from_heads is not None
    turns, basis = _turns(observation), tangent_basis(limb.axis)
    knots: list[FloatArray] = []
    gain: list[FloatArray] = []
    for name, los in seen.items():
        axis = turns[name].apply(limb.axis)
        places = np.linspace(0.0, len(los) - 1.0, HEAD_KNOTS)
        for place in places:
            hat = np.clip(1.0 - np.abs(np.arange(len(los)) - place) / (places[1] - places[0]), 0.0, None)
            moved = los - MOVED_RAD * hat[:, None] * inwards_of(los, axis)
            points = {
                other: project(observation.heads[other].camera, moved if other == name else one)[0]
                for other, one in seen.items()
            }
            again = estimator.from_heads(points, observation)
            if isinstance(again, Refusal):
                return None
            knots.append(turns[name].inv().apply(los[round(place)]))
            gain.append((again.nadir_cam - fit.nadir_cam) @ basis / MOVED_RAD)
    moves = np.vstack([np.array(gain).T, np.zeros(len(gain))])
    systematic = _systematic(np.array(knots), limb.axis, limb.seen_rho_rad, observation, estimator.estimates, moves)
    return None if systematic is None else systematic[:2, :2]


def _confirmed(fit: Fit, limb: GuardLimb, observation: Observation, systematic: FloatArray) -> Fit | Refusal:
    """Return the fit with its model error, ``systematic`` (2, 2), if the limb and all that is known bear it out."""
    rho = limb.seen_rho_rad
    smallest = 0.0 if observation.prior.angular_radius is not None else limits.SMALLEST_RHO_RAD
    if not smallest <= rho <= largest_rho_rad(observation.prior):
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is no orbit's horizon", fit.points)
    basis = tangent_basis(limb.axis)
    of_points = 0.0 if fit.systematic_nadir_cam is None else fit.systematic_nadir_cam
    confirmed = replace(fit, systematic_nadir_cam=of_points + basis @ systematic @ basis.T)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - limb.axis)
    # Few points bend with the limb's shape otherwise than many do: the model's error counts, too.
    spread = basis.T @ confirmed.total_covariance_nadir_cam @ basis + limb.noise[:2, :2]
    spread += limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ limb.axis < 0 or apart @ np.linalg.solve(spread, apart) > SIGMAS**2:
        angle = np.degrees(angle_between(np.asarray(fit.nadir_cam), limb.axis))
        return Refusal(Outcome.AMBIGUOUS, f"the method's nadir lies {angle:.2f} deg from that of the limb", fit.points)
    variance = float(limb.noise[2, 2] + limb.systematic[2, 2])
    for refusal in (
        too_wide(confirmed, observation.prior.accept_rad),
        contradicted(confirmed, observation, rho, variance),
    ):
        if refusal is not None:
            return refusal
    return confirmed


def _run_on_pixels(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    """Run a method that takes the whole image, and test its claim; a fit of the pixels has most of its guard within."""
    result = estimator.run(observation)
    if isinstance(result, Refusal):
        return result
    prior, nadir = observation.prior, np.asarray(result.nadir_cam)
    rho = result.angular_radius_rad
    if rho is None:
        altitude = result.altitude_m or 0.0
        rho = float(np.arcsin(prior.sphere_radius_m / (prior.sphere_radius_m + max(altitude, 1.0))))
    if prior.angular_radius is None and rho < limits.SMALLEST_RHO_RAD:
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is not the Earth", result.points)
    if estimator.claim == "likelihood":
        # Claims of a fit are false beyond half of the error that is allowed to a cone.
        refusal = too_wide(result, 0.5 * prior.accept_rad)
        return result if refusal is None else refusal
    image = np.asarray(observation.image, dtype=np.float64)
    refusal = _unlike_a_limb(image, observation, nadir, rho, result.points, by_pixels=True)
    if refusal is None:
        refusal = too_wide(result, prior.accept_rad)
    return result if refusal is None else refusal
