"""Errors of a camera's calibration, and what they add to a method's claim.

A camera may have errors of its focal length, its principal point and its radial distortion. The distortion's error is
given at the image's farthest corner. With ``r`` the corner's position without distortion in normalised coordinates (of
a fisheye the angle from the boresight), and q the denominator of a rational distortion there (else 1)::

    dk1 = error_px q / (f r^3)

A fit of the pixels has them as unknowns with priors (:func:`lens_sigmas`). A method of points takes its camera as
exact. Its answer ``n(c)`` is therefore computed again from the same pixels with a camera that is off by each stated
standard deviation ``sigma_k``, of every head and independently, and the differences widen the claim::

    C = C_image + sum_k d_k d_k^T,        d_k = n(c + sigma_k e_k) - n(c)

Neglected: which pixels a search takes for the limb; the mounting, which turns roll and pitch and not the nadir in
camera axes; clock and exposure, which are in the sigmas of the prior; second-order products of two errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.geometry import brown
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import tangent_basis
from horizonval.spec.camera import unified_radius


def miscalibrated(
    camera: CameraModel,
    focal_length: float = 0.0,
    principal_point_px: tuple[float, float] = (0.0, 0.0),
    distortion_px: float = 0.0,
) -> CameraModel:
    """Return a camera with errors; raises ``UserError`` as :func:`k1_per_px` does.

    ``focal_length``: relative; ``principal_point_px``: of column and row; ``distortion_px``: radial, at the farthest
    corner.
    """
    k1, *others = camera.distortion
    if distortion_px != 0.0:
        k1 += distortion_px * k1_per_px(camera)
    return replace(
        camera,
        fx=camera.fx * (1.0 + focal_length),
        fy=camera.fy * (1.0 + focal_length),
        cx=camera.cx + principal_point_px[0],
        cy=camera.cy + principal_point_px[1],
        distortion=(k1, *others),
    )


def k1_per_px(camera: CameraModel) -> float:
    """Return the change of ``k1`` that moves the farthest corner outwards by a pixel.

    Raises ``UserError``: the camera has no distortion, or its corner no direction.
    """
    where = "calibration: distortion_error_px, distortion_sigma_px"
    if camera.projection == "equal_angle":
        expected = "a pinhole, a fisheye or a unified lens"
        raise UserError("the projection equal_angle has no distortion", where=where, expected=expected)
    u = max((-0.5, camera.width - 0.5), key=lambda column: abs(column - camera.cx))
    v = max((-0.5, camera.height - 0.5), key=lambda row: abs(row - camera.cy))
    if camera.wide and camera.image_circle_rad is not None:
        angle = camera.image_circle_rad
    else:
        x, y, z = unproject(replace(camera, image_circle_rad=None), np.array([u, v]))
        angle = math.atan2(math.hypot(x, y), z)
    radius = angle
    if camera.projection == "pinhole":
        radius = math.hypot(x, y) / z
    elif camera.projection == "unified":
        radius = (1.0 + camera.shape[0]) * float(unified_radius(angle, camera.shape))
    if not (math.isfinite(radius) and radius > 0.0):
        expected = "a camera whose distortion is one to one over the image"
        raise UserError("the image's farthest corner has no direction", where=where, expected=expected)
    denominator = 1.0 if camera.projection == "fisheye" else brown.denominator(camera.distortion, radius)
    return denominator / (math.sqrt(camera.fx * camera.fy) * radius**3)


Run = Callable[[Observation], Fit | Refusal]

View = tuple[Observation, FloatArray]
"""An image, and the pixels (n, 2) of the limb in it."""

AxisOf = Callable[[Sequence[View]], FloatArray]
"""Nadir of limb points in the body's axes, its length ``1 / cos`` of the angular radius; ``LinAlgError`` for none."""


def lens_sigmas(calibration: Calibration | None) -> FloatArray:
    """Return the standard deviations (4,) of ln focal length, principal point [px] and corner [px]; 0 of exact ones."""
    said = calibration or Calibration()
    point = said.principal_point_sigma_px
    return np.array([said.focal_length_sigma, point, point, said.distortion_sigma_px])


@dataclass(frozen=True)
class WithLensError:
    """A method of points that adds to its covariance what the stated errors of its lenses do to its answer.

    ``run``: takes the camera for exact; ``axis_of``: the method behind its search for points.
    """

    run: Run
    axis_of: AxisOf

    def __call__(self, observation: Observation) -> Fit | Refusal:
        found = self.run(_held_exact(observation))
        return found if isinstance(found, Refusal) else with_errors(found, observation, self.axis_of)


def with_lens_error(run: Run, axis_of: AxisOf | None = None) -> WithLensError:
    """Return a method that claims the errors of its lenses, too; by default it is one of cones through points."""
    return WithLensError(run, axis_of or cone_axis)


def with_errors(fit: Fit, observation: Observation, axis_of: AxisOf) -> Fit | Refusal:
    """Return a fit whose claim counts the stated errors of its lenses, or why they leave it no answer."""
    heads = _heads(observation)
    errors = [
        (k, error) for k, one in enumerate(heads) for error in np.diag(lens_sigmas(one.calibration)) if error.any()
    ]
    if not errors:
        return fit
    views = _views(fit, observation)

    def axis_with(wrong: int, error: FloatArray) -> FloatArray:
        focal, u, v, bend = (float(value) for value in error)
        head, uv = views[wrong]
        seen = (replace(head, camera=miscalibrated(head.camera, focal, (u, v), bend)), uv)
        return axis_of([*views[:wrong], seen, *views[wrong + 1 :]])

    try:
        before = axis_of(views)
        moved = np.array([axis_with(*error) for error in errors]) - before
    except np.linalg.LinAlgError as e:
        reason = f"what errors of the lens do to the answer is not determined: {e}"
        return Refusal(Outcome.AMBIGUOUS, reason, fit.points)
    length = float(np.linalg.norm(before))
    axis = before / length
    turns = (moved - np.outer(moved @ axis, axis)) / length @ _cam_from_body(observation).T
    added = turns.T @ turns
    sigma = fit.sigma_altitude_m
    if sigma is not None and fit.altitude_m is not None and length > 1.0:
        # altitude = R / sin rho - R, with cos rho = 1 / length
        sine_2 = 1.0 - length**-2
        by_length = (fit.altitude_m + observation.prior.sphere_radius_m) / (sine_2 * length**3)
        sigma = float(np.hypot(sigma, by_length * np.linalg.norm(moved @ axis)))
    return replace(
        fit,
        systematic_nadir_cam=added if fit.systematic_nadir_cam is None else fit.systematic_nadir_cam + added,
        sigma_altitude_m=sigma,
    )


def cone_axis(views: Sequence[View]) -> FloatArray:
    """Return the axis of the cone through limb points, shape (3,), as long as :data:`AxisOf` says."""
    los = np.concatenate([los_body(one, uv) for one, uv in views])
    if len(los) < 3:
        raise np.linalg.LinAlgError(f"{len(los)} limb points")
    cone = fit_cone(los)
    if not cone.cos_rho > 0.0:
        raise np.linalg.LinAlgError("the points determine no cone")
    return np.asarray(cone.axis_cam / cone.cos_rho)


def los_body(head: Observation, uv: FloatArray) -> FloatArray:
    """Return unit lines of sight of pixels in the body's axes, shape (n, 3)."""
    return unproject(head.camera, uv) @ _cam_from_body(head)


def _held_exact(observation: Observation) -> Observation:
    """Return the observation with lenses taken as exact, so that an inner method does not count their errors again."""

    def exact(said: Calibration | None) -> Calibration | None:
        return said and replace(said, focal_length_sigma=0.0, principal_point_sigma_px=0.0, distortion_sigma_px=0.0)

    heads = {name: replace(one, calibration=exact(one.calibration)) for name, one in observation.heads.items()}
    return replace(observation, calibration=exact(observation.calibration), heads=heads)


def _heads(observation: Observation) -> list[Observation]:
    return [*observation.heads.values()] or [observation]


def _cam_from_body(observation: Observation) -> FloatArray:
    return Rotation.from_quat(observation.q_cam_from_body).as_matrix()


def _views(fit: Fit, observation: Observation) -> list[View]:
    heads = _heads(observation)
    if len(heads) == 1:
        # 64 points at most: the errors of a lens are smooth over the image.
        return [(heads[0], fit.points[:: -(-len(fit.points) // 64) or 1])]
    if len(fit.points) == len(heads):
        return [(head, fit.points[k : k + 1]) for k, head in enumerate(heads)]
    nadir_body = fit.nadir_cam @ _cam_from_body(observation)
    rho = 0.5 * math.pi if fit.angular_radius_rad is None else fit.angular_radius_rad
    # Of these directions round the whole limb every head sees some.
    azimuth = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
    first, second = tangent_basis(nadir_body).T
    outwards = np.cos(azimuth)[:, None] * first + np.sin(azimuth)[:, None] * second
    limb = math.cos(rho) * nadir_body + math.sin(rho) * outwards
    return [(head, _in_view(head, limb)) for head in heads]


def _in_view(head: Observation, limb_body: FloatArray) -> FloatArray:
    """Return the pixels (n, 2) of a limb's directions that a head sees, in order along the arc; at least the nearest.

    A linear array crosses the limb between two directions.
    """
    camera = head.camera
    uv, ahead = project(camera, limb_body @ _cam_from_body(head).T)
    beyond = np.maximum(-0.5 - uv, uv - (camera.width - 0.5, camera.height - 0.5)).max(axis=1)
    beyond = np.where(ahead & np.isfinite(beyond), beyond, np.inf)
    seen = beyond <= max(0.0, float(beyond.min()))
    # An arc that runs through the first azimuth begins after the last one that is not in view.
    first = -int(np.argmin(seen))
    return np.roll(uv, first, axis=0)[np.roll(seen, first)]
