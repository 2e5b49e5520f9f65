"""The guard for methods that look through several heads: the answer is taken back to every head's image.

A head sees little: a short, nearly straight piece of limb, or a row across it. What one head shows can hardly be judged
by itself, what all of them show together can. The method answers first; its nadir and angular radius are one cone, and
that cone runs through every head's image. There it is read as :mod:`horizonval.estimators.guard` reads a limb:

* along the cone, points are moved to the steepest place (:mod:`horizonval.limb.steepest`); a limb is where most of them
  find one near by, all bright on the same side of it, the same side in every head, on points that are to be trusted;
* the points of all heads together must lie on one cone, to the scatter of a limb;
* its axis must be the method's nadir, within the uncertainty of both, and must be determined well enough.

A Sun, a Moon or a terminator in one head is no piece of the cone through the others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.estimators import guard_limits as limits
from horizonval.estimators.observation import Estimator, Fit, NoFit, Observation
from horizonval.geometry.camera import project, unproject
from horizonval.limb.cone import cone_uncertainty, fit_cone, off_axis_angle, tangent_basis
from horizonval.limb.steepest import to_steepest
from horizonval.limb.systematic import systematic_covariance
from horizonval.limb.trusted import read_sides, restless, saturated
from horizonval.outcome import Outcome

FloatArray = NDArray[np.float64]

AZIMUTHS = 7200


def run_heads(estimator: Estimator, observation: Observation) -> Fit | NoFit:
    """Run a method of several heads and believe it only if every head's image shows its limb."""
    result = estimator.run(observation)
    if isinstance(result, NoFit):
        return result
    rho = _angular_radius(result, observation)
    nadir = np.asarray(result.nadir_cam, dtype=np.float64)
    first = next(iter(observation.heads.values()))
    seen: list[FloatArray] = []
    for name, head in observation.heads.items():
        # Axes of the first head to those of this one, by way of the body.
        turn = Rotation.from_quat(head.q_cam_from_body) * Rotation.from_quat(first.q_cam_from_body).inv()
        found = _limb_in_head(head, turn.apply(nadir), rho)
        if isinstance(found, NoFit):
            return NoFit(found.status, f"head {name}: {found.reason}", result.points)
        seen.append(turn.inv().apply(found))
    return _confirmed(result, np.concatenate(seen), observation, estimator.estimates)


def _angular_radius(fit: Fit, observation: Observation) -> float:
    if fit.angular_radius_rad is not None:
        return float(fit.angular_radius_rad)
    # One point of every head, in the heads' order: the angle between nadir and points is the radius.
    first = next(iter(observation.heads.values()))
    angles = []
    for point, head in zip(fit.points, observation.heads.values(), strict=False):
        turn = Rotation.from_quat(head.q_cam_from_body) * Rotation.from_quat(first.q_cam_from_body).inv()
        angles.append(off_axis_angle(unproject(head.camera, point[None, :]), turn.apply(fit.nadir_cam))[0])
    return float(np.mean(angles)) if angles else float("nan")


def _limb_in_head(head: Observation, nadir_cam: FloatArray, rho_rad: float) -> FloatArray | NoFit:
    """Return the limb's lines of sight in a head's own axes, shape (n, 3), near a cone, or why there is none."""
    if not np.isfinite(rho_rad):
        return NoFit(Outcome.NOT_CONVERGED, "the answer has no angular radius")
    image = np.asarray(head.image, dtype=np.float64)
    turn = np.linspace(0.0, 2.0 * np.pi, AZIMUTHS, endpoint=False)
    basis = tangent_basis(nadir_cam)
    los = np.cos(rho_rad) * nadir_cam + np.sin(rho_rad) * (
        np.cos(turn)[:, None] * basis[:, 0] + np.sin(turn)[:, None] * basis[:, 1]
    )
    uv, in_front = project(head.camera, los)
    rim = limits.HEAD_RIM_PX
    with np.errstate(invalid="ignore"):
        inside = in_front & ((uv >= rim) & (uv <= (head.camera.width - 1 - rim, head.camera.height - 1 - rim))).all(1)
    los = _one_per_pixel(los[inside], uv[inside])
    if len(los) < limits.FEWEST_POINTS:
        return NoFit(Outcome.SHORT_ARC, f"{len(los)} px of the answer's limb are in view")
    sides = read_sides(image, head.camera, los, nadir_cam)
    bright_inside = bool(np.median(sides.inner - sides.outer) > 0.0)
    if head.band_kind is not None and not bright_inside:
        return NoFit(Outcome.NO_LIMB, "the answer's limb has its bright side in space")
    moved, _ = to_steepest(image, head.camera, los, nadir_cam, bright_inside)
    if len(moved) < limits.FEWEST_POINTS:
        return NoFit(Outcome.NO_LIMB, "there is no edge along the answer's limb")
    sides = read_sides(image, head.camera, moved, nadir_cam)
    bad = restless(sides)
    if head.full_scale is not None:
        bad = bad | saturated(sides, head.full_scale)
    off = off_axis_angle(moved, nadir_cam)
    bad = bad | (np.abs(off - np.median(off)) > limits.HEAD_SCATTER_PX / max(head.camera.fx, head.camera.fy))
    if np.mean(~bad) * len(moved) < limits.HEAD_LIMB_SHARE * len(los):
        return NoFit(Outcome.NO_LIMB, f"{np.mean(~bad) * len(moved) / len(los):.0%} of the answer's limb is an edge")
    return moved[~bad]


def _one_per_pixel(los: FloatArray, uv: FloatArray) -> FloatArray:
    _, first = np.unique(np.rint(uv).astype(np.int64), axis=0, return_index=True)
    return los[np.sort(first)]


def _confirmed(fit: Fit, los: FloatArray, observation: Observation, estimates: str) -> Fit | NoFit:
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
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
        return NoFit(Outcome.SHORT_ARC, "the heads' limbs do not determine a cone", fit.points)
    basis = noise.basis
    confirmed = replace(fit, systematic_nadir_cam=basis @ systematic[:2, :2] @ basis.T)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - cone.axis_cam)
    # Few crossings bend with the limb's shape otherwise than many points do: the model's error counts, too.
    spread = basis.T @ (confirmed.total_covariance_nadir_cam + noise.covariance_axis) @ basis
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ cone.axis_cam < 0 or apart @ np.linalg.solve(spread + floor, apart) > limits.AGREEMENT**2:
        angle = float(np.degrees(np.arccos(np.clip(fit.nadir_cam @ cone.axis_cam, -1, 1))))
        return NoFit(Outcome.AMBIGUOUS, f"the answer lies {angle:.2f} deg from the cone through all heads", fit.points)
    total = basis.T @ confirmed.total_covariance_nadir_cam @ basis
    sigma = float(np.sqrt(np.linalg.eigvalsh(total)[-1]))
    if not sigma <= limits.LARGEST_SIGMA_RAD:
        return NoFit(Outcome.SHORT_ARC, f"the heads determine the nadir to {np.degrees(sigma):.2f} deg", fit.points)
    return confirmed
