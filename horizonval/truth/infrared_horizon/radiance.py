"""Radiance of the clear limb in a thermal band, integrated along exact rays.

With ``u`` of :mod:`horizonval.truth.infrared_horizon.rays` the optical depth of a g point is the integral of
``k (ds/du) du``, which is smooth. The path is cut at shells about 1 km apart; every piece has its depth ``D`` and its
mean source ``M = integral of S dtau / D`` by Simpson's rule in u. Within the piece the source is the parabola in tau
through its values ``S0`` and ``S1`` at the ends with that mean::

    integral of S exp(-tau) dtau = S0 (1 - b) + S1 (b - e) + (M - (S0 + S1)/2) 6 [(1 + e) - 2 b] / D,
    e = exp(-D),  b = (1 - e) / D

which is exact for thin pieces and tends to S0 for thick ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.truth.infrared_horizon.bent_rays import StraightHeights
from horizonval.truth.infrared_horizon.rays import RayPath

SHELL_M = 1000.0
"""Thickness of the shells from 17 to 60 km; half of it and a quarter below 17 and 8 km, where water vapour changes
fast, twice and four times it above 60 and 80 km."""

_THIN = 0.02
_OPAQUE = 80.0
_AZIMUTHS_AT_ONCE = 4
"""What is at hand for so many stays in a processor's cache: four fifths of the time of all at once."""


def shells_m(top_m: float, step_m: float = SHELL_M) -> FloatArray:
    """Return the heights [m] at which paths are cut, from 0 to ``top_m``."""
    parts = [
        np.arange(0.0, 8e3, 0.25 * step_m),
        np.arange(8e3, 17e3, 0.5 * step_m),
        np.arange(17e3, 60e3, step_m),
        np.arange(60e3, 80e3, 2.0 * step_m),
        np.arange(80e3, max(top_m, 80e3), 4.0 * step_m),
    ]
    shells = np.concatenate(parts)
    return np.append(shells[shells < top_m], top_m)


def layer_edges_m(band: EmittingBand, altitude_m: FloatArray) -> FloatArray:
    """Return the heights at which paths must be cut besides: where layers of thin cloud begin, bend and end."""
    inside = np.nonzero(band.layer_per_m.any(axis=0))[0] if len(band.layer_per_m) else np.zeros(0, dtype=np.intp)
    if not len(inside):
        return np.zeros(0)
    beside = np.concatenate([inside - 1, inside, inside + 1])
    return np.asarray(altitude_m[np.unique(np.clip(beside, 0, len(altitude_m) - 1))])


class BandMedium:
    """Extinction and source of one band, laid out for rays: g point last. ``heights``: None where no light is bent."""

    def __init__(self, band: EmittingBand, heights: StraightHeights | None = None) -> None:
        extinction, source = band.columns()
        self.altitude_m = band.altitude_m
        if heights is not None:
            self.altitude_m = heights.of(band.altitude_m)
            extinction = extinction * np.interp(band.altitude_m, heights.altitude_m, heights.stretch)
        self.sin_latitude = band.sin_latitude
        self.edges_m = layer_edges_m(band, self.altitude_m)
        self.column_map = band.column_map
        self.extinction = np.ascontiguousarray(np.moveaxis(extinction, 0, -1))
        self.source = np.ascontiguousarray(np.moveaxis(source, 0, -1))
        self._both = None if band.column_map is None else self._flat()

    @property
    def top_m(self) -> float:
        """Vacuum above."""
        return float(self.altitude_m[-1])

    @property
    def absorbs(self) -> bool:
        """Whether there is anything in it that a ray could notice."""
        return bool(self.extinction.max() > 1e-30)

    @property
    def is_uniform(self) -> bool:
        """Whether the air is the same everywhere."""
        return self.column_map is None and len(self.sin_latitude) == 1

    def along(self, path: RayPath, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return extinction and source at the points of rays, shape (azimuths, points, g); 1 azimuth if uniform."""
        height = np.maximum(path.lowest_m + u * u, 0.0)
        i = np.clip(np.searchsorted(self.altitude_m, height, side="right") - 1, 0, len(self.altitude_m) - 2)
        w = ((height - self.altitude_m[i]) / (self.altitude_m[i + 1] - self.altitude_m[i]))[:, None]
        if self.is_uniform:
            k, s = (c[:, i] * (1.0 - w) + c[:, i + 1] * w for c in (self.extinction, self.source))
            return k, s
        if self._both is not None:
            return self._on_the_map(path, u, i, w[:, 0])
        places = self._rows(path, u)
        corners = [(share[..., None] * v, j, level) for j, share in places for v, level in ((1.0 - w, i), (w, i + 1))]
        result = []
        for column in (self.extinction, self.source):
            value = np.zeros((*places[0][0].shape, column.shape[-1]))
            for weight, rows, levels in corners:
                value += weight * column[rows, levels]
            result.append(value)
        return result[0], result[1]

    def _rows(self, path: RayPath, u: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return the two rows of latitude about the points of rays, and their weights."""
        step = self.sin_latitude[1] - self.sin_latitude[0]
        row = np.clip((path.sine_at(u) - self.sin_latitude[0]) / step, 0.0, len(self.sin_latitude) - 1)
        j = np.minimum(row.astype(np.intp), len(self.sin_latitude) - 2)
        v = row - j
        return [(j, 1.0 - v), (j + 1, v)]

    def _flat(self) -> FloatArray:
        """Return extinction and source side by side, shape (columns x heights, 2 g)."""
        return np.concatenate([self.extinction, self.source], axis=-1).reshape(-1, 2 * self.source.shape[-1])

    def _on_the_map(self, path: RayPath, u: FloatArray, i: np.ndarray, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what :meth:`along` does; eight neighbours of each point by one product with a sparse matrix."""
        assert self._both is not None
        heights = len(self.altitude_m)
        index, weight = [], []
        for j, share in self._columns(path, u):
            index += [j * heights + i, j * heights + i + 1]
            weight += [share * (1.0 - w), share * w]
        shape = index[0].shape
        points = math.prod(shape)
        matrix = csr_array(
            (
                np.stack(weight, axis=-1).ravel(),
                np.stack(index, axis=-1).ravel(),
                np.arange(0, 8 * points + 1, 8),
            ),
            shape=(points, len(self._both)),
        )
        both = np.asarray(matrix @ self._both).reshape(*shape, -1)
        g = both.shape[-1] // 2
        return both[..., :g], both[..., g:]

    def _columns(self, path: RayPath, u: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return the four columns of a map about the points of rays, and their weights.

        Written anew from the map's definition: the truth knows where columns stand, not how others read them.
        """
        lattice = self.column_map
        assert lattice is not None
        normal = path.normal_at(u)
        along = normal @ lattice.axes.T
        plane = along[..., :2] / (1.0 + along[..., 2:])
        side = np.linspace(-lattice.half, lattice.half, lattice.count)
        plane = np.clip(plane, side[0], side[-1])
        low = np.clip(np.searchsorted(side, plane, side="right") - 1, 0, lattice.count - 2)
        share = (plane - side[low]) / (side[low + 1] - side[low])
        (i, j), (p, q) = np.moveaxis(low, -1, 0), np.moveaxis(share, -1, 0)
        return [
            ((j + b) * lattice.count + i + a, (p if a else 1.0 - p) * (q if b else 1.0 - q))
            for a in (0, 1)
            for b in (0, 1)
        ]


def limb_radiance(air: BandMedium, rays: Sequence[RayPath], *, step_m: float = SHELL_M) -> FloatArray:
    """Return the radiance [W m-2 sr-1], shape (azimuths, heights), of rays past the ground.

    Parameters
    ----------
    air : BandMedium
    rays : sequence of Course, length heights
        Lowest heights from 0 on; the camera is above the air.
    step_m : float
        Thickness of the shells; 1 km leaves 1e-4 of the plateau.
    """
    columns = []
    for path in rays:
        u = _cuts(path, path.lowest_m, step_m, air.edges_m)
        u = np.concatenate([-u[:0:-1], u])
        parts = [_integrate(air, few, u)[0].sum(axis=-1) for few in path.parts(_AZIMUTHS_AT_ONCE)]
        columns.append(np.concatenate(parts))
    return np.stack(columns, axis=-1)


def ground_ray(air: BandMedium, path: RayPath, *, step_m: float = SHELL_M) -> tuple[FloatArray, FloatArray]:
    """Return path radiance [W m-2 sr-1] and transmission to the ground, shapes (azimuths, g).

    The rays' lowest height is negative: the depth of the chord.
    """
    return _integrate(air, path, -_cuts(path, 0.0, step_m, air.edges_m)[::-1])


def _cuts(path: RayPath, start_m: float, step_m: float, edges_m: FloatArray) -> FloatArray:
    """Return u at the shells between ``start_m`` and the top, with the middles (in u) between: odd in number."""
    shells = shells_m(path.top_m, step_m)
    # Most of the air on a ray lies just above its lowest point. Shells of the same thickness there for all rays keep
    # their errors alike, which the slope of a profile needs more than its value.
    near = 0.5 * step_m * np.ceil(start_m / (0.5 * step_m)) + np.arange(8) * 0.5 * step_m
    shells = np.union1d(shells, near[near < path.top_m])
    shells = np.union1d(shells, edges_m[edges_m < path.top_m])
    # A sliver of a shell costs as much as a whole one.
    sliver = 0.05 * step_m if not len(edges_m) else 1.0
    ends = np.append(start_m, shells[shells > start_m + sliver])
    u = np.sqrt(ends - path.lowest_m)
    both = np.empty(2 * len(u) - 1)
    both[::2] = u
    both[1::2] = 0.5 * (u[1:] + u[:-1])
    return both


def _integrate(air: BandMedium, path: RayPath, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return radiance and transmission, shapes (azimuths, g), along ``u`` from the observer on."""
    k, source = air.along(path, u)
    slope = k * path.metres_per_u(u)[..., None]
    weighted = slope * source
    sixth = ((u[2::2] - u[:-2:2]) / 6.0)[:, None]
    depth = (slope[:, :-2:2] + 4.0 * slope[:, 1::2] + slope[:, 2::2]) * sixth
    mean = (weighted[:, :-2:2] + 4.0 * weighted[:, 1::2] + weighted[:, 2::2]) * sixth / np.maximum(depth, 1e-300)
    near, far = source[:, :-2:2], source[:, 2::2]
    depth = np.minimum(depth, _OPAQUE)
    e = np.exp(-depth)
    d = np.maximum(depth, _THIN)
    b = np.where(depth < _THIN, 1.0 - depth * (1 / 2 - depth * (1 / 6 - depth / 24)), (1.0 - e) / d)
    bulge = np.where(depth < _THIN, depth * (1.0 - depth * (1 / 2 - depth * 3 / 20)), 6.0 * (1.0 + e - 2.0 * b) / d)
    emitted = near * (1.0 - b) + far * (b - e) + (mean - 0.5 * (near + far)) * bulge
    behind = np.minimum(np.cumsum(depth, axis=1), 8.0 * _OPAQUE)
    before = np.exp(depth - behind)
    return (emitted * before).sum(axis=1), np.exp(-behind[:, -1])
