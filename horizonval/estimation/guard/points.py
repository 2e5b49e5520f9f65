"""The limb points of one image that lie at one height above the Earth.

They are those of the search (:mod:`horizonval.estimation.limb.finder`). A limb many pixels deep is an edge in a
smaller copy of the image, where all of this then works. Towards the terminator the limb darkens and rises. Where the
Sun's direction is known, so is the height there (:mod:`horizonval.estimation.guard.sunlit`), and the limb is followed
along the cone into the twilight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.heights import SUN_SIGMA_RAD
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.sunlit import SunlitLimb, blur_across, sun_angles, sunlit_limb
from horizonval.estimation.limb.cone import inwards_of, near_cone
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.locate import SATURATED_SHARE, to_edge
from horizonval.estimation.limb.picture import Picture, in_wider_pixels
from horizonval.estimation.limb.pyramid import cone_frame, on_cone, trace_limb
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import Cone, fit_cone
from horizonval.geometry.rotation import off_axis_angle

BoolArray = NDArray[np.bool_]

DEPTH_PX = 6.0
"""Distance from the limb at which its sides are compared: beyond a lens's blur."""
LOW_SUN_RAD = float(np.deg2rad(75.0))
"""Sun's zenith angle from which the limb is followed along the cone: a search for edges begins to lose it there."""
FOLLOWED_PX = 3.0
"""Farthest that a followed point may lie from the cone: the limb rises by two pixels of 20 km."""
MUCH_LOST = 0.3
"""Share of the points beyond which what took them is named as the reason of a refusal."""


@dataclass(frozen=True)
class TrustedPoints:
    """n limb points of one image.

    ``observation``: the image that they were measured in, perhaps with wider pixels; ``seen``, ``ground``: lines of
    sight (n, 3) as the image has them, and without the known height of a sunlit limb; ``patterns_m``: errors (k, n) of
    that height; ``zenith_rad``: Sun's zenith angles (n,), None without a known Sun; ``bright_inside``: the Earth is the
    brighter side; ``cause``: what took many of the other points.
    """

    observation: Observation
    picture: Picture
    seen: FloatArray
    ground: FloatArray
    bright_inside: bool
    cause: Outcome | None
    patterns_m: FloatArray | None = None
    zenith_rad: FloatArray | None = None

    def take(self, rows: BoolArray | NDArray[np.intp]) -> TrustedPoints:
        """Return some of the points."""
        return TrustedPoints(
            self.observation,
            self.picture,
            self.seen[rows],
            self.ground[rows],
            self.bright_inside,
            self.cause,
            None if self.patterns_m is None else self.patterns_m[:, rows],
            None if self.zenith_rad is None else self.zenith_rad[rows],
        )

    def without_outliers(self) -> TrustedPoints:
        """Return the points near the cone through them."""
        px_rad = 1.0 / max(self.observation.camera.fx, self.observation.camera.fy)
        return self.take(near_cone(self.ground, px_rad, limits.FEWEST_POINTS))

    def seen_cone(self) -> Cone:
        """Return the cone of the limb as the image has it."""
        return fit_cone(self.seen)


def trusted_points(observation: Observation) -> TrustedPoints | Refusal:
    """Return the points of an image's limb that may be trusted, at least :data:`limits.FEWEST_POINTS` of them."""
    searched = find_limb_and_picture(observation)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    if found.scale > 1:
        return trusted_points(in_wider_pixels(observation, found.scale))
    camera = observation.camera
    axis = fit_cone(found.los_cam).axis_cam
    inner, outer = sides(picture, camera, found.los_cam, axis)
    bright_inside = bool(np.nanmedian(inner - outer) > 0.0)
    full = np.inf if observation.full_scale is None else SATURATED_SHARE * observation.full_scale
    # The edge of a saturated side is that of the air's tail, kilometres too high; a side out of view may be saturated.
    kept = (inner < full) | (inner <= outer)
    if np.count_nonzero(kept) < limits.FEWEST_POINTS:
        return Refusal(Outcome.SATURATED, f"{np.mean(~kept):.0%} of the limb points are saturated", found.uv)
    los = found.los_cam[kept]
    cause = Outcome.SATURATED if np.mean(kept) < 1.0 - MUCH_LOST else None
    sun = observation.sun_cam if observation.band_kind == "solar" else None
    if sun is None:
        return TrustedPoints(observation, picture, los, los, bright_inside, cause)
    los = _into_twilight(los, picture, observation, sun, bright_inside)
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(Outcome.DARK, f"{len(los)} limb points are followed towards the terminator", found.uv)
    limb = _sunlit(los, observation, sun)
    lit = np.isfinite(limb.height_m)
    if np.count_nonzero(lit) < limits.FEWEST_POINTS:
        return Refusal(Outcome.DARK, f"the Sun lights {np.count_nonzero(lit)} limb points", found.uv)
    los = los[lit]
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    drop = (limb.height_m[lit] * np.tan(rho) / observation.prior.sphere_radius_m)[:, None]
    ground = np.cos(drop) * los + np.sin(drop) * inwards_of(los, cone.axis_cam)
    cause = Outcome.DARK if lit.mean() < 1.0 - MUCH_LOST else cause
    patterns, zenith = limb.patterns_m[:, lit], limb.zenith_rad[lit]
    return TrustedPoints(observation, picture, los, ground, bright_inside, cause, patterns, zenith)


def _into_twilight(
    los: FloatArray, picture: Picture, observation: Observation, sun: FloatArray, bright_inside: bool
) -> FloatArray:
    """Return the points under a high Sun and, where it is low, the cone's own directions: edges fade out there."""
    cone, camera = fit_cone(los), observation.camera
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    around = on_cone(cone_frame(cone.axis_cam), rho, trace_limb(camera, cone.axis_cam, rho, 1.0).azimuth)
    low = sun_angles(around, cone.axis_cam, sun)[0] > LOW_SUN_RAD
    high = sun_angles(los, cone.axis_cam, sun)[0] <= LOW_SUN_RAD
    if not low.any():
        return los[high]
    followed, _ = to_edge(picture.grey, camera, around[low], cone.axis_cam, bright_inside)
    off = np.abs(off_axis_angle(followed, cone.axis_cam) - rho)
    return np.concatenate([los[high], followed[off * max(camera.fx, camera.fy) < FOLLOWED_PX]])


def _sunlit(los: FloatArray, observation: Observation, sun: FloatArray) -> SunlitLimb:
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    blur = blur_across(observation.camera, los, cone.axis_cam)
    sigma = observation.prior.sun_sigma_rad
    sun_sigma = SUN_SIGMA_RAD if sigma is None else sigma
    return sunlit_limb(los, cone.axis_cam, rho, sun, blur, sun_sigma, observation.band_um)


def sides(
    picture: Picture, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the grey levels on the cone's side of limb points (n, 3) and on the other, shape (n,), NaN out of view."""
    apart = DEPTH_PX / max(camera.fx, camera.fy) * inwards_of(los_cam, axis_cam)
    uv, seen = project(camera, np.array([los_cam + apart, los_cam - apart]))
    column, row = np.moveaxis(np.rint(np.where(seen[..., None], uv, -1.0)).astype(np.intp), -1, 0)
    seen = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    inner, outer = np.where(seen, picture.mean[np.where(seen, row, 0), np.where(seen, column, 0)], np.nan)
    return inner, outer
