r"""Cramer-Rao bound of a frame: how exactly the limb of an image can determine the nadir.

With the information ``F`` of an image (:mod:`horizonval.scoring.information`) and ``P`` of the scene's ``[prior]``, no
unbiased method that uses the limb has a smaller covariance of the pose than::

    C = (F + P)^-1        nadir: N C N^T,    bound = sqrt(trace),    N: how turn and position move it

(H. Cramer, "Mathematical Methods of Statistics", 1946, section 32.6; with priors H. L. Van Trees, "Detection,
Estimation and Modulation Theory I", 1968, section 2.4.2). Without a prior position the unknowns are the nadir and the
altitude, and a turn about the nadir is taken as known; without a prior altitude the altitude is free.

There are two bounds of the nadir. ``noise`` counts the detector's noise alone: air, relief, brightness and blur are
known. For ``known`` these are free too, each with its prior, and so is the height of the limb.

A method that uses all the information has a mean square of 1 of its error over the bound. The bound holds for errors
that are small against a pixel. Methods that are given the pose, or that refuse bad frames, may have smaller errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.frame import DetectorImage, FrameTruth
from horizonval.geometry.rotation import tangent_basis
from horizonval.scoring import limits
from horizonval.scoring.information import UNKNOWNS, LimbInformation, carried
from horizonval.spec.camera import CameraSpec
from horizonval.spec.prior import PriorSpec

ANY_LIMB_SIGMA_M = {"solar": 12e3, "thermal": 21e3}
"""Standard deviation of a limb height without a prior: that of an even distribution from 2 km below the ground to 40 km
(solar) or 70 km (thermal) above it."""
HOPELESS_RAD = math.radians(30.0)
"""Larger bounds mean that the image does not determine the nadir."""
ARCSEC = math.radians(1.0 / 3600.0)


@dataclass(frozen=True)
class Bound:
    """The smallest root mean square error that an unbiased method can have on a frame.

    ``noise_rad``, ``known_rad``: of the nadir, by noise alone and by all that is unknown; ``altitude_m``: of the
    distance from the Earth's centre, by all that is unknown. None where the image does not determine the nadir.
    """

    noise_rad: float | None
    known_rad: float | None
    altitude_m: float | None

    @property
    def noise_arcsec(self) -> float | None:
        """Bound of the nadir by the noise alone [arcsec]."""
        return None if self.noise_rad is None else self.noise_rad / ARCSEC

    @property
    def known_arcsec(self) -> float | None:
        """Bound of the nadir by all that is not known [arcsec]."""
        return None if self.known_rad is None else self.known_rad / ARCSEC


NO_BOUND = Bound(None, None, None)


def known_bound(images: Iterable[DetectorImage], truth: FrameTruth, band: str) -> Bound | None:
    """Return the bound of the images of several heads of one body, or of one; None where none carries information."""
    known = [information for image in images if (information := carried(image)) is not None]
    return bound_of(reduce(add, known), truth, band) if known else None


def bound_of(information: LimbInformation | None, truth: FrameTruth, band: str) -> Bound:
    """Return the bound of the information of one image, or of the sum of several heads, with the scene's priors.

    ``truth`` is that of any of the heads: it gives position and attitude of the body.
    """
    if information is None:
        return NO_BOUND
    r = np.array(truth.r_itrs)
    body_from_cam = Rotation.from_quat(truth.q_cam_from_body).inv()
    body_from_itrs = (body_from_cam * Rotation.from_quat(truth.q_cam_from_itrs)).as_matrix()
    nadir = body_from_cam.apply(np.array(truth.nadir_geocentric_cam))
    prior = _prior(truth)
    pose = _pose_rows(prior, truth.camera_spec, r)
    across = -(np.eye(3) - np.outer(nadir, nadir)) @ body_from_itrs / np.linalg.norm(r)
    by_step = np.zeros((4, UNKNOWNS))
    by_step[:3, :3] = np.array([[0.0, -nadir[2], nadir[1]], [nadir[2], 0.0, -nadir[0]], [-nadir[1], nadir[0], 0.0]])
    by_step[:3, 3:6] = across
    by_step[3, 3:6] = r / np.linalg.norm(r)
    height = ANY_LIMB_SIGMA_M[{one.name: one.kind for one in truth.camera_spec.band}[band]]
    if prior.limb_height_sigma_km is not None:
        height = 1e3 * prior.limb_height_sigma_km
    flattened = math.sqrt(2.0 / 15.0) * (truth.ellipsoid_a_m - truth.ellipsoid_b_m)
    shape = 0.0 if prior.position_sigma_km is not None else flattened
    free = _free(prior, r, nadir)
    noise, _ = _left(information.by_noise, pose, free, 0.0, 0.0, by_step)
    known, altitude = _left(information.by_knowledge, pose, free, height, shape, by_step)
    return Bound(noise, known, altitude)


def accept_rad(truth: FrameTruth) -> float:
    """Return the bound of the nadir up to which a frame must be answered, as the scene's prior says."""
    said = _prior(truth).accept_deg
    return limits.ACCEPT_RAD if said is None else math.radians(said)


def _left(
    information: FloatArray,
    pose: FloatArray,
    free_pose: FloatArray,
    height_sigma_m: float,
    shape_sigma_m: float,
    by_step: FloatArray,
) -> tuple[float | None, float | None]:
    """Return the standard deviations of nadir [rad] and altitude [m]; a prior sigma of 0 fixes the height or shape."""
    total = information + pose
    kept = [6] * (height_sigma_m > 0.0) + [*range(7, UNKNOWNS)] * (shape_sigma_m > 0.0)
    for k in kept:
        total[k, k] += (height_sigma_m if k == 6 else shape_sigma_m) ** -2
    free = np.column_stack([free_pose, np.eye(UNKNOWNS)[:, kept]])
    total = free.T @ total @ free
    size = np.sqrt(np.diag(total))
    if not (size > 0.0).all():
        return None, None
    try:
        covariance = np.linalg.inv(total / np.outer(size, size)) / np.outer(size, size)
    except np.linalg.LinAlgError:
        return None, None
    steps = by_step @ free
    out = np.einsum("ij,jk,ik->i", steps, covariance, steps)
    nadir = math.sqrt(max(float(out[:3].sum()), 0.0))
    if not (math.isfinite(nadir) and 0.0 < nadir < HOPELESS_RAD and (np.diag(covariance) > 0.0).all()):
        return None, None
    return nadir, math.sqrt(max(float(out[3]), 0.0))


def _free(prior: PriorSpec, r_itrs: FloatArray, nadir_body: FloatArray) -> FloatArray:
    """Return the directions of the unknowns, shape (12, k), in which turn and position are free."""
    # What is known exactly is left out of the equations. As a row of large weight it would bury in its rounding what a
    # far disc says of the altitude.
    up = r_itrs / np.linalg.norm(r_itrs)
    turn = tangent_basis(nadir_body) if prior.attitude_sigma_deg is None else np.eye(3)
    place = up[:, None] if prior.position_sigma_km is None else np.eye(3)
    free = np.zeros((UNKNOWNS, turn.shape[1] + place.shape[1]))
    free[:3, : turn.shape[1]] = turn
    free[3:6, turn.shape[1] :] = place
    return free


def _pose_rows(prior: PriorSpec, camera: CameraSpec, r_itrs: FloatArray) -> FloatArray:
    """Return the information on all unknowns, shape (12, 12), of what is said of the pose with an error."""
    rows = np.zeros((UNKNOWNS, UNKNOWNS))
    up = r_itrs / np.linalg.norm(r_itrs)
    if prior.attitude_sigma_deg is not None:
        rows[:3, :3] = np.diag(np.radians(np.array(prior.attitude_sigma_deg)) ** -2.0)
    if prior.position_sigma_km is not None:
        rows[3:6, 3:6] = np.eye(3) / (1e3 * prior.position_sigma_km) ** 2
    known_km = prior.altitude_sigma_km
    if known_km is None and camera.platform.altitude_km is not None:
        known_km = camera.platform.altitude_sigma_km
    if known_km is not None:
        rows[3:6, 3:6] += np.outer(up, up) / (1e3 * known_km) ** 2
    return rows


def _prior(truth: FrameTruth) -> PriorSpec:
    table: Mapping[str, Any] = truth.scene.get("prior") or {}
    return PriorSpec.model_validate(table)
