"""A guard around any method: it tests what published methods take for granted, before and after the method runs.

1. *The limb* is the curve whose predicted profile makes the pixels most probable
   (:mod:`horizonval.estimation.limb.finder`). A limb many pixels deep is searched in a smaller copy.
2. *Points* are moved to the steepest position of the soft limb (:mod:`horizonval.estimation.limb.steepest`). Points on
   saturated, faded or restless pieces, isolated points, and outliers from the cone are left out
   (:mod:`horizonval.estimation.limb.trusted`). Where the Sun's direction is known, the known height of the sunlit limb
   is subtracted (:mod:`horizonval.estimation.guard.sunlit`).
3. *Sufficiency*: the remaining pieces must determine the nadir to the accuracy of a claim, given noise and all that
   makes the limb no circle (:mod:`horizonval.estimation.guard.limits`). The body must be too large for the Moon.
4. *The method* runs on the remaining points (``Estimator.from_points``). Its answer must agree with the guard's cone
   within the uncertainty of both.
5. *The answer* is tested against the pixels (:mod:`horizonval.estimation.guard.three_tests`).

A method that uses the whole image instead of points answers first; step 5 decides. Methods of several heads are guarded
by :mod:`horizonval.estimation.guard.heads`.

Where the calibration states errors of the lens, they are part of the claim (:mod:`horizonval.estimation.lens_error`). A
claim that becomes too uncertain is refused.

The covariance of a fit from points is that of the detector's noise; ``systematic_nadir_cam`` is the covariance of what
the method's model leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.heads import run_heads
from horizonval.estimation.guard.limits import blur_of, model_covariance
from horizonval.estimation.guard.sunlit import SunlitLimb, sun_angles, sunlit_limb
from horizonval.estimation.guard.three_tests import SeenLimb, doubted, in_wider_pixels
from horizonval.estimation.lens_error import WithLensError, lens_errors, with_lens_error
from horizonval.estimation.likelihood.height import SUN_SIGMA_RAD
from horizonval.estimation.limb.cone import ConeUncertainty, cone_uncertainty, limb_directions
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, Picture, in_whole, median
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.estimation.limb.steepest import NEEDED_PX, noise_covariance, pixel_variance, to_steepest
from horizonval.estimation.limb.trusted import alone, faded, faint, read_sides, restless, saturated
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.camera import project, unproject
from horizonval.geometry.horizon import Cone, fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


@dataclass(frozen=True)
class TrustedLimb:
    """Limb points that passed every test, and how well a cone through them is determined.

    Attributes
    ----------
    seen_cam : ndarray, shape (n, 3)
        Lines of sight as the image has them.
    los_cam : ndarray, shape (n, 3)
        The same without the known height of a sunlit limb.
    uv : ndarray, shape (n, 2)
    cone : Cone
        Through ``los_cam``, of half-angle ``rho_rad``.
    noise : ConeUncertainty
        From the points' scatter, whatever makes it.
    systematic : ndarray, shape (3, 3)
        Covariance of what is not known of the limb's shape, as of (axis, axis, half-angle).
    bright_inside : bool
        Whether the Earth is the brighter side.
    """

    seen_cam: FloatArray
    los_cam: FloatArray
    uv: FloatArray
    cone: Cone
    rho_rad: float
    noise: ConeUncertainty
    systematic: FloatArray
    bright_inside: bool

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the nadir in its worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh((self.noise.covariance + self.systematic)[:2, :2])[-1]))


def guarded(estimator: Estimator) -> Estimator:
    """Return the estimator behind the guard, named ``guarded-<name>``; one that is given the pose is only renamed."""
    run: Callable[[Observation], Fit | Refusal] = estimator.run
    if estimator.needs != "pose":
        of_pixels = estimator.needs == "image" and estimator.from_points is None
        axis_of = estimator.run.axis_of if isinstance(estimator.run, WithLensError) else None
        run = with_lens_error(partial(run_heads if estimator.needs == "heads" else _run, estimator), axis_of)
        run = partial(_not_too_wide, run, limits.PIXEL_SHARE if of_pixels else 1.0)
    return replace(estimator, name=f"guarded-{estimator.name}", title=f"{estimator.title}, guarded", run=run)


def _not_too_wide(run: Callable[[Observation], Fit | Refusal], share: float, observation: Observation) -> Fit | Refusal:
    """Return what a guarded method claims, if it is enough for a claim with the errors of its lenses too."""
    result = run(observation)
    if isinstance(result, Refusal) or not any(lens_errors(observation)):
        return result
    refusal = too_wide(result, share * observation.prior.accept_rad)
    return result if refusal is None else refusal


def _trusted(picture: Picture, found: LimbPoints, observation: Observation, estimates: str) -> TrustedLimb | Refusal:
    """Return what may be trusted of a limb that the search has found."""
    image, camera = picture.grey, observation.camera
    cone = fit_cone(found.los_cam)
    sides = read_sides(picture, camera, found.los_cam, cone.axis_cam)
    bright_inside = bool(median(sides.inner - sides.outer) > 0.0)
    los, _ = to_steepest(image, camera, found.los_cam, cone.axis_cam, bright_inside)
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(Outcome.SHORT_ARC, f"{len(los)} limb points have their profile in view", found.uv)
    sun = observation.sun_cam if observation.band_kind == "solar" else None
    if sun is not None:
        los = _into_twilight(los, image, observation, sun, bright_inside)
        if len(los) < limits.FEWEST_POINTS:
            return Refusal(Outcome.DARK, f"{len(los)} limb points are followed towards the terminator", found.uv)
    axis = fit_cone(los).axis_cam
    sides = read_sides(picture, camera, los, axis)
    tests = {Outcome.SUN_GLARE: restless(sides)}
    if sun is not None:
        tests[Outcome.DARK] = faint(sides, picture.noise_sigma, bright_inside) | ~np.isfinite(
            _sunlit(los, observation, sun).height_m
        )
    elif observation.band_kind == "thermal":
        # The infrared limb shines all round; what fades is the lens towards the corners of a wide field.
        tests[Outcome.DARK] = faint(sides, picture.noise_sigma, bright_inside)
    else:
        tests[Outcome.DARK] = faded(sides)
    if observation.full_scale is not None:
        tests[Outcome.SATURATED] = saturated(sides, observation.full_scale)
    bad = np.any(list(tests.values()), axis=0)
    worst = max(tests, key=lambda outcome: int(tests[outcome].sum())) if bad.any() else Outcome.SHORT_ARC
    trusted = los[~bad]
    if len(trusted) >= limits.FEWEST_POINTS:
        trusted = trusted[~alone(trusted, camera)]
    lost = 1.0 - len(trusted) / len(los)
    los = trusted
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(worst, _too_few(lost, axis, found.los_cam, observation), project(camera, los)[0])
    cause = worst if lost > limits.MUCH_LOST else None
    if sun is None:
        return _determined(_GuardPoints(los, los, None, bright_inside), observation, estimates, cause)
    return _best_reach(los, observation, sun, estimates, cause, bright_inside)


@dataclass(frozen=True)
class _GuardPoints:
    """Points on their way through the guard: as seen, as they would be on the ground, and what is not known of that."""

    seen: FloatArray
    los: FloatArray
    patterns: FloatArray | None
    bright_inside: bool

    def take(self, rows: NDArray[np.bool_]) -> _GuardPoints:
        patterns = None if self.patterns is None else self.patterns[:, rows]
        return _GuardPoints(self.seen[rows], self.los[rows], patterns, self.bright_inside)


def _into_twilight(
    los: FloatArray, image: FloatArray, observation: Observation, sun: FloatArray, bright_inside: bool
) -> FloatArray:
    """Return the points under a high Sun and, where it is low, the cone's own directions: edges fade out there."""
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    on_cone = limb_directions(observation.camera, cone.axis_cam, rho, NEEDED_PX)
    low = sun_angles(on_cone, cone.axis_cam, sun)[0] > limits.LOW_SUN_RAD
    followed, _ = to_steepest(image, observation.camera, on_cone[low], cone.axis_cam, bright_inside)
    off = np.abs(off_axis_angle(followed, cone.axis_cam) - rho)
    followed = followed[off * max(observation.camera.fx, observation.camera.fy) < limits.FOLLOWED_PX]
    high = sun_angles(los, cone.axis_cam, sun)[0] <= limits.LOW_SUN_RAD
    return np.concatenate([los[high], followed])


def _sunlit(los: FloatArray, observation: Observation, sun: FloatArray) -> SunlitLimb:
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    blur = blur_of(los, cone.axis_cam, observation)
    sigma = observation.prior.sun_sigma_rad
    sun_sigma = SUN_SIGMA_RAD if sigma is None else sigma
    return sunlit_limb(los, cone.axis_cam, rho, sun, blur, sun_sigma, observation.band_um)


def _best_reach(
    los: FloatArray,
    observation: Observation,
    sun: FloatArray,
    estimates: str,
    cause: Outcome | None,
    bright_inside: bool,
) -> TrustedLimb | Refusal:
    """Lower the points to the ground, and keep the Sun's zenith angles up to which the nadir is determined best."""
    limb = _sunlit(los, observation, sun)
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    drop = limb.height_m * np.tan(rho) / observation.prior.sphere_radius_m
    inwards = cone.axis_cam - los * (los @ cone.axis_cam)[:, None]
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    ground = np.cos(drop)[:, None] * los + np.sin(drop)[:, None] * inwards
    points = _GuardPoints(los, ground, limb.patterns_m, bright_inside)
    best: TrustedLimb | Refusal | None = None
    tried = -1
    for reach in limits.REACHES_RAD:
        within = limb.zenith_rad <= reach
        if int(within.sum()) == tried:
            continue
        tried = int(within.sum())
        lost = cause or (Outcome.DARK if within.mean() < 1.0 - limits.MUCH_LOST else None)
        result = _determined(points.take(within), observation, estimates, lost)
        if best is None or (isinstance(result, TrustedLimb) and _is_better(result, best)):
            best = result
    assert best is not None
    return best


def _too_few(lost: float, axis: FloatArray, los: FloatArray, observation: Observation) -> str:
    """Return why too few points are left, with the width of a pixel at the limb where it is what prevents them."""
    text = f"{lost:.0%} of the limb points fail the guard's tests"
    rho = float(off_axis_angle(los, axis).mean())
    focal_px = max(observation.camera.fx, observation.camera.fy)
    pixel_km = 1e-3 * observation.prior.sphere_radius_m / max(np.tan(rho), 1e-9) / focal_px
    if pixel_km < limits.COARSE_PIXEL_KM:
        return text
    return f"{text}: a pixel spans {pixel_km:.0f} km at the limb; limb-profile, with a position, can use such pixels"


def _is_better(one: TrustedLimb, other: TrustedLimb | Refusal) -> bool:
    return isinstance(other, Refusal) or one.sigma_rad < other.sigma_rad


def _without_outliers(points: _GuardPoints, observation: Observation) -> _GuardPoints:
    smallest = limits.SMALLEST_TRIM_PX / max(observation.camera.fx, observation.camera.fy)
    for _ in range(limits.TRIMS):
        if len(points.los) < limits.FEWEST_POINTS:
            break
        cone = fit_cone(points.los)
        off = off_axis_angle(points.los, cone.axis_cam)
        off = np.abs(off - median(off))
        good = off <= max(limits.TRIM_SIGMAS * MEDIAN_TO_SIGMA * median(off), smallest)
        if good.all():
            break
        points = points.take(good)
    return points


def _determined(
    points: _GuardPoints, observation: Observation, estimates: str, cause: Outcome | None
) -> TrustedLimb | Refusal:
    """Refuse points that leave the nadir open; ``cause``: what took the points that are missing."""
    points = _without_outliers(points, observation)
    uv = project(observation.camera, points.seen)[0]
    status = cause or Outcome.SHORT_ARC
    if len(points.los) < limits.FEWEST_POINTS:
        return Refusal(status, f"{len(points.los)} limb points are left", uv)
    los = points.los
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    if observation.prior.angular_radius is None and rho < limits.SMALLEST_RHO_RAD:
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is not the Earth", uv)
    try:
        noise = cone_uncertainty(los, cone.axis_cam, rho)
        systematic = model_covariance(los, cone.axis_cam, rho, observation, estimates, points.patterns)
    except np.linalg.LinAlgError:
        return Refusal(status, "the points do not determine a cone", uv)
    limb = TrustedLimb(points.seen, los, uv, cone, rho, noise, systematic, points.bright_inside)
    if not limb.sigma_rad <= limits.LARGEST_SIGMA_RAD:
        sigma = np.degrees(limb.sigma_rad)
        return Refusal(status, f"the limb that can be trusted determines the nadir to {sigma:.2f} deg", uv)
    return limb


def _run(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    if estimator.from_points is None:
        return _run_on_pixels(estimator, observation)
    searched = find_limb_and_picture(observation.image, observation.camera, observation.full_scale, observation.prior)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    if found.scale > 1:
        # A limb that is many pixels deep is an edge in a smaller copy, where the whole guard then works.
        result = _run(estimator, in_wider_pixels(observation, found.scale))
        return replace(result, points=in_whole(result.points, found.scale))
    limb = _trusted(picture, found, observation, estimator.estimates)
    if isinstance(limb, Refusal):
        return limb
    result = estimator.from_points(limb.los_cam, limb.uv, observation)
    if isinstance(result, Refusal):
        return result
    basis = limb.noise.basis
    result = replace(result, systematic_nadir_cam=basis @ limb.systematic[:2, :2] @ basis.T)
    if (refusal := check_fit(result, limb)) is not None:
        return refusal
    if (refusal := doubted(result, observation, _as_seen(limb))) is not None:
        return refusal
    return _noise_apart(result, limb, observation)


def _run_on_pixels(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    """Run a method that takes the whole image, and test what it claims."""
    result = estimator.run(observation)
    if isinstance(result, Refusal):
        return result
    for refusal in (
        _too_bright(result, observation),
        doubted(result, observation),
        too_wide(result, limits.PIXEL_SHARE * observation.prior.accept_rad),
    ):
        if refusal is not None:
            return refusal
    return result


def _too_bright(fit: Fit, observation: Observation) -> Refusal | None:
    """Refuse a limb most of which is saturated: its profile is cut off, and the rest of it stands too high."""
    if observation.full_scale is None:
        return None
    los = unproject(observation.camera, fit.points)
    los = los[np.isfinite(los).all(axis=1)]
    picture = Picture(observation.image, observation.full_scale)
    share = float(
        np.mean(saturated(read_sides(picture, observation.camera, los, fit.nadir_cam), observation.full_scale))
    )
    if not share > limits.MOST_SATURATED:
        return None
    return Refusal(Outcome.SATURATED, f"{share:.0%} of the limb is saturated", fit.points)


def _as_seen(limb: TrustedLimb) -> SeenLimb:
    """Return the limb as the image has it: without the known height of a sunlit limb taken away."""
    seen = fit_cone(limb.seen_cam)
    rho = float(off_axis_angle(limb.seen_cam, seen.axis_cam).mean())
    return SeenLimb(seen.axis_cam, rho, float(limb.noise.covariance[2, 2] + limb.systematic[2, 2]))


def _noise_apart(fit: Fit, limb: TrustedLimb, observation: Observation) -> Fit:
    """Move the scatter beyond the detector's noise from the noise covariance to the systematic one."""
    image, camera = np.asarray(observation.image, dtype=np.float64), observation.camera
    seen = fit_cone(limb.seen_cam)
    rho = float(off_axis_angle(limb.seen_cam, seen.axis_cam).mean())
    variance = pixel_variance(image, camera, seen.axis_cam, rho, observation.full_scale)
    try:
        noise = noise_covariance(image, camera, limb.seen_cam, seen.axis_cam, rho, variance, limb.bright_inside)
    except np.linalg.LinAlgError:
        return fit
    basis, seen_basis = tangent_basis(fit.nadir_cam), tangent_basis(seen.axis_cam)
    turned = basis.T @ seen_basis
    noise = turned @ noise[:2, :2] @ turned.T
    values, vectors = np.linalg.eigh(basis.T @ fit.covariance_nadir_cam @ basis - noise)
    rest = (vectors * np.maximum(values, 0.0)) @ vectors.T
    systematic = rest if fit.systematic_nadir_cam is None else rest + basis.T @ fit.systematic_nadir_cam @ basis
    return replace(
        fit,
        covariance_nadir_cam=basis @ noise @ basis.T,
        systematic_nadir_cam=basis @ systematic @ basis.T,
    )


def check_fit(fit: Fit, limb: TrustedLimb) -> Refusal | None:
    """Return why the answer of a method of points is refused, or None.

    Its nadir must agree with the guard's cone within the noise of both, or within one pixel.
    """
    basis = tangent_basis(limb.cone.axis_cam)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - limb.cone.axis_cam)
    spread = basis.T @ (fit.total_covariance_nadir_cam + limb.noise.covariance_axis) @ basis
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ limb.cone.axis_cam < 0 or apart @ np.linalg.solve(spread + floor, apart) > limits.AGREEMENT**2:
        angle = float(np.degrees(np.arccos(np.clip(fit.nadir_cam @ limb.cone.axis_cam, -1, 1))))
        return Refusal(Outcome.AMBIGUOUS, f"the method's nadir lies {angle:.2f} deg from that of the limb", fit.points)
    return too_wide(fit, limits.LARGEST_SIGMA_RAD)


def too_wide(fit: Fit, largest_rad: float) -> Refusal | None:
    """Return why a fit does not determine the nadir as a claim must, or None; ``largest_rad``: sigma, worst way."""
    basis = tangent_basis(np.asarray(fit.nadir_cam))
    sigma = float(np.sqrt(np.linalg.eigvalsh(basis.T @ fit.total_covariance_nadir_cam @ basis)[-1]))
    if not sigma <= largest_rad:
        least = f"{np.degrees(largest_rad):.2g} deg are accepted (prior: accept_deg)"
        reason = f"the method determines the nadir to {np.degrees(sigma):.2f} deg, {least}"
        return Refusal(Outcome.SHORT_ARC, reason, fit.points)
    return None
