r"""The air along a limb in view: profiles at nodes of azimuth, and how the modes vary from node to node.

A coefficient of a mode is along the limb a random function with the covariance ``exp(-d^2 / (2 l^2))``, ``d`` the
distance of two places on the unit sphere. On the nodes it is ``V diag(w) V^T``, and ::

    a_k(node j) = sum_i  z_i sqrt(w_i) V_ji,        z_i ~ N(0, 1)

(Karhunen and Loeve), as for the relief in :mod:`.relief_modes`. Waves that hold less than :data:`LEFT_OUT` of a mode's
variance are left out.

A line that passes at ``h``, below the height ``z`` from which light comes, ends the angle ``d`` before its lowest
point, where the air is another one. What is there is alike with what stands at the lowest point as ``r``, so that a
mode falls apart into two, with coefficients that do not know of each other::

    a r f(h) + b (1 - r^2)^1/2 f(h),        d = (2 (z - h) / R)^1/2,        r = exp(-d^2 / (2 l^2))

The height ``z`` is the highest at which the mean has half of its largest value. Two more kinds of functions join them:

- what its modes leave: bumps over height whose squares sum up to one, each times ``left_sigma``, alike along the limb
  over :data:`LEFT_LENGTH_RAD`;
- the gain of the optics, which a calibration has to :data:`GAIN_SIGMA`: the mean profile itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray

LEFT_OUT = 1e-4
"""Of a mode's variance: 1 % of its standard deviation."""
BUMP_M = 6e3
"""Between the middles of bumps: the height over which what clouds and layers do is one."""
BUMP_HEIGHTS_M = (-15e3, 75e3)
"""Where bumps are: below a profile is smooth, above is too little light."""
LEAST_BUMP = 3e-3
"""Of the brightest place of the profile: a bump that is less everywhere is left out, below the noise of any pixel."""
GAIN_SIGMA, GAIN_LENGTH_RAD = 0.01, 0.3
EARTH_RADIUS_M = 6.371e6
LEAST_APART = 0.05
"""Of a mode's standard deviation: a second part that is less everywhere in the grid is left out."""
LEFT_LENGTH_RAD = 0.1
"""Over which what the modes leave is alike along the limb: between that of clouds and that of the air."""


@dataclass(frozen=True)
class NodeAir:
    """Profiles at m nodes along the limb.

    Attributes
    ----------
    bottom_m : float
        First distance of the grid, across the limb.
    step_m : float
        Of the grid.
    functions : ndarray, shape (m, 1 + k, n)
        The mean, and k functions that are added to it.
    waves : tuple of ndarray, shape (m, j) each
        Of every added function: what the unit unknowns make of its coefficient at the nodes.
    """

    bottom_m: float
    step_m: float
    functions: FloatArray
    waves: tuple[FloatArray, ...]

    @property
    def count(self) -> int:
        """Unknowns of all functions together."""
        return sum(wave.shape[1] for wave in self.waves)

    @property
    def function(self) -> NDArray[np.intp]:
        """Number of every unknown's function, from 0 without the mean, shape (count,)."""
        return np.repeat(np.arange(len(self.waves)), [wave.shape[1] for wave in self.waves])

    def coefficients(self, unknowns: FloatArray) -> FloatArray:
        """Return what the functions are multiplied with at the nodes, shape (m, 1 + k): 1 of the mean."""
        product = np.concatenate(self.waves, axis=1) * unknowns
        starts = np.cumsum([0] + [wave.shape[1] for wave in self.waves[:-1]])
        return np.concatenate([np.ones((len(product), 1)), np.add.reduceat(product, starts, axis=1)], axis=1)


def node_air(
    height_m: FloatArray,
    mean: FloatArray,
    modes: FloatArray,
    left_sigma: FloatArray,
    correlation_rad: FloatArray,
    places: FloatArray,
    grid_m: tuple[float, float, float],
    curve: float,
) -> NodeAir:
    """Return the air at the nodes.

    Parameters
    ----------
    height_m : ndarray, shape (h,)
    mean, left_sigma : ndarray, shape (m, h)
    modes : ndarray, shape (m, k, h)
    correlation_rad : ndarray, shape (k,)
    places : ndarray, shape (m, 3)
        Unit vectors from the Earth's centre to the nodes.
    grid_m : tuple of float
        First and last distance across the limb (:func:`.ray_height.level_distance`) that are asked for, and the step:
        profiles are means over steps.
    curve : float
        That turns distances into heights. Above the table there is no light, below it that of its end.
    """
    count = int(np.ceil((grid_m[1] - grid_m[0]) / grid_m[2])) + 1
    borders = grid_m[0] + (np.arange(count + 1) - 0.5) * grid_m[2]
    borders -= curve * borders**2
    grid, width = 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)
    known = np.concatenate(
        [[min(borders[0], height_m[0]) - 1.0], height_m, [height_m[-1] + 1.0, max(borders[-1], height_m[-1]) + 2.0]]
    )
    i = np.clip(np.searchsorted(known, borders, side="right") - 1, 0, len(known) - 2)
    into = borders - known[i]
    share = into / (known[i + 1] - known[i])

    def even(values: FloatArray) -> FloatArray:
        nothing = np.zeros((*values.shape[:-1], 2))
        values = np.concatenate([values[..., :1], values, nothing], axis=-1)
        parts = 0.5 * (values[..., 1:] + values[..., :-1]) * np.diff(known)
        whole = np.concatenate([nothing[..., :1], np.cumsum(parts, axis=-1)], axis=-1)
        before = whole[..., i] + into * (values[..., i] * (1.0 - 0.5 * share) + values[..., i + 1] * 0.5 * share)
        return np.asarray(np.diff(before, axis=-1) / width)

    alike = alike_at_ends(height_m, mean, correlation_rad)
    elsewhere = np.sqrt(1.0 - alike**2)
    inside = (height_m > grid_m[0]) & (height_m < grid_m[1])
    second = np.flatnonzero((elsewhere[:, :, inside] > LEAST_APART).any(axis=(0, 2)))
    modes = np.concatenate([modes * alike, (modes * elsewhere)[:, second]], axis=1)
    lengths = np.concatenate([correlation_rad, correlation_rad[second]])
    mean, modes, left = even(mean), even(modes), even(left_sigma)
    apart = np.sum((places[:, None] - places[None, :]) ** 2, axis=-1)
    functions, waves = [mean[:, None], modes], [_waves(apart, length) for length in lengths]
    if left.any():
        bumps = left[:, None] * _bumps(grid)
        bumps = bumps[:, (bumps > LEAST_BUMP * mean.max(axis=1)[:, None, None]).any(axis=(0, 2))]
        functions.append(bumps)
        waves += [_waves(apart, LEFT_LENGTH_RAD)] * bumps.shape[1]
    functions.append(mean[:, None])
    waves.append(GAIN_SIGMA * _waves(apart, GAIN_LENGTH_RAD))
    return NodeAir(grid_m[0], grid_m[2], np.concatenate(functions, axis=1), tuple(waves))


def before_lowest_rad(height_m: FloatArray, mean: FloatArray) -> FloatArray:
    """Return how long before their lowest points lines end, as angles at the Earth's centre, shape (m, h).

    Parameters
    ----------
    height_m : ndarray, shape (h,)
        Of the lines' lowest points.
    mean : ndarray, shape (m, h)
        Profiles: light comes from where they have half of their largest value.
    """
    bright = mean >= 0.5 * mean.max(axis=1)[:, None]
    source_m = height_m[len(height_m) - 1 - np.argmax(bright[:, ::-1], axis=1)]
    return np.asarray(np.sqrt(np.maximum(2.0 * (source_m[:, None] - height_m) / EARTH_RADIUS_M, 0.0)))


def alike_at_ends(height_m: FloatArray, mean: FloatArray, correlation_rad: FloatArray) -> FloatArray:
    """Return how a mode where lines end is correlated with what it is at their lowest points, shape (m, k, h)."""
    away = before_lowest_rad(height_m, mean)
    return np.asarray(np.exp(-0.5 * (away[:, None] / correlation_rad[:, None]) ** 2))


def _waves(apart: FloatArray, length_rad: float) -> FloatArray:
    """Return the square root of a Gaussian covariance of squared distances (m, m), shape (m, j)."""
    variance, vectors = np.linalg.eigh(np.exp(-0.5 * apart / length_rad**2))
    variance, vectors = np.maximum(variance[::-1], 0.0), vectors[:, ::-1]
    # A sign of their own, so that the same unknowns mean nearly the same of nearly the same nodes.
    vectors = vectors * np.where(vectors[np.abs(vectors).argmax(axis=0), np.arange(len(vectors))] < 0.0, -1.0, 1.0)
    kept = int(np.searchsorted(np.cumsum(variance), (1.0 - LEFT_OUT) * variance.sum())) + 1
    return np.asarray(vectors[:, :kept] * np.sqrt(variance[:kept]))


def _bumps(grid: FloatArray) -> FloatArray:
    """Return cosines over height, shape (b, n), whose squares sum up to one."""
    middles = np.arange(*BUMP_HEIGHTS_M, BUMP_M)
    away = np.clip(np.abs(grid[None, :] - middles[:, None]) / BUMP_M, 0.0, 1.0)
    return np.asarray(np.cos(0.5 * np.pi * away))
