"""Where one row of a linear array crosses the limb.

**As published** (Cui and others 2016): after a median filter the pixel E of the largest first difference is the coarse
crossing; the row is interpolated linearly on E-2..E+2 every 0.1 pixel, and the largest difference of that is the fine
crossing. The difference of a piecewise linear function is constant within a pixel, so that the fine crossing is the
coarse one plus a constant: whole pixels, with an error uniform over +-1/2 pixel.

**By area**, for edges that the array does not resolve. A spread function conserves the light, so that its sum on the
row gives the edge for any blur that ends within the window::

    x = x_first - 1/2 + sum_i (L_i - L_right) / (L_left - L_right)

**By half level**, for limbs wider than a pixel, where the area would count the whole curve down to space: the position
where a cubic spline through the pixels falls to half of the step, the usual definition of the infrared horizon.

The distance between the row's levels of 20 % and 80 % decides between the last two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, median_filter

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, rounding_variance

AREA_REACH = 3
"""Pixels on either side of the edge that the area counts; an unresolved edge has no light beyond."""
PLATEAU, SPACE = (5, 9), (10, 26)
"""Pixels inside a resolved limb that form its plateau (13 to 25 km below half of it, from 200 to 600 km at 0.1 deg),
and outside of it that make its dark level."""
LEVEL_PIXELS, FEWEST_LEVEL_PIXELS = 8, 3
"""Pixels of the level next to an unresolved edge, which is known to a third of a pixel's noise, and the fewest of any
level where the row ends: 0.6 of a pixel's noise."""
SYSTEMATIC_PX = 5e-3
"""Error of the locators without noise: the spline's on a limb of three pixels or more, and lens fall-off in the
window."""


@dataclass(frozen=True)
class PublishedCrossing:
    """Published crossing [px] between ``coarse`` and ``coarse + 1``; ``sigma_px`` covers rounding and wrong maxima."""

    coarse: int
    fine: float
    sigma_px: float


@dataclass(frozen=True)
class Crossing:
    """Sub-pixel crossing [px].

    ``column``: integers are pixel centres; ``sigma_px``: from the row's noise, :data:`SYSTEMATIC_PX` and the locator;
    ``width_px``: distance between the 20 % and 80 % levels.
    """

    column: float
    sigma_px: float
    kind: Literal["area", "half-level"]
    width_px: float


def published_crossing(row: FloatArray) -> PublishedCrossing:
    """Return the published pipeline's crossing of a row (n >= 5); the first of equally large differences."""
    smooth = median_filter(np.asarray(row, dtype=np.float64), size=3, mode="nearest")
    coarse = int(np.argmax(np.abs(np.diff(smooth))))
    step, reach = 0.1, 2  # [px], as published
    low, high = max(coarse - reach, 0), min(coarse + reach, len(smooth) - 1)
    samples = low + step * np.arange(round((high - low) / step) + 1)
    difference = np.abs(np.diff(np.interp(samples, np.arange(len(smooth)), smooth)))
    # Equal differences differ in the last bits of the interpolation.
    first = int(np.argmax(difference >= difference.max() * (1.0 - 1e-9)))
    return PublishedCrossing(coarse, float(samples[first] + 0.5 * step), _published_sigma_px(row, smooth, coarse))


def _published_sigma_px(row: FloatArray, smooth: FloatArray, coarse: int) -> float:
    """Return the standard deviation of the pixel of the largest difference.

    Differences smaller by ``d`` are weighted with ``exp(-(d / s)^2)``, ``s`` the pixel noise: within 15 % of simulated
    limbs.
    """
    step = np.abs(np.diff(smooth))
    # Six pixels away noise does not make another pixel the steepest.
    near = np.arange(max(coarse - 6, 0), min(coarse + 7, len(step)))
    lacking = step[coarse] - step[near]
    noise = row_noise(np.asarray(row, dtype=np.float64), coarse)
    weight = np.exp(-((lacking / noise) ** 2)) if noise > 0.0 else (lacking == 0.0).astype(np.float64)
    weight /= weight.sum()
    return float(np.sqrt(weight @ (near - weight @ near) ** 2 + 1.0 / 12.0))


def sub_pixel_crossing(row: FloatArray) -> Crossing | Refusal:
    """Return where a row of grey levels crosses the limb (Earth brighter, at either end), or why it does not."""
    row = np.asarray(row, dtype=np.float64)
    if len(row) < 2 * (AREA_REACH + FEWEST_LEVEL_PIXELS) + 1 or not np.isfinite(row).all():
        return Refusal(Outcome.BAD_INPUT, f"a row of {len(row)} finite pixels cannot hold a limb and its two levels")
    edge = int(np.argmax(np.abs(gaussian_filter1d(row, 1.5, order=1, mode="nearest"))))
    if not 0 < edge < len(row) - 1:
        return Refusal(Outcome.NO_LIMB, "the largest step of the row lies at its very end")
    noise = row_noise(row, edge)
    sharp = _by_area(row, edge, noise)
    # A step blurred by half a pixel is 1.2 px wide from 20 to 80 %.
    if isinstance(sharp, Crossing) and sharp.width_px < 2.0:
        return sharp
    return _half_level(row, edge, noise)


def row_noise(row: FloatArray, edge: int) -> float:
    """Return the standard deviation of a row's noise, from third differences away from the edge.

    The larger of both sides, since dark ones may be clipped; integer rows have at least 1/sqrt(12).
    """
    third = np.abs(np.diff(row, n=3))
    sides = [third[: max(edge - SPACE[0], 0)], third[edge + SPACE[0] :]]
    estimates = [
        MEDIAN_TO_SIGMA * float(np.median(side)) / np.sqrt(20.0) for side in sides if len(side) >= LEVEL_PIXELS
    ]
    return float(max(*estimates, np.sqrt(rounding_variance(row)), 0.0))


def _levels(row: FloatArray, left: range, right: range, noise: float) -> tuple[float, float, int, int] | Refusal:
    """Return the means over two stretches of a row and how many pixels each has."""
    on_left = row[max(left.start, 0) : max(left.stop, 0)]
    on_right = row[max(right.start, 0) : max(right.stop, 0)]
    if min(len(on_left), len(on_right)) < FEWEST_LEVEL_PIXELS:
        return Refusal(Outcome.NO_LIMB, "the largest step of the row lies too near to its end to know the level beyond")
    low, high = float(on_left.mean()), float(on_right.mean())
    step = abs(low - high)
    # Eight standard deviations: no step among a row's pixels by chance.
    if step <= 8.0 * noise:
        return Refusal(Outcome.NO_LIMB, f"no step in the row: {step:.3g} of levels, {noise:.3g} of noise")
    # Smoothed, or the noise of a faint limb would count as its range.
    whole = float(np.ptp(gaussian_filter1d(row, 1.5, mode="nearest")))
    # A slope from end to end is no limb.
    if step < 0.6 * whole:
        return Refusal(Outcome.NO_LIMB, f"no limb: the steepest place has {step:.3g} of the row's range of {whole:.3g}")
    return low, high, len(on_left), len(on_right)


def _by_area(row: FloatArray, edge: int, noise: float) -> Crossing | Refusal:
    first, last = edge - AREA_REACH, edge + AREA_REACH + 1
    levels = _levels(row, range(first - LEVEL_PIXELS, first), range(last, last + LEVEL_PIXELS), noise)
    if isinstance(levels, Refusal):
        return levels
    left, right, n_left, n_right = levels
    share = (row[first:last] - right) / (left - right)
    inside, n = float(share.sum()), last - first
    variance = n + inside**2 / n_left + (n - inside) ** 2 / n_right
    sigma = np.hypot(noise * np.sqrt(variance) / abs(left - right), SYSTEMATIC_PX)
    return Crossing(first - 0.5 + inside, float(sigma), "area", _width(share))


def _half_level(row: FloatArray, edge: int, noise: float) -> Crossing | Refusal:
    bright_left = row[max(edge - SPACE[0], 0) : edge].mean() > row[edge : edge + SPACE[0]].mean()
    # Earth to the left in the frame of the computation; the plateau is on its side.
    line = row if bright_left else row[::-1]
    centre = edge if bright_left else len(row) - 1 - edge
    column = float(centre)
    for _ in range(8):
        centre = round(column)
        start = max(min(centre + SPACE[0], len(line) - FEWEST_LEVEL_PIXELS), centre + 6)
        levels = _levels(
            line,
            range(centre - PLATEAU[1], centre - PLATEAU[0] + 1),
            range(start, centre + SPACE[1]),
            noise,
        )
        if isinstance(levels, Refusal):
            return levels
        _, space, n_plateau, n_space = levels
        low, high = max(centre - PLATEAU[1] - 1, 0), min(centre + SPACE[0], len(line) - 1)
        spline = CubicSpline(np.arange(low, high + 1), line[low : high + 1] - space)
        # The mean over a stretch that goes with the fraction of the pixel: a plateau slopes.
        ends = max(column - PLATEAU[1], low), column - PLATEAU[0]
        plateau = float(spline.integrate(*ends)) / (ends[1] - ends[0])
        roots = spline.solve(0.5 * plateau, extrapolate=False)
        roots = roots[spline(roots, 1) * plateau < 0.0]
        if not len(roots):
            return Refusal(Outcome.NO_LIMB, "the row does not fall to half of its step")
        before, column = column, float(roots[-1])
        if abs(column - before) < 1e-4:
            break
    slope = abs(float(spline(column, 1)))
    # The spline's value between two pixels has at most one pixel's noise.
    variance = 1.0 + 0.25 / n_plateau + 0.25 / n_space
    # From 6 px outside on, where the row ends soon, some 2 % of the plateau remain in the dark level: 0.1 px.
    systematic = SYSTEMATIC_PX if start == centre + SPACE[0] else 0.1
    sigma = np.hypot(noise * np.sqrt(variance) / slope, systematic)
    place = column if bright_left else len(row) - 1 - column
    return Crossing(place, float(sigma), "half-level", _width((line[low : high + 1] - space) / plateau))


def _width(share: FloatArray) -> float:
    """Return the distance [px] between the last place above 80 % and the first below 20 % of a falling edge."""
    pixel = np.arange(len(share), dtype=np.float64)

    def last_above(level: float) -> float:
        above = np.flatnonzero(share >= level)
        if not len(above) or above[-1] == len(share) - 1:
            return float(pixel[-1])
        i = int(above[-1])
        return float(i + (share[i] - level) / (share[i] - share[i + 1]))

    return last_above(0.2) - last_above(0.8)
