"""Errors of one estimate against the truth of its frame.

The nadir error is the angle between the claimed and the true nadir in camera axes,

    delta = atan2(|n_true x n|, n_true . n),

which keeps full accuracy for small angles. The tangent-plane error ``e`` (two components, length ``delta``) and the
claimed covariance projected on the same plane, ``P = B^T C B``, give the normalised error squared
``e^T P^-1 e`` (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2): 2 on average for an honest covariance.

A claim whose covariance is not positive definite across the nadir has no such statistic. It is judged as if it claimed

An estimator that claims the geodetic vertical is compared with the geodetic nadir, and its roll and pitch with the
angles of that nadir in body axes.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit
from horizonval.frame import FrameTruth
from horizonval.geometry import frames
from horizonval.geometry.rotation import angle_between, tangent_basis
from horizonval.scoring import limits
from horizonval.scoring.row import Score, to_digits

ARCSEC = math.radians(1 / 3600)
METHOD_RADIUS_M = 6371008.8


def score(
    truth: FrameTruth, estimator: Estimator | None, result: Fit | Refusal, *, earth_radius_m: float = METHOD_RADIUS_M
) -> Score:
    """Compare one result with the truth of its frame.

    Parameters
    ----------
    truth : FrameTruth
    estimator : Estimator or None
        ``estimates`` selects the nadir and ``claim`` the limits. None: the fit's own ``estimates``, limits of a cone.
    result : Fit or Refusal
    earth_radius_m : float, optional
        Radius that the method was given (``Prior.sphere_radius_m``), for ``altitude_error_km``.

    Returns
    -------
    Score
        Numbers are finite or None, rounded to the digits that are results. A fit that is not finite is a false claim.
    """
    if isinstance(result, Refusal):
        return Score(status=str(result.status), reason=result.reason or None, n_points=len(result.points))
    estimates = result.estimates if estimator is None else estimator.estimates
    nadir_true = _unit(truth.nadir_geodetic_cam if estimates == "geodetic" else truth.nadir_geocentric_cam)
    nadir = np.asarray(result.nadir_cam, dtype=np.float64)
    norm = float(np.linalg.norm(nadir))
    if not math.isfinite(norm) or norm == 0.0:
        return Score(status=str(Outcome.VALID), n_points=len(result.points), false_valid=True, without_sigma=True)
    nadir = nadir / norm
    error = angle_between(nadir_true, nadir)
    noise = np.asarray(result.covariance_nadir_cam, dtype=np.float64)
    total = np.asarray(result.total_covariance_nadir_cam, dtype=np.float64)
    sigma, nees = _consistency(nadir, nadir_true, noise)
    _, nees_total = _consistency(nadir, nadir_true, total)
    systematic = None
    if result.systematic_nadir_cam is not None:
        systematic = _finite(sigma_nadir_rad(nadir, np.asarray(result.systematic_nadir_cam, dtype=np.float64)) / ARCSEC)
    roll_error, pitch_error = _attitude_errors(truth, nadir_true, result)
    altitude_error = altitude_error_geodetic = None
    if result.altitude_m is not None:
        distance = math.hypot(*truth.r_itrs)
        altitude_error = (result.altitude_m - (distance - earth_radius_m)) / 1e3
        altitude_error_geodetic = (result.altitude_m - truth.altitude_m) / 1e3
    radius_error = None
    if result.angular_radius_rad is not None:
        radius_error = (result.angular_radius_rad - truth.angular_radius_rad) / ARCSEC
    return to_digits(
        Score(
            status=str(Outcome.VALID),
            nadir_error_arcsec=error / ARCSEC,
            roll_error_arcsec=roll_error,
            pitch_error_arcsec=pitch_error,
            altitude_error_km=_finite(altitude_error),
            altitude_error_geodetic_km=_finite(altitude_error_geodetic),
            angular_radius_error_arcsec=_finite(radius_error),
            sigma_nadir_arcsec=_finite(sigma / ARCSEC),
            nees_nadir=nees,
            n_points=len(result.points),
            false_valid=is_false(error, nees_total, _limits(estimator)),
            nees_nadir_total=nees_total,
            without_sigma=nees_total is None,
            sigma_systematic_arcsec=systematic,
        )
    )


def _limits(estimator: Estimator | None) -> limits.ClaimLimits:
    return limits.CONE_LIMITS if estimator is None else limits.claim_limits(estimator.claim)


def is_false(nadir_error_rad: float, nees_nadir: float | None, judged: limits.ClaimLimits = limits.CONE_LIMITS) -> bool:
    """Whether a claimed nadir with this error is a false claim (:mod:`horizonval.scoring.limits`).

    ``nees_nadir`` includes noise and model error; None, no uncertainty claimed, is judged by the default.
    """
    if nadir_error_rad > judged.nadir_error_rad:
        return True
    nees = (nadir_error_rad / limits.DEFAULT_SIGMA_RAD) ** 2 if nees_nadir is None else nees_nadir
    return nees > limits.SIGMA_LIMIT**2 and nadir_error_rad > judged.sigma_floor_rad


def sigma_nadir_rad(nadir_cam: FloatArray, covariance_nadir_cam: FloatArray) -> float:
    """Claimed root-mean-square nadir error [rad]: square root of the trace of the covariance across ``nadir_cam``."""
    basis = tangent_basis(_unit(nadir_cam))
    with np.errstate(over="ignore", invalid="ignore"):
        return math.sqrt(max(float(np.trace(basis.T @ covariance_nadir_cam @ basis)), 0.0))


def _attitude_errors(truth: FrameTruth, nadir_true_cam: FloatArray, fit: Fit) -> tuple[float | None, float | None]:
    if not (math.isfinite(fit.roll_rad) and math.isfinite(fit.pitch_rad)):
        return None, None
    # A truth with pitch beyond 90 deg has the same nadir as one within, and only the nadir can be observed: both truth
    # and claim are reduced to the roll and pitch of their nadir before they are compared.
    nadir_true_body = frames.rotate(frames.inverse(truth.q_cam_from_body), nadir_true_cam)
    nadir_body = frames.nadir_of_roll_pitch(fit.roll_rad, fit.pitch_rad)
    roll_true, pitch_true = (float(angle) for angle in frames.roll_pitch_of_nadir(nadir_true_body))
    roll, pitch = (float(angle) for angle in frames.roll_pitch_of_nadir(nadir_body))
    pitch_error = _wrapped(pitch - pitch_true) / ARCSEC
    if min(math.cos(pitch_true), math.cos(pitch)) < limits.ROLL_DEFINED_MIN_COS_PITCH:
        return None, pitch_error
    return _wrapped(roll - roll_true) / ARCSEC, pitch_error


def _consistency(nadir: FloatArray, nadir_true: FloatArray, covariance: FloatArray) -> tuple[float, float | None]:
    """Claimed rms nadir error [rad] and normalised error squared (``None`` if no uncertainty is claimed)."""
    projected = _projected(nadir, covariance)
    if projected is None:
        is_matrix = covariance.shape == (3, 3) and bool(np.isfinite(covariance).all())
        return sigma_nadir_rad(nadir, covariance) if is_matrix else math.nan, None
    across = tangent_basis(nadir).T @ nadir_true
    length = float(np.linalg.norm(across))
    # The opposite direction has no azimuth: any will do.
    azimuth = across / length if length > 0 else np.array([1.0, 0.0])
    error = angle_between(nadir_true, nadir) * azimuth
    return math.sqrt(float(np.trace(projected))), _finite(float(error @ np.linalg.solve(projected, error)))


def _projected(nadir: FloatArray, covariance: FloatArray) -> FloatArray | None:
    """Covariance across the nadir, shape (2, 2), positive definite; ``None`` where it is none."""
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        return None
    if np.abs(covariance - covariance.T).max() > limits.ASYMMETRY * np.abs(covariance).max():
        return None
    basis = tangent_basis(nadir)
    with np.errstate(over="ignore", invalid="ignore"):
        projected = basis.T @ (0.5 * covariance + 0.5 * covariance.T) @ basis
    if not np.isfinite(projected).all():
        return None
    projected = 0.5 * projected + 0.5 * projected.T
    smaller, larger = np.linalg.eigvalsh(projected)
    usable = smaller >= limits.SMALLEST_SIGMA_RAD**2 and smaller > limits.SHARPEST * larger
    return projected if usable else None


def _unit(v: tuple[float, float, float] | FloatArray) -> FloatArray:
    array = np.asarray(v, dtype=np.float64)
    unit: FloatArray = array / np.linalg.norm(array)
    return unit


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau)


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
