"""Errors of a camera's calibration, and what they add to a method's claim.

A camera may have errors of its focal length, its principal point and its radial distortion. The distortion's error is
given at the image's farthest corner. With ``r`` the corner's position without distortion in normalised coordinates (of
a fisheye the angle from the boresight), and q the denominator of a rational distortion there (else 1)::

    dk1 = error_px q / (f r^3)

A method treats its camera as exact, so that its covariance is that of the image. Where the calibration states standard
deviations, each is an unknown with a prior, independent of the others and of every other head's. With ``n(c)`` the
nadir in camera axes that the method finds with the camera ``c``::

    C = C_image + sum_k d_k d_k^T,        d_k = n(c + sigma_k e_k) - n(c)

The altitude's variance grows in the same way. A central difference would cost twice the time and differs to second
order of a small sigma. If one sigma, either way, removes the answer, the method is refused.

**Neglected.** The mounting, which turns roll and pitch and not the nadir in camera axes; clock and exposure, which are
in the sigmas of the prior; second-order products of two errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.geometry import brown
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.spec.camera import unified_radius


def miscalibrated(
    camera: CameraModel,
    focal_length: float = 0.0,
    principal_point_px: tuple[float, float] = (0.0, 0.0),
    distortion_px: float = 0.0,
) -> CameraModel:
    """Return a camera as it is believed to be.

    Raises ``UserError``: an error of the distortion of a camera that has none, or whose corner has no direction.

    ``camera``: as it is; ``focal_length``: error as a share of it; ``principal_point_px``: error of column and row;
    ``distortion_px``: error of the radial distortion at the farthest corner.
    """
    k1 = camera.distortion[0]
    if distortion_px != 0.0:
        k1 += distortion_px * k1_per_px(camera)
    return replace(
        camera,
        fx=camera.fx * (1.0 + focal_length),
        fy=camera.fy * (1.0 + focal_length),
        cx=camera.cx + principal_point_px[0],
        cy=camera.cy + principal_point_px[1],
        distortion=(k1, *camera.distortion[1:]),
    )


def k1_per_px(camera: CameraModel) -> float:
    """Return the change of ``k1`` that moves the farthest corner outwards by a pixel.

    Raises ``UserError``: the camera has no distortion, or its corner no direction.
    """
    if camera.projection == "equal_angle":
        raise UserError(
            "the projection equal_angle has no distortion",
            where="calibration: distortion_error_px, distortion_sigma_px",
            expected="a pinhole, a fisheye or a unified lens",
        )
    u = max((-0.5, camera.width - 0.5), key=lambda place: abs(place - camera.cx))
    v = max((-0.5, camera.height - 0.5), key=lambda place: abs(place - camera.cy))
    if camera.wide and camera.image_circle_rad is not None:
        angle = camera.image_circle_rad
    else:
        x, y, z = unproject(replace(camera, image_circle_rad=None), np.array([u, v]))
        angle = math.atan2(math.hypot(x, y), z)
    if camera.projection == "pinhole":
        radius = math.hypot(x, y) / z
    elif camera.projection == "unified":
        radius = (1.0 + camera.shape[0]) * float(unified_radius(angle, camera.shape))
    else:
        radius = angle
    if not (math.isfinite(radius) and radius > 0.0):
        raise UserError(
            "the image's farthest corner has no direction",
            where="calibration: distortion_error_px, distortion_sigma_px",
            expected="a camera whose distortion is one to one over the image",
        )
    denominator = 1.0 if camera.projection == "fisheye" else brown.denominator(camera.distortion, radius)
    return denominator / (math.sqrt(camera.fx * camera.fy) * radius**3)


Run = Callable[[Observation], Fit | Refusal]
SHORTER = 0.25
"""Share of a sigma used where a whole one removes the answer."""


def with_lens_error(run: Run) -> Run:
    """Return a method that adds to its covariance what the stated errors of its lenses do to its answer."""
    return partial(_allowed, run)


def _allowed(run: Run, observation: Observation) -> Fit | Refusal:
    asked = _held_exact(observation)
    found = run(asked)
    if isinstance(found, Refusal):
        return found
    along = found.nadir_cam
    spread, of_altitude = np.zeros((3, 3)), 0.0
    for name, head, error in lens_errors(observation):
        moved = _moved(run, asked, found, head, error)
        if moved is None:
            return Refusal(
                Outcome.AMBIGUOUS, f"an error of the {name} of its own sigma leaves the method no answer", found.points
            )
        step, altitude_m = moved
        step = step - along * (along @ step)
        spread += np.outer(step, step)
        of_altitude += altitude_m**2
    if not spread.any():
        return found
    systematic = spread if found.systematic_nadir_cam is None else found.systematic_nadir_cam + spread
    sigma = found.sigma_altitude_m
    return replace(
        found,
        systematic_nadir_cam=systematic,
        sigma_altitude_m=None if sigma is None else float(np.hypot(sigma, np.sqrt(of_altitude))),
    )


LensError = tuple[float, tuple[float, float], float]
"""Errors of focal length, principal point and distortion, as :func:`miscalibrated` takes them."""


def lens_errors(observation: Observation) -> Iterator[tuple[str, str | None, LensError]]:
    """Yield the name of every error with a sigma, the head that has it (None of a single camera), and one sigma."""
    heads: list[tuple[str | None, Observation]] = [*observation.heads.items()] or [(None, observation)]
    for head, one in heads:
        said = one.calibration
        if said is None:
            continue
        point = said.principal_point_sigma_px
        if said.focal_length_sigma > 0.0:
            yield "focal length", head, (said.focal_length_sigma, (0.0, 0.0), 0.0)
        if point > 0.0:
            yield "principal point", head, (0.0, (point, 0.0), 0.0)
            yield "principal point", head, (0.0, (0.0, point), 0.0)
        if said.distortion_sigma_px > 0.0:
            yield "distortion", head, (0.0, (0.0, 0.0), said.distortion_sigma_px)


def _moved(
    run: Run, asked: Observation, found: Fit, head: str | None, error: LensError
) -> tuple[FloatArray, float] | None:
    """Return by how much nadir and altitude [m] change with an error of one sigma; None where no answer is left."""
    for share in (1.0, -1.0, SHORTER, -SHORTER):
        other = run(_seen_with(asked, head, share, error))
        if isinstance(other, Fit):
            known = other.altitude_m is not None and found.altitude_m is not None
            higher_m = (other.altitude_m or 0.0) - (found.altitude_m or 0.0) if known else 0.0
            return (other.nadir_cam - found.nadir_cam) / share, higher_m / share
    return None


def _seen_with(asked: Observation, head: str | None, share: float, error: LensError) -> Observation:
    focal, (u, v), bend = error

    def changed(one: Observation) -> Observation:
        camera = miscalibrated(one.camera, share * focal, (share * u, share * v), share * bend)
        return replace(one, camera=camera)

    if head is None:
        return changed(asked)
    heads = {name: changed(one) if name == head else one for name, one in asked.heads.items()}
    # The fields of an observation of several heads are those of its first.
    first = next(iter(heads.values()))
    return replace(asked, camera=first.camera, heads=heads)


def _held_exact(observation: Observation) -> Observation:
    """Return the observation with lenses that are taken for exact, so that no method within does this once more."""

    def exact(said: Calibration | None) -> Calibration | None:
        if said is None:
            return None
        return replace(said, focal_length_sigma=0.0, principal_point_sigma_px=0.0, distortion_sigma_px=0.0)

    heads = {name: replace(one, calibration=exact(one.calibration)) for name, one in observation.heads.items()}
    return replace(observation, calibration=exact(observation.calibration), heads=heads)
