"""The limb points of one image that lie at one height above the Earth.

The limb that the search finds (:mod:`horizonval.estimation.limb.finder`) is moved to its steepest position
(:mod:`horizonval.estimation.limb.steepest`). A limb many pixels deep is an edge in a smaller copy of the image, where
all of this then works. Grey levels are read inside and outside of every point. Points are left out that are

* *saturated*: where the bright side reaches full scale the edge is that of the air's tail, kilometres too high;
* *faded*: towards the terminator the limb darkens and rises, so that points with a small share of the step elsewhere on
  the limb are left out. Where the Sun's direction is known, so is the height there
  (:mod:`horizonval.estimation.guard.sunlit`), and the limb is followed along the cone as far as it exceeds the noise;
* *restless*: the outer side varies (Sun's halo, Moon, ghost) by more than a share of the step;
* *isolated*: outside of any unbroken stretch of some length.
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
from horizonval.estimation.limb.cone import arc_order, near_cone
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.picture import ROSE_SIGMAS, Picture, in_wider_pixels, median
from horizonval.estimation.limb.pyramid import cone_frame, on_cone, trace_limb
from horizonval.estimation.limb.steepest import SATURATED_SHARE, inwards_of, to_steepest
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import Cone, fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

BoolArray = NDArray[np.bool_]

FADED_SHARE = 0.3
"""Smallest step relative to the limb's strong steps (their 90th percentile)."""
RESTLESS_SHARE = 0.25
"""Largest range of outer levels relative to the limb's typical step, its upper quartile."""
GAP_PX = 6.0
"""Largest gap between neighbours of one stretch, whose points are a pixel apart."""
SHORTEST_STRETCH_PX = 20.0
"""Two profiles long: over less the bright and dark sides of a cloud's edge decide."""
NEAR_PX = (3.0, 4.0, 5.0, 6.0)
"""Distances from the limb at which its sides are read: from beyond a lens's blur to the search range."""
DEEP_PX = (6.0, 8.0, 10.0, 12.0)
"""Twice the distances: levels of Earth and space themselves."""
LOW_SUN_RAD = float(np.deg2rad(75.0))
"""Sun's zenith angle from which the limb is followed along the cone: a search for edges begins to lose it there."""
FOLLOWED_PX = 3.0
"""Farthest that a followed point may lie from the cone: the limb rises by two pixels of 20 km."""
COARSE_PIXEL_KM = 60.0
"""Width of a pixel at the limb from which points rarely pass: the limb of the air, some 60 km high, is within one."""
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
    cone = fit_cone(found.los_cam)
    sides = read_sides(picture, camera, found.los_cam, cone.axis_cam)
    bright_inside = bool(median(sides.inner - sides.outer) > 0.0)
    los, _ = to_steepest(picture.grey, camera, found.los_cam, cone.axis_cam, bright_inside)
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(Outcome.SHORT_ARC, f"{len(los)} limb points have their profile in view", found.uv)
    sun = observation.sun_cam if observation.band_kind == "solar" else None
    limb = None
    if sun is not None:
        los = _into_twilight(los, picture, observation, sun, bright_inside)
        if len(los) < limits.FEWEST_POINTS:
            return Refusal(Outcome.DARK, f"{len(los)} limb points are followed towards the terminator", found.uv)
        limb = _sunlit(los, observation, sun)
    axis = fit_cone(los).axis_cam
    sides = read_sides(picture, camera, los, axis)
    # The infrared limb shines all round; what fades is the lens towards the corners of a wide field.
    even = limb is not None or observation.band_kind == "thermal"
    dark = faint(sides, picture.noise_sigma, bright_inside) if even else faded(sides)
    tests = {
        Outcome.SUN_GLARE: restless(sides),
        Outcome.DARK: dark if limb is None else dark | ~np.isfinite(limb.height_m),
    }
    if observation.full_scale is not None:
        tests[Outcome.SATURATED] = saturated(sides, observation.full_scale)
    bad = np.any(list(tests.values()), axis=0)
    worst = max(tests, key=lambda outcome: int(tests[outcome].sum())) if bad.any() else Outcome.SHORT_ARC
    good = np.flatnonzero(~bad)
    if len(good) >= limits.FEWEST_POINTS:
        good = good[~isolated(los[good], camera)]
    lost = 1.0 - len(good) / len(los)
    if len(good) < limits.FEWEST_POINTS:
        return Refusal(worst, _too_few(lost, axis, found.los_cam, observation), project(camera, los[good])[0])
    cause = worst if lost > MUCH_LOST else None
    los = los[good]
    if limb is None:
        return TrustedPoints(observation, picture, los, los, bright_inside, cause)
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    drop = (limb.height_m[good] * np.tan(rho) / observation.prior.sphere_radius_m)[:, None]
    ground = np.cos(drop) * los + np.sin(drop) * inwards_of(los, cone.axis_cam)
    patterns, zenith = limb.patterns_m[:, good], limb.zenith_rad[good]
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
    followed, _ = to_steepest(picture.grey, camera, around[low], cone.axis_cam, bright_inside)
    off = np.abs(off_axis_angle(followed, cone.axis_cam) - rho)
    return np.concatenate([los[high], followed[off * max(camera.fx, camera.fy) < FOLLOWED_PX]])


def _sunlit(los: FloatArray, observation: Observation, sun: FloatArray) -> SunlitLimb:
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    blur = blur_across(observation.camera, los, cone.axis_cam)
    sigma = observation.prior.sun_sigma_rad
    sun_sigma = SUN_SIGMA_RAD if sigma is None else sigma
    return sunlit_limb(los, cone.axis_cam, rho, sun, blur, sun_sigma, observation.band_um)


def _too_few(lost: float, axis: FloatArray, los: FloatArray, observation: Observation) -> str:
    """Return why too few points are left, with the width of a pixel at the limb where it is what prevents them."""
    text = f"{lost:.0%} of the limb points fail the guard's tests"
    rho = float(off_axis_angle(los, axis).mean())
    focal_px = max(observation.camera.fx, observation.camera.fy)
    pixel_km = 1e-3 * observation.prior.sphere_radius_m / max(np.tan(rho), 1e-9) / focal_px
    if pixel_km < COARSE_PIXEL_KM:
        return text
    return f"{text}: a pixel spans {pixel_km:.0f} km at the limb; limb-profile, with a position, can use such pixels"


@dataclass(frozen=True)
class Sides:
    """Grey levels at both sides of limb points, shape (n,) each.

    ``inner``, ``outer``: 3 to 12 px within and outside; ``peak``: maximum within 6 px inside, the reach of a profile;
    ``spread``: half the range of outer levels; ``azimuth``: about the cone's axis [rad].
    """

    inner: FloatArray
    outer: FloatArray
    peak: FloatArray
    spread: FloatArray
    azimuth: FloatArray


def read_sides(picture: Picture, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> Sides:
    """Read the image at both sides of limb points (n, 3), along the direction to the cone's axis."""
    distances = np.array(NEAR_PX + DEEP_PX) / max(camera.fx, camera.fy)
    steps = np.array([distances, -distances])[:, :, None, None]
    inside, outside = _levels(picture.mean, camera, los_cam + steps * inwards_of(los_cam, axis_cam))
    # A pixel outside the image has no level; a point has at least its nearest ones.
    inner, outer = _median(inside), _median(outside)
    near = inside[: len(NEAR_PX)]
    peak = np.where(np.isnan(near), -np.inf, near).max(axis=0)
    lit = ~np.isnan(outside)
    highest, lowest = np.where(lit, outside, -np.inf).max(axis=0), np.where(lit, outside, np.inf).min(axis=0)
    spread = np.where(lit.any(axis=0), 0.5 * (highest - lowest), 0.0)
    across = los_cam @ tangent_basis(axis_cam)
    return Sides(inner, outer, peak, spread, np.arctan2(across[:, 1], across[:, 0]))


def saturated(sides: Sides, full_scale: float) -> BoolArray:
    """Return which points have a saturated Earth side."""
    return np.asarray((sides.peak >= SATURATED_SHARE * full_scale) & (sides.inner > sides.outer))


def faded(sides: Sides) -> BoolArray:
    """Return which points have a step, averaged over a piece of limb, far below what it is elsewhere."""
    step = limits.smoothed(np.abs(sides.inner - sides.outer), sides.azimuth)
    return np.asarray(step < FADED_SHARE * np.percentile(step, 90.0))


def faint(sides: Sides, noise: float, bright_inside: bool = True) -> BoolArray:
    """Return which points have a limb, averaged over a piece, below the pixel noise; the brighter side is compared."""
    step = sides.peak - sides.outer if bright_inside else sides.outer - sides.inner
    return np.asarray(limits.smoothed(step, sides.azimuth) < ROSE_SIGMAS * noise)


def restless(sides: Sides) -> BoolArray:
    """Return which points have an outer side that varies by more than a share of the limb's typical step."""
    return np.asarray(sides.spread > RESTLESS_SHARE * np.percentile(np.abs(sides.inner - sides.outer), 75.0))


def _levels(image: NDArray[np.float32], camera: CameraModel, d_cam: FloatArray) -> FloatArray:
    """Return the levels of the pixels that directions (..., 3) fall on; NaN outside the image."""
    uv, in_front = project(camera, d_cam)
    height, width = image.shape
    good: BoolArray = np.logical_and(in_front, np.isfinite(uv).all(axis=-1))
    column, row = np.moveaxis(np.rint(np.where(good[..., None], uv, -1.0)).astype(np.int64), -1, 0)
    good &= (column >= 0) & (row >= 0) & (column < width) & (row < height)
    out = np.full(good.shape, np.nan)
    out[good] = image[row[good], column[good]]
    return out


def _median(values: FloatArray) -> FloatArray:
    """Return the medians of the columns of (k, n) without their NaN; 0 for a column that holds nothing else."""
    ordered = np.sort(values, axis=0)
    count = len(values) - np.isnan(values).sum(axis=0)
    column = np.arange(values.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, column], ordered[count // 2 % len(values), column]
    return np.where(count > 0, np.where(count % 2 == 1, low, (low + high) / 2.0), 0.0)


def isolated(los_cam: FloatArray, camera: CameraModel) -> BoolArray:
    """Return which points form no long unbroken stretch: spots between clouds, which affect them too."""
    uv, _ = project(camera, los_cam)
    order = arc_order(los_cam, fit_cone(los_cam).axis_cam)
    step = np.hypot(*np.diff(np.vstack([uv[order], uv[order[:1]]]), axis=0).T)
    breaks = np.flatnonzero(step > GAP_PX)
    bad = np.zeros(len(los_cam), dtype=bool)
    if not len(breaks):
        return bad
    # A stretch runs from behind one break to the next, round the circle.
    piece = np.searchsorted(breaks, np.arange(len(order)), side="left") % len(breaks)
    length = np.bincount(piece, weights=np.where(step > GAP_PX, 0.0, step), minlength=len(breaks))
    bad[order] = length[piece] < SHORTEST_STRETCH_PX
    return bad
