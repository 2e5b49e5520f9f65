"""The height of a band's limb along its arc, and its uncertainty, from the shipped profiles.

**Correlation of a random function at two positions, with different lengths along parallels and meridians.** At a
position with the unit vectors ``u`` up, ``n`` north and the lengths ``l_n`` along the meridian, ``l_e`` along the
parallel, the covariance is normal with the matrix ::

    S = l_e^2 1 + (l_n^2 - l_e^2) n n^T

and between two positions, ``d = u_i - u_j``, with ``S_m = (S_i + S_j) / 2``::

    c_ij = |S_i|^1/4 |S_j|^1/4 |S_m|^-1/2 exp(-d^T S_m^-1 d / 2)

(C. J. Paciorek and M. J. Schervish, Environmetrics 17, 483 (2006), equation 1), which is a covariance for any lengths.
Equal lengths give ``exp(-d^2 / (2 l^2))``.

**Two criteria of the height.** :func:`edge_height`: a fit (:mod:`horizonval.estimation.fit.edge`) explains the pixels
across a limb by ``b + (a + c x + d x^2) E(x)``, with the edge ``E`` of :mod:`horizonval.estimation.fit.light`. For a
rendered profile, blurred by lens and pixel, the levels are solved for at every height of a grid; the height is that of
the least residual. :func:`steepest_height`: a search takes the position where the blurred profile is steepest. A
parabola refines both.

**Tables of heights** (:class:`HeightGrid`). Heights are tabulated by pixel size or blur and the two axes of the
profiles. In :class:`BandHeights` a mode changes the height by half of the difference between one standard deviation
above the mean and one below. Whether a scene has clouds is a binary variable: the height is the middle of both cases,
with half of their distance as standard deviation. The residual of the edge adds a variance: the profile is no
exponential.

**Height along the arc**: the mean, plus independent modes that vary along the limb with the correlation above. The
error of a Sun sensor is two more patterns; without a Sun direction every Sun that lights the whole arc is equally
likely. If the location of a thermal limb is unknown, the spread over all latitudes and months is one number for the
whole arc, and the measured relief (:mod:`horizonval.earth.limb_heights`) is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief
from horizonval.estimation.fit.light import (
    INSIDE_PX,
    OUTSIDE_PX,
    OUTSIDE_SCALES,
    PIXEL_VARIANCE,
    edge_profile,
    light_basis,
)
from horizonval.estimation.fit.templates import CLOUDED, MONTHS, LimbTemplates, shipped_templates
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.rotation import fibonacci_sphere, tangent_basis

BLUR_PX = 0.7
"""Standard deviation of a usual lens's blur."""


@dataclass(frozen=True)
class ArcPlaces:
    """Positions along the limb.

    ``los_cam``, ``up_cam``: shape (n, 3), unit lines of sight and verticals; ``cam_from_itrs``: shape (3, 3);
    ``pixel_m``: shape (n,), height per pixel.
    """

    los_cam: FloatArray
    up_cam: FloatArray
    cam_from_itrs: FloatArray
    pixel_m: FloatArray


class LimbHeights(Protocol):
    """What is known of the limb's height along it."""

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights above the pose's [m] and covariance [m^2], at azimuths (n,) about the nadir [rad]."""


def everywhere(lengths_rad: ArrayLike, count: int) -> FloatArray:
    """Return lengths (K,) that are the same at so many places and in all directions, shape (count, K, 2)."""
    lengths = np.asarray(lengths_rad, dtype=np.float64)
    return np.ascontiguousarray(np.broadcast_to(lengths[None, :, None], (count, len(lengths), 2)))


def correlations(lengths_rad: FloatArray, up: FloatArray, pole: FloatArray) -> FloatArray:
    """Return correlations of n positions, shape (k, n, n), from chord distances on the unit sphere.

    ``lengths_rad``: shape (n, k, 2), along meridian and parallel, angles at the Earth's centre; ``up``: shape (n, 3),
    unit vectors from the Earth's centre; ``pole``: shape (3,), the Earth's axis.
    """
    square = np.moveaxis(np.asarray(lengths_rad, dtype=np.float64) ** 2, 1, 0)
    north = north_of(up, pole)
    parallel = square[..., 1]
    # At a pole only the parallel's length counts.
    more = 0.5 * (square[..., 0] - parallel) * north.any(axis=1)
    apart = up[:, None] - up[None, :]
    p, q = np.einsum("ix,ijx->ij", north, apart), np.einsum("jx,ijx->ij", north, apart)
    g = north @ north.T
    # S_m = a (1 + b n_i n_i^T + c n_j n_j^T), whose inverse and determinant have closed forms.
    a = 0.5 * (parallel[:, :, None] + parallel[:, None, :])
    b, c = more[:, :, None] / a, more[:, None, :] / a
    d = (1.0 + b) * (1.0 + c) - b * c * g**2
    along = (b * (1.0 + c) * p**2 - 2.0 * b * c * g * p * q + c * (1.0 + b) * q**2) / d
    size = parallel**2 * (parallel + 2.0 * more)
    share = (size[:, :, None] * size[:, None, :]) ** 0.25 / np.sqrt(a**3 * d)
    return np.asarray(share * np.exp(-0.5 * (np.sum(apart**2, axis=-1) - along) / a))


def lengths_along(lengths_rad: FloatArray, up: FloatArray, level: FloatArray, pole: FloatArray) -> FloatArray:
    """Return the lengths, shape (n, k), along level directions (n, 3) at places; others as of :func:`correlations`."""
    northward = np.einsum("ij,ij->i", north_of(up, pole), level)[:, None] ** 2
    inverse = northward / lengths_rad[..., 0] ** 2 + (1.0 - northward) / lengths_rad[..., 1] ** 2
    return np.asarray(1.0 / np.sqrt(inverse))


def north_of(up: FloatArray, pole: FloatArray) -> FloatArray:
    """Return unit vectors towards the north, shape (n, 3), and nothing at a pole."""
    at_pole = 1e-9  # cosine of a latitude, above the rounding of unit vectors
    level = pole - (up @ pole)[:, None] * up
    size = np.linalg.norm(level, axis=1, keepdims=True)
    return np.asarray(np.where(size > at_pole, level / np.maximum(size, at_pole), 0.0))


ZENITHS_RAD = np.radians([0, 15, 30, 45, 55, 65, 70, 75, 80, 83, 85, 87, 88, 89, 90, 91, 92, 93, 94, 95, 96.0])
"""Zenith angles of the Sun; beyond the last there is too little radiance."""
FAINTEST = 0.05
"""Smallest share of the mean profile that modes leave: a profile stays positive, and its logarithm finite."""


def without_clouds(table: LimbTemplates) -> FloatArray:
    """Return the profiles of scenes without clouds, shape (A, B, h)."""
    clear = table.mean
    for mode, kind in zip(np.moveaxis(table.modes, 2, 0), table.mode_kinds, strict=True):
        if kind == "scene":
            clear = clear - math.sqrt(CLOUDED / (1.0 - CLOUDED)) * _with_clouds(table, mode)
    return np.asarray(np.maximum(clear, FAINTEST * table.mean))


def _with_clouds(table: LimbTemplates, mode: FloatArray) -> FloatArray:
    """Return a mode (A, B, h) of the presence of clouds, with the sign that means presence.

    Clouds are bright under a high Sun and cold in the infrared. Modes have one sign everywhere.
    """
    below = mode[0][..., table.height_m < 0.0].sum()
    return mode if (below > 0.0) == (table.band_kind == "solar") else -mode


def seen_from(table: LimbTemplates, values: FloatArray, altitude_m: float) -> FloatArray:
    """Return values (s, A, B, h) as the lines of one camera have them, by the Sun's angles at the ground's horizon.

    The lowest point of a line at the height ``h`` lies the angle ``acos((R + h) / r) - acos(R / r)`` farther from an
    observer at the distance ``r`` from the Earth's centre than that of the ground's horizon.
    """
    zenith, azimuth = np.meshgrid(ZENITHS_RAD, table.axes[1], indexing="ij")
    up, ahead, side = np.cos(zenith), np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth)
    away = MEAN_RADIUS_M + altitude_m
    turn = np.arccos(np.minimum((MEAN_RADIUS_M + table.height_m) / away, 1.0)) - math.acos(MEAN_RADIUS_M / away)
    seen = np.empty((len(values), *zenith.shape, len(turn)))
    for k, angle in enumerate(turn):
        there = np.arccos(np.clip(up * np.cos(angle) + ahead * np.sin(angle), -1.0, 1.0))
        level = np.arctan2(side, ahead * np.cos(angle) - up * np.sin(angle))
        weights = table.linear(there.ravel(), level.ravel())
        seen[..., k] = np.tensordot(values[..., k], weights, axes=([1, 2], [1, 2])).reshape(-1, *zenith.shape)
    return seen


def edge_height(
    height_m: FloatArray, profiles: FloatArray, pixel_m: float, blur_px: float, scale_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return heights [m] and the root-mean-square misfit as a share of the profile's span, shape (n,) each.

    ``height_m``: shape (h,), rising; ``profiles``: shape (n, h), linear between, zero above the last; ``pixel_m``:
    height per pixel at the limb; ``blur_px``: standard deviation of the lens; ``scale_m``: scale height of the edge.
    """
    blur = float(np.sqrt(blur_px**2 + PIXEL_VARIANCE))
    soft = scale_m / pixel_m
    # A lens of 0.7 px leaves no structure finer than half a pixel.
    x = np.arange(-OUTSIDE_PX - OUTSIDE_SCALES * soft, INSIDE_PX, 0.5)
    lowest_m, highest_m = -20e3, 60e3  # over all bands
    middle = 0.5 * (lowest_m + highest_m)
    seen = _blurred(height_m, profiles, middle - x * pixel_m, blur * pixel_m)
    # A kilometre or a twentieth of a pixel: the parabola leaves a hundredth of it.
    heights = np.arange(lowest_m, highest_m, max(1e3, 0.05 * pixel_m))
    total = np.einsum("ij,ij->i", seen, seen)
    left = np.empty((len(profiles), len(heights)))
    for k, height in enumerate(heights):
        inside = x + (height - middle) / pixel_m
        edge = edge_profile(inside, blur, np.full(len(x), soft)).level
        # The first four functions are local levels; the others describe their change along the limb.
        basis = light_basis(edge, inside, np.zeros_like(x))[:4]
        explained = seen @ np.linalg.qr(basis.T)[0]
        left[:, k] = total - np.einsum("ij,ij->i", explained, explained)
    best, share, bent, fall = _vertex(left, np.argmin(left, axis=1))
    share = np.where(bent > 0.0, np.clip(share, -0.5, 0.5), 0.0)
    lowest = np.maximum(left[np.arange(len(left)), best] - 0.5 * fall * share, 0.0)
    misfit = np.sqrt(lowest / len(x)) / np.maximum(np.ptp(seen, axis=1), 1e-300)
    return heights[best] + (heights[1] - heights[0]) * share, misfit


def steepest_height(height_m: FloatArray, profiles: FloatArray, sigma_m: float) -> FloatArray:
    """Return the heights [m], shape (n,); NaN where a profile has no steepest position within reach.

    ``height_m``: shape (h,), rising; ``profiles``: shape (n, h); ``sigma_m``: of the blur.
    """
    places, bends = _polygon(height_m, profiles)
    # Sunlit limbs are steepest from the ground to 40 km, and none has radiance above 55 km. A search of limb points
    # looks six pixels far, five sigmas of its blur. Steps of a fifth of the blur leave a thousandth of it.
    typical_m, reach_m, step_m = 20e3, max(5.0 * sigma_m, 35e3), sigma_m / 5.0
    x = np.arange(typical_m - reach_m, typical_m + reach_m, step_m)
    fall = -bends @ ndtr((x[None, :] - places[:, None]) / sigma_m)
    highest = np.argmax(fall, axis=1)
    best, share, bent, _ = _vertex(fall, highest)
    found = (best == highest) & (fall[np.arange(len(fall)), best] > 0.0) & (bent < 0.0)
    return np.where(found, x[best] + step_m * share, np.nan)


def _vertex(values: FloatArray, best: np.ndarray) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray]:
    """Return the extremes' inner columns, the vertex of the parabola from there, second and twice first differences.

    ``values``: shape (n, m); ``best``: shape (n,).
    """
    best = np.clip(best, 1, values.shape[1] - 2)
    row = np.arange(len(values))
    before, at, after = values[row, best - 1], values[row, best], values[row, best + 1]
    bent, fall = before - 2.0 * at + after, before - after
    return best, 0.5 * fall / np.where(bent == 0.0, np.inf, bent), bent, 0.5 * fall


def _polygon(height_m: FloatArray, profiles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of profiles (n, h) [m], shape (h + 1,), and the changes of slope there, (n, h + 1)."""
    # The radiance falls to zero over a kilometre, one step of the shipped tables.
    places = np.append(height_m, height_m[-1] + 1e3)
    none = np.zeros((len(profiles), 1))
    slopes = np.diff(np.concatenate([profiles, none], axis=1), axis=1) / np.diff(places)
    return places, np.diff(np.concatenate([none, slopes, none], axis=1), axis=1)


def _blurred(height_m: FloatArray, profiles: FloatArray, at_m: FloatArray, sigma_m: float) -> FloatArray:
    """Return profiles (n, h) blurred by a Gaussian, at heights (m,), shape (n, m)."""
    places, bends = _polygon(height_m, profiles)
    z = (at_m[None, :] - places[:, None]) / sigma_m
    ramp = sigma_m * (z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))
    return np.asarray(profiles[:, :1] + bends @ ramp)


def heights_on_grid(
    table: LimbTemplates,
    states: FloatArray,
    sizes_m: FloatArray,
    criterion: Callable[[FloatArray, FloatArray, float], FloatArray | tuple[FloatArray, ...]],
    altitude_m: float = 700e3,
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return two axes and what a criterion makes of profiles (s, A, B, h) at every size, shape (c, S, s, A, B).

    ``criterion``: of heights (h,), profiles (n, h) and a size, to c rows (n,); ``altitude_m``: of the observer, for a
    sunlit band; from 300 to 2000 km the heights under a high Sun differ by 0.1 km.
    """
    if table.band_kind == "solar":
        states = np.exp(seen_from(table, np.log(np.maximum(states, 1e-300)), altitude_m))
        axes = ZENITHS_RAD, table.axes[1]
    else:
        # The year is a circle: its first month follows the last.
        states = np.concatenate([states, states[:, :, :1]], axis=2)
        axes = table.axes[0], np.append(table.axes[1], table.axes[1][0] + MONTHS)
    flat = states.reshape(-1, len(table.height_m))
    found = np.array([np.atleast_2d(criterion(table.height_m, flat, float(size))) for size in sizes_m])
    return axes, np.moveaxis(found.reshape(len(sizes_m), -1, *states.shape[:3]), 1, 0)


class HeightGrid:
    """Values (m, S, A, B) over the logarithm of a size [m] and two axes, linear between; NaN beyond the two axes."""

    def __init__(self, sizes_m: FloatArray, axes: Sequence[FloatArray], values: FloatArray) -> None:
        self._smallest, self._largest = float(sizes_m[0]), float(sizes_m[-1])
        grid = (np.log(sizes_m), *axes)
        self._at = RegularGridInterpolator(grid, np.moveaxis(values, 0, -1), bounds_error=False, fill_value=np.nan)

    def at(self, size_m: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return the values, shape (m, n); beyond the ends of the sizes the last ones hold, for NaN the largest's."""
        size = np.clip(np.nan_to_num(size_m, nan=self._largest), self._smallest, self._largest)
        return np.asarray(self._at(np.column_stack([np.log(size), first, second])).T)


@dataclass(frozen=True)
class EdgeHeights:
    """Heights at n positions along a limb.

    ``mean_m``: shape (n,); ``patterns_m``: shape (k, n), one standard deviation of each mode, the last of the departure
    from an exponential; ``correlation_rad``: shape (n, k, 2), correlation length along meridian and parallel.
    """

    mean_m: FloatArray
    patterns_m: FloatArray
    correlation_rad: FloatArray


class BandHeights:
    """Heights of a band's edge on a grid. ``scale_m``: scale height of the edge that is fitted."""

    def __init__(self, table: LimbTemplates, scale_m: float) -> None:
        # From 0.05 deg in low orbit to a degree at four times the distance, two to an octave.
        pixels_m = np.geomspace(2e3, 256e3, 15)

        def edge(height_m: FloatArray, profiles: FloatArray, pixel_m: float) -> tuple[FloatArray, FloatArray]:
            return edge_height(height_m, profiles, pixel_m, BLUR_PX, scale_m)

        axes, (heights, misfit) = heights_on_grid(table, _states(table), pixels_m, edge)
        heights, misfit = np.moveaxis(heights, 1, 0), misfit[:, 0]
        changes = 0.5 * (heights[1::2] - heights[2::2])
        scenes = np.array(table.mode_kinds) == "scene"
        middle = heights[0] + (0.5 * (heights[1::2] + heights[2::2]) - heights[0])[scenes].sum(axis=0)
        # Five pixels per misfit relative to the step: of a residual like the edge's slope, half a step per pixel over
        # three of the twenty fitted pixels.
        open_m = 5.0 * misfit * pixels_m[:, None, None]
        self._grid = HeightGrid(pixels_m, axes, np.concatenate([middle[None], changes, open_m[None]]))
        self._ends = [(float(axis[0]), float(axis[-1])) for axis in axes]
        # What is no exponential is so as the light is, which changes along the limb no faster than the air does.
        self._table, self._air = table, [kind == "air" for kind in table.mode_kinds]

    def at(self, pixel_m: FloatArray, first: FloatArray, second: FloatArray) -> EdgeHeights:
        """Return the heights at positions along a limb.

        ``pixel_m``: shape (n,), height per pixel; ``first``, ``second``: shape (n,), along the table's axes: the Sun's
        zenith angle and azimuth [rad], or latitude [rad] and month. Beyond the ends the last values hold.
        """
        if self._table.band_kind == "thermal":
            second = self._ends[1][0] + (second - self._ends[1][0]) % MONTHS
        first, second = (np.clip(x, *ends) for x, ends in zip((first, second), self._ends, strict=True))
        found = self._grid.at(pixel_m, first, second)
        lengths = self._table.lengths_at(first)
        lengths = np.concatenate([lengths, lengths[:, self._air].mean(axis=1, keepdims=True)], axis=1)
        return EdgeHeights(found[0], found[1:], lengths)


@cache
def band_heights(
    band_kind: Literal["solar", "thermal"], band_um: tuple[float, float], scale_m: float
) -> BandHeights | None:
    """Return the heights of the shipped table of a band, None where none is."""
    table = shipped_templates(band_kind, band_um)
    return None if table is None else BandHeights(table, scale_m)


def _states(table: LimbTemplates) -> FloatArray:
    """Return the mean profiles, and those of each mode more and less, shape (1 + 2 k, A, B, h)."""
    states = [table.mean]
    for mode, kind in zip(np.moveaxis(table.modes, 2, 0), table.mode_kinds, strict=True):
        more = less = 1.0
        if kind == "scene":
            mode, odds = _with_clouds(table, mode), math.sqrt(CLOUDED / (1.0 - CLOUDED))
            more, less = 1.0 / odds, odds
        states += [table.mean + more * mode, table.mean - less * mode]
    return np.maximum(np.stack(states), FAINTEST * table.mean)


SUN_SIGMA_RAD = math.radians(0.5)
"""Standard deviation of a coarse Sun sensor, right to a degree."""
SUNS = 64
"""Number of directions, evenly over the sphere, that stand for a Sun that is not known."""


def sun_angles_at(los_cam: FloatArray, up_cam: FloatArray, sun_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth from the line of sight [rad] of the Sun, shape (n,) each or (k, n) for k Suns.

    ``los_cam``, ``up_cam``: shape (n, 3), line of sight and vertical at tangent points; ``sun_cam``: (3,) or (k, 3).
    """
    cosine = np.clip(sun_cam @ up_cam.T, -1.0, 1.0)
    level = sun_cam[..., None, :] - cosine[..., None] * up_cam
    length = np.maximum(np.linalg.norm(level, axis=-1), 1e-9)
    ahead = np.einsum("...ij,ij->...i", level, los_cam) / length
    return np.arccos(cosine), np.arccos(np.clip(ahead, -1.0, 1.0))


def misread_suns(sun_cam: FloatArray, sigma_rad: float) -> FloatArray:
    """Return directions one standard deviation off a Sun direction (3,), along two axes, shape (2, 3)."""
    moved = sun_cam + sigma_rad * tangent_basis(sun_cam).T
    return np.asarray(moved / np.linalg.norm(moved, axis=1)[:, None])


@dataclass(frozen=True)
class UnevenLimb:
    """Knowledge of a band's limb.

    ``sun_cam``: shape (3,), for a sunlit band, else None; ``sun_sigma_rad``: of each of its two angles; ``month``: for
    a thermal band of known position, else None; ``reliefs``: variation along a limb of unknown position; ``typical_m``:
    reference of a height with a separate prior, None for the mean along the arc.
    """

    heights: BandHeights
    sun_cam: FloatArray | None
    sun_sigma_rad: float
    month: float | None
    thermal: bool
    reliefs: tuple[Relief, ...] = ()
    typical_m: float | None = None

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights [m], shape (n,), and covariance [m^2], (n, n), at azimuths (n,) about the nadir [rad]."""
        if self.thermal:
            mean, covariance = self._thermal(places, azimuth)
        else:
            mean, covariance = self._sunlit(places)
        if self.typical_m is not None:
            return mean - self.typical_m, covariance
        level = np.eye(len(mean)) - 1.0 / len(mean)
        return level @ mean, level @ covariance @ level

    def _thermal(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.month is not None:
            latitude = np.arcsin(np.clip((places.up_cam @ places.cam_from_itrs)[:, 2], -1.0, 1.0))
            edge = self.heights.at(places.pixel_m, latitude, np.full(len(latitude), self.month))
            return edge.mean_m, _covariance(edge, places)
        # The mean over the sphere: latitudes whose sines are even.
        sines, months = np.linspace(-1.0, 1.0, 19), np.arange(1.0, MONTHS + 1.0)
        latitude = np.repeat(np.arcsin(sines), len(months))
        month = np.tile(months, len(sines))
        edge = self.heights.at(np.full(len(month), np.median(places.pixel_m)), latitude, month)
        variance = float(np.var(edge.mean_m) + np.mean((edge.patterns_m**2).sum(axis=0)))
        apart = np.abs(azimuth[:, None] - azimuth[None, :])
        apart = np.minimum(apart, 2.0 * np.pi - apart)
        covariance = np.full((len(azimuth), len(azimuth)), variance)
        for relief in self.reliefs:
            covariance += relief.sigma_m**2 * np.exp(-0.5 * (apart / relief.correlation_rad) ** 2)
        return np.full(len(azimuth), float(edge.mean_m.mean())), covariance

    def _sunlit(self, places: ArcPlaces) -> tuple[FloatArray, FloatArray]:
        if self.sun_cam is not None:
            edge = self._under(places, self.sun_cam)
            misread = [self._under(places, sun) for sun in misread_suns(self.sun_cam, self.sun_sigma_rad)]
            changes = np.array([one.mean_m for one in misread]) - edge.mean_m
            return edge.mean_m, _covariance(edge, places) + changes.T @ changes
        suns = fibonacci_sphere(SUNS)
        lit = (suns @ places.up_cam.T >= 0.0).all(axis=1)
        overhead = places.up_cam.mean(axis=0)
        likely = suns[lit] if lit.any() else [overhead / np.linalg.norm(overhead)]
        edges = [self._under(places, sun) for sun in likely]
        heights = np.array([edge.mean_m for edge in edges])
        mean = heights.mean(axis=0)
        spread = (heights - mean).T @ (heights - mean) / len(heights)
        return mean, spread + np.mean([_covariance(edge, places) for edge in edges], axis=0)

    def _under(self, places: ArcPlaces, sun: FloatArray) -> EdgeHeights:
        """Return the heights under a Sun, shape (3,)."""
        return self.heights.at(places.pixel_m, *sun_angles_at(places.los_cam, places.up_cam, sun))


def _covariance(edge: EdgeHeights, places: ArcPlaces) -> FloatArray:
    """Return what the patterns make of the heights [m^2], shape (n, n)."""
    alike = correlations(edge.correlation_rad, places.up_cam, places.cam_from_itrs[:, 2])
    return np.asarray(np.einsum("ki,kj,kij->ij", edge.patterns_m, edge.patterns_m, alike))
