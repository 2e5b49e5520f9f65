"""A guard around any method: it tests what published methods take for granted, before and after the method runs.

1. *Points* of the limb that may be trusted are found in every image (:mod:`horizonval.estimation.guard.points`). Rows
   of linear arrays have one crossing each (:mod:`horizonval.estimation.guard.rows`).
2. *Sufficiency*: the points of all images together must determine the nadir to the accuracy of a claim, given noise and
   all that makes the limb no circle (:mod:`horizonval.estimation.guard.limits`). The body must be too large for the
   Moon.
3. *The method* runs on these points (``Estimator.from_points``, ``Estimator.from_heads``), without the known height of
   the limb along it; of rows, on the images.
4. *The answer* must agree with the cone through the points, and with what is known of altitude and attitude, each by
   the Mahalanobis distance. The pixels about the limb must pass the guard of the fits
   (:mod:`horizonval.estimation.fit.guard`), which methods of the pixels have within.

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
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import reliefs, systematic_covariance
from horizonval.estimation.fit.guard import CHANCE, SIGMAS, accepted, examined
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.guard.limits import SMALLEST_RHO_RAD, contradicted, model_error
from horizonval.estimation.guard.points import TrustedPoints, trusted_points
from horizonval.estimation.guard.rows import RowLimb, is_row, misfit, row_limb
from horizonval.estimation.lens_error import WithLensError, with_lens_error
from horizonval.estimation.limb.cone import arc_order, cone_gain, cone_uncertainty, inwards_of
from horizonval.estimation.limb.finder import largest_rho_rad
from horizonval.estimation.limb.locate import noise_covariance, pixel_noise
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.camera import project
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import angle_between, off_axis_angle, tangent_basis

AGREEMENT_FLOOR_RAD = float(np.deg2rad(0.02))
"""Smallest tolerance for methods with whole pixels or circles where the guard uses sub-pixels and cones."""
HEAD_LOWEST_SUN_RAD = float(np.deg2rad(83.0))
"""Sun's zenith angle at which the limb has risen by 0.7 km (5 km at 91 deg). The limbs of several heads are not lowered
by their height, and short arcs cannot tell a rise from a tilt."""


def guarded(estimator: Estimator) -> Estimator:
    """Return the estimator behind the guard, named ``guarded-<name>``.

    One that is given the pose is only renamed.
    """
    run: Callable[[Observation], Fit | Refusal] = estimator.run
    if estimator.from_points or estimator.needs == "heads":
        run = partial(_run, estimator)
        run = with_lens_error(run, estimator.run.axis_of if isinstance(estimator.run, WithLensError) else None)
        run = partial(_accepted, run)
    elif estimator.needs == "image":
        run = partial(_run_on_pixels, estimator)
    return replace(estimator, name=f"guarded-{estimator.name}", title=f"{estimator.title}, guarded", run=run)


def _accepted(run: Callable[[Observation], Fit | Refusal], observation: Observation) -> Fit | Refusal:
    return accepted(run(observation), observation.prior.accept_rad)


def _run(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    if estimator.needs != "heads":
        return _run_on_points(estimator, observation)
    if observation.heads and all(is_row(head) for head in observation.heads.values()):
        return _run_on_rows(estimator, observation)
    return _run_on_arcs(estimator, observation)


@dataclass(frozen=True)
class GuardLimb:
    """The cone through the limb of all images, in the first camera's axes.

    ``axis``: shape (3,), without the known height of the limb along it; ``rho_rad``: mean half-angle of the limb as it
    is seen; ``noise``, ``systematic``: covariances (3, 3) [rad^2] of (axis along the tangent basis, half-angle).
    """

    axis: FloatArray
    rho_rad: float
    noise: FloatArray
    systematic: FloatArray


def _run_on_points(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    assert estimator.from_points is not None
    points = trusted_points(observation)
    if isinstance(points, Refusal):
        return points
    # Points are reported in pixels of the image; they may have been measured in wider ones.
    uv = project(observation.camera, points.los)[0]
    seen, first, rho = points.observation, points.axis, points.rho_rad
    if seen.prior.angular_radius is None and rho < SMALLEST_RHO_RAD:
        return _no_earth(rho, uv)
    try:
        raised, model = model_error(points.los, first, rho, seen, estimator.estimates)
        los = np.cos(raised)[:, None] * points.los + np.sin(raised)[:, None] * inwards_of(points.los, first)
        axis = fit_cone(los).axis_cam
        noise = cone_uncertainty(los, axis, float(off_axis_angle(los, axis).mean())).covariance
    except np.linalg.LinAlgError:
        return Refusal(points.cause, "the points do not determine a cone", uv)
    turn = block_diag(tangent_basis(axis).T @ tangent_basis(first), 1.0)
    limb = GuardLimb(axis, rho, noise, turn @ model @ turn.T)
    result = estimator.from_points(los, uv, seen)
    if isinstance(result, Refusal):
        return result
    confirmed = _confirmed(replace(result, systematic_nadir_cam=None), limb, observation, limb.systematic[:2, :2])
    if isinstance(confirmed, Refusal):
        short = confirmed.status is Outcome.SHORT_ARC
        return replace(confirmed, status=points.cause) if short else confirmed
    refusal = _unlike_a_limb(points, uv)
    return _noise_apart(confirmed, points) if refusal is None else refusal


def _no_earth(rho_rad: float, points: FloatArray) -> Refusal:
    return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho_rad):.2f} deg is not the Earth", points)


def _unlike_a_limb(points: TrustedPoints, uv: FloatArray) -> Refusal | None:
    """Return why the pixels about the points show no limb in air, or None."""
    return _unlike(points.picture.grey, points.observation, points.axis, points.rho_rad, uv, by_pixels=False)


def _unlike(
    image: FloatArray, observation: Observation, nadir: FloatArray, rho_rad: float, uv: FloatArray, *, by_pixels: bool
) -> Refusal | None:
    radius = observation.prior.sphere_radius_m
    pose = LimbPose(np.eye(3), -radius / float(np.sin(rho_rad)) * nadir)
    return examined(image, observation, pose, sphere(radius), in_air=True, points=uv, by_pixels=by_pixels)


def _noise_apart(fit: Fit, points: TrustedPoints) -> Fit:
    """Move the scatter beyond the detector's noise from the noise covariance to the systematic one."""
    image, camera, axis = points.picture.grey, points.observation.camera, points.axis
    of_pixels = pixel_noise(image, camera, axis, points.rho_rad, points.observation.full_scale)
    try:
        noise = noise_covariance(image, camera, points.los, axis, of_pixels)
    except np.linalg.LinAlgError:
        return fit
    basis = tangent_basis(fit.nadir_cam)
    turned = basis.T @ tangent_basis(axis)
    noise = turned @ noise[:2, :2] @ turned.T
    values, vectors = np.linalg.eigh(basis.T @ fit.covariance_nadir_cam @ basis - noise)
    rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    assert fit.systematic_nadir_cam is not None
    return replace(
        fit,
        covariance_nadir_cam=basis @ noise @ basis.T,
        systematic_nadir_cam=fit.systematic_nadir_cam + basis @ rest @ basis.T,
    )


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
    if misfit(los, axis, rho, sigma, observation) < CHANCE:
        return Refusal(Outcome.AMBIGUOUS, "the crossings of the heads do not lie on one limb", result.points)
    try:
        systematic = _systematic(los, axis, rho, observation, estimator.estimates)
        gain = cone_gain(los, axis)
    except np.linalg.LinAlgError:
        return Refusal(Outcome.SHORT_ARC, "the heads' crossings do not determine a cone", result.points)
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
    # Oblateness, and the search's scatter.
    if missed > np.deg2rad(0.25) + 1.5 / max(observation.camera.fx, observation.camera.fy):
        return Refusal(Outcome.AMBIGUOUS, f"the limbs of the heads miss one cone by {np.degrees(missed):.2f} deg")
    try:
        systematic = _systematic(los, axis, rho, observation, estimator.estimates)
        limb = GuardLimb(axis, rho, cone_uncertainty(los, axis, rho).covariance, systematic)
    except np.linalg.LinAlgError:
        return Refusal(Outcome.SHORT_ARC, "the heads' limbs do not determine a cone")
    result = estimator.from_heads(_pixels(seen, observation), observation)
    if isinstance(result, Refusal):
        return result
    of_method = _of_method(estimator, result, seen, limb, observation)
    if of_method is None:
        return Refusal(Outcome.NOT_CONVERGED, "the method jumps where the limb is moved a little", result.points)
    return _confirmed(result, limb, observation, of_method)


def _pixels(los_cam: Mapping[str, FloatArray], observation: Observation) -> dict[str, FloatArray]:
    return {name: project(observation.heads[name].camera, one)[0] for name, one in los_cam.items()}


def _arc_in_head(head: Observation) -> FloatArray | Refusal:
    """Return lines of sight to a head's limb in its own axes, shape (n, 3), or why there is none to trust."""
    points = trusted_points(head, HEAD_LOWEST_SUN_RAD)
    if isinstance(points, Refusal):
        return points
    if head.band_kind is not None and not points.bright_inside:
        return Refusal(Outcome.NO_LIMB, "the limb has its bright side in space")
    uv = project(head.camera, points.los)[0]
    refusal = _unlike_a_limb(points, uv)
    if refusal is not None:
        return refusal
    # Less is a chord of a few pixels.
    shortest = 0.15 * min(head.camera.width, head.camera.height)
    length = float(np.linalg.norm(np.ptp(uv, axis=0)))
    if length < shortest:
        return Refusal(points.cause, f"{length:.0f} px of limb are to be trusted, {shortest:.0f} are needed", uv)
    return points.los[arc_order(points.los, points.axis)]


def _systematic(
    los: FloatArray,
    axis: FloatArray,
    rho: float,
    observation: Observation,
    estimates: str,
    gain: FloatArray | None = None,
) -> FloatArray:
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


def _of_method(
    estimator: Estimator, fit: Fit, seen: Mapping[str, FloatArray], limb: GuardLimb, observation: Observation
) -> FloatArray | None:
    """Return the covariance (2, 2) of a method's nadir from oblateness and relief, in the limb's basis.

    A method may weigh its points differently from a cone fit. The limb is therefore raised at one place of each arc
    after another, falling to zero at the next place, and the method runs again each time.
    """
    assert estimator.from_heads is not None
    turns, basis = _turns(observation), tangent_basis(limb.axis)
    # A hundredth of a pixel and more, a hundredth of rho.
    moved_rad = 1e-4
    knots: list[FloatArray] = []
    gain: list[FloatArray] = []
    for name, los in seen.items():
        inwards = inwards_of(los, turns[name].apply(limb.axis))
        places = np.linspace(0.0, len(los) - 1.0, 6)
        for place in places:
            hat = np.clip(1.0 - np.abs(np.arange(len(los)) - place) / (places[1] - places[0]), 0.0, None)
            moved = {**seen, name: los - moved_rad * hat[:, None] * inwards}
            again = estimator.from_heads(_pixels(moved, observation), observation)
            if isinstance(again, Refusal):
                return None
            knots.append(turns[name].inv().apply(los[round(place)]))
            gain.append((again.nadir_cam - fit.nadir_cam) @ basis / moved_rad)
    moves = np.vstack([np.array(gain).T, np.zeros(len(gain))])
    return _systematic(np.array(knots), limb.axis, limb.rho_rad, observation, estimator.estimates, moves)[:2, :2]


def _confirmed(fit: Fit, limb: GuardLimb, observation: Observation, systematic: FloatArray) -> Fit | Refusal:
    """Return the fit with its model error, ``systematic`` (2, 2), if the limb and all that is known bear it out."""
    rho, prior = limb.rho_rad, observation.prior
    smallest = 0.0 if prior.angular_radius is not None else SMALLEST_RHO_RAD
    if not smallest <= rho <= largest_rho_rad(prior):
        return _no_earth(rho, fit.points)
    basis = tangent_basis(limb.axis)
    of_points = 0.0 if fit.systematic_nadir_cam is None else fit.systematic_nadir_cam
    confirmed = replace(fit, systematic_nadir_cam=of_points + basis @ systematic @ basis.T)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - limb.axis)
    # Few points bend with the limb's shape otherwise than many do: the model's error counts, too.
    spread = basis.T @ confirmed.total_covariance_nadir_cam @ basis + limb.noise[:2, :2]
    spread += AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ limb.axis < 0 or apart @ np.linalg.solve(spread, apart) > SIGMAS**2:
        angle = np.degrees(angle_between(np.asarray(fit.nadir_cam), limb.axis))
        return Refusal(Outcome.AMBIGUOUS, f"the method's nadir lies {angle:.2f} deg from that of the limb", fit.points)
    variance = float(limb.noise[2, 2] + limb.systematic[2, 2])
    refusal = contradicted(confirmed, observation, rho, variance)
    return accepted(confirmed, prior.accept_rad) if refusal is None else refusal


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
    if prior.angular_radius is None and rho < SMALLEST_RHO_RAD:
        return _no_earth(rho, result.points)
    if estimator.claim == "likelihood":
        # Claims of a fit are false beyond half of the error that is allowed to a cone.
        return accepted(result, 0.5 * prior.accept_rad)
    image = np.asarray(observation.image, dtype=np.float64)
    refusal = _unlike(image, observation, nadir, rho, result.points, by_pixels=True)
    return accepted(result, prior.accept_rad) if refusal is None else refusal
