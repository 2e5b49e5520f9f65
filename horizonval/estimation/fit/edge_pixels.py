"""The pixels for a fit of the limb's edge, and the heights of the limb along it.

**Pixels.** Those within a window about the limb. Where they are more than the fit needs (:data:`MOST_PIXELS`), pixels
at one distance from the limb and near each other are replaced by their mean: cells are half a pixel deep at the edge
and wider beside it, and the variance of the distances in a cell is a part of its blur.

**Modes.** Along the limb the height differs from its mean by a random function of azimuth with the covariance ``K(phi)
= s^2 exp(-phi^2 / (2 l^2))`` (:mod:`horizonval.earth.limb_heights`). On ``m`` nodes ``K = V diag(w) V^T``, and
(Karhunen and Loeve) ::

    height(phi_j) = sum over modes of  z_i sqrt(w_i) V_ji,      z_i ~ N(0, 1)

The fit therefore knows which changes along the arc may not be taken for a tilt, and its covariance includes them. All
images of a shot have one such function, round the part of the horizon that they see together.

A sphere fitted to the oblate Earth has a second relief. The limb of a planet of flattening ``f`` differs from a
sphere's by ``-f R (u . pole)^2``, with ``u`` from the centre to the point of the limb; its covariance over all poles
(:mod:`horizonval.earth.limb_heights`) is added to ``K``.

Modes that together hold less than :data:`LEFT_OUT` of the variance are left out; between nodes the modes are linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, oblate_limbs
from horizonval.estimation.fit.edge import EdgeKnown, EdgeModel, EdgePixels
from horizonval.estimation.fit.heights import ArcPlaces
from horizonval.estimation.fit.image import LENS, POSE, Chosen, ShotState
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import (
    INSIDE_PX,
    OUTSIDE_PX,
    OUTSIDE_SCALES,
    LightNoise,
    from_widest_gap,
    sectors_of,
)
from horizonval.estimation.fit.pixels import (
    LimbAngle,
    gradient,
    image_scale,
    in_view,
    limb_angle,
    limb_bend,
    near_pixels,
    pixel_at_limb_m,
)
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import miscalibrated
from horizonval.estimation.limb.picture import rounding_variance
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import tangent_basis

BLURS = 3.0
"""Additional width of the window for a blurred limb, in blurs: half the width of the edge."""
SHARP_PX = 1.0
"""Blur from which the window grows."""
LARGEST_BLUR_PX = INSIDE_PX
"""Blur of an edge as wide as the window inside it: what is fitted there is no limb. Searches for a limb pass 6.7."""
FEWEST_LIMB_PX = 8
"""Smallest limb in view [px]: seven unknowns and a level."""
PLACES = 48
"""Places along the limb at which its bend and motion are evaluated: four to the wave of a pose's unknowns on a whole
disc, and more."""
SHORTEST_RAD = 0.05
"""Correlation length of cloud heights at the Earth's centre: 3 deg."""
MISPLACED_PX = 0.05
"""Standard deviation of the common displacement between real air's limb and an exponential: residuals of 0.01 to 0.05
of the step over a slope of 0.5 of the step per pixel. With equal pixels it acts as a height; with unequal ones it bends
the limb."""
DARKEST_SIGMA_RAD = 0.3
"""Standard deviation of the direction in which a disc is darkest, by a slope of a third of the levels' scatter."""
STEP_PX = 0.5
"""Step of the limb in the image for differences of the image scale, which changes over a hundred pixels."""
MOST_PIXELS = 4000
"""Number of pixels and cells of an image from which it is fitted by cells."""
CELL_PX, WIDE_CELL_PX, EDGE_PX = 0.5, 2.0, 4.0
"""Depth of cells at the edge and beside it, and how far the edge reaches. Half a pixel adds 0.02 px^2 to the blur's
0.6, and its fourth moment changes the edge by less than 1e-4 of the step."""


@dataclass(frozen=True)
class EdgeImage:
    """An image, its camera, and ``cam_from_body``, shape (3, 3).

    ``image``: shape (H, W), linear in radiance, NaN where it is not (saturated).
    """

    image: FloatArray
    camera: CameraModel
    cam_from_body: FloatArray


class EdgeChooser:
    """Chooses the pixels of all images of a shot.

    ``knowledge``: of the limb, in the axes of the body; ``whole``: share of the profile across the limb that must be in
    the picture; ``scaled``: whether the image scale follows pose and lens: a shift of the principal point and a turn
    move the limb alike, and differ by its change.
    """

    def __init__(
        self, images: Sequence[EdgeImage], knowledge: LimbKnowledge, whole: float = 0.0, *, scaled: bool = False
    ) -> None:
        self.images, self.knowledge, self._whole, self._scaled = tuple(images), knowledge, whole, scaled
        # The scale height is common to all images, each of which states its share of what is known of it.
        share = float(np.sqrt(len(self.images)))
        self.known = EdgeKnown(
            knowledge.ellipsoid.axes_m,
            knowledge.blur_px,
            knowledge.blur_log_sigma,
            knowledge.scale_height_m,
            share * knowledge.scale_sigma_m,
            knowledge.mean.height_m + knowledge.scale_height_m,
            share * knowledge.middle_sigma_m,
        )
        self._basis_body: FloatArray | None = None
        self._heights: _Heights | None = None
        self._most: int | None = None

    def start(self, pose: LimbPose) -> ShotState:
        """Return the unknowns before the first choice, of the body's pose."""
        return ShotState(pose, (self.known.own,) * len(self.images), np.zeros(0))

    def __call__(
        self, state: ShotState, lens: FloatArray, most: int | None, tighter: float, before: Chosen | None
    ) -> Chosen:
        """Return the pixels near the limb at a state."""
        pose = state.pose
        if self._basis_body is None or before is None:
            self._heights = None
            self._basis_body = tangent_basis(pose.nadir_cam)
        limbs, lens_open = [], self._scaled or bool(self.knowledge.lens_sigmas.any())
        for one, own in zip(self.images, state.own, strict=True):
            near = _limb(one, pose, self._basis_body, self.known, own, lens, most, self._whole, lens_open=lens_open)
            limbs.append(near)
        # The heights along the limb are those at the start: what it moves by is small before what they vary over.
        if self._heights is None:
            self._heights = _heights(limbs, pose, self.knowledge)
            state = replace(state, air=np.zeros(self._heights.count))
        models = [
            _model(limb, pose.of_camera(one.cam_from_body), self._heights, self.known, self._scaled)
            for limb, one in zip(limbs, self.images, strict=True)
        ]
        columns = [np.arange(self._heights.count)] * len(models)
        noises: list[LightNoise | None] = [None] * len(models)
        if before is not None and most == self._most:
            for k, (model, own) in enumerate(zip(models, state.own, strict=True)):
                was, noise = before.models[k], before.noises[k]
                if isinstance(was, EdgeModel) and isinstance(noise, LightNoise):
                    pose = state.pose.of_camera(self.images[k].cam_from_body)
                    noises[k] = model.noise_of(was, noise, pose, own, state.air)
        self._most = most
        return Chosen(models, columns, state, noises)


@dataclass(frozen=True)
class _Limb:
    """The pixels near the limb in one image, or cells of them, at a pose, n in all.

    ``camera``: with the errors ``lens``, which are unknowns if ``lens_open``; ``los``: shape (3, n), lines of sight,
    whose angle is ``angle``; ``gradient``: shape (2, n), change of the angle by column and by row [rad/px]; ``delta``,
    ``values``, ``columns``, ``rows``: shape (n,), means of the pixels' angles, grey levels and places; ``counts``,
    ``wide_px2``: as in :class:`.edge.EdgePixels`; ``azimuth``: shape (n,), about the body's nadir at the start [rad];
    ``on_limb``: numbers of some pixels nearest to the limb; ``limb_px``, ``limb_rad``: its length; ``rounding``:
    variance of rounding.
    """

    camera: CameraModel
    lens: FloatArray
    lens_open: bool
    los: FloatArray
    gradient: FloatArray
    delta: FloatArray
    values: FloatArray
    columns: FloatArray
    rows: FloatArray
    counts: FloatArray
    wide_px2: FloatArray
    angle: LimbAngle
    azimuth: FloatArray
    on_limb: NDArray[np.intp]
    limb_px: int
    limb_rad: float
    rounding: float

    @cached_property
    def scale(self) -> FloatArray:
        """Image scale across the limb [rad/px], shape (n,)."""
        return np.hypot(*self.gradient)

    @property
    def pixel_m(self) -> FloatArray:
        """Height that a pixel sees at each of the places on the limb."""
        return np.asarray(self.scale[self.on_limb] / self.angle.take(self.on_limb).by_height)

    @cached_property
    def by_lens(self) -> FloatArray:
        """Change of the angle by errors of the lens, shape (4, n).

        A direction is seen at another place in the image: the pixel, which stays, sees what is as far to the other
        side.
        """
        if not self.lens_open:
            return np.zeros((LENS, len(self.columns)))
        camera, none, one = self.camera, np.zeros_like(self.columns), np.ones_like(self.columns)
        bent = np.zeros((len(one), 2))
        if camera.projection != "equal_angle":
            # Linear in its coefficient: one of a whole pixel at the corner is as good as a small one.
            there, _ = project(miscalibrated(camera, distortion_px=1.0), self.los.T)
            bent = np.nan_to_num(there - np.column_stack([self.columns, self.rows]))
        to_column = np.array([self.columns - camera.cx, one, none, bent[:, 0]])
        to_row = np.array([self.rows - camera.cy, none, one, bent[:, 1]])
        return -(self.gradient[0] * to_column + self.gradient[1] * to_row)


def _limb(
    one: EdgeImage,
    body: LimbPose,
    basis_body: FloatArray,
    known: EdgeKnown,
    own: FloatArray,
    lens: FloatArray,
    most: int | None,
    whole: float,
    *,
    lens_open: bool,
) -> _Limb:
    """Return the pixels near a limb, gathered in cells where they are many.

    Pixels whose limb is outside the picture are left out: without an edge they would determine levels alone and
    misplace the limb. Raises ``LinAlgError``: too little limb in view, or an edge that is none.
    """
    blur_px = float(np.exp(own[0]))
    if blur_px > LARGEST_BLUR_PX:
        raise np.linalg.LinAlgError(f"the edge is wider than {LARGEST_BLUR_PX:.0f} px: no limb near the start")
    camera, pose = with_errors(one.camera, lens), body.of_camera(one.cam_from_body)
    axes = known.axes_m + pose.height_m
    wide = BLURS * max(blur_px - SHARP_PX, 0.0)
    soft = OUTSIDE_SCALES * float(own[1]) / pixel_at_limb_m(camera, pose.r_itrs, axes[0])
    outside, inside = OUTSIDE_PX + wide + soft, INSIDE_PX + wide
    near = near_pixels(camera, pose.cam_from_itrs, pose.r_itrs, axes, outside, inside, most)
    angle = limb_angle(near.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    values = np.asarray(one.image[near.rows, near.columns], dtype=np.float64)
    seen = in_view(camera, near, angle, (-whole * outside, whole * inside)) & np.isfinite(values)
    if not seen.all():
        near, angle, values = near.take(seen), angle.take(seen), values[seen]
    slopes = gradient(angle, near.by_column, near.by_row)
    x = angle.delta / np.hypot(*slopes)
    on_limb = np.flatnonzero(np.abs(x) < 0.5)
    limb_px = len(on_limb) * near.every
    fewest = 1 if min(one.image.shape) == 1 else FEWEST_LIMB_PX
    if limb_px < fewest or not len(on_limb):
        raise np.linalg.LinAlgError(f"{limb_px} pixels of limb in view, not saturated; {fewest} are needed")
    across = (basis_body.T @ one.cam_from_body.T) @ near.los_cam
    azimuth, counts, wide_px2 = np.mod(np.arctan2(across[1], across[0]), 2.0 * np.pi), np.ones(len(x)), np.zeros(len(x))
    each = [*near.los_cam, *slopes, angle.delta, values, near.columns, near.rows]
    limb_rad = float(np.hypot(*slopes)[on_limb].sum()) * near.every
    rounding = rounding_variance(values)
    if len(values) > MOST_PIXELS:
        azimuth, counts, wide_px2, x, each = _gathered(azimuth, x, each)
        on_limb = np.flatnonzero(np.abs(x) < CELL_PX)
        angle = limb_angle(np.array(each[:3]), pose.cam_from_itrs, pose.r_itrs, axes)
    delta, values, columns, rows = (np.asarray(row, dtype=np.float64) for row in each[5:])
    return _Limb(
        camera=camera,
        lens=lens,
        lens_open=lens_open,
        los=np.array(each[:3]),
        gradient=np.array(each[3:5]),
        delta=delta,
        values=values,
        columns=columns,
        rows=rows,
        counts=counts,
        wide_px2=wide_px2,
        angle=angle,
        azimuth=azimuth,
        on_limb=on_limb[:: max(1, len(on_limb) // PLACES)],
        limb_px=limb_px,
        limb_rad=limb_rad,
        rounding=rounding,
    )


def with_errors(camera: CameraModel, lens: FloatArray) -> CameraModel:
    """Return a camera with errors of its lens, shape (4,)."""
    if not lens.any():
        return camera
    return miscalibrated(camera, float(np.expm1(lens[0])), (float(lens[1]), float(lens[2])), float(lens[3]))


def _scale_changes(limb: _Limb, pose: LimbPose, known: EdgeKnown) -> FloatArray:
    """Return the relative changes of the image scale by pose and lens, shape (11, n), as central differences."""
    camera = limb.camera
    pixel_m = float(np.median(limb.pixel_m))
    pixel_rad = 1.0 / max(camera.fx, camera.fy)
    sizes = STEP_PX * np.array([*[pixel_rad] * 3, *[pixel_m] * 4, pixel_rad, 1.0, 1.0, 1.0])
    bends = camera.projection != "equal_angle"
    sides = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    around = np.column_stack([limb.columns, limb.rows]) + sides[:, None]

    def scale(step: FloatArray) -> FloatArray:
        lens, moved = step[POSE:], pose.moved(step[:POSE])
        changed = with_errors(camera, lens)
        los, right, left, below, above = unproject(changed, around).transpose(0, 2, 1)
        angle = limb_angle(los, moved.cam_from_itrs, moved.r_itrs, known.axes_m + moved.height_m)
        return image_scale(angle, 0.5 * (right - left), 0.5 * (below - above))

    changes = np.zeros((POSE + LENS, len(limb.scale)))
    for number, step in enumerate(np.diag(sizes)[: len(sizes) - (not bends)]):
        changes[number] = (scale(step) - scale(-step)) / (2.0 * sizes[number] * limb.scale)
    return np.nan_to_num(changes)


def _model(limb: _Limb, pose: LimbPose, heights: _Heights, known: EdgeKnown, scaled: bool) -> EdgeModel:
    """Return the model of an image's pixels, at the pose of its camera."""
    sectors = sectors_of(limb.azimuth, limb.limb_px, limb.limb_rad)
    order, some, angle = sectors.order, limb.on_limb, limb.angle
    lift, modes = heights.at(limb.azimuth)
    if heights.misplaced:
        # As a height, since a height is what a mode is of.
        modes = np.concatenate([modes, [MISPLACED_PX * limb.scale / angle.by_height]])
    pixels = EdgePixels(
        columns=limb.columns[order],
        rows=limb.rows[order],
        values=limb.values[order],
        counts=limb.counts[order],
        wide_px2=limb.wide_px2[order],
        rounding=limb.rounding,
        sectors=sectors.count,
        # A linear array crosses the limb in one pixel, which has no place along it.
        along=sectors.along if limb.limb_px > 1 else np.zeros(len(order)),
        los_cam=np.ascontiguousarray(limb.los[:, order]),
        offset=(limb.delta - angle.delta)[order],
        by_lens=np.ascontiguousarray(limb.by_lens[:, order]),
        lens=limb.lens,
        scale=limb.scale[order],
        scale_changes=np.ascontiguousarray(_scale_changes(limb, pose, known)[:, order]) if scaled else None,
        pose=pose,
        bend=_bend(limb, pose, known)[order],
        lift_m=lift[order],
        modes=np.ascontiguousarray(modes[:, order]),
    )
    angle = angle.take(some)
    by_all = [angle.by_rotation, angle.by_position, angle.by_height[None], limb.by_lens[:, some]]
    return EdgeModel(pixels, known, np.concatenate(by_all) / limb.scale[some])


def _bend(limb: _Limb, pose: LimbPose, known: EdgeKnown) -> FloatArray:
    """Return the bend of the limb at the pixels, shape (n,)."""
    uv = np.column_stack([limb.columns, limb.rows])[limb.on_limb]
    bend = limb_bend(limb.camera, uv, pose.cam_from_itrs, pose.r_itrs, known.axes_m + pose.height_m)
    seen = np.isfinite(bend)
    if not seen.any():
        return np.zeros(len(limb.azimuth))
    return np.asarray(np.interp(limb.azimuth, limb.azimuth[limb.on_limb][seen], bend[seen], period=2.0 * np.pi))


def _gathered(
    azimuth: FloatArray, x: FloatArray, each: list[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, list[FloatArray]]:
    """Return pixels gathered in cells of azimuth and distance.

    ``azimuth``, ``x``: shape (n,), distance inside the limb [px]; ``each``: r rows (n,). Result for m cells, shape (m,)
    each: azimuth, number of pixels, variance of the distances, mean distance, and means of the rows.
    """
    edges = np.arange(-EDGE_PX, EDGE_PX + 0.5 * CELL_PX, CELL_PX)
    beside = (np.arange(-EDGE_PX, x.min(), -WIDE_CELL_PX)[:0:-1], np.arange(EDGE_PX, x.max(), WIDE_CELL_PX)[1:])
    across = np.searchsorted(np.concatenate([beside[0], edges, beside[1]]), x)
    deep = int(across.max()) + 1
    order, along = from_widest_gap(azimuth)
    count = max(MOST_PIXELS // deep, 1)
    turned = np.empty(len(order))
    turned[order] = along
    arc = np.minimum((turned * (count / max(along[-1], 1e-300))).astype(np.intp), count - 1)
    number = arc * deep + across
    every = np.bincount(number, minlength=count * deep)
    used = np.flatnonzero(every)
    pixels = every[used].astype(np.float64)
    along, middle, square, *means = (np.bincount(number, row)[used] / pixels for row in (turned, x, x * x, *each))
    around = np.mod(along + azimuth[order[0]], 2.0 * np.pi)
    return around, pixels, np.maximum(square - middle**2, 0.0), middle, means


@dataclass(frozen=True)
class _Heights:
    """Height of the limb round the part of the horizon that is seen.

    ``first``: azimuth of the first node [rad]; ``nodes``: shape (m,), from it [rad]; ``lift_m``: shape (m,); ``modes``:
    shape (k, m) [m]; ``misplaced``: whether the air may displace the limb by a part of a pixel besides.
    """

    first: float
    nodes: FloatArray
    lift_m: FloatArray
    modes: FloatArray
    misplaced: bool

    @property
    def count(self) -> int:
        """Number of unknowns."""
        return len(self.modes) + int(self.misplaced)

    def at(self, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return lift (n,) and modes (k, n) at azimuths (n,)."""
        before = np.pi - 0.5 * float(self.nodes[-1])
        along = np.mod(azimuth - self.first + before, 2.0 * np.pi) - before
        left = np.clip(np.searchsorted(self.nodes, along, side="right") - 1, 0, len(self.nodes) - 2)
        share = np.clip((along - self.nodes[left]) / (self.nodes[left + 1] - self.nodes[left]), 0.0, 1.0)
        rows = np.concatenate([self.lift_m[None], self.modes])
        found = rows[:, left] * (1.0 - share) + rows[:, left + 1] * share
        return found[0], found[1:]


def _heights(limbs: Sequence[_Limb], body: LimbPose, knowledge: LimbKnowledge) -> _Heights:
    """Return the heights along the limb that all images see together."""
    order, _ = from_widest_gap(np.concatenate([limb.azimuth for limb in limbs]))
    everywhere = np.concatenate([limb.azimuth for limb in limbs])
    first = float(everywhere[order[0]])
    span = float(np.mod(everywhere[order[-1]] - first, 2.0 * np.pi))
    axes = knowledge.ellipsoid.axes_m + body.height_m
    rho = float(np.arcsin(min(float(axes[0]) / float(np.linalg.norm(body.r_itrs)), 1.0)))
    uneven, sliver = knowledge.uneven, knowledge.sliver
    if uneven is None:
        nodes, modes = relief_modes(span, knowledge.reliefs, knowledge.flattened_m, rho)
        lift = np.zeros(len(nodes))
    else:
        nodes = relief_nodes(span, SHORTEST_RAD / float(np.cos(rho)))
    if uneven is not None or sliver is not None:
        seen = np.concatenate([np.mod(limb.azimuth[limb.on_limb] - first, 2.0 * np.pi) for limb in limbs])
        order = np.argsort(seen)
        pixel_m = np.interp(nodes, seen[order], np.concatenate([limb.pixel_m for limb in limbs])[order])
    if uneven is not None:
        lift, covariance = uneven.along(_places(nodes + first, body, rho, pixel_m), nodes)
        modes = modes_of(covariance + oblate_covariance(nodes + first, knowledge.flattened_m, rho))
    if sliver is not None:
        u, v = sliver.darkest @ tangent_basis(body.nadir_cam)
        away = nodes + first - np.arctan2(v, u)
        unlit = sliver.depth_px * pixel_m * np.maximum(np.cos(away), 0.0)
        depth = unlit * np.cos(away)
        lift = lift - depth
        modes = np.concatenate([modes, [depth, DARKEST_SIGMA_RAD * 2.0 * unlit * np.sin(away)]])
    return _Heights(first, nodes, lift, modes, misplaced=uneven is None and bool(knowledge.reliefs))


def _places(azimuth: FloatArray, pose: LimbPose, rho_rad: float, pixel_m: FloatArray) -> ArcPlaces:
    """Return places along the limb at azimuths (m,) about the nadir."""
    nadir = pose.nadir_cam
    basis = tangent_basis(nadir)
    outwards = np.cos(azimuth)[:, None] * basis[:, 0] + np.sin(azimuth)[:, None] * basis[:, 1]
    los = np.cos(rho_rad) * nadir + np.sin(rho_rad) * outwards
    up = np.cos(rho_rad) * outwards - np.sin(rho_rad) * nadir
    return ArcPlaces(los, up, pose.cam_from_itrs, pixel_m)


LEFT_OUT = 1e-3
"""Neglected share of the heights' variance: 3 % of their standard deviation, in waves too short to act as a tilt."""
NODES_PER_LENGTH = 2.0
"""Per correlation length: a Gaussian covariance sampled at half of its length loses 2e-4 of its variance between."""
MOST_NODES = 96
"""Largest number of nodes: a circle of 6.3 rad at 0.13 rad. Shorter reliefs are averaged over a node, as a tilt
does."""
OBLATE_LENGTH_RAD = 0.5
"""Correlation length for the nodes of an ellipsoid's limb, two waves round a circle."""


def relief_nodes(span_rad: float, shortest_rad: float) -> FloatArray:
    """Return azimuths [rad], shape (m,), from 0 to the span, close enough for a relief of that correlation length."""
    count = int(np.clip(np.ceil(NODES_PER_LENGTH * span_rad / shortest_rad) + 1, 3, MOST_NODES))
    return np.linspace(0.0, span_rad, count)


def relief_modes(
    span_rad: float, reliefs: tuple[Relief, ...], flattened_m: float = 0.0, rho_rad: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return nodes of azimuth [rad], shape (m,), and the modes there [m], shape (k, m).

    ``span_rad``: azimuth of the limb in view; ``reliefs``: independent contributions, none without modes;
    ``flattened_m``: flattening times radius of a planet fitted as a sphere, else 0; ``rho_rad``: its angular radius,
    for the flattening.
    """
    if not reliefs and flattened_m == 0.0:
        return np.array([0.0, span_rad]), np.zeros((0, 2))
    shortest = min([relief.correlation_rad for relief in reliefs] or [OBLATE_LENGTH_RAD])
    nodes = relief_nodes(span_rad, shortest)
    width = nodes[1] - nodes[0]
    apart = np.abs(nodes[:, None] - nodes[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    heights = np.zeros_like(apart)
    for relief in reliefs:
        # The mean over the width of a node, a box of variance width^2 / 12 at both ends, in place of single points.
        square = relief.correlation_rad**2
        wide = square + width**2 / 6.0
        heights += relief.sigma_m**2 * np.sqrt(square / wide) * np.exp(-0.5 * apart**2 / wide)
    return nodes, modes_of(heights + oblate_covariance(nodes, flattened_m, rho_rad))


def oblate_covariance(nodes: FloatArray, flattened_m: float, rho_rad: float) -> FloatArray:
    """Return what the flattening makes of a sphere's limb at azimuths (m,), all poles alike [m^2], shape (m, m)."""
    if flattened_m == 0.0:
        return np.zeros((len(nodes), len(nodes)))
    limbs = oblate_limbs(np.column_stack([np.cos(nodes), np.sin(nodes)]), rho_rad, flattened_m) / np.tan(rho_rad)
    limbs -= limbs.mean()
    return np.asarray(limbs @ limbs.T / limbs.shape[1])


def modes_of(covariance: FloatArray) -> FloatArray:
    """Return the modes, shape (k, m), of a covariance of heights (m, m)."""
    variance, vectors = np.linalg.eigh(covariance)
    variance, vectors = np.maximum(variance[::-1], 0.0), vectors[:, ::-1]
    kept = int(np.searchsorted(np.cumsum(variance), (1.0 - LEFT_OUT) * variance.sum())) + 1
    return np.asarray(np.sqrt(variance[:kept])[:, None] * vectors.T[:kept])
