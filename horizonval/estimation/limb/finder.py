"""Image in, limb points out: the whole search in the order in which it happens.

checks -> eight bits -> Canny -> consensus on cones -> sub-pixel refinement -> verdict

``find_limb`` does all of it. ``find_edges_only`` stops after the sub-pixel step and keeps every edge point;
``find_canny_pixels`` stops before it, as the published altitude-free method does. Both are right only where the limb is
the one edge in the image.
"""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.limb.checks import check_image
from horizonval.estimation.limb.consensus import Candidate, EdgePoints, find_candidates, to_sights
from horizonval.estimation.limb.edges import Edges, find_edges
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.limb.result import LimbPoints
from horizonval.estimation.limb.subpixel import half_window, refine
from horizonval.estimation.limb.sun import find_sun
from horizonval.estimation.limb.verdict import Limb, judge
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.directions import off_axis_angle

MOST_POINTS = 24_000
"""Edge points taken into the consensus: the calmest ones, since space is calm."""
MOST_OTHERS = 12_000
"""Edge points sampled to see what lies outside a curve."""
JUDGED = 6
RIVAL_ARC_SHARE = 0.5
RIVAL_SIGMAS = 5.0
RIVAL_ANGLE_RAD = float(np.deg2rad(1.0))
SUN_REACH = 2.0
LARGEST_SUN_RADIUS_RAD = float(np.deg2rad(3.0))
FEWEST_POINTS = 8
LIMB_SHARE = 0.4
"""Canny's upper threshold over the image's strong gradients, where all edges are taken for limb. On a picture of 50 to
200 pixels the shading of a whole disc is steep enough for a lower one."""
DARK_CONTRAST = 0.02
DARK_LEVEL = 0.2
"""An image without edges below these shares of full scale shows an unlit scene, not a uniformly bright one."""


def find_limb(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return the sub-pixel points of the Earth's limb, or why there are none.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels that grow, or fall, with radiance. Anything else is refused, not raised.
    camera : CameraModel
        Its width and height must be the image's.
    full_scale : float, optional
        Digital number at which the converter saturates.

    Returns
    -------
    LimbPoints or Refusal
        The points in order along the limb.
    """
    picture = picture_of(image, camera, full_scale)
    return picture if isinstance(picture, Refusal) else find_limb_in(picture, camera)


def picture_of(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> Picture | Refusal:
    """Return an image that may hold a limb as a picture, or why it holds none; parameters as for :func:`find_limb`."""
    if (refusal := check_image(image, full_scale)) is not None:
        return refusal
    if image.shape != (camera.height, camera.width):
        return Refusal(
            Outcome.BAD_INPUT,
            f"the image is {image.shape[1]} x {image.shape[0]} pixels, the camera {camera.width} x {camera.height}",
        )
    return Picture(image, full_scale)


def find_limb_in(picture: Picture, camera: CameraModel) -> LimbPoints | Refusal:
    """Return the limb of a picture of this camera; as :func:`find_limb`."""
    grey, saturated, full_scale = picture.grey, picture.saturated, picture.full_scale
    rim = half_window(grey.shape) + 1
    edges = _inside_image_circle(find_edges(picture.eight_bit, rim), camera, rim)
    seed = int.from_bytes(hashlib.sha256(np.ascontiguousarray(grey).data).digest(), "big")
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    sun = find_sun(saturated)
    dazzled = sun is not None
    if sun is not None and sun.radius_px / camera.fx < LARGEST_SUN_RADIUS_RAD:
        edges = _take(edges, np.hypot(*(edges.uv - (sun.column, sun.row)).T) > SUN_REACH * sun.radius_px + rim)
    if len(edges.uv) < FEWEST_POINTS:
        return _no_edges(grey, saturated, dazzled, full_scale)
    sample = rng.permutation(len(edges.uv))[:MOST_OTHERS]
    calm = np.argsort(edges.quiet, kind="stable")[:MOST_POINTS]
    sight, others = to_sights(edges, camera, grey.shape, calm, sample)
    candidates = find_candidates(sight, rng)
    if not candidates:
        return _no_edges(grey, saturated, dazzled, full_scale)
    weight = len(edges.uv) / max(len(sample), 1)
    return _decide(picture, camera, sight, candidates[:JUDGED], others, weight, rim, dazzled)


def find_edges_only(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return every edge point of the image, refined, with no test of whether it belongs to the limb.

    Parameters and returns as for :func:`find_limb`.
    """
    picture = picture_of(image, camera, full_scale)
    if isinstance(picture, Refusal):
        return picture
    rim = half_window(picture.grey.shape) + 1
    edges = _inside_image_circle(find_edges(picture.eight_bit, rim), camera, rim)
    uv, _, _ = refine(picture.grey, edges.uv, edges.gradient)
    los = unproject(camera, uv)
    good = np.isfinite(los).all(axis=1)
    if good.sum() < FEWEST_POINTS:
        return Refusal(Outcome.NO_LIMB, f"{int(good.sum())} edge points; {FEWEST_POINTS} are needed")
    return LimbPoints(uv[good], los[good])


def find_canny_pixels(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return every pixel that Canny marks, as it marks it: no sub-pixel step, no test of whether it is the limb's.

    Nothing after Canny throws an edge away, so its threshold must: see :data:`LIMB_SHARE`.

    Parameters and returns as for :func:`find_limb`.
    """
    picture = picture_of(image, camera, full_scale)
    if isinstance(picture, Refusal):
        return picture
    edges = _inside_image_circle(find_edges(picture.eight_bit, 1, LIMB_SHARE), camera, 1)
    los = unproject(camera, edges.uv)
    good = np.isfinite(los).all(axis=1)
    if good.sum() < FEWEST_POINTS:
        return Refusal(Outcome.NO_LIMB, f"{int(good.sum())} edge points; {FEWEST_POINTS} are needed")
    return LimbPoints(edges.uv[good], los[good])


def _take(edges: Edges, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Edges:
    return Edges(edges.uv[rows], edges.gradient[rows], edges.quiet[rows])


def _inside_image_circle(edges: Edges, camera: CameraModel, rim_px: int) -> Edges:
    """Leave out the lens's own edge: a perfect cone with nothing outside, everything a limb is."""
    if camera.image_circle_rad is None:
        return edges
    outwards = edges.uv - (camera.cx, camera.cy)
    length = np.maximum(np.hypot(*outwards.T), 1e-9)[:, None]
    further = unproject(camera, edges.uv + rim_px * outwards / length)
    return _take(edges, np.asarray(np.isfinite(further).all(axis=1)))


def _no_edges(image: FloatArray, saturated: NDArray[np.bool_], dazzled: bool, full_scale: float | None) -> Refusal:
    if dazzled:
        return Refusal(Outcome.SUN_GLARE, "a saturated blob and no other edge")
    if saturated.mean() > 0.5:
        return Refusal(Outcome.SATURATED, f"{saturated.mean():.0%} of the pixels are saturated and no limb is left")
    if full_scale is not None:
        # a converter's black level is not light: what counts is how far the brightest pixels rise above the rest
        middle, bright = np.percentile(image, (50.0, 99.9))
        if bright - middle < DARK_CONTRAST * full_scale and bright < DARK_LEVEL * full_scale:
            return Refusal(Outcome.DARK, f"no edge, and a flat {middle / full_scale:.0%} of full scale")
    return Refusal(Outcome.NO_LIMB, "no edge stands out of the noise")


def _decide(
    picture: Picture,
    camera: CameraModel,
    sight: EdgePoints,
    candidates: list[Candidate],
    others: EdgePoints,
    weight: float,
    rim: int,
    dazzled: bool,
) -> LimbPoints | Refusal:
    """Judge the candidates; the longest accepted one wins unless another one contradicts it."""
    verdicts = [judge(picture, camera, sight, c, others, weight, rim) for c in candidates]
    accepted = sorted((v for v in verdicts if isinstance(v, Limb)), key=lambda v: -v.arc_px)
    if not accepted:
        first = verdicts[0]
        assert isinstance(first, Refusal)
        if dazzled:
            return Refusal(Outcome.SUN_GLARE, f"a saturated blob is in view; without it, {first.reason}")
        return first
    best = accepted[0]
    for rival in accepted[1:]:
        if rival.arc_px > RIVAL_ARC_SHARE * best.arc_px and _contradicts(best, rival):
            return Refusal(Outcome.AMBIGUOUS, "two curves could be the limb and disagree on the nadir")
    return best.points


def _contradicts(one: Limb, other: Limb) -> bool:
    apart = float(off_axis_angle(one.cone.axis_cam, other.cone.axis_cam))
    sigma = np.hypot(one.uncertainty.sigma_axis_rad, other.uncertainty.sigma_axis_rad)
    return bool(apart > max(RIVAL_ANGLE_RAD, RIVAL_SIGMAS * sigma))
