r"""Straight rays through a spherical shell from every height in every direction: the fixed geometry of skylight.

A ray from radius ``r0`` with the cosine ``mu`` of its angle to the zenith depends on neither the Sun nor the azimuth,
so that its nodes, extinction and slopes are found once. With the impact parameter ``b = r0 sqrt(1 - mu^2)`` and a ray
parameter y::

    r = r_b + D y^2,       s = +-sqrt((r_b - b + D y^2) (r + b)),       ds/dy = 2 r D y / s

    up        mu >= 0           r_b = r0, D = r_top - r0, y from 0 to 1
    limb      mu_h < mu < 0     r_b = b,  D = r_top - b,  y from -sqrt((r0 - b) / D) to 1
    ground    mu <= mu_h        r_b = R,  D = r0 - R,     y from -1 to 0

``s`` is counted from the point nearest to the centre. The form is regular at tangent points and dense where the air is.
``r_b - b`` is carried on its own (``r0 mu^2 / (1 + sqrt(1 - mu^2))`` for rays going up): the difference of the two
radii cancels for level rays. ``mu_h`` is the cosine of the geometric horizon; directions are split there, cubed above
it and squared below, because the sky changes fastest just above the horizon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray


@dataclass(frozen=True)
class ShellRays:
    """Rays from ``n_r`` radii in ``n_d`` polar directions with ``n_n`` nodes each.

    Attributes
    ----------
    radius_m : ndarray, shape (n_r,)
    cosine : ndarray, shape (n_r, n_d)
        Of the directions' angle to the zenith.
    solid_angle : ndarray, shape (n_r, n_d)
        Weight of a direction, per radian of azimuth.
    reaches_ground : ndarray of bool, shape (n_r, n_d)
    end_m, end_transmittance : ndarray, shape (n_r, n_d)
        Distance and transmittance to the end of the ray (ground or top).
    node_radius_m, node_distance_m, node_up, node_weight : ndarray, shape (n_r, n_d, n_n)
        Radius, distance from the origin, cosine of the ray's angle to the zenith there, and the weight of emission per
        metre there: the step times the transmittance from the origin.
    """

    radius_m: FloatArray
    cosine: FloatArray
    solid_angle: FloatArray
    reaches_ground: NDArray[np.bool_]
    end_m: FloatArray
    end_transmittance: FloatArray
    node_radius_m: FloatArray
    node_distance_m: FloatArray
    node_up: FloatArray
    node_weight: FloatArray


def polar_directions(height_m: FloatArray, planet_m: float, n_up: int, n_down: int) -> tuple[FloatArray, FloatArray]:
    """Return cosines and weights of polar directions, shape (n_r, n_up + n_down), from just above the horizon on."""
    horizon = -np.sqrt(height_m * (2 * planet_m + height_m)) / (planet_m + height_m)
    x, w = (v / 2 for v in np.polynomial.legendre.leggauss(n_up))
    x = x + 0.5
    above = horizon[:, None] + (1 - horizon[:, None]) * x**3
    above_weight = (1 - horizon[:, None]) * 3 * x**2 * w
    x, w = (v / 2 for v in np.polynomial.legendre.leggauss(n_down))
    x = x + 0.5
    below = horizon[:, None] - (1 + horizon[:, None]) * x**2
    below_weight = (1 + horizon[:, None]) * 2 * x * w
    return np.concatenate([above, below], axis=1), np.concatenate([above_weight, below_weight], axis=1)


def shell_rays(
    altitude_m: FloatArray,
    extinction_per_m: FloatArray,
    planet_m: float,
    height_m: FloatArray,
    n_up: int,
    n_down: int,
    n_nodes: int,
    bands: Sequence[tuple[float, float]] = (),
) -> ShellRays:
    """Return the rays of a shell with extinction linear in altitude.

    Parameters
    ----------
    altitude_m, extinction_per_m : ndarray, shape (n,)
        From the ground to the top.
    planet_m : float
        Radius of the ground.
    height_m : ndarray, shape (n_r,)
        Where rays start, the ground included.
    n_up, n_down, n_nodes : int
        Directions above and below the horizon, nodes on every ray; with ``bands`` about twice as many.
    bands : sequence of (float, float)
        Heights of sharp layers, rising: rays are cut at their edges, and every piece has nodes of its own.
    """
    top = planet_m + altitude_m[-1]
    cosine, solid_angle = polar_directions(height_m, planet_m, n_up, n_down)
    mu = cosine
    r0 = np.broadcast_to((planet_m + height_m)[:, None], mu.shape)
    impact = r0 * np.sqrt(1 - mu**2)
    up = mu >= 0
    ground = np.broadcast_to(np.arange(mu.shape[1]) >= n_up, mu.shape)
    base = np.where(up, r0, np.where(ground, planet_m, impact))
    gap = np.where(up, r0 * mu**2 / (1 + np.sqrt(1 - mu**2)), np.where(ground, planet_m - impact, 0.0))
    depth = np.where(ground, r0 - planet_m, top - base)
    limb_start = -np.sqrt(np.maximum(r0 - impact, 0.0) / np.maximum(top - impact, 1e-9))
    y0 = np.where(up, 0.0, np.where(ground, -1.0, limb_start))
    y1 = np.where(ground, 0.0, 1.0)

    def place(y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return radius, distance from the lowest point and ds/dy; ``y`` has one axis more than the directions."""
        b, g, d = impact[..., None], gap[..., None], depth[..., None]
        r = base[..., None] + d * y**2
        s_abs = np.sqrt(np.maximum((g + d * y**2) * (r + b), 0.0))
        slope = np.where(s_abs > 0, 2 * r * d * np.abs(y) / np.where(s_abs > 0, s_abs, 1.0), 0.0)
        # level rays at y = 0: the limit of the quotient
        slope = np.where((s_abs <= 0) & (g == 0), 2 * r * np.sqrt(d / (r + b)), slope)
        return r, np.where((y < 0) | ground[..., None], -s_abs, s_abs), slope

    def extinction(r: FloatArray) -> FloatArray:
        return np.interp(r - planet_m, altitude_m, extinction_per_m)

    edge_m = [height for band in bands for height in band]
    reach = [np.sqrt(np.maximum(planet_m + height - base, 0.0) / np.maximum(depth, 1e-9)) for height in edge_m]
    cuts = np.stack([y0, *(np.clip(-v, y0, y1) for v in reversed(reach)), *(np.clip(v, y0, y1) for v in reach), y1], -1)
    pieces = cuts.shape[-1] - 1
    x, w = np.polynomial.legendre.leggauss(n_nodes if pieces == 1 else -(-2 * n_nodes // pieces))
    halves = 0.5 * np.diff(cuts, axis=-1)
    inner = 0.5 * (cuts[..., 1:] + cuts[..., :-1])[..., None] + halves[..., None] * x
    edges = np.concatenate([cuts[..., :-1, None], inner], axis=-1).reshape(*mu.shape, -1)
    edges = np.concatenate([edges, y1[..., None]], axis=-1)
    y, half, w = inner.reshape(*mu.shape, -1), np.repeat(halves, len(x), axis=-1), np.tile(w, pieces)
    tau = np.cumsum(_optical_depth(edges, place, extinction), axis=-1)
    end_tau = tau[..., -1]
    tau = tau[..., np.arange(tau.shape[-1]) % (len(x) + 1) != len(x)]
    r, s, slope = place(y)
    start = place(y0[..., None])[1]
    # a ray straight up from the ground has s = r0 mu at its start, not 0
    start = np.where(up[..., None], (r0 * mu)[..., None], start)
    weight = w * half * slope * np.exp(-tau)
    end = place(y1[..., None])[1] - start
    return ShellRays(
        planet_m + height_m,
        cosine,
        solid_angle,
        ground,
        end[..., 0],
        np.exp(-end_tau),
        r,
        s - start,
        s / r,
        weight,
    )


def _optical_depth(
    edges: FloatArray,
    place: Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
    extinction: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return the optical depth between neighbouring edges, two 4-point Gauss rules each."""
    x, w = np.polynomial.legendre.leggauss(4)
    x = np.concatenate([0.25 + 0.25 * x, 0.75 + 0.25 * x])
    w = np.concatenate([w, w]) / 4
    low, width = edges[..., :-1, None], np.diff(edges, axis=-1)[..., None]
    y = low + width * x
    shape = y.shape
    r, _, slope = place(y.reshape(*shape[:-2], -1))
    return np.sum((extinction(r) * slope).reshape(shape) * width * w, axis=-1)
