"""A guard around any method: what published methods take for granted is tested, before and after.

A limb method is a formula that is right when its points lie on the Earth's limb. The guard sees to that, and says no
where it cannot:

1. *The limb itself*: consensus on cones of sight lines decides which edges are one limb and which side of it is space
   (:mod:`horizonval.limb.finder`); the Sun's blob is left out.
2. *Points*: moved to the steepest place of the soft limb (:mod:`horizonval.limb.steepest`); those on a saturated, faded
   or restless piece are left out (:mod:`horizonval.limb.trusted`), so are outliers from the cone through the rest.
3. *Enough*: the pieces that are left must determine the nadir, for noise and for all that makes the limb no circle
   (:mod:`horizonval.limb.systematic`), to what a claim needs; and the body must be large enough not to be the Moon.
4. *The method* runs on what is left: on the points where it can take points
   (``Estimator.from_points``), else on an image from which all but that limb has been cleaned.
5. *The answer*: must lie where the guard's own cone lies, within the uncertainty of both; its residuals must be those
   of a limb; and where the altitude is known from the orbit the fitted one must agree.

Methods of several heads are guarded by :mod:`horizonval.estimators.guard_heads`.

The fit keeps its covariance of noise; ``systematic_nadir_cam`` says beside it what the method's model leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from horizonval.estimators import guard_limits as limits
from horizonval.estimators.clean_image import cleaned
from horizonval.estimators.guard_heads import run_heads
from horizonval.estimators.observation import Estimator, Fit, NoFit, Observation
from horizonval.limb.cone import Cone, ConeUncertainty, cone_uncertainty, fit_cone, off_axis_angle, tangent_basis
from horizonval.limb.finder import find_limb
from horizonval.limb.result import NoLimb
from horizonval.limb.steepest import to_steepest
from horizonval.limb.systematic import systematic_covariance
from horizonval.limb.trusted import faded, low_sun, read_sides, restless, saturated
from horizonval.outcome import Outcome

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TrustedLimb:
    """Limb points that passed every test, and how well a cone through them is determined.

    Attributes
    ----------
    los_cam : ndarray, shape (n, 3)
    uv : ndarray, shape (n, 2)
    cone : Cone
    rho_rad : float
    noise : ConeUncertainty
    systematic : ndarray, shape (3, 3)
        As :func:`horizonval.limb.systematic.systematic_covariance`.
    """

    los_cam: FloatArray
    uv: FloatArray
    cone: Cone
    rho_rad: float
    noise: ConeUncertainty
    systematic: FloatArray


def guarded(estimator: Estimator) -> Estimator:
    """Return the estimator behind the guard, named ``guarded-<name>``.

    One that is given the pose has nothing to guard and is returned as it is under that name.
    """
    run: Callable[[Observation], Fit | NoFit] = estimator.run
    if estimator.needs != "pose":
        run = partial(run_heads if estimator.needs == "heads" else _run, estimator)
    return replace(estimator, name=f"guarded-{estimator.name}", title=f"{estimator.title}, guarded", run=run)


def trusted_limb(observation: Observation, estimates: str = "geocentric") -> TrustedLimb | NoFit:
    """Return the limb points of an image that may be trusted, or why there are none."""
    found = find_limb(observation.image, observation.camera, observation.full_scale)
    if isinstance(found, NoLimb):
        return NoFit(found.status, found.reason)
    image = np.asarray(observation.image, dtype=np.float64)
    cone = fit_cone(found.los_cam)
    sides = read_sides(image, observation.camera, found.los_cam, cone.axis_cam)
    bright_inside = bool(np.median(sides.inner - sides.outer) > 0.0)
    los, kept = to_steepest(image, observation.camera, found.los_cam, cone.axis_cam, bright_inside)
    uv = found.uv[kept]
    if len(los) < limits.FEWEST_POINTS:
        return NoFit(Outcome.SHORT_ARC, f"{len(los)} limb points have their profile in view", uv)
    sides = read_sides(image, observation.camera, los, fit_cone(los).axis_cam)
    tests = {Outcome.DARK: faded(sides), Outcome.SUN_GLARE: restless(sides)}
    if observation.sun_cam is not None and observation.band_kind == "solar":
        axis = fit_cone(los).axis_cam
        tests[Outcome.DARK] |= low_sun(los, axis, observation.sun_cam, limits.LOWEST_SUN_RAD)
    if observation.full_scale is not None:
        tests[Outcome.SATURATED] = saturated(sides, observation.full_scale)
    bad = np.any(list(tests.values()), axis=0)
    los, uv = los[~bad], uv[~bad]
    los, uv = _without_outliers(los, uv, observation)
    worst = max(tests, key=lambda outcome: int(tests[outcome].sum()))
    if len(los) < limits.FEWEST_POINTS:
        return NoFit(worst, f"{bad.mean():.0%} of the limb points are not to be trusted", uv)
    return _determined(los, uv, observation, estimates, worst if bad.mean() > limits.MUCH_LOST else None)


def _without_outliers(los: FloatArray, uv: FloatArray, observation: Observation) -> tuple[FloatArray, FloatArray]:
    smallest = limits.SMALLEST_TRIM_PX / max(observation.camera.fx, observation.camera.fy)
    for _ in range(limits.TRIMS):
        if len(los) < limits.FEWEST_POINTS:
            break
        cone = fit_cone(los)
        off = off_axis_angle(los, cone.axis_cam)
        off = np.abs(off - np.median(off))
        good = off <= max(limits.TRIM_SIGMAS * 1.4826 * float(np.median(off)), smallest)
        if good.all():
            break
        los, uv = los[good], uv[good]
    return los, uv


def _determined(
    los: FloatArray,
    uv: FloatArray,
    observation: Observation,
    estimates: str,
    cause: Outcome | None,
) -> TrustedLimb | NoFit:
    """Refuse points that leave the nadir open; ``cause``: what took the points that are missing."""
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    status = cause or Outcome.SHORT_ARC
    if rho < limits.SMALLEST_RHO_RAD:
        return NoFit(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is not the Earth", uv)
    try:
        noise = cone_uncertainty(los, cone.axis_cam, rho)
        systematic = systematic_covariance(
            los,
            cone.axis_cam,
            rho,
            flattening=observation.flattening,
            reliefs=limits.reliefs(observation.band_kind),
            earth_radius_m=observation.earth_radius_m,
            estimates="geodetic" if estimates == "geodetic" else "geocentric",
        )
    except np.linalg.LinAlgError:
        return NoFit(status, "the points do not determine a cone", uv)
    sigma = float(np.sqrt(np.linalg.eigvalsh((noise.covariance + systematic)[:2, :2])[-1]))
    if not sigma <= limits.LARGEST_SIGMA_RAD:
        return NoFit(status, f"the limb that can be trusted determines the nadir to {np.degrees(sigma):.2f} deg", uv)
    return TrustedLimb(los, uv, cone, rho, noise, systematic)


def _run(estimator: Estimator, observation: Observation) -> Fit | NoFit:
    limb = trusted_limb(observation, estimator.estimates)
    if isinstance(limb, NoFit):
        return limb
    if estimator.from_points is not None:
        result = estimator.from_points(limb.los_cam, limb.uv, observation)
    else:
        image = cleaned(observation.image, observation.camera, limb.cone, limb.los_cam)
        result = estimator.run(replace(observation, image=image))
    if isinstance(result, NoFit):
        return result
    basis = limb.noise.basis
    result = replace(result, systematic_nadir_cam=basis @ limb.systematic[:2, :2] @ basis.T)
    return check_fit(result, limb, observation) or result


def check_fit(fit: Fit, limb: TrustedLimb, observation: Observation) -> NoFit | None:
    """Return why a fit is not believed, or None.

    Its nadir must be that of the guard's cone within their noise, or within a pixel's worth of it; its residuals must
    be a limb's; its altitude must be that of the orbit where one is known.
    """
    basis = tangent_basis(limb.cone.axis_cam)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - limb.cone.axis_cam)
    spread = basis.T @ (fit.total_covariance_nadir_cam + limb.noise.covariance_axis) @ basis
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ limb.cone.axis_cam < 0 or apart @ np.linalg.solve(spread + floor, apart) > limits.AGREEMENT**2:
        angle = float(np.degrees(np.arccos(np.clip(fit.nadir_cam @ limb.cone.axis_cam, -1, 1))))
        return NoFit(Outcome.AMBIGUOUS, f"the method's nadir lies {angle:.2f} deg from that of the limb", fit.points)
    sigma = float(np.sqrt(np.linalg.eigvalsh(basis.T @ fit.total_covariance_nadir_cam @ basis)[-1]))
    if not sigma <= limits.LARGEST_SIGMA_RAD:
        return NoFit(Outcome.SHORT_ARC, f"the method determines the nadir to {np.degrees(sigma):.2f} deg", fit.points)
    if observation.altitude_m is not None:
        radius = observation.earth_radius_m
        expected = np.arcsin(radius / (radius + observation.altitude_m))
        off = limb.rho_rad - expected
        height = limits.limb_height_m(observation.band_kind)
        low, high = (h * np.tan(expected) / radius for h in height)
        slack = limits.AGREEMENT * float(np.sqrt(limb.noise.covariance[2, 2] + limb.systematic[2, 2]))
        if not low - slack <= off <= high + slack:
            return NoFit(
                Outcome.AMBIGUOUS,
                f"the angular radius is {np.degrees(off):+.2f} deg from that of the known altitude",
                fit.points,
            )
    return None
