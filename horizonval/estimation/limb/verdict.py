"""Is a consensus the Earth's limb? Every reason to doubt it, each with its own refusal.

A wrong attitude that is claimed is worse than none, so a cone must pass all of:

* *long enough*: the unbroken limb measures a fifth of the image's width (and a dozen pixels);
* *complete*: it covers a fair share of the cone's limb that lies in the image. A limb is lit over half of its length at
  least when the whole disc is in view; arcs picked from clouds or text are patches;
* *space outside*: hardly any edges lie beyond it, and the grey level there is nearly constant compared with the step at
  the limb. Clouds, coastlines, text and the terminator have a world on both sides;
* *curved*: the half-angle differs from 90 deg (a straight line) by several of its own standard deviations, else the
  Earth's side is unknown, and stays below what the lowest orbit shows;
* *certain*: the nadir's standard deviation is below two degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.limb.consensus import Candidate, EdgePoints, off_limb_px, unbroken_px
from horizonval.estimation.limb.model.shading import SHARP, unshade
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.limb.ranks import median
from horizonval.estimation.limb.result import LimbPoints
from horizonval.estimation.limb.shape.cone import ConeUncertainty, arc_order, cone_uncertainty
from horizonval.estimation.limb.subpixel import refine
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.cone import Cone, fit_cone
from horizonval.geometry.directions import off_axis_angle, tangent_basis

SHORTEST_SHARE_OF_WIDTH = 0.2
SHORTEST_ARC_PX = 10.0
SMALLEST_FILL = 0.3
LARGEST_OUTSIDE = 0.4
"""Edge points outside the limb per limb point."""
OUTSIDE_MARGIN_PX = 4.0
LARGEST_OUTER_SPREAD = 0.5
SMALLEST_SIDE_AGREEMENT = 0.9
HALO_SLOPE = 0.1
"""Fall of the grey level between 8 and 24 px outside a saturated disc, over the step: glare falls on, space is flat."""
LARGEST_RHO_RAD = float(np.deg2rad(82.0))
"""A camera 60 km up sees the Earth at 82 deg; nothing orbits there."""
CURVATURE_SIGMAS = 5.0
LARGEST_SIGMA_RAD = float(np.deg2rad(2.0))
SMALLEST_SHARPNESS = 0.8
"""Of the sharpness of the limb's sharper quarter. Where the limb is softer the terminator begins or the air is lit from
behind, and the edge sinks below the horizon: on a full disc seen from far away the night side would pull the centre."""
FEWEST_POINTS = 8
TRIM_SIGMAS = 3.5
SMALLEST_TRIM_PX = 0.4


@dataclass(frozen=True)
class Limb:
    """An accepted limb: its points, the cone through them and how long it is."""

    points: LimbPoints
    cone: Cone
    uncertainty: ConeUncertainty
    arc_px: float


def judge(
    picture: Picture,
    camera: CameraModel,
    sight: EdgePoints,
    candidate: Candidate,
    others: EdgePoints,
    others_weight: float,
    rim_px: int,
) -> Limb | Refusal:
    """Refine a candidate's points and decide whether they are a limb.

    Parameters
    ----------
    picture : Picture
        A refused candidate's reason names what failed first.
    camera : CameraModel
    sight : EdgePoints
        The points that ``candidate.rows`` index.
    candidate : Candidate
    others : EdgePoints
        Edge points of the whole image (or a random sample), to see what lies outside.
    others_weight : float
        Number of edge points that each of ``others`` stands for.
    rim_px : int
        Width of the image's rim where no points are looked for.
    """
    image = picture.grey
    shortest = max(SHORTEST_ARC_PX, SHORTEST_SHARE_OF_WIDTH * image.shape[1])
    uv, kept, sharpness = refine(image, sight.uv[candidate.rows], sight.gradient[candidate.rows])
    if len(uv) < FEWEST_POINTS:
        return _short_or_none(candidate.arc_px, shortest)
    points = _trim(_LimbPoints(uv, unproject(camera, uv), sight.gradient[candidate.rows][kept], sharpness), camera)
    if len(points.uv) < FEWEST_POINTS:
        return _short_or_none(candidate.arc_px, shortest)
    cone = fit_cone(points.los)
    points = points.take(arc_order(points.los, cone.axis_cam))
    arc = unbroken_px(points.uv)
    if arc < shortest:
        return _short_or_none(arc, shortest)
    # The length counts all of the limb, the fit only where it is sharp: see SMALLEST_SHARPNESS.
    sharp = points.sharpness >= SMALLEST_SHARPNESS * np.percentile(points.sharpness, 75)
    points = _trim(points.take(sharp), camera)
    if len(points.uv) < FEWEST_POINTS:
        return _short_or_none(candidate.arc_px, shortest)
    points = _unshaded(points, image, camera)
    uv, los, gradient = points.uv, points.los, points.gradient
    cone = fit_cone(los)
    outside = float(np.sum(off_limb_px(others, cone.axis_cam, cone.cos_rho) < -OUTSIDE_MARGIN_PX)) * others_weight
    if outside > LARGEST_OUTSIDE * len(uv):
        return Refusal(
            Outcome.NO_LIMB, f"{outside:.0f} edge points lie outside the best curve of {len(uv)}: no space there"
        )
    if (refusal := _sides(picture, cone, camera, uv, gradient)) is not None:
        return refusal
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    try:
        uncertainty = cone_uncertainty(los, cone.axis_cam, rho)
    except np.linalg.LinAlgError:
        return Refusal(Outcome.SHORT_ARC, "the points do not determine a cone")
    if np.pi / 2 - rho < CURVATURE_SIGMAS * uncertainty.sigma_rho_rad:
        return Refusal(Outcome.SHORT_ARC, "the curve is straight within its noise: the Earth's side is unknown")
    if rho > LARGEST_RHO_RAD:
        return Refusal(
            Outcome.NO_LIMB, f"the curve's angular radius of {np.rad2deg(rho):.1f} deg is no orbit's horizon"
        )
    if uncertainty.sigma_axis_rad > LARGEST_SIGMA_RAD:
        sigma = np.rad2deg(uncertainty.sigma_axis_rad)
        return Refusal(Outcome.SHORT_ARC, f"the arc determines the nadir only to {sigma:.1f} deg")
    visible = _visible_px(camera, cone.axis_cam, rho, rim_px)
    if arc < SMALLEST_FILL * visible:
        return Refusal(Outcome.NO_LIMB, f"only {arc / visible:.0%} of the best curve's length in the image is an edge")
    return Limb(LimbPoints(uv, los), cone, uncertainty, arc)


def _short_or_none(arc: float, shortest: float) -> Refusal:
    if arc > 0.4 * shortest:
        return Refusal(Outcome.SHORT_ARC, f"{arc:.0f} px of limb in view; {shortest:.0f} are needed")
    return Refusal(Outcome.NO_LIMB, f"the longest consistent curve measures {arc:.0f} px")


@dataclass(frozen=True)
class _LimbPoints:
    uv: FloatArray
    los: FloatArray
    gradient: FloatArray
    sharpness: FloatArray

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> _LimbPoints:
        return _LimbPoints(self.uv[rows], self.los[rows], self.gradient[rows], self.sharpness[rows])


def _unshaded(points: _LimbPoints, image: FloatArray, camera: CameraModel) -> _LimbPoints:
    """Return a hard limb's points freed of the shading's bias; a soft limb's as they are."""
    if median(points.sharpness) < SHARP:
        return points
    uv, kept = unshade(image, camera, fit_cone(points.los).axis_cam, points.uv, points.gradient)
    return _LimbPoints(uv, unproject(camera, uv), points.gradient[kept], points.sharpness[kept])


def _trim(points: _LimbPoints, camera: CameraModel) -> _LimbPoints:
    """Leave out refined points beyond 3.5 robust standard deviations of the limb, twice."""
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    for _ in range(2):
        if len(points.uv) < FEWEST_POINTS:
            break
        cone = fit_cone(points.los)
        angle = off_axis_angle(points.los, cone.axis_cam)
        off = np.abs(angle - median(angle))
        bound = max(TRIM_SIGMAS * 1.4826 * median(off), SMALLEST_TRIM_PX * rad_per_px)
        points = points.take(off <= bound)
    return points


def _sides(picture: Picture, cone: Cone, camera: CameraModel, uv: FloatArray, gradient: FloatArray) -> Refusal | None:
    """Refuse if the outer side is not one level, or the inner side is not on the same side of it everywhere."""
    height, width = picture.grey.shape
    reach = float(np.clip(min(height, width) / 12.0, 2.5, 8.0))
    step = 1.0
    inner_los = unproject(camera, uv + step * gradient) @ cone.axis_cam
    outer_los = unproject(camera, uv - step * gradient) @ cone.axis_cam
    inward = np.where(inner_los > outer_los, 1.0, -1.0)[:, None] * gradient
    levels = []
    for distance in (reach, -reach, 3.0 * reach, -3.0 * reach):
        at = np.rint(uv + distance * inward).astype(int)
        levels.append(
            picture.mean[np.clip(at[:, 1], 0, height - 1), np.clip(at[:, 0], 0, width - 1)].astype(np.float64)
        )
    inner, outer = levels[:2]
    difference = inner - outer
    typical = median(difference)
    agree = float(np.mean(np.sign(difference) == np.sign(typical)))
    spread = 1.4826 * median(np.abs(outer - median(outer)))
    deep, further = levels[2:]
    saturated_inside = float(np.mean(deep >= picture.brightest * (1 - 1e-6))) > 0.9 and typical > 0
    still_falling = median(outer - further) > HALO_SLOPE * median(inner - further)
    if saturated_inside and still_falling:
        return Refusal(Outcome.SUN_GLARE, "the best curve is the rim of a saturated blob with a halo")
    if typical == 0.0 or agree < SMALLEST_SIDE_AGREEMENT:
        return Refusal(
            Outcome.NO_LIMB, f"the best curve has its bright side inside along {agree:.0%} of its length only"
        )
    if spread > LARGEST_OUTER_SPREAD * abs(typical):
        return Refusal(Outcome.NO_LIMB, "the grey level outside the best curve varies too much to be space")
    return None


def _visible_px(camera: CameraModel, axis: FloatArray, rho: float, rim_px: int) -> float:
    """Return the length [px] of a cone's limb inside the image, its rim left out."""
    angle = np.linspace(0.0, 2.0 * np.pi, 3601)
    basis = tangent_basis(axis)
    around = np.cos(angle)[:, None] * basis[:, 0] + np.sin(angle)[:, None] * basis[:, 1]
    uv, in_front = project(camera, np.cos(rho) * axis + np.sin(rho) * around)
    with np.errstate(invalid="ignore"):
        inside = (
            in_front & (uv >= rim_px).all(axis=1) & (uv < (camera.width - rim_px, camera.height - rim_px)).all(axis=1)
        )
        length = np.hypot(*np.diff(uv, axis=0).T)
    return float(length[inside[1:] & inside[:-1]].sum())
