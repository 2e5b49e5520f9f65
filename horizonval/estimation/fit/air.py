"""The air along a limb in view: profiles at nodes of azimuth, how modes vary between nodes, and the table they come
from.

**Modes.** The coefficient of a mode is along the limb a random function with the covariance of :mod:`.heights`:
``exp(-d^2 / (2 l^2))`` for chords ``d`` of the unit sphere where the length ``l`` is constant. On the nodes it is ``V
diag(w) V^T``, and (Karhunen and Loeve) ::

    a_k(node j) = sum_i  z_i sqrt(w_i) V_ji,        z_i ~ N(0, 1)

A line that passes at ``h``, below the height ``z`` from which the radiance comes, ends the angle ``e`` before its
lowest point. The air there is correlated with that at the lowest point by ``r``, so that a mode ``f`` of the air splits
into two with independent coefficients; of clouds and ground the second is neglected::

    a r f(h) + b (1 - r^2)^1/2 f(h),        e = (2 (z - h) / R)^1/2,        r = exp(-e^2 / (2 l^2))

with the length ``l`` along the line, and ``z`` the highest height at which the mean has half of its maximum. Waves that
hold less than :data:`LEFT_OUT` of a mode's variance are left out. One more function is the gain of the optics,
calibrated to :data:`GAIN_SIGMA`: the mean profile itself. What the modes leave of the ensemble is noise of the pixels,
common to those within :data:`LEFT_M` of height and :data:`LEFT_LENGTH_RAD` along the limb.

**Table.** Profiles are read at the location of the limb and its Sun. With the normal ``u`` of the ellipsoid beneath a
point of the limb, the (level) line of sight ``d`` to it and the Sun's direction ``s``: zenith angle ``acos(s . u)``,
azimuth from the line of sight ``atan2(s . (u x d), s . d)``. The Sun's zenith angle at the observer follows from time
and position, its azimuth from a Sun sensor, or else from the attitude.

The mean at each height is read at the point of its line that decides it, the angle ``b`` nearer to the camera::

    u' = cos b u - sin b d,      d' = cos b d + sin b u

In a sunlit band it is the lowest point: a line ``h`` above the limb at the distance ``l`` has ``b = h / l``. In a
thermal band it is the end of the line, ``b = e``.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.climate import month_of
from horizonval.estimation.fit.heights import correlations, everywhere, lengths_along
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.estimation.prior import MEAN_RADIUS_M

LEFT_OUT = 1e-4
"""Neglected share of a mode's variance: 1 % of its standard deviation. It moves the nadir by up to 0.03 of its sigma in
eleven frames, 1e-3 by up to 0.24."""
LEFT_M, LEFT_LENGTH_RAD = 6e3, 0.1
"""Correlation height and length along the limb of what the modes leave, between the values of clouds and of air."""
GAIN_SIGMA, GAIN_LENGTH_RAD = 0.01, 0.3
"""Standard deviation of the optics' gain along the limb, relative, and its correlation length."""
POLE_ITRS = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class NodeAir:
    """Profiles at m nodes along the limb of one image.

    ``bottom_m``, ``step_m``: first distance across the limb and step of the grid. ``functions``: shape (m, 1 + k, n),
    the mean and k functions added to it, of which the last is the gain. ``up_itrs``: shape (m, 3), unit vectors from
    the Earth's centre. ``lengths_rad``: shape (m, k, 2), correlation lengths along meridian and parallel. ``left``:
    shape (m, n), standard deviation of what the functions leave. ``waves``: shape (m, j) per added function, its
    coefficient at the nodes per unit unknown (:func:`common_air`).
    """

    bottom_m: float
    step_m: float
    functions: FloatArray
    up_itrs: FloatArray
    lengths_rad: FloatArray
    left: FloatArray
    waves: tuple[FloatArray, ...] = ()

    @cached_property
    def wave(self) -> FloatArray:
        """All waves side by side, shape (m, count)."""
        return np.concatenate(self.waves, axis=1)

    @cached_property
    def function(self) -> NDArray[np.intp]:
        """Number of every unknown's function, from 0 without the mean, shape (count,)."""
        return np.repeat(np.arange(len(self.waves)), [wave.shape[1] for wave in self.waves])

    def coefficients(self, unknowns: FloatArray) -> FloatArray:
        """Return the factors of the functions at the nodes, shape (m, 1 + k): 1 of the mean."""
        starts = np.searchsorted(self.function, np.arange(len(self.waves)))
        added = np.add.reduceat(self.wave * unknowns, starts, axis=1)
        return np.concatenate([np.ones((len(added), 1)), added], axis=1)


def line_ends_rad(height_m: FloatArray, mean: FloatArray) -> FloatArray:
    """Return how far before their lowest points lines end, as angles at the Earth's centre, shape (m, h).

    Light comes from where the profile ``mean``, shape (m, h), has half of its maximum.
    """
    bright = mean >= 0.5 * mean.max(axis=1)[:, None]
    source_m = height_m[len(height_m) - 1 - np.argmax(bright[:, ::-1], axis=1)]
    return np.asarray(np.sqrt(np.maximum(2.0 * (source_m[:, None] - height_m) / MEAN_RADIUS_M, 0.0)))


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


def common_air(airs: Sequence[NodeAir], tables: Sequence[Hashable]) -> CommonAir:
    """Combine the air of all images; those with equal ``tables`` share their functions, but for the optics' gain."""
    shared: dict[Hashable, list[tuple[int, int]]] = {}
    for image, (air, table) in enumerate(zip(airs, tables, strict=True)):
        gain = air.lengths_rad.shape[1] - 1
        for k in range(gain + 1):
            shared.setdefault(("gain", image) if k == gain else (table, k), []).append((image, k))
    by_images: dict[tuple[int, ...], list[list[int]]] = {}
    for places in shared.values():
        by_images.setdefault(tuple(image for image, _ in places), []).append([k for _, k in places])
    waves: list[dict[int, FloatArray]] = [{} for _ in airs]
    columns: list[dict[int, NDArray[np.intp]]] = [{} for _ in airs]
    count = 0
    for images, functions in by_images.items():
        up = np.concatenate([airs[i].up_itrs for i in images])
        borders = np.cumsum([len(airs[i].up_itrs) for i in images])[:-1]
        lengths = [
            np.concatenate([airs[i].lengths_rad[:, k] for i, k in zip(images, of_one, strict=True)])
            for of_one in functions
        ]
        for of_one, wave in zip(
            functions, waves_of(correlations(np.stack(lengths, axis=1), up, POLE_ITRS)), strict=True
        ):
            for i, k, part in zip(images, of_one, np.split(wave, borders), strict=True):
                waves[i][k], columns[i][k] = part, count + np.arange(wave.shape[1])
            count += wave.shape[1]
    images_air = [replace(air, waves=tuple(own[k] for k in sorted(own))) for air, own in zip(airs, waves, strict=True)]
    return CommonAir(images_air, [np.concatenate([own[k] for k in sorted(own)]) for own in columns], count)


def _means(height_m: FloatArray, values: FloatArray, borders: FloatArray) -> FloatArray:
    """Return the means of values (..., h), linear between heights, over n intervals, shape (..., n).

    Values are constant below the first height and zero above the last.
    """
    integral = make_interp_spline(height_m, np.moveaxis(values, -1, 0), k=1).antiderivative()
    whole = np.moveaxis(integral(np.clip(borders, height_m[0], height_m[-1])), 0, -1)
    whole += np.minimum(borders - height_m[0], 0.0) * values[..., :1]
    return np.asarray(np.diff(whole, axis=-1) / np.diff(borders))


class KnownAir:
    """The air of a table at one time, under one Sun.

    ``sun_cam``: shape (3,), from a Sun sensor; ``sun_itrs``: shape (3,), from the time, or None if only the sensor is
    believed. At least one is given.
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
        """Return the air at places along the limb.

        ``normal_cam``, ``los_cam``: shape (m, 3), normals of the ellipsoid and lines of sight; ``grid_m``: first and
        last distance across the limb (:func:`.profile_pixels.level_distance`) and the step, over which profiles are
        averaged; ``curve``: converts distances to heights.
        """
        table = self._templates
        first, second = self._place(normal_cam, los_cam, pose)
        mean, modes, left = table.at(first, second)
        up, level = normal_cam @ pose.cam_from_itrs, los_cam @ pose.cam_from_itrs
        lengths, ends = table.lengths_at(first), line_ends_rad(table.height_m, mean)
        along = lengths_along(lengths, up, level, POLE_ITRS)
        alike = np.exp(-0.5 * (ends[:, None] / along[:, :, None]) ** 2)
        air, modes = np.flatnonzero(np.array(table.mode_kinds) == "air"), modes * table.prior_sigmas
        modes = np.concatenate([modes * alike, (modes * np.sqrt(1.0 - alike**2))[:, air]], axis=1)
        if table.band_kind == "thermal":
            # Lines with lowest points 160 km below the source of their light, and deeper, end as far away.
            nearer = np.minimum(ends, 0.25)
        else:
            nearer = np.broadcast_to(
                np.clip(table.height_m, -20e3, 80e3) * np.sqrt(2.0 * curve / MEAN_RADIUS_M), mean.shape
            )
        mean = self._nearer(nearer, normal_cam, los_cam, pose)
        count = int(np.ceil((grid_m[1] - grid_m[0]) / grid_m[2])) + 1
        borders = grid_m[0] + (np.arange(count + 1) - 0.5) * grid_m[2]
        parts = np.concatenate([mean[:, None], modes, GAIN_SIGMA * mean[:, None], left[:, None]], axis=1)
        parts = _means(table.height_m, parts, borders - curve * borders**2)
        lengths = np.concatenate([lengths, lengths[:, air], everywhere([GAIN_LENGTH_RAD], len(mean))], axis=1)
        return NodeAir(grid_m[0], grid_m[2], parts[:, :-1], up, lengths, parts[:, -1])

    def _nearer(
        self, nearer_rad: FloatArray, normal_cam: FloatArray, los_cam: FloatArray, pose: LimbPose
    ) -> FloatArray:
        """Return means (m, h), every height's from a point of its line nearer by an angle, shape (m, h)."""
        # From one to the next the Sun's angles change by at most 0.8 deg (200 km).
        steps = np.linspace(nearer_rad.min(), nearer_rad.max() + 1e-9, 6)
        means = []
        for step in steps:
            normal = np.cos(step) * normal_cam - np.sin(step) * los_cam
            los = np.cos(step) * los_cam + np.sin(step) * normal_cam
            means.append(self._templates.mean_at(*self._place(normal, los, pose)))
        place = (nearer_rad - steps[0]) / (steps[1] - steps[0])
        first = np.minimum(place.astype(np.intp), len(steps) - 2)
        before, after = (np.take_along_axis(np.array(means), first[None] + k, axis=0)[0] for k in (0, 1))
        return np.asarray(before + (place - first) * (after - before))

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
        # A Sun straight above or below has no azimuth.
        level /= max(float(np.linalg.norm(level)), 1e-9)
        return np.asarray(down * nadir + np.sqrt(max(1.0 - down**2, 0.0)) * level)
