r"""The pose that makes the pixels across the limb most probable: Gauss-Newton on their likelihood.

A pixel near the limb is ``I = b_s + a_s E(x) + c_s E(x) x + noise`` with the edge profile ``E``
(:mod:`.edge_profile`), ``x`` its distance inside the limb in pixels, and levels of its sector ``s`` of azimuth
(:mod:`.sectors`). Unknown are, beside the levels, a turn of the camera (3), its position (3), the mean height of the
limb, the logarithms of blur and scale height, and the modes of the relief (:mod:`.relief_modes`). With the noise's
weights ``W``, the information ``P`` of all priors about ``m``, and ``J`` the derivatives with the levels eliminated::

    step = (J^T W J + P)^-1 (J^T W residuals + P (m - now)),        C = (J^T W J + P)^-1

Every prior is rows of these equations, the relief's too. ``C`` is the covariance that is claimed; of it
``C J^T W J C`` is the noise's part and ``C P_r C`` the relief's.

Noise and outliers: :mod:`.light`.

**Neglected.** How the scale of the image changes over the distance itself: ``x`` is a few pixels, the change a
thousandth per pixel, and where the profile is steep ``x`` is small. Pixels' noise is taken as independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.edge_profile import PIXEL_VARIANCE, EdgeProfile, edge_profile
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose
from horizonval.estimation.likelihood.light import LimbLight, solved, weighed
from horizonval.estimation.likelihood.limb_angle import LimbAngle, limb_angle
from horizonval.estimation.likelihood.limb_pixels import LimbPixels, limb_pixels
from horizonval.estimation.likelihood.pixels import image_scale
from horizonval.estimation.likelihood.sectors import eliminated
from horizonval.geometry.camera import CameraModel

POSE = 7
"""Turn, position, height of the limb."""
MOST_STEPS = 12
"""Gauss-Newton takes 3 to 6 from within a pixel; with twice as many it does not come."""
SETTLING_STEPS = 2
"""After which noise, outliers and the spread of the light are held: a pixel at the edge of being left out would else be
left out at every second step."""
CONVERGED = 1e-4
"""Square of a step over its own covariance: a hundredth of a standard deviation."""
RESELECT_PX = 0.5
"""Motion of the limb after which the pixels near it are chosen again."""
LEAST_SAG = 0.5
"""Of a height by its tangent: far above any air; keeps what is seen there of a soft limb falling."""
LARGEST_LOG_STEP = 0.5
"""Of blur and scale height: a step beyond the reach of their derivatives."""


@dataclass(frozen=True)
class LimbLikelihoodFit:
    """The most probable pose.

    Attributes
    ----------
    pose : LimbPose
    blur_px : float
        Of the lens.
    scale_height_m : float
    covariance : ndarray, shape (7, 7)
        Of a step from the pose: turn in camera axes [rad], position [m], limb height [m]; noise, priors and relief.
    relief_covariance : ndarray, shape (7, 7)
        The relief's part of it.
    noise_sigma : tuple of float
        Standard deviation of a pixel in space and on the Earth, in the image's levels.
    chi_squared : float
        Mean square of the residuals over the variance of the noise that neighbouring pixels show of each other.
    pixels : int
        That were used.
    uv : ndarray, shape (m, 2)
        A place on the limb for every sector [px].
    residuals_rad : ndarray, shape (m,)
        How far inside of the fitted limb each sector shows it, relief and all.
    steps : ndarray, shape (k, 7)
    """

    pose: LimbPose
    blur_px: float
    scale_height_m: float
    covariance: FloatArray
    relief_covariance: FloatArray
    noise_sigma: tuple[float, float]
    chi_squared: float
    pixels: int
    uv: FloatArray
    residuals_rad: FloatArray
    steps: FloatArray

    @property
    def by_nadir(self) -> FloatArray:
        """How a step moves the nadir in camera axes, shape (3, 7)."""
        return nadir_derivative(self.pose)


def nadir_derivative(pose: LimbPose) -> FloatArray:
    """Return the derivative, shape (3, 7), of the geocentric nadir in camera axes by a step of the pose."""
    n = pose.nadir_cam
    turn = -np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    across = -(np.eye(3) - np.outer(n, n)) @ pose.cam_from_itrs / np.linalg.norm(pose.r_itrs)
    return np.concatenate([turn, across, np.zeros((3, 1))], axis=1)


@dataclass
class _State:
    """Unknowns beside the pose."""

    blur: float
    scale_m: float


@dataclass(frozen=True)
class _Model:
    """The pixels as the present unknowns say they are."""

    angle: LimbAngle
    scale: FloatArray
    x: FloatArray
    edge: EdgeProfile
    soft_px: FloatArray | None
    basis: FloatArray


def fit_limb(
    image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: LimbKnowledge, noise_sigma: float | None = None
) -> LimbLikelihoodFit:
    """Fit the limb near a pose that is right to some pixels.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels, linear in radiance.
    camera : CameraModel
    start : LimbPose
    knowledge : LimbKnowledge
    noise_sigma : float, optional
        Of a pixel as neighbours show it, for ``chi_squared``; NaN without.

    Raises
    ------
    numpy.linalg.LinAlgError
        Too little limb in view, or no convergence.
    """
    pose = start
    state = _State(float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE)), knowledge.scale_height_m)
    near = limb_pixels(image, camera, pose, knowledge, state.blur, state.scale_m)
    relief = np.zeros(len(near.modes))
    weighed_for: LimbPixels | None = None
    steps = []
    for count in range(MOST_STEPS):
        model = _predicted(near, pose, knowledge, state, relief)
        starts = near.sectors.starts
        if count <= SETTLING_STEPS or near is not weighed_for:
            light, weighed_for = weighed(model.basis, near.values, starts), near
        else:
            spread = light.levels.spread_information
            light = solved(model.basis, near.values, starts, light.weights, light.variance, spread)
        jacobian = _jacobian(near, model, light.of_pixel, state)
        normal, right = eliminated(jacobian, model.basis, light.residuals, light.weights, starts, light.levels)
        prior, pull = _prior_rows(knowledge, pose, state, relief)
        covariance = _inverse(normal + prior)
        step = covariance @ (right + pull)
        square = float(step @ (normal + prior) @ step)
        if not np.isfinite(square):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        steps.append(step[:POSE])
        if square < CONVERGED and count > 0:
            break
        step[POSE : POSE + 2] = np.clip(step[POSE : POSE + 2], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
        moved_px = np.abs(_motion(model, step[:POSE])).max()
        pose = pose.moved(step[:POSE])
        state = _State(state.blur * float(np.exp(step[POSE])), state.scale_m * float(np.exp(step[POSE + 1])))
        relief = relief + step[POSE + 2 :]
        if moved_px > RESELECT_PX:
            near = limb_pixels(image, camera, pose, knowledge, state.blur, state.scale_m)
            if len(near.modes) != len(relief):
                relief = np.zeros(len(near.modes))
    else:
        raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps of the likelihood")
    relief_part = covariance[:POSE, POSE + 2 :] @ covariance[POSE + 2 :, :POSE]
    uv, off = _by_sector(near, model, light, relief)
    used = light.weights > 0.0
    chi_squared = float("nan") if noise_sigma is None else float(np.mean(light.residuals[used] ** 2)) / noise_sigma**2
    return LimbLikelihoodFit(
        pose=pose,
        blur_px=float(np.sqrt(max(state.blur**2 - PIXEL_VARIANCE, 0.0))),
        scale_height_m=state.scale_m,
        covariance=covariance[:POSE, :POSE],
        relief_covariance=relief_part,
        noise_sigma=(float(np.sqrt(light.variance[0])), float(np.sqrt(light.variance[1]))),
        chi_squared=chi_squared,
        pixels=int(used.sum()),
        uv=uv,
        residuals_rad=off,
        steps=np.array(steps),
    )


def _predicted(near: LimbPixels, pose: LimbPose, knowledge: LimbKnowledge, state: _State, relief: FloatArray) -> _Model:
    pixels = near.pixels
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    angle = limb_angle(pixels.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    scale = image_scale(angle, pixels.by_column, pixels.by_row)
    delta = angle.delta + angle.by_height * (relief @ near.modes) if len(relief) else angle.delta
    x = delta / scale + 0.5 * state.blur**2 * near.bend
    soft = None
    if knowledge.scale_height_m > 0.0:
        # The ray at the angle y outside has its lowest point y tan(rho) / 2 of its height below the tangent's straight
        # line: 0.4 % at 8 km seen from 500 km, 2 arcsec.
        sag = 1.0 + 0.5 * np.minimum(angle.delta, 0.0) * axes[0] * angle.by_height
        soft = state.scale_m * angle.by_height / (scale * np.maximum(sag, LEAST_SAG))
    edge = edge_profile(x, state.blur, soft)
    return _Model(angle, scale, x, edge, soft, np.array([np.ones_like(x), edge.level, edge.level * x]))


def _jacobian(near: LimbPixels, model: _Model, levels: FloatArray, state: _State) -> FloatArray:
    """Return the derivatives, shape (p, n): pose, ln blur, ln scale height, modes of the relief."""
    edge, angle = model.edge, model.angle
    shading = levels[2]
    lift = levels[1] + shading * model.x
    by_x = lift * edge.slope + shading * edge.level
    per_rad = by_x / model.scale
    by_height = angle.by_height * per_rad
    by_blur = state.blur * (lift * edge.by_blur + by_x * state.blur * near.bend)
    by_scale = np.zeros_like(by_x) if model.soft_px is None else lift * edge.by_scale * model.soft_px
    return np.concatenate(
        [
            angle.by_rotation * per_rad,
            angle.by_position * per_rad,
            by_height[None],
            by_blur[None],
            by_scale[None],
            near.modes * by_height,
        ]
    )


def _prior_rows(
    knowledge: LimbKnowledge, pose: LimbPose, state: _State, relief: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the priors' information (p, p) and their pull (p,) on the step."""
    count = POSE + 2 + len(relief)
    information = np.zeros((count, count))
    information[:POSE, :POSE] = knowledge.information
    information[POSE, POSE] = knowledge.blur_log_sigma**-2
    information[POSE + 1, POSE + 1] = knowledge.scale_log_sigma**-2
    information[POSE + 2 :, POSE + 2 :] = np.eye(len(relief))
    blur = float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE))
    soft = np.log(knowledge.scale_height_m / state.scale_m) if knowledge.scale_height_m > 0.0 else 0.0
    wanted = np.concatenate([pose.step_to(knowledge.mean), [np.log(blur / state.blur), soft], -relief])
    return information, information @ wanted


def _inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix whose unknowns have units of their own."""
    size = np.sqrt(np.diag(matrix))
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        raise np.linalg.LinAlgError("the limb in view does not determine the fit's unknowns")
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))


def _motion(model: _Model, step: FloatArray) -> FloatArray:
    """Return by how far a step of the pose moves the limb in the image [px]."""
    angle = model.angle
    moved = step[:3] @ angle.by_rotation + step[3:6] @ angle.by_position + step[6] * angle.by_height
    return np.asarray(moved / model.scale)


def _by_sector(near: LimbPixels, model: _Model, light: LimbLight, relief: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector and how far inside of it the sector shows the limb [rad]."""
    slope = light.of_pixel[1] * model.edge.slope / model.scale
    weights = light.weights * slope
    uv, off = [], []
    for first, last in pairwise(near.sectors.starts):
        here = slice(first, last)
        information = float(weights[here] @ slope[here])
        shift = float(weights[here] @ light.residuals[here]) / information if information > 0.0 else 0.0
        if len(relief):
            lifted = model.angle.by_height[here] * (relief @ near.modes[:, here])
            shift += float(np.mean(lifted))
        nearest = first + int(np.argmin(np.abs(model.x[here])))
        uv.append([near.pixels.columns[nearest], near.pixels.rows[nearest]])
        off.append(shift)
    return np.array(uv, dtype=float), np.array(off)
