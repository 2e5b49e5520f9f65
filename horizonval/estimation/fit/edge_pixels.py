"""The pixels for a fit of the limb's edge, those within a window about it, and the heights of the limb along it.

**Modes.** Along the limb the height differs from its mean by a random function of azimuth with the covariance ``K(phi)
= s^2 exp(-phi^2 / (2 l^2))`` (:mod:`horizonval.earth.limb_heights`). On ``m`` nodes ``K = V diag(w) V^T``, and
(Karhunen and Loeve) ::

    height(phi_j) = sum over modes of  z_i sqrt(w_i) V_ji,      z_i ~ N(0, 1)

The fit therefore knows which changes along the arc may not be taken for a tilt, and its covariance includes them. All
images of a shot have one such function, round the part of the horizon that they see together.

A sphere fitted to the oblate Earth has a second relief. The limb of a planet of flattening ``f`` differs from a
sphere's by ``-f R (u . pole)^2``, with ``u`` from the centre to the point of the limb; its covariance over all poles
(:mod:`horizonval.earth.limb_heights`) is added to ``K``.

Modes that together hold less than a thousandth of the variance are left out; between nodes the modes are linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, oblate_limbs
from horizonval.estimation.fit.edge import EdgeModel, EdgePixels
from horizonval.estimation.fit.heights import ArcPlaces
from horizonval.estimation.fit.image import POSE, Chosen, ShotState
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import (
    INSIDE_PX,
    OUTSIDE_PX,
    OUTSIDE_SCALES,
    from_widest_gap,
    sectors_of,
)
from horizonval.estimation.fit.pixels import (
    FEWEST_LIMB_PX,
    Limb,
    LimbPixels,
    limb_pixels,
    near_pixels,
    pixel_at_limb_m,
    with_errors,
)
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.limb.picture import rounding_variance
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import tangent_basis

MISPLACED_PX = 0.05
"""Standard deviation of the common displacement between real air's limb and an exponential: residuals of 0.01 to 0.05
of the step over a slope of 0.5 of the step per pixel. With equal pixels it acts as a height; with unequal ones it bends
the limb."""
MOST_PIXELS = 4000
"""Number of pixels and cells of an image from which it is fitted by cells."""


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
    the picture.
    """

    def __init__(self, images: Sequence[EdgeImage], knowledge: LimbKnowledge, whole: float = 0.0) -> None:
        self.images, self.knowledge, self._whole = tuple(images), knowledge, whole
        # The scale height is common to all images, each of which states its share of what is known of it.
        share = float(np.sqrt(len(self.images)))
        sigmas = share * knowledge.scale_sigma_m, share * knowledge.middle_sigma_m
        self.known = replace(knowledge, scale_sigma_m=sigmas[0], middle_sigma_m=sigmas[1])
        self._basis_body: FloatArray | None = None
        self._heights: _Heights | None = None

    def start(self, pose: LimbPose) -> ShotState:
        """Return the unknowns before the first choice, of the body's pose."""
        return ShotState(pose, (self.known.own,) * len(self.images), np.zeros(0))

    def __call__(
        self, state: ShotState, lens: FloatArray, most: int | None, tighter: float, before: Chosen | None
    ) -> Chosen:
        """Return the pixels near the limb at a state."""
        if self._basis_body is None or before is None:
            self._heights = None
            self._basis_body = tangent_basis(state.pose.nadir_cam)
        limbs = [
            self._limb(one, state.pose, float(np.exp(own[0])), float(own[1]), lens, most)
            for one, own in zip(self.images, state.own, strict=True)
        ]
        # The heights along the limb are those at the start: what it moves by is small before what they vary over.
        if self._heights is None:
            self._heights = _heights(limbs, state.pose, self.knowledge)
            state = replace(state, air=np.zeros(self._heights.count))
        models = [EdgeModel(_sectors(limb, self._heights), self.known, tighter) for limb in limbs]
        return Chosen(models, [np.arange(self._heights.count)] * len(models), state)

    def _limb(
        self, one: EdgeImage, body: LimbPose, blur_px: float, scale_m: float, lens: FloatArray, most: int | None
    ) -> _Limb:
        """Return the pixels near a limb, gathered in cells where they are many.

        Pixels whose limb is outside the picture are left out: without an edge they would determine levels alone and
        misplace the limb. Raises ``LinAlgError``: too little limb in view, or an edge that is none.
        """
        if blur_px > INSIDE_PX:
            raise np.linalg.LinAlgError(f"the edge is wider than {INSIDE_PX:.0f} px: no limb near the start")
        camera, pose = with_errors(one.camera, lens), body.of_camera(one.cam_from_body)
        axes = self.knowledge.ellipsoid.axes_m + pose.height_m
        # Three blurs are half the width of an edge.
        wide = 3.0 * max(blur_px - 1.0, 0.0)
        soft = OUTSIDE_SCALES * scale_m / pixel_at_limb_m(camera, pose.r_itrs, axes[0])
        outside, inside = OUTSIDE_PX + wide + soft, INSIDE_PX + wide
        near = near_pixels(camera, pose, axes, outside, inside, most)
        seen = np.isfinite(one.image[near.rows, near.columns])
        seen &= near.in_view(camera, (-self._whole * outside, self._whole * inside))
        if not seen.all():
            near = near.take(seen)
        limb_px = int(np.count_nonzero(np.abs(near.x_px) < 0.5)) * near.every
        fewest = 1 if min(one.image.shape) == 1 else FEWEST_LIMB_PX
        if limb_px < fewest:
            raise np.linalg.LinAlgError(f"{limb_px} pixels of limb in view, not saturated; {fewest} are needed")
        rounding = rounding_variance(one.image[near.rows, near.columns])
        assert self._basis_body is not None
        basis = one.cam_from_body @ self._basis_body
        pixels = limb_pixels(one.image, camera, near, pose, lens, axes, basis, MOST_PIXELS)
        return _Limb(pixels, Limb(pose.cam_from_itrs, pose.r_itrs, axes), camera, limb_px, rounding)


@dataclass(frozen=True)
class _Limb:
    """The pixels near the limb in one image; ``limb_px``: its length in view; ``rounding``: variance of rounding."""

    pixels: LimbPixels
    limb: Limb
    camera: CameraModel
    limb_px: int
    rounding: float

    @cached_property
    def on_limb(self) -> NDArray[np.intp]:
        """Numbers of some pixels nearest to the limb, four to the shortest wave of a pose round a disc, or more."""
        on_limb = np.flatnonzero(np.abs(self.pixels.across_m) < 0.5 * self.pixels.width_m)
        return on_limb[:: max(1, len(on_limb) // 48)]


def _sectors(seen: _Limb, heights: _Heights) -> EdgePixels:
    """Return the pixels of an image in sectors."""
    pixels, some = seen.pixels, seen.on_limb
    limb_rad = seen.limb_px * float(np.mean(pixels.width_m[some] / pixels.distance_m[some]))
    sectors = sectors_of(pixels.azimuth, seen.limb_px, limb_rad)
    lift, modes = heights.at(pixels.azimuth)
    if heights.misplaced:
        # As a height, since a height is what a mode is of.
        modes = np.concatenate([modes, [MISPLACED_PX * pixels.width_m]])
    uv = np.column_stack([pixels.columns, pixels.rows])[some]
    bend = seen.limb.bend_m(seen.camera, uv, pixels.gradient[:, some])
    of_limb = np.concatenate([pixels.by_pose, pixels.by_lens])[:, some]
    order = sectors.order
    arrays = pixels.of(order)
    # In pixels, whose width is that at the pose of the choice, a nearer or a higher limb moves alike on both sides.
    arrays["by_pose"][3:] /= -arrays["by_pose"][POSE - 1]
    return EdgePixels(
        pixels.pose,
        pixels.lens,
        pixels.every,
        **arrays,
        sectors=sectors.count,
        # A linear array crosses the limb in one pixel, which has no place along it.
        along=sectors.along if seen.limb_px > 1 else np.zeros(len(order)),
        rounding=seen.rounding,
        bend_m=np.interp(pixels.azimuth[order], pixels.azimuth[some], bend, period=2.0 * np.pi),
        lift_m=lift[order],
        modes=np.ascontiguousarray(modes[:, order]),
        motion=of_limb / pixels.width_m[some],
        curve=seen.limb.curve,
    )


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
    everywhere = np.concatenate([limb.pixels.azimuth for limb in limbs])
    order, along = from_widest_gap(everywhere)
    first, span = float(everywhere[order[0]]), float(along[-1])
    axes = knowledge.ellipsoid.axes_m + body.height_m
    rho = float(np.arcsin(min(float(axes[0]) / float(np.linalg.norm(body.r_itrs)), 1.0)))
    if knowledge.uneven is None:
        nodes, modes = relief_modes(span, knowledge.reliefs, knowledge.flattened_m, rho)
        return _Heights(first, nodes, np.zeros(len(nodes)), modes, misplaced=bool(knowledge.reliefs))
    # Cloud heights are correlated over 3 deg at the Earth's centre.
    nodes = relief_nodes(span, 0.05 / float(np.cos(rho)))
    azimuth, nadir = nodes + first, body.nadir_cam
    seen = np.concatenate([limb.pixels.azimuth[limb.on_limb] for limb in limbs])
    widths = np.concatenate([limb.pixels.width_m[limb.on_limb] for limb in limbs])
    outwards = (tangent_basis(nadir) @ np.array([np.cos(azimuth), np.sin(azimuth)])).T
    places = ArcPlaces(
        np.cos(rho) * nadir + np.sin(rho) * outwards,
        np.cos(rho) * outwards - np.sin(rho) * nadir,
        body.cam_from_itrs,
        np.interp(azimuth, seen, widths, period=2.0 * np.pi),
    )
    lift, covariance = knowledge.uneven.along(places, nodes)
    modes = modes_of(covariance + oblate_covariance(azimuth, knowledge.flattened_m, rho))
    return _Heights(first, nodes, lift, modes, misplaced=False)


def relief_nodes(span_rad: float, shortest_rad: float) -> FloatArray:
    """Return azimuths [rad], shape (m,), from 0 to the span, close enough for a relief of that correlation length."""
    # Two nodes to a correlation length lose 2e-4 of the variance between them. A circle has 6.3 rad at 0.13 rad;
    # shorter reliefs are averaged over a node, as a tilt does.
    count = int(np.clip(np.ceil(2.0 * span_rad / shortest_rad) + 1, 3, 96))
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
    # The limb of an ellipsoid has two waves round a circle.
    shortest = min([relief.correlation_rad for relief in reliefs] or [0.5])
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
    # What is left out is 3 % of their standard deviation, in waves too short to act as a tilt.
    kept = int(np.searchsorted(np.cumsum(variance), 0.999 * variance.sum())) + 1
    return np.asarray(np.sqrt(variance[:kept])[:, None] * vectors.T[:kept])
