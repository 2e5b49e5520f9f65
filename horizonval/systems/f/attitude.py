r"""Pitch and roll from the two phases of a conical scan, with their covariance, or a refusal.

*Sphere* (as flown in the seventies): both crossings lie at the angle rho from the nadir n, and so::

    n = (d_in + d_out) cos rho / (1 + d_in . d_out)  +-  b (d_in x d_out),      |n| = 1

The plane between both crossings gives the pitch (the middle of the chord), b the roll (its length, with rho from the
known altitude); of two signs the one is right whose nadir lies nearer to the body's z axis.

*Ellipsoid*: Newton's steps on ``limb_side(d_in) = limb_side(d_out) = 0`` for roll and pitch, the position and the yaw
being known: the exact horizon, raised by one constant height.

Covariance: a phase off by dp moves the line of sight by ``d' dp``; to first order ``d . dn = -(d' . n) dp`` for both
crossings, two equations for the two angles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.frames import body_from_lvlh, inverse, nadir_of_roll_pitch, roll_pitch_of_nadir, rotate
from horizonval.geometry.horizon import limb_side
from horizonval.systems.f.scan_cone import ScanCone

Residual = Callable[[float, float], FloatArray]
"""How far both crossings are off the horizon at a roll and a pitch."""
STEP_RAD = 1e-6
LEAST_SINE = 1e-3
"""Of the angle between both crossings' effects: below it the chord no longer tells pitch from roll."""
NEWTON_STEPS, CONVERGED_RAD = 20, 1e-11


@dataclass(frozen=True)
class ScannerFit:
    """An attitude.

    Attributes
    ----------
    roll_rad, pitch_rad : float
    covariance : ndarray, shape (2, 2)
        Of roll and pitch [rad2].
    """

    roll_rad: float
    pitch_rad: float
    covariance: FloatArray


def attitude_over_sphere(
    cone: ScanCone, entered_rad: float, left_rad: float, rho_rad: float, sigma_rad: tuple[float, float]
) -> ScannerFit | Refusal:
    """Return roll and pitch over a sphere of angular radius rho.

    Parameters
    ----------
    cone : ScanCone
    entered_rad, left_rad : float
        Phases of the edges, delays taken off.
    rho_rad : float
    sigma_rad : tuple of float
        Standard deviations of both phases.
    """
    d = cone.directions(np.array([entered_rad, left_rad]))
    cosine = float(d[0] @ d[1])
    level = math.cos(rho_rad) / (1.0 + cosine)
    rest = 1.0 - 2.0 * level**2 * (1.0 + cosine)
    if rest < 0.0:
        return Refusal(Outcome.NOT_CONVERGED, "the chord is longer than the Earth is wide")
    normal = np.cross(d[0], d[1]) * math.sqrt(rest / (1.0 - cosine**2))
    candidates = [level * (d[0] + d[1]) + sign * normal for sign in (-1.0, 1.0)]
    nadir = max(candidates, key=lambda n: float(n[2]))
    roll, pitch = (float(angle) for angle in roll_pitch_of_nadir(nadir))

    def off(r: float, p: float) -> FloatArray:
        return np.asarray(d @ nadir_of_roll_pitch(r, p) - math.cos(rho_rad))

    return _with_covariance(roll, pitch, off, cone.slopes([entered_rad, left_rad]) @ nadir, sigma_rad)


def attitude_over_ellipsoid(
    cone: ScanCone,
    entered_rad: float,
    left_rad: float,
    r_itrs: FloatArray,
    lvlh_from_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    sigma_rad: tuple[float, float],
) -> ScannerFit | Refusal:
    """Return roll and pitch over an ellipsoid, at a known position [m] and no yaw; ``lvlh_from_itrs``: a quaternion."""
    phases = np.array([entered_rad, left_rad])
    d = cone.directions(phases)

    def off_of(directions: FloatArray, roll: float, pitch: float) -> FloatArray:
        d_lvlh = rotate(inverse(body_from_lvlh(0.0, pitch, roll)), directions)
        return limb_side(rotate(inverse(lvlh_from_itrs), d_lvlh), r_itrs, ellipsoid)

    def off(roll: float, pitch: float) -> FloatArray:
        return off_of(d, roll, pitch)

    roll = pitch = 0.0
    for _ in range(NEWTON_STEPS):
        jacobian = _jacobian(off, roll, pitch)
        if _sine(jacobian) < LEAST_SINE:
            return Refusal(Outcome.SHORT_ARC, "the chord does not tell pitch from roll")
        step = np.linalg.solve(jacobian, off(roll, pitch))
        roll, pitch = roll - float(step[0]), pitch - float(step[1])
        if max(abs(roll), abs(pitch)) > math.pi / 4:
            return Refusal(Outcome.NOT_CONVERGED, "the edges fit no attitude near the nadir")
        if np.max(np.abs(step)) < CONVERGED_RAD:
            moved = off_of(cone.directions(phases + STEP_RAD), roll, pitch)
            return _with_covariance(roll, pitch, off, (moved - off(roll, pitch)) / STEP_RAD, sigma_rad)
    return Refusal(Outcome.NOT_CONVERGED, "no attitude after the last step")


def _with_covariance(
    roll: float, pitch: float, off: Residual, per_phase: FloatArray, sigma_rad: tuple[float, float]
) -> ScannerFit | Refusal:
    jacobian = _jacobian(off, roll, pitch)
    if _sine(jacobian) < LEAST_SINE:
        return Refusal(Outcome.SHORT_ARC, "the chord does not tell pitch from roll")
    per_angle = np.linalg.solve(jacobian, np.diag(per_phase * np.asarray(sigma_rad)))
    return ScannerFit(roll, pitch, per_angle @ per_angle.T)


def _jacobian(off: Residual, roll: float, pitch: float) -> FloatArray:
    by_roll = off(roll + STEP_RAD, pitch) - off(roll - STEP_RAD, pitch)
    by_pitch = off(roll, pitch + STEP_RAD) - off(roll, pitch - STEP_RAD)
    return np.stack([by_roll, by_pitch], axis=-1) / (2.0 * STEP_RAD)


def _sine(jacobian: FloatArray) -> float:
    return abs(float(np.linalg.det(jacobian))) / max(float(np.prod(np.linalg.norm(jacobian, axis=1))), 1e-30)
