"""The air along a limb in view: profiles at nodes of azimuth, how modes vary between nodes, and the table they come
from.

**Modes.** The coefficient of a mode is along the limb a random function with the covariance of :mod:`..height`:
``exp(-d^2 / (2 l^2))`` for chords ``d`` of the unit sphere where the length ``l`` is constant. On the nodes it is ``V
diag(w) V^T``, and (Karhunen and Loeve) ::

    a_k(node j) = sum_i  z_i sqrt(w_i) V_ji,        z_i ~ N(0, 1)

Waves that hold less than :data:`LEFT_OUT` of a mode's variance are left out.

A line that passes at ``h``, below the height ``z`` from which the radiance comes, ends the angle ``d`` before its
lowest point. The air there is correlated with that at the lowest point by ``r``, so that a mode splits into two with
independent coefficients::

    a r f(h) + b (1 - r^2)^1/2 f(h),        d = (2 (z - h) / R)^1/2,        r = exp(-d^2 / (2 l^2))

with the length ``l`` along the line, and ``z`` the highest height at which the mean has half of its maximum. Two more
kinds of functions are added:

- the rest of the ensemble: bumps over height whose squares sum up to one, times ``left_sigma``, correlated along the
  limb over :data:`LEFT_LENGTH_RAD`;
- the gain of the optics, calibrated to :data:`GAIN_SIGMA`: the mean profile itself.

**Table.** Profiles are read at the location of the limb and its Sun. With the normal ``u`` of the ellipsoid beneath a
point of the limb, the (level) line of sight ``d`` to it and the Sun's direction ``s``: zenith angle ``acos(s . u)``,
azimuth from the line of sight ``atan2(s . (u x d), s . d)``.

The Sun's zenith angle at the observer follows from time and position, its azimuth from a Sun sensor, or else from the
attitude. A sensor whose Sun contradicts time and attitude is believed alone: the clock may be wrong.

The lowest point of a line ``h`` above the limb, turned outwards by ``b = h / l`` at the limb's distance ``l``, is
nearer by that angle. Sunlit tables are read at the lowest point of every line::

    u' = cos b u - sin b d,      d' = cos b d + sin b u
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.climate import month_of
from horizonval.estimation.fit.heights import correlations, everywhere, lengths_along
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.rotation import off_axis_angle

LEFT_OUT = 1e-4
"""Neglected share of a mode's variance: 1 % of its standard deviation. It moves the nadir by up to 0.03 of its sigma in
eleven frames, 1e-3 by up to 0.24."""
BUMP_M = 6e3
"""Spacing of bumps: the correlation height of clouds and layers."""
BUMP_HEIGHTS_M = (-15e3, 75e3)
"""Where bumps are: below a profile is smooth, above is too little light."""
LEAST_BUMP = 3e-3
"""Bump height, relative to the profile's maximum, below which a bump counts as pixel noise."""
LEAST_LEFT = 5e-5
"""Smallest residual sigma relative to the maximum: half a step of the tables' 8 bits."""
GAIN_SIGMA, GAIN_LENGTH_RAD = 0.01, 0.3
POLE_ITRS = np.array([0.0, 0.0, 1.0])
LEAST_APART = 0.15
"""Size, relative to a mode's standard deviation, below which its second part is neglected: it moves the nadir by 0.01
of its sigma."""
MAIN = ("limb", "end")
"""Kinds of the functions that move a limb most: modes at the lowest points and the ends of lines. They come first."""
LEFT_LENGTH_RAD = 0.1
"""Correlation length along the limb of what the modes leave: between clouds and air."""


@dataclass(frozen=True)
class NodeAir:
    """Profiles at m nodes along the limb of one image.

    ``bottom_m``, ``step_m``: first distance across the limb and step of the grid. ``functions``: shape (m, 1 + k, n),
    the mean and k functions added to it. ``names``: (kind, number) per added function, independent of nodes and grid.
    ``up_itrs``: shape (m, 3), unit vectors from the Earth's centre. ``lengths_rad``: shape (m, k, 2), correlation
    lengths along meridian and parallel. ``neglected``: shape (m, n), standard deviation of the neglected bumps.
    ``waves``: shape (m, j) per added function, its coefficient at the nodes per unit unknown (:func:`common_air`).
    """

    bottom_m: float
    step_m: float
    functions: FloatArray
    names: tuple[tuple[str, int], ...]
    up_itrs: FloatArray
    lengths_rad: FloatArray
    neglected: FloatArray
    waves: tuple[FloatArray, ...] = ()

    @property
    def few(self) -> NodeAir:
        """The same air with its modes alone."""
        count = sum(kind in MAIN for kind, _ in self.names)
        return replace(
            self,
            functions=self.functions[:, : 1 + count],
            names=self.names[:count],
            lengths_rad=self.lengths_rad[:, :count],
            waves=self.waves[:count],
        )

    @cached_property
    def wave(self) -> FloatArray:
        """All waves side by side, shape (m, count)."""
        return np.concatenate(self.waves, axis=1)

    @cached_property
    def function(self) -> NDArray[np.intp]:
        """Number of every unknown's function, from 0 without the mean, shape (count,)."""
        return np.repeat(np.arange(len(self.waves)), [wave.shape[1] for wave in self.waves])

    @cached_property
    def _starts(self) -> NDArray[np.intp]:
        return np.cumsum([0] + [wave.shape[1] for wave in self.waves[:-1]])

    def coefficients(self, unknowns: FloatArray) -> FloatArray:
        """Return the factors of the functions at the nodes, shape (m, 1 + k): 1 of the mean."""
        added = np.add.reduceat(self.wave * unknowns, self._starts, axis=1)
        return np.concatenate([np.ones((len(added), 1)), added], axis=1)


@dataclass(frozen=True)
class LimbNodes:
    """Where nodes are, ITRS: unit vectors up from the Earth's centre (m, 3), and along the lines of sight (m, 3)."""

    up_itrs: FloatArray
    los_itrs: FloatArray


def node_air(
    height_m: FloatArray,
    mean: FloatArray,
    modes: FloatArray,
    left_sigma: FloatArray,
    lengths_rad: FloatArray,
    places: LimbNodes,
    grid_m: tuple[float, float, float],
    curve: float,
) -> NodeAir:
    """Return the air at the nodes.

    ``height_m``: shape (h,); ``mean``, ``left_sigma``: shape (m, h); ``modes``: shape (m, k, h); ``lengths_rad``: shape
    (m, k, 2), along meridian and parallel; ``grid_m``: first and last distance across the limb
    (:func:`.ray_height.level_distance`) and the step, over which profiles are averaged; ``curve``: converts distances
    to heights. Radiance is zero above the table and constant below it.
    """
    count = int(np.ceil((grid_m[1] - grid_m[0]) / grid_m[2])) + 1
    even_borders = grid_m[0] + (np.arange(count + 1) - 0.5) * grid_m[2]
    borders = np.asarray(even_borders - curve * even_borders**2)
    grid = 0.5 * (borders[1:] + borders[:-1])
    to_grid = _means(height_m, borders)

    def even(values: FloatArray) -> FloatArray:
        return np.asarray((to_grid @ values.reshape(-1, len(height_m)).T).T.reshape(*values.shape[:-1], count))

    along = lengths_along(lengths_rad, places.up_itrs, places.los_itrs, POLE_ITRS)
    alike = alike_at_ends(height_m, mean, along)
    elsewhere = np.sqrt(1.0 - alike**2)
    inside = (height_m > grid_m[0]) & (height_m < grid_m[1])
    second = np.flatnonzero((elsewhere[:, :, inside] > LEAST_APART).any(axis=(0, 2)))
    modes = np.concatenate([modes * alike, (modes * elsewhere)[:, second]], axis=1)
    mean, modes, left = even(mean), even(modes), even(left_sigma)
    functions = [mean[:, None], modes]
    lengths = [lengths_rad, lengths_rad[:, second]]
    names = [("limb", i) for i in range(lengths_rad.shape[1])] + [("end", int(i)) for i in second]
    neglected = np.zeros_like(left)
    if left.any():
        brightest = mean.max(axis=1)[:, None]
        shapes = _bumps(grid)
        bumps = left[:, None] * shapes
        kept = np.flatnonzero((bumps > LEAST_BUMP * brightest[:, None]).any(axis=(0, 2)))
        bumps = bumps[:, kept]
        above = np.maximum(1.0 - np.sum(shapes[kept] ** 2, axis=0), 0.0) * (grid > BUMP_HEIGHTS_M[0] + BUMP_M)
        neglected = np.maximum(left, LEAST_LEFT * brightest) * np.sqrt(above)
        functions.append(bumps)
        names += [("bump", int(i)) for i in kept]
        lengths.append(everywhere(np.full(len(kept), LEFT_LENGTH_RAD), len(mean)))
    functions.append(GAIN_SIGMA * mean[:, None])
    names.append(("gain", 0))
    lengths.append(everywhere([GAIN_LENGTH_RAD], len(mean)))
    return NodeAir(
        grid_m[0],
        grid_m[2],
        np.concatenate(functions, axis=1),
        tuple(names),
        places.up_itrs,
        np.concatenate(lengths, axis=1),
        neglected,
    )


def before_lowest_rad(height_m: FloatArray, mean: FloatArray) -> FloatArray:
    """Return how far before their lowest points lines end, as angles at the Earth's centre, shape (m, h).

    Light comes from where the profile ``mean``, shape (m, h), has half of its maximum.
    """
    bright = mean >= 0.5 * mean.max(axis=1)[:, None]
    source_m = height_m[len(height_m) - 1 - np.argmax(bright[:, ::-1], axis=1)]
    return np.asarray(np.sqrt(np.maximum(2.0 * (source_m[:, None] - height_m) / MEAN_RADIUS_M, 0.0)))


def alike_at_ends(height_m: FloatArray, mean: FloatArray, along_rad: FloatArray) -> FloatArray:
    """Return correlations (m, k, h) of modes between a line's end and lowest point; ``along_rad`` is (m, k)."""
    away = before_lowest_rad(height_m, mean)
    return np.asarray(np.exp(-0.5 * (away[:, None] / along_rad[:, :, None]) ** 2))


def waves_of(covariances: FloatArray) -> list[FloatArray]:
    """Return the square roots (m, j) of covariances (k, m, m), each with as many columns as it needs."""
    found = []
    for variances, vectors in zip(*np.linalg.eigh(covariances), strict=True):
        falling = np.maximum(variances[::-1], 0.0)
        count = int(np.searchsorted(np.cumsum(falling), (1.0 - LEFT_OUT) * falling.sum())) + 1
        found.append(np.asarray(vectors[:, ::-1][:, :count] * np.sqrt(falling[:count])))
    return found


@dataclass(frozen=True)
class CommonAir:
    """The air of all images of a shot.

    ``images``: air of each, with the common waves at its nodes; ``columns``: indices of each image's unknowns among the
    common ones; ``count``: number of these.
    """

    images: Sequence[NodeAir]
    columns: Sequence[NDArray[np.intp]]
    count: int

    @cached_property
    def few(self) -> CommonAir:
        """The same air with its modes alone, whose unknowns are the first ones; all of a table without modes."""
        images = [air.few for air in self.images]
        if not all(air.names for air in images):
            return self
        columns = [at[: air.wave.shape[1]] for air, at in zip(images, self.columns, strict=True)]
        return CommonAir(images, columns, 1 + max(int(at.max()) for at in columns))


def common_air(airs: Sequence[NodeAir], tables: Sequence[Hashable]) -> CommonAir:
    """Combine the air of all images; those with equal ``tables`` share their functions, but for the optics' gain."""
    places: dict[Hashable, list[tuple[int, int]]] = {}
    for main in (True, False):
        for image, (air, table) in enumerate(zip(airs, tables, strict=True)):
            for k, name in enumerate(air.names):
                if (name[0] in MAIN) == main:
                    places.setdefault((image if name[0] == "gain" else table, name), []).append((image, k))
    # Functions of one length vary along the limb in the same way.
    lengths = [np.concatenate([airs[i].lengths_rad[:, k] for i, k in of_one]) for of_one in places.values()]
    keys = [(tuple(i for i, _ in of_one), one.tobytes()) for of_one, one in zip(places.values(), lengths, strict=True)]
    roots: dict[tuple[tuple[int, ...], bytes], FloatArray] = {}
    for seen_by in {images for images, _ in keys}:
        different = {key: one for key, one in zip(keys, lengths, strict=True) if key[0] == seen_by}
        up = np.concatenate([airs[i].up_itrs for i in seen_by])
        covariances = correlations(np.stack(list(different.values()), axis=1), up, POLE_ITRS)
        roots |= zip(different, waves_of(covariances), strict=True)
    waves: list[dict[int, FloatArray]] = [{} for _ in airs]
    columns: list[dict[int, NDArray[np.intp]]] = [{} for _ in airs]
    count = 0
    for of_one, key in zip(places.values(), keys, strict=True):
        wave, first = roots[key], 0
        for i, k in of_one:
            last = first + len(airs[i].up_itrs)
            waves[i][k], columns[i][k] = wave[first:last], count + np.arange(wave.shape[1])
            first = last
        count += wave.shape[1]
    images = [
        replace(air, waves=tuple(own[k] for k in range(len(air.names)))) for air, own in zip(airs, waves, strict=True)
    ]
    return CommonAir(images, [np.concatenate([own[k] for k in range(len(own))]) for own in columns], count)


def _means(height_m: FloatArray, borders: FloatArray) -> csr_array:
    """Return the matrix (n, h) that averages values at heights (h,), linear between, over n intervals."""
    low, high = min(borders[0], height_m[0]) - 1.0, max(borders[-1], height_m[-1]) + 2.0
    known = np.concatenate([[low], height_m, [height_m[-1] + 1.0, high]])
    i = np.clip(np.searchsorted(known, borders, side="right") - 1, 0, len(known) - 2)
    into = borders - known[i]
    share = into / (known[i + 1] - known[i])
    values = np.zeros((len(known), len(height_m)))
    values[1:-2] = np.eye(len(height_m))
    values[0, 0] = 1.0
    parts = 0.5 * (values[1:] + values[:-1]) * np.diff(known)[:, None]
    whole = np.concatenate([np.zeros((1, len(height_m))), np.cumsum(parts, axis=0)])
    before = whole[i] + into[:, None] * (
        values[i] * (1.0 - 0.5 * share)[:, None] + values[i + 1] * 0.5 * share[:, None]
    )
    return csr_array(np.diff(before, axis=0) / np.diff(borders)[:, None])


def _bumps(grid: FloatArray) -> FloatArray:
    """Return cosines over height, shape (b, n), whose squares sum up to one."""
    middles = np.arange(*BUMP_HEIGHTS_M, BUMP_M)
    away = np.clip(np.abs(grid[None, :] - middles[:, None]) / BUMP_M, 0.0, 1.0)
    return np.asarray(np.cos(0.5 * np.pi * away))


FARTHEST_RAD, STEPS = 0.25, 6
"""Largest distance of line ends before their lowest points, and the number of positions up to there at which tables are
read. Deeper lines, with lowest points 160 km below the source of their light, use the last."""
CONTRADICTED = 5.0
"""Standard deviations: chance is as far off in both axes once in 270 000, exp(-5^2 / 2)."""
LEAST_LEVEL = 1e-9
"""Smallest horizontal part of the Sun's direction; a Sun straight above or below has no azimuth."""
SUNLIT_M = np.linspace(-20e3, 80e3, 6)
"""Heights at which sunlit tables are read for the Sun's angles at the lowest point; between them radiance is linear.
The Sun's angles change by at most 0.8 deg from one to the next (200 km)."""


class KnownAir:
    """The air of a table at one time, under one Sun.

    ``sun_cam``: shape (3,), from a Sun sensor; ``sun_itrs``: shape (3,), from the time, or None if only the sensor is
    believed (:func:`sun_of_time`). At least one is given.
    """

    def __init__(
        self, templates: LimbTemplates, epoch_utc: datetime, sun_cam: FloatArray | None, sun_itrs: FloatArray | None
    ) -> None:
        self._templates, self._epoch = templates, epoch_utc
        self._sun_cam, self._sun_itrs = sun_cam, sun_itrs

    @property
    def heights_m(self) -> tuple[float, float]:
        """First and last height of the table."""
        height = self._templates.height_m
        return float(height[0]), float(height[-1])

    def nodes(
        self,
        normal_cam: FloatArray,
        los_cam: FloatArray,
        pose: LimbPose,
        grid_m: tuple[float, float, float],
        curve: float,
    ) -> NodeAir:
        """Return the air at places along the limb; parameters as for ``ProfileKnowledge.air``."""
        table = self._templates
        first, second = self._place(normal_cam, los_cam, pose)
        mean, modes, left = table.at(first, second)
        if table.band_kind == "thermal":
            mean = self._where_lines_end(mean, normal_cam, los_cam, pose)
        else:
            mean = self._under_own_sun(normal_cam, los_cam, pose, curve)
        places = LimbNodes(normal_cam @ pose.cam_from_itrs, los_cam @ pose.cam_from_itrs)
        return node_air(table.height_m, mean, modes, left, table.lengths_at(first), places, grid_m, curve)

    def _where_lines_end(
        self, mean: FloatArray, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose
    ) -> FloatArray:
        """Return means (m, h), each height from the latitude where its line ends; sunlit tables have no positions."""
        height = self._templates.height_m
        away = before_lowest_rad(height, mean)
        steps = np.linspace(0.0, FARTHEST_RAD, STEPS)
        ends = [np.cos(step) * normal_cam - np.sin(step) * los_cam for step in steps]
        at = np.array([self._templates.mean_at(*self._place(end, los_cam, pose)) for end in ends])
        place = np.minimum(away / steps[1], STEPS - 1.001)
        first = place.astype(np.intp)
        share = place - first
        node, row = np.indices(mean.shape)
        return np.asarray(at[first, node, row] * (1.0 - share) + at[first + 1, node, row] * share)

    def _under_own_sun(self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose, curve: float) -> FloatArray:
        """Return means (m, h), every height's under the Sun of its own line's lowest point."""
        turn = SUNLIT_M * np.sqrt(2.0 * curve / MEAN_RADIUS_M)
        cosine, sine = np.cos(turn)[:, None, None], np.sin(turn)[:, None, None]
        normal, los = cosine * normal_cam - sine * los_cam, cosine * los_cam + sine * normal_cam
        means = self._templates.mean_at(*self._place(normal.reshape(-1, 3), los.reshape(-1, 3), pose))
        all_of_them = means.reshape(len(turn), len(normal_cam), -1)
        place = np.interp(self._templates.height_m, SUNLIT_M, np.arange(len(SUNLIT_M)))
        first = np.minimum(place.astype(np.intp), len(SUNLIT_M) - 2)
        share, row = place - first, np.arange(len(place))
        return np.asarray(
            all_of_them[first, :, row] * (1.0 - share)[:, None] + all_of_them[first + 1, :, row] * share[:, None]
        ).T

    def means(self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose, height_m: FloatArray) -> FloatArray:
        """Return the mean profiles at places (m, 3) on heights (n,), shape (m, n); above the table nothing."""
        known = self._templates.height_m
        mean = self._templates.mean_at(*self._place(normal_cam, los_cam, pose))
        return np.array([np.interp(height_m, known, row, right=0.0) for row in mean])

    def _place(
        self, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose
    ) -> tuple[FloatArray, FloatArray | float]:
        """Return where places along the limb lie in the table, as :meth:`.LimbTemplates.at` takes them."""
        if self._templates.band_kind == "thermal":
            latitude = np.arcsin(np.clip(normal_cam @ pose.cam_from_itrs[:, 2], -1.0, 1.0))
            return latitude, month_of(self._epoch)
        sun = self._towards_sun(pose)
        zenith = np.arccos(np.clip(normal_cam @ sun, -1.0, 1.0))
        azimuth = np.arctan2(np.cross(normal_cam, los_cam) @ sun, los_cam @ sun)
        return zenith, azimuth

    def _towards_sun(self, pose: LimbPose) -> FloatArray:
        """Return the direction of the Sun in camera axes, shape (3,)."""
        if self._sun_itrs is None:
            assert self._sun_cam is not None
            return self._sun_cam
        if self._sun_cam is None:
            return np.asarray(pose.cam_from_itrs @ self._sun_itrs)
        nadir = pose.nadir_cam
        down = -float(self._sun_itrs @ pose.r_itrs) / float(np.linalg.norm(pose.r_itrs))
        level = self._sun_cam - float(self._sun_cam @ nadir) * nadir
        size = max(float(np.linalg.norm(level)), LEAST_LEVEL)
        return np.asarray(down * nadir + np.sqrt(max(1.0 - down**2, 0.0)) * level / size)


def sun_of_time(
    sun_itrs: FloatArray, sun_cam: FloatArray | None, cam_from_itrs: FloatArray, sigma_rad: float
) -> FloatArray | None:
    """Return the Sun's direction from the time, or None if a sensor contradicts it.

    ``sun_itrs``, ``sun_cam``: shape (3,), from time and sensor (optional); ``cam_from_itrs``: shape (3, 3), known
    attitude; ``sigma_rad``: standard deviation of the angle between both, from attitude and sensor.
    """
    if sun_cam is None or float(off_axis_angle(sun_cam, cam_from_itrs @ sun_itrs)) <= CONTRADICTED * sigma_rad:
        return sun_itrs
    return None
