"""The limb points of one image that may be trusted.

They are those of the search (:mod:`horizonval.estimation.limb.finder`), without saturated points, points that the Sun
does not light, and outliers from the cone. A limb many pixels deep is an edge in a smaller copy of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.limits import FEWEST_POINTS
from horizonval.estimation.limb.cone import inwards_of, near_cone
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.locate import SATURATED_SHARE
from horizonval.estimation.limb.picture import Picture, in_wider_pixels
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

MUCH_LOST = 0.3
"""Share of the points beyond which what took them is named as the reason of a refusal."""


@dataclass(frozen=True)
class TrustedPoints:
    """n limb points of one image.

    ``observation``: the image that they were measured in, perhaps with wider pixels; ``los``: shape (n, 3), lines of
    sight; ``axis``, ``rho_rad``: of the cone through them; ``bright_inside``: the Earth is the brighter side;
    ``cause``: what took many of the other points.
    """

    observation: Observation
    picture: Picture
    los: FloatArray
    axis: FloatArray
    rho_rad: float
    bright_inside: bool
    cause: Outcome


def trusted_points(observation: Observation, lowest_sun_rad: float = 0.5 * np.pi) -> TrustedPoints | Refusal:
    """Return the points of an image's limb that may be trusted, at least :data:`.FEWEST_POINTS` of them.

    ``lowest_sun_rad``: largest zenith angle of a known Sun at a point of a sunlit limb.
    """
    searched = find_limb_and_picture(observation)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    if found.scale > 1:
        return trusted_points(in_wider_pixels(observation, found.scale), lowest_sun_rad)
    camera = observation.camera
    axis = fit_cone(found.los_cam).axis_cam
    inner, outer = sides(picture, camera, found.los_cam, axis)
    bright_inside = bool(np.nanmedian(inner - outer) > 0.0)
    full = np.inf if observation.full_scale is None else SATURATED_SHARE * observation.full_scale
    # The edge of a saturated side is that of the air's tail, kilometres too high; a side out of view may be saturated.
    kept = (inner < full) | (inner <= outer)
    if np.count_nonzero(kept) < FEWEST_POINTS:
        return Refusal(Outcome.SATURATED, f"{np.mean(~kept):.0%} of the limb points are saturated", found.uv)
    cause = Outcome.SATURATED if np.mean(kept) < 1.0 - MUCH_LOST else Outcome.SHORT_ARC
    los = found.los_cam[kept]
    if observation.band_kind == "solar" and observation.sun_cam is not None:
        lit = inwards_of(los, axis) @ observation.sun_cam < -np.cos(lowest_sun_rad)
        cause = Outcome.DARK if np.mean(lit) < 1.0 - MUCH_LOST else cause
        los = los[lit]
    los = los[near_cone(los, 1.0 / max(camera.fx, camera.fy), FEWEST_POINTS)] if len(los) else los
    if len(los) < FEWEST_POINTS:
        reason = f"{len(los)} limb points can be trusted, {FEWEST_POINTS} are needed"
        return Refusal(cause, reason, project(camera, los)[0])
    axis = fit_cone(los).axis_cam
    rho = float(off_axis_angle(los, axis).mean())
    return TrustedPoints(observation, picture, los, axis, rho, bright_inside, cause)


def sides(
    picture: Picture, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the grey levels on the cone's side of limb points (n, 3) and on the other, shape (n,), NaN out of view."""
    # Beyond a lens's blur.
    apart = 6.0 / max(camera.fx, camera.fy) * inwards_of(los_cam, axis_cam)
    uv, seen = project(camera, np.array([los_cam + apart, los_cam - apart]))
    column, row = np.moveaxis(np.rint(np.where(seen[..., None], uv, -1.0)).astype(np.intp), -1, 0)
    seen = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    inner, outer = np.where(seen, picture.mean[np.where(seen, row, 0), np.where(seen, column, 0)], np.nan)
    return inner, outer
