"""The likelihood of a limb along a curve, against that of no limb.

The limb of a cone is cut into sectors, and the picture is read across each of them, ``x`` pixels inside of it, as the
mean of neighbouring profiles. Two models with equally many free levels are fitted by least squares::

    limb      I = b + a E(x - d) + c E(x - d) (x - d),     E(x) = Phi(x / s)
    no limb   I = b + a x + c E(x - d) (x - d)

``b`` is space, ``a`` the Earth's brightness relative to it, ``c`` its shading. A ramp that begins, as the terminator
does, is no limb. The width ``s`` is common to all sectors, one of a few; the shift ``d`` is fitted
per sector, up to two pixels. With the mean squared residuals ``m``, and the noise unknown, the log likelihood ratio is
::

    (n / 2) ln (m_none + f) / (m_limb + f),     f = noise^2 + (share of a)^2

where ``f`` is the least misfit of any predicted profile (shading, clouds, layers of the air). Only widths of a lens or
of the air, some tens of kilometres at the cone, are tried.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.pyramid import PyramidLevel, Trace, cone_frame, on_cone, trace_limb
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel

REACH_PX = 8
"""Length of a profile to either side of the curve: twice the widest edge and the largest shift."""
WIDTHS_PX = (0.4, 0.8, 1.6, 3.2)
"""Widths of edges tried, in factors of two; a wider edge is half as wide a level on."""
SHIFTS_PX = (-2.0, -1.0, 0.0, 1.0, 2.0)
"""A cone of a level is right to a pixel, which is two of the next one."""
PROFILES = 4
"""Neighbouring ones that make a sector's mean: half of the noise, over less limb than the tolerated relief takes."""
MOST_SECTORS = 64
"""More would tell no more of three unknowns and cost more: 256 profiles."""
INNERMOST = 2
"""Pixels of a profile that tell the Earth from a bright line."""
CERTAIN = 6.0
"""Log likelihood ratio of a sector that shows a limb: 400 to 1. One in a thousand sectors of noise passes it."""


@dataclass(frozen=True)
class Evidence:
    """Evidence of a level along a cone, in m sectors.

    ``log_ratio`` (m,): likelihood of limb against none, negative for the opposite bright side; ``step`` (m,):
    brightness of Earth minus space; ``deep`` (m,): the same of the innermost pixels read; ``los`` (m, 3): lines of
    sight to the middle of the sector's limb; ``width_px``: of the edge, in pixels of the level; ``sector_px``: sector
    length, in pixels of the picture; ``px_rad``: angle of the level's pixel across the limb.
    """

    log_ratio: FloatArray
    step: FloatArray
    deep: FloatArray
    los: FloatArray
    width_px: float
    bright_inside: bool
    sector_px: float
    px_rad: float

    @property
    def shows(self) -> NDArray[np.bool_]:
        """Which sectors show a limb, shape (m,)."""
        return np.asarray(self.log_ratio > CERTAIN)

    @property
    def bright_side(self) -> float:
        """Share of the sectors that show a limb whose inside, away from the edge, is what the edge says."""
        deep = self.deep[self.shows]
        return float(np.mean((deep > 0.0) if self.bright_inside else (deep < 0.0))) if len(deep) else 0.0

    @property
    def score(self) -> float:
        """Mean logarithm of the likelihood ratio of a pixel of limb, times its length."""
        return float(self.log_ratio.sum()) * self.sector_px

    @property
    def arc_px(self) -> float:
        """Length of the limb that shows [px of the picture]."""
        return float(np.count_nonzero(self.shows)) * self.sector_px

    @property
    def explained(self) -> float:
        """Share of the limb in view that shows."""
        return float(np.mean(self.shows)) if len(self.log_ratio) else 0.0


def weigh(level: PyramidLevel, camera: CameraModel, axis_cam: FloatArray, rho_rad: float) -> Evidence | None:
    """Return a level's evidence along a cone's limb, None if too little is in the image; ``camera``: of the picture."""
    trace = trace_limb(camera, axis_cam, rho_rad, level.scale, PROFILES * MOST_SECTORS)
    sectors = len(trace.azimuth) // PROFILES
    if not sectors:
        return None
    reach = inner_reach(trace, rho_rad, level.scale)
    offsets = np.arange(-REACH_PX, reach + 1.0)
    profiles, known = read_profiles(level, trace, offsets)
    shape = (sectors, PROFILES, len(offsets))
    good = enough_known(np.asarray(known[: sectors * PROFILES].reshape(shape).any(axis=1)), offsets)
    if not good.any():
        return None
    mean = profiles[: sectors * PROFILES].reshape(shape).mean(axis=1)[good]
    widths = allowed_widths(trace, rho_rad, level.scale)
    log_ratio, step, space, shift, width = _compared(mean, reach, widths, level.noise / np.sqrt(PROFILES))
    bright = bool(np.sum(np.where(log_ratio > 0.0, log_ratio, 0.0) * np.sign(step)) > 0.0)
    log_ratio = np.where((step > 0.0) == bright, log_ratio, -np.abs(log_ratio))
    first = np.flatnonzero(good) * PROFILES + PROFILES // 2
    rho = rho_rad - level.scale * shift * trace.px_rad[first]
    los = on_cone(cone_frame(axis_cam), rho, trace.azimuth[first])
    px_rad = trace.middle_px_rad * level.scale
    sector_px = trace.spacing * PROFILES
    return Evidence(
        log_ratio,
        step,
        mean[:, -INNERMOST:].mean(axis=1) - space,
        los,
        width,
        bright,
        sector_px,
        px_rad,
    )


def inner_reach(trace: Trace, rho_rad: float, scale: float) -> int:
    """Return how far inside a profile may go [px of the level]: not to the middle of a small disc."""
    radius = rho_rad / (trace.middle_px_rad * scale)
    return int(np.clip(radius, 2.0, REACH_PX))


def allowed_widths(trace: Trace, rho_rad: float, scale: float) -> tuple[float, ...]:
    """Return the widths of an edge that lens or air may have in a level; the sharpest always.

    From half of its brightness carbon dioxide's limb falls to a tenth within 20 km, haze and ozone less.
    """
    px_m = MEAN_RADIUS_M / np.tan(rho_rad) * trace.middle_px_rad * scale
    # A lens may blur its own pixels, not the means of many.
    lens = WIDTHS_PX[2] if scale == 1.0 else WIDTHS_PX[1]
    return tuple(width for width in WIDTHS_PX if width <= max(lens, 40e3 / px_m))


def read_profiles(level: PyramidLevel, trace: Trace, offsets: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the level at offsets (k,) [px of the level] inside the limb, shape (n, k), and which are known."""
    places = trace.uv[:, None, :] / level.scale + offsets[None, :, None] * trace.inwards[:, None, :]
    return level.at(places)


def enough_known(known: NDArray[np.bool_], offsets: FloatArray) -> NDArray[np.bool_]:
    """Return which profiles (n, k) are measured at their middle and at three quarters of all places."""
    middle = np.abs(offsets) <= SHIFTS_PX[-1] + 1.0
    return np.asarray((known.mean(axis=1) >= 0.75) & np.all(known[:, middle], axis=1))


@cache
def _projections(reach: int) -> FloatArray:
    """Return columns (k, 6 e) for e edges: of edges, of ramps' begins, of steps and of space.

    The first two are orthonormal and orthogonal to a constant; the product of a profile with the last two is the step
    and the level of space that fit it.
    """
    x = np.arange(-REACH_PX, reach + 1.0)

    def varying(*columns: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.qr(np.column_stack([np.ones_like(x), *columns]))[0][:, 1:])

    edges, begins, steps, spaces = [], [], [], []
    for width in WIDTHS_PX:
        for shift in SHIFTS_PX:
            edge = ndtr((x - shift) / width)
            edges.append(varying(edge, edge * (x - shift)))
            begins.append(varying(x, edge * (x - shift)))
            levels = np.linalg.pinv(np.column_stack([np.ones_like(x), edge, edge * (x - shift) / REACH_PX]))
            steps.append(levels[1][:, None])
            spaces.append(levels[0][:, None])
    return np.hstack([*edges, *begins, *steps, *spaces])


def _compared(
    mean: FloatArray, reach: int, widths: tuple[float, ...], noise: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Return of profiles (m, k): logarithm of the likelihood ratio, step, space, shift, (m,) each, and the width."""
    m, k = mean.shape
    centred = mean - mean.mean(axis=1, keepdims=True)
    power = np.einsum("ij,ij->i", centred, centred)
    every, tried = len(WIDTHS_PX) * len(SHIFTS_PX), len(widths) * len(SHIFTS_PX)
    columns = _projections(reach)
    explained = (centred @ columns[:, : 4 * every]) ** 2
    explained = explained[:, ::2] + explained[:, 1::2]
    edges, begins = explained[:, :tried], explained[:, every : every + tried]
    left_none = np.maximum(power - begins.max(axis=1), 0.0) / k
    left = np.maximum(power[:, None] - edges, 0.0) / k
    step = mean @ columns[:, 4 * every : 4 * every + tried]
    # A good profile misfits by some hundredths of its step.
    floor = noise**2 / k + (0.03 * step) ** 2
    ratio = (0.5 * k * np.log((left_none[:, None] + floor) / (left + floor))).reshape(m, len(widths), -1)
    best = int(np.argmax(ratio.max(axis=2).sum(axis=0)))
    ratio = ratio[:, best]
    place = np.argmax(ratio, axis=1)
    rows, column = np.arange(m), best * len(SHIFTS_PX) + place
    space = np.einsum("ij,ij->i", mean, columns.T[5 * every + column])
    shift = SHIFTS_PX[0] + place + _top(ratio, place)
    return ratio[rows, place], step[rows, column], space, shift, widths[best]


def _top(ratio: FloatArray, place: NDArray[np.intp]) -> FloatArray:
    """Return how far between its neighbours a row's largest value lies, by a parabola; 0 at the ends."""
    rows = np.arange(len(ratio))
    inner = np.clip(place, 1, ratio.shape[1] - 2)
    before, middle, after = (ratio[rows, inner + i] for i in (-1, 0, 1))
    bend = before - 2.0 * middle + after
    top = 0.5 * (before - after) / np.where(bend < 0.0, bend, -np.inf)
    return np.where(place == inner, np.clip(top, -0.5, 0.5), 0.0)
