"""The limb as an edge: an image model whose profile is one exponential, blurred.

A pixel near the limb is ``I = b + B(x) E(x) + noise`` with the edge profile ``E`` (:mod:`.light`), ``x`` its distance
inside the limb in pixels, background and brightness of its sector of azimuth (:mod:`.levels`). An image's own unknowns
are the logarithm of the blur, of lens and pixel together, and the scale height; those of the air are modes of the
limb's height along it (:mod:`.edge_pixels`). The levels are eliminated within the model.

An error of the lens moves the line of sight of a pixel as if the pixel were at another place in the image.

**Neglected.** The change of the image scale over the distance itself, a thousandth per pixel where ``x`` is a few
pixels, and, but for calibrations, over the half pixel that a pose moves the limb before pixels are chosen again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.image import LENS, POSE, OwnPrior
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import (
    PIXEL_VARIANCE,
    EdgeProfile,
    Levels,
    LightNoise,
    brightness,
    edge_profile,
    eliminated,
    inner_levels,
    light_basis,
    light_noise,
    solve_levels,
)
from horizonval.estimation.fit.pixels import LimbPixels
from horizonval.estimation.fit.pose import FIXED_LENGTH_M, LimbPose

BLUR = POSE + LENS
SCALE = BLUR + 1
"""Places of an image's own unknowns among those that it has with shot and camera."""
LARGEST_MOTION_PX, LARGEST_SCALE_STEP_PX, LARGEST_LOG_STEP = 2.0, 0.25, 0.5
"""Largest step of limb, scale height and ln blur for which the derivatives hold; the last also as a share of the scale
height, where that is more, and as the largest share of the blur's variance that makes room for a scale height."""
LOWEST = np.array([0.5 * np.log(PIXEL_VARIANCE), 0.0])
"""Least values of an image's own unknowns: a lens without blur, a hard limb."""


@dataclass(frozen=True)
class EdgePixels(LimbPixels):
    """n pixels near a limb, or means of some, in order of azimuth; sectors have equally many.

    ``sectors``: number of sectors; ``along``: shape (n,), place in the sector, -1/2 to 1/2; ``rounding``: variance of
    rounding; ``bend_m``: shape (n,), what a blur of one pixel's variance adds to the distances; ``lift_m``: shape (n,),
    known height of the limb above the pose's; ``modes``: shape (k, n), of the air's unknowns [m]; ``motion``: shape
    (11, q), derivatives of places on the limb by pose and lens [px]; ``curve``: see :class:`.pixels.Limb` [1/m].
    """

    sectors: int
    along: FloatArray
    rounding: float
    bend_m: FloatArray
    lift_m: FloatArray
    modes: FloatArray
    motion: FloatArray
    curve: float


@dataclass(frozen=True)
class _Edge:
    """Profile of the pixels, ``x`` inside the limb [px]; ``by_turn``: shape (3, n), of the distances outside it [m];
    ``soft``: scale height in the image [px/m], None for a hard limb."""

    x: FloatArray
    by_turn: FloatArray
    blur: FloatArray
    edge: EdgeProfile
    soft: FloatArray | None
    basis: FloatArray


@dataclass(frozen=True)
class EdgeLook:
    """Pixels as the unknowns predict them."""

    seen: _Edge
    levels: Levels
    residuals: FloatArray

    @property
    def penalty(self) -> float:
        """Squared departures of the sectors' levels from their mean, in units of their spread."""
        return self.levels.penalty

    @cached_property
    def of_pixel(self) -> FloatArray:
        """Levels of every pixel's sector, shape (6, n)."""
        levels = self.levels.of_sector
        return np.repeat(levels, len(self.residuals) // len(levels), axis=0).T


class EdgeLinear:
    """Normal equations of the pixels at one look; ``jacobian``: shape (13 + k, n)."""

    exact: ClassVar[bool] = False

    def __init__(self, jacobian: FloatArray, normal: FloatArray) -> None:
        self._jacobian, own = jacobian, SCALE + 1
        self.shared, self.mixed, self.air = normal[:own, :own], normal[:own, own:], normal[own:, own:]

    def rights(self, look: EdgeLook, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the right sides of other residuals by the same derivatives."""
        right = self._jacobian @ (weights * look.residuals)
        return right[: SCALE + 1], right[SCALE + 1 :]


class EdgeModel:
    """The pixels of one image near the limb.

    ``known``: the image's share of what is known; ``tighter``: factor on its information on blur and scale height.
    """

    def __init__(self, pixels: EdgePixels, known: LimbKnowledge, tighter: float) -> None:
        self.pixels, self.known = pixels, known
        self._px_per_m = float(np.abs(pixels.motion[POSE - 1]).max())
        self._largest_scale_step_m = LARGEST_SCALE_STEP_PX / self._px_per_m
        self._spread: FloatArray | None = None
        self._tighter = tighter
        self._last: tuple[bytes, _Edge] | None = None

    def moved(self, own: FloatArray, step: FloatArray) -> FloatArray:
        """Return the own unknowns after a step, within their limits.

        The edge's variance is that of blur and scale height together, ``s^2 + c^2``, and tells them apart badly: to
        second order in the step of ``c`` the blur makes room for it.
        """
        scale_m = max(float(own[1] + step[1]), LOWEST[1])
        blur_2 = float(np.exp(2.0 * (own[0] + step[0])))
        blur_2 -= min((self._px_per_m * (scale_m - float(own[1]))) ** 2, LARGEST_LOG_STEP * blur_2)
        return np.array([max(0.5 * np.log(blur_2), LOWEST[0]), scale_m])

    def prior(self, pose: LimbPose, own: FloatArray) -> OwnPrior:
        """Return the prior of blur and scale height."""
        known = self.known
        sigmas = np.array([known.blur_log_sigma, max(known.scale_sigma_m, FIXED_LENGTH_M), known.middle_sigma_m])
        sigmas[:2] /= np.sqrt(self._tighter)
        middle_m = known.mean.height_m + known.scale_height_m - pose.height_m - own[1]
        off, rows = np.array([*(known.own - own), middle_m]) / sigmas, np.zeros((3, SCALE + 1))
        rows[0, BLUR], rows[1, SCALE], rows[2, [POSE - 1, SCALE]] = 1.0 / sigmas
        return OwnPrior(rows.T @ rows, off @ rows, float(off @ off))

    def reach(self, step: FloatArray) -> float:
        """Return how far a step goes, 1 where derivatives end to hold."""
        return max(
            self.motion_px(step) / LARGEST_MOTION_PX,
            abs(float(step[BLUR])) / LARGEST_LOG_STEP,
            abs(float(step[SCALE])) / self._largest_scale_step_m,
        )

    def motion_px(self, step: FloatArray) -> float:
        """Return by how much a step (7 + 4 + own) moves the limb where it moves it most [px].

        The limb of a soft air is a scale height above its foot, so that one rises as much as the other falls.
        """
        rises = step[SCALE] * self.pixels.motion[POSE - 1]
        return float(np.abs(step[:BLUR] @ self.pixels.motion + rises).max())

    def look(
        self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray, weights: FloatArray | None
    ) -> EdgeLook:
        """Return the pixels as predicted, with the most probable levels by weights so far."""
        seen = self._seen(pose, lens, own, air)
        pixels = self.pixels
        if weights is None:
            weights = pixels.counts
        levels = solve_levels(seen.basis, pixels.values, weights, pixels.sectors, self._spread)
        return EdgeLook(seen, levels, pixels.values - levels.of_pixels(seen.basis))

    def noise(self, look: EdgeLook) -> LightNoise:
        """Return the variance model of the pixels, and estimate the spread of the sectors' levels."""
        pixels = self.pixels
        places = np.array([pixels.columns, pixels.rows])
        noise, self._spread = light_noise(
            look.seen.basis, places, pixels.values, pixels.counts, pixels.sectors, pixels.rounding
        )
        return noise

    def linear(self, look: EdgeLook, own: FloatArray, weights: FloatArray) -> EdgeLinear:
        """Return the normal equations at a look, the levels eliminated."""
        pixels, seen = self.pixels, look.seen
        assert self._spread is not None
        blur = float(np.exp(own[0]))
        self._largest_scale_step_m = max(LARGEST_SCALE_STEP_PX / self._px_per_m, LARGEST_LOG_STEP * float(own[1]))
        lift, change = brightness(look.of_pixel, seen.x, pixels.along)
        by_x = lift * seen.edge.slope + change * seen.edge.level
        per_m = -by_x / pixels.width_m
        jacobian = np.empty((SCALE + 1 + len(pixels.modes), len(by_x)))
        jacobian[:3] = seen.by_turn * per_m
        jacobian[3:POSE] = pixels.by_pose[3:] * per_m
        jacobian[POSE:BLUR] = pixels.by_lens * per_m
        jacobian[BLUR] = blur**2 * (lift * seen.edge.by_blur / seen.blur + 2.0 * pixels.bend_m * per_m)
        jacobian[SCALE] = 0.0 if seen.soft is None else lift * seen.edge.by_scale * seen.soft
        jacobian[SCALE + 1 :] = pixels.modes * jacobian[POSE - 1]
        return EdgeLinear(jacobian, eliminated(jacobian, seen.basis, weights, pixels.sectors, self._spread))

    def _seen(self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray) -> _Edge:
        unknowns = [pose.cam_from_itrs.ravel(), pose.r_itrs, np.array([pose.height_m]), lens, own, air]
        key = np.concatenate(unknowns).tobytes()
        # The noise is estimated again and again at one state.
        if self._last is None or self._last[0] != key:
            self._last = key, self._predicted(pose, lens, own, air)
        return self._last[1]

    def _predicted(self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray) -> _Edge:
        pixels, soft = self.pixels, None
        blur, scale_m = float(np.exp(own[0])), float(own[1])
        across, by_turn = pixels.moved(pose, lens)
        across = across + pixels.by_pose[POSE - 1] * (pixels.lift_m + air @ pixels.modes)
        if self.known.soft:
            # Outside the limb a ray passes lower than its distance from the limb: 0.4 % at 8 km seen from 500 km. Half
            # is far above any air and keeps the exponential edge monotonic.
            lower = np.maximum(1.0 - pixels.curve * np.maximum(across, 0.0), 0.5)
            soft = 1.0 / (pixels.width_m * lower)
        x = -(across + blur**2 * pixels.bend_m) / pixels.width_m
        wide = np.sqrt(blur**2 + pixels.spread_px2)
        edge = edge_profile(x, wide, None if soft is None else scale_m * soft)
        return _Edge(x, by_turn, wide, edge, soft, light_basis(edge.level, x, pixels.along))


@dataclass(frozen=True)
class SectorPlaces:
    """What every sector shows.

    ``uv``: shape (m, 2), a point on its limb [px]; ``off_rad``: shape (m,), how far inside the fitted limb it shows the
    limb, relief included; ``squares``: shape (m,), squares of what is left of that without the relief, over the
    variance by noise, NaN where nothing is seen; ``levels``: shape (m,), how much brighter than space it is inside.
    """

    uv: FloatArray
    off_rad: FloatArray
    squares: FloatArray
    levels: FloatArray


def sector_places(model: EdgeModel, look: EdgeLook, weights: FloatArray, air: FloatArray) -> SectorPlaces:
    """Return what every sector of a fitted limb shows; ``weights``: shape (n,); ``air``: shape (k,)."""
    pixels, seen, count = model.pixels, look.seen, model.pixels.sectors

    def sums(values: FloatArray) -> FloatArray:
        return np.asarray(values.reshape(count, -1).sum(axis=1))

    size = len(pixels.values) // count
    slope = brightness(look.of_pixel, seen.x, pixels.along)[0] * seen.edge.slope * pixels.distance_m / pixels.width_m
    information = sums(weights * slope * slope)
    shift = sums(weights * slope * look.residuals) / np.maximum(information, 1e-300)
    nearest = np.argmin(np.abs(seen.x).reshape(count, -1), axis=1) + size * np.arange(count)
    return SectorPlaces(
        uv=np.column_stack([pixels.columns[nearest], pixels.rows[nearest]]).astype(float),
        off_rad=shift + sums(air @ pixels.modes / pixels.distance_m) / size,
        squares=np.where(information > 0.0, shift**2 * information, np.nan),
        levels=inner_levels(pixels.values, seen.edge.level, look.levels.of_sector),
    )
