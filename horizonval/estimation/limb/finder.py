"""Image in, limb points out: the limb that makes the picture most probable, coarse to fine.

1. The picture is reduced by halves (:mod:`.pyramid`); at small sizes cones through agreeing edge points are proposed
   (:mod:`.proposals`).
2. Each is judged by the likelihood of the pixels across it, with a limb there and without (:mod:`.evidence`), the Earth
   the brighter side or the darker. The best is fitted anew at each larger size.
3. A limb is claimed where most of the cone in view shows, with space outside of it, and where it determines a nadir.
   Another cone with half of its likelihood and another nadir makes it ambiguous.
4. Its points are measured at the finest size that still shows it (:mod:`.locate`).

``find_limb`` does all of it. ``find_edges_only`` and ``find_canny_pixels`` are the published methods' searches: every
edge of the image, right only where the limb is the only edge.

The Sun is a compact saturated blob whose rim is a perfect circle before a flat sky: a limb, except that it is too
small.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.cone import ConeUncertainty, cone_uncertainty
from horizonval.estimation.limb.edges import Edges, find_edges, half_window, refine
from horizonval.estimation.limb.evidence import (
    MOST_SECTORS,
    PROFILES,
    SHIFTS_PX,
    WIDTHS_PX,
    Evidence,
    inner_reach,
    weigh,
)
from horizonval.estimation.limb.locate import points_of
from horizonval.estimation.limb.picture import (
    DARK_LEVEL,
    MEDIAN_TO_SIGMA,
    TRIM_SIGMAS,
    Picture,
    check_image,
    median,
    percentile,
)
from horizonval.estimation.limb.proposals import FEWEST_POINTS, LimbPoints, propose
from horizonval.estimation.limb.pyramid import (
    LARGEST_FINE_PX,
    PyramidLevel,
    levels_of,
    trace_limb,
    without_disc,
)
from horizonval.estimation.prior import MEAN_RADIUS_M, Prior
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.horizon import Cone, fit_cone
from horizonval.geometry.rotation import off_axis_angle

NOTHING_KNOWN = Prior()
LARGEST_SHARE_OF_SIDE = 0.3
"""A blob wider than this share of the image's smaller side is not called the Sun."""
SMALLEST_PIXELS = 9
"""Three by three: hot pixels are fewer."""
SMALLEST_SHARE_OF_SATURATED = 0.6
"""The Sun is most of what is saturated; sunlit clouds saturate in many patches."""


@dataclass(frozen=True)
class SunBlob:
    """A saturated blob: centre (column, row) and radius [px]."""

    column: float
    row: float
    radius_px: float


def find_sun(saturated: NDArray[np.bool_]) -> SunBlob | None:
    """Return the largest compact blob of saturated pixels (:func:`.picture.saturated_pixels`), or None."""
    height, width = saturated.shape
    pixels = np.count_nonzero(saturated)
    # Nothing, or more than the largest Sun could be most of.
    largest = (LARGEST_SHARE_OF_SIDE * min(height, width)) ** 2
    if pixels < SMALLEST_PIXELS or SMALLEST_SHARE_OF_SATURATED * pixels > largest:
        return None
    mask = saturated.view(np.uint8)
    first_column, first_row, across, down = cv2.boundingRect(mask)
    lit = np.ascontiguousarray(mask[first_row : first_row + down, first_column : first_column + across])
    count, _, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)
    stats[:, :2] += (first_column, first_row)
    best: SunBlob | None = None
    best_area = SMALLEST_PIXELS - 1
    for left, top, wide, high, area in stats[1:count]:
        at_rim = left == 0 or top == 0 or left + wide == width or top + high == height
        compact = area > 0.6 * wide * high and (at_rim or 0.6 < wide / high < 1.7)
        if compact and max(wide, high) < LARGEST_SHARE_OF_SIDE * min(height, width) and area > best_area:
            best_area = int(area)
            best = SunBlob(left + (wide - 1) / 2, top + (high - 1) / 2, max(wide, high) / 2)
    enough = best_area >= SMALLEST_SHARE_OF_SATURATED * pixels
    return best if enough else None


STILL_SHOWN = float(np.sqrt(0.5))
"""Likelihood relative to the largest over all sizes, from which the search refines a limb with the widest tried edge: a
resolved limb gains nothing from smaller pixels and soon exceeds the window."""
STILL_SEEN = 0.25
"""The same for a sharp limb: half the pixel size halves contrast over noise, and quarters the log likelihood."""
TRIED = 2
"""Cones of a level that are followed to larger ones: the most probable one, and what might contradict it."""
WHOLE = 0.9
"""Visible share of the cone's limb above which no other cone is searched."""
SHORTEST_SHARE_OF_WIDTH = 0.2
"""Smallest limb relative to the field: a tenth is half a pixel from straight in the smallest image from low orbit."""
SMALLEST_FILL = 0.3
"""Smallest visible share of the cone's limb in view: the Sun lights half a full disc, clouds hide some of it."""
SAME_SIDE = 0.9
"""Share of the visible limb with the Earth inside: chance gives half, a dark cloud hides a tenth."""
RIVAL_SHARE = 0.5
"""Log likelihood of a rival, relative to the best curve, that puts it in doubt: limb half as long."""
SIGMAS = 5.0
"""Significance of a curve against a straight line, and of two nadirs: one in a million by chance."""
LARGEST_RHO_RAD = float(np.deg2rad(82.0))
"""A camera 60 km up sees the Earth at 82 deg; nothing orbits there, and a prior says whose camera is lower."""
LARGEST_SIGMA_RAD = float(np.deg2rad(2.0))
"""Largest standard deviation of the nadir; beyond, dependent methods cannot distinguish a limb from a line."""
LOWEST_M = 1e3
"""Lowest altitude of a camera: below, the ground is what limits its view."""
TALLEST_AIR_M = 120e3
"""Airglow and aurora: what shines higher is not the Earth's."""
LEAST_SIGNAL = 3.0
"""Smallest brightness of the Earth over the pixel noise: less is below ten electrons, and masked noise looks like a
disc."""
OTHER_SHARE = 0.3
"""Difference from space, relative to the limb's step, above which a pixel shows an object."""
MOST_OTHER = 0.3
"""Largest share of the sky in view with objects: the Moon, the Sun with its glare, a part of the spacecraft."""
PIECES = 32
"""Pieces of the visible limb over which its step is averaged: clouds vary faster along it than sunlight."""
FADED_SHARE = 0.7
"""Ratio of the limb's step to the step deep inside (upper quartile), below which the limb has faded near the
terminator, where the edge sinks below the horizon."""
SMALLEST_TRIM_PX = 0.4
"""Points nearer to the cone are kept: a noiseless limb has no spread but that of the pixels' own squares."""
SUN_REACH = 2.0
"""Radii of a saturated blob that are left out: its bloom."""
LARGEST_SUN_RADIUS_RAD = float(np.deg2rad(3.0))
"""Largest radius of the Sun (0.27 deg) with its glare; a larger blob may be a saturated Earth and is not left out."""
ROUGH_SIGMAS = 3.0
"""Standard deviations of a rough nadir, and of what a limb may be wrong by, within which the two agree."""
LIMB_SHARE = 0.4
"""Canny's upper threshold, relative to strong gradients, where all edges count as limb; discs of 50 to 200 px have
steep shading."""
DARK_CONTRAST = 0.02
"""Contrast of full scale between middle and brightest pixels, five levels of eight bits: below, and darker than
:data:`DARK_LEVEL`, the scene is unlit rather than uniformly bright."""


def find_limb(
    image: FloatArray, camera: CameraModel, full_scale: float | None = None, prior: Prior = NOTHING_KNOWN
) -> LimbPoints | Refusal:
    """Return the sub-pixel points of the Earth's limb in order, or why there are none.

    ``image``: shape (H, W), grey levels monotonic in radiance; anything else is refused. ``camera``: of the image's
    size; ``full_scale``: digital number of saturation; ``prior``: its altitude bounds the angular radius, and its
    attitude decides between two curves.
    """
    found = find_limb_and_picture(image, camera, full_scale, prior)
    return found if isinstance(found, Refusal) else found[0]


def find_limb_and_picture(
    image: FloatArray, camera: CameraModel, full_scale: float | None = None, prior: Prior = NOTHING_KNOWN
) -> tuple[LimbPoints, Picture] | Refusal:
    """Return the limb of an image and the picture that it was found in; otherwise as :func:`find_limb`."""
    picture = picture_of(image, camera, full_scale)
    if isinstance(picture, Refusal):
        return picture
    found = _find_limb_in(picture, camera, largest_rho_rad(prior), prior.rough_nadir)
    return found if isinstance(found, Refusal) else (found, picture)


def altitude_in_air_m(prior: Prior) -> float | None:
    """Return the lowest altitude that is known of a camera if it is below all orbits, else None."""
    altitude, sigma = prior.altitude_m, prior.altitude_sigma_m
    if altitude is None and prior.r_itrs is not None:
        altitude, sigma = float(np.linalg.norm(prior.r_itrs)) - prior.sphere_radius_m, prior.position_sigma_m
    if altitude is None or sigma is None:
        return None
    lowest = max(altitude - SIGMAS * sigma, LOWEST_M)
    return lowest if prior.sphere_radius_m > (prior.sphere_radius_m + lowest) * np.sin(LARGEST_RHO_RAD) else None


def largest_rho_rad(prior: Prior) -> float:
    """Return the largest angular radius of a limb: that of an orbit, or of a camera that is known to be lower."""
    lowest = altitude_in_air_m(prior)
    if lowest is None:
        return LARGEST_RHO_RAD
    rho = float(np.arcsin(prior.sphere_radius_m / (prior.sphere_radius_m + lowest)))
    return min(rho + LARGEST_SIGMA_RAD, 0.5 * np.pi)


def picture_of(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> Picture | Refusal:
    """Return an image that may hold a limb as a picture, or why it holds none; parameters as for :func:`find_limb`."""
    if (refusal := check_image(image, full_scale)) is not None:
        return refusal
    if image.shape != (camera.height, camera.width):
        return wrong_size(image, camera)
    return Picture(image, full_scale)


def wrong_size(image: FloatArray, camera: CameraModel) -> Refusal:
    """Return the refusal of an image (H, W) that is not its camera's."""
    return Refusal(
        Outcome.BAD_INPUT,
        f"the image is {image.shape[1]} x {image.shape[0]} pixels, the camera {camera.width} x {camera.height}",
    )


def _find_limb_in(
    picture: Picture, camera: CameraModel, largest_rho_rad: float, rough_nadir: tuple[FloatArray, float] | None
) -> LimbPoints | Refusal:
    """Return the limb of a picture of this camera; as :func:`find_limb`."""
    sun = find_sun(picture.saturated)
    levels = levels_of(picture, camera)
    if sun is not None and sun.radius_px / camera.fx < LARGEST_SUN_RADIUS_RAD:
        levels = without_disc(levels, sun.column, sun.row, SUN_REACH * sun.radius_px + 1.0)
    verdicts = sorted(_verdicts(levels, camera, largest_rho_rad, rough_nadir), key=lambda one: -one[0])
    accepted = [one for _, one in verdicts if isinstance(one, FoundLimb)]
    doubts = [(score, one) for score, one in verdicts if isinstance(one, Refusal)]
    # A refused limb that is far more probable is the right one, so that no other is returned.
    if not accepted or (doubts and accepted[0].score < RIVAL_SHARE * doubts[0][0]):
        short = (one for _, one in doubts if one.status is Outcome.SHORT_ARC)
        return _refused(picture, sun is not None, next(short, doubts[0][1] if doubts else None))
    rivals = [one for one in accepted if one.score > RIVAL_SHARE * accepted[0].score]
    rivals = [one for one in rivals if _agrees(one.cone.axis_cam, rough_nadir)] or rivals
    best = rivals[0]
    if any(_contradicts(best, rival) for rival in rivals[1:]):
        return Refusal(Outcome.AMBIGUOUS, "two curves could be the limb and disagree on the nadir")
    return best.points if best.too_low is None else best.too_low


@dataclass(frozen=True)
class FoundLimb:
    """A limb that is believed: its points, the cone through them, and its likelihood.

    ``too_low``: why it is refused, if it is the limb of a camera below all orbits and nothing known says so.
    """

    points: LimbPoints
    cone: Cone
    uncertainty: ConeUncertainty
    score: float
    explained: float
    too_low: Refusal | None = None


@dataclass(frozen=True)
class _Candidate:
    """A cone, the number and scale of the level that it was last fitted to, and what that shows of it."""

    axis_cam: FloatArray
    rho_rad: float
    number: int
    scale: float
    evidence: Evidence


def _verdicts(
    levels: list[PyramidLevel],
    camera: CameraModel,
    largest_rho_rad: float,
    rough_nadir: tuple[FloatArray, float] | None,
) -> list[tuple[float, FoundLimb | Refusal]]:
    """Return verdict and score of every level's most probable cones, smallest level first."""
    verdicts: list[tuple[float, FoundLimb | Refusal]] = []
    tried: list[_Candidate] = []
    for number in range(len(levels) - 1, -1, -1):
        if max(levels[number].grey.shape) > LARGEST_FINE_PX and number < len(levels) - 1:
            break
        for one in _proposed(levels[number], number, camera, largest_rho_rad, rough_nadir):
            if any(_same(one, other) for other in tried):
                continue
            found = _followed(levels, camera, one)
            if not any(_same(found, other) for other in tried):
                verdicts.append((found.evidence.score, _judged(levels, camera, found, largest_rho_rad)))
            tried += [one, found]
        found_limbs = [one for _, one in verdicts if isinstance(one, FoundLimb)]
        if any(one.explained > WHOLE and _agrees(one.cone.axis_cam, rough_nadir) for one in found_limbs):
            break
    return verdicts


def _proposed(
    level: PyramidLevel,
    number: int,
    camera: CameraModel,
    largest_rho_rad: float,
    rough_nadir: tuple[FloatArray, float] | None,
) -> list[_Candidate]:
    """Return the most probable cones of a level, the most probable first."""
    found: list[_Candidate] = []
    for one in propose(level, camera, min(largest_rho_rad + LARGEST_SIGMA_RAD, 0.5 * np.pi)):
        evidence = weigh(level, camera, one.axis_cam, one.rho_rad)
        if evidence is not None and evidence.explained >= 0.5 * SMALLEST_FILL and evidence.score > 0.0:
            found.append(_Candidate(one.axis_cam, one.rho_rad, number, level.scale, evidence))
            if evidence.explained > WHOLE and _agrees(one.axis_cam, rough_nadir):
                break
    return sorted(found, key=lambda one: -one.evidence.score)[:TRIED]


def _same(one: _Candidate, other: _Candidate) -> bool:
    """Whether two cones have the same limb in view, to the pixels of the coarser one."""
    off = off_axis_angle(one.evidence.los, other.axis_cam) - other.rho_rad
    return bool(median(np.abs(off)) < SHIFTS_PX[-1] * max(one.evidence.px_rad, other.evidence.px_rad))


def _followed(levels: list[PyramidLevel], camera: CameraModel, start: _Candidate) -> _Candidate:
    """Return a cone fitted to one level after another, down to the finest that still shows it."""
    best, largest = start, start.evidence.score
    for number in range(start.number, -1, -1):
        here = _fitted(levels[number], number, camera, best)
        if here is None:
            break
        sharp = number < best.number and here.evidence.width_px < WIDTHS_PX[-1]
        if here.evidence.score < (STILL_SEEN if sharp else STILL_SHOWN) * largest:
            break
        best, largest = here, max(largest, here.evidence.score)
    # The width of the edge is that at a cone of this level.
    return _fitted(levels[best.number], best.number, camera, best) or best


def _fitted(level: PyramidLevel, number: int, camera: CameraModel, start: _Candidate) -> _Candidate | None:
    """Return the cone through the sectors that show a limb, and what a level shows of it."""
    shown = start.evidence.los[start.evidence.shows]
    if len(shown) < 3:
        return None
    axis = fit_cone(shown).axis_cam
    rho = float(off_axis_angle(shown, axis).mean())
    evidence = weigh(level, camera, axis, rho)
    return None if evidence is None else _Candidate(axis, rho, number, level.scale, evidence)


def _judged(
    levels: list[PyramidLevel], camera: CameraModel, found: _Candidate, largest_rho_rad: float
) -> FoundLimb | Refusal:
    """Decide whether a cone is the limb."""
    evidence, level = found.evidence, levels[found.number]
    shortest = SHORTEST_SHARE_OF_WIDTH * camera.width
    if evidence.arc_px < shortest:
        if evidence.arc_px > 0.4 * shortest:
            return Refusal(Outcome.SHORT_ARC, f"{evidence.arc_px:.0f} px of limb in view; {shortest:.0f} are needed")
        return Refusal(Outcome.NO_LIMB, f"the longest consistent curve measures {evidence.arc_px:.0f} px")
    if evidence.explained < SMALLEST_FILL:
        return Refusal(Outcome.NO_LIMB, f"{evidence.explained:.0%} of the best curve in the image is a limb")
    if evidence.bright_side < SAME_SIDE:
        return Refusal(
            Outcome.NO_LIMB,
            f"the best curve's inside is what its edge says along {evidence.bright_side:.0%} of it only",
        )
    bright = abs(median(evidence.step[evidence.shows]))
    if bright < LEAST_SIGNAL * _grain(levels[0], camera, found):
        return Refusal(Outcome.NO_LIMB, "the best curve's inside is noise")
    if (refusal := _sky(levels[-1], camera, found)) is not None:
        return refusal
    uv, step, deep = points_of(level, camera, found.axis_cam, found.rho_rad, evidence.width_px, evidence.bright_inside)
    if len(uv):
        uv = uv[_lit(step, deep)]
    uv, los = _trimmed(uv, camera)
    if len(uv) < FEWEST_POINTS:
        return Refusal(Outcome.SHORT_ARC, f"{len(uv)} limb points; {FEWEST_POINTS} are needed")
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    try:
        uncertainty = cone_uncertainty(los, cone.axis_cam, rho)
    except np.linalg.LinAlgError:
        return Refusal(Outcome.SHORT_ARC, "the points do not determine a cone")
    if np.pi / 2 - rho < SIGMAS * uncertainty.sigma_rho_rad:
        return Refusal(Outcome.SHORT_ARC, "the curve is straight within its noise: the Earth's side is unknown")
    if uncertainty.sigma_axis_rad > LARGEST_SIGMA_RAD:
        sigma = np.rad2deg(uncertainty.sigma_axis_rad)
        return Refusal(Outcome.SHORT_ARC, f"the arc determines the nadir only to {sigma:.1f} deg")
    too_low = None
    if rho > largest_rho_rad:
        degrees = np.rad2deg(rho)
        too_low = Refusal(Outcome.NO_LIMB, f"the curve's angular radius of {degrees:.1f} deg is no orbit's horizon")
    points = LimbPoints(uv, los, int(level.scale))
    return FoundLimb(points, cone, uncertainty, evidence.score, evidence.explained, too_low)


def _grain(finest: PyramidLevel, camera: CameraModel, found: _Candidate) -> float:
    """Return the standard deviation of a pixel's noise inside a curve: of differences of neighbours, half of them."""
    trace = trace_limb(camera, found.axis_cam, found.rho_rad, 2.0 * finest.scale, PROFILES * MOST_SECTORS)
    inside = inner_reach(trace, found.rho_rad, found.scale) * found.scale
    # Whole pixels: between them noise is smoothed.
    places = np.rint(trace.uv + inside * trace.inwards)
    one, known = finest.at(places)
    other, also = finest.at(places + np.array([1.0, 0.0]))
    difference = np.abs(one - other)[known & also]
    return MEDIAN_TO_SIGMA * median(difference) / np.sqrt(2.0) if len(difference) else 0.0


def _sky(coarsest: PyramidLevel, camera: CameraModel, found: _Candidate) -> Refusal | None:
    """Refuse a curve outside of which there is more than space."""
    height, width = coarsest.grey.shape
    v, u = np.mgrid[:height, :width].reshape(2, -1)
    known = np.ones(len(u), dtype=bool) if coarsest.known is None else coarsest.known[v, u]
    los = unproject(camera, coarsest.scale * np.column_stack([u, v]).astype(np.float64))
    outside = off_axis_angle(los, found.axis_cam) - found.rho_rad
    margin = max(TALLEST_AIR_M / MEAN_RADIUS_M * np.tan(found.rho_rad), SHIFTS_PX[-1] * coarsest.scale / camera.fx)
    with np.errstate(invalid="ignore"):
        sky = known & (outside > margin)
    shows = found.evidence.shows
    step = abs(median(found.evidence.step[shows]))
    if np.count_nonzero(sky) < FEWEST_POINTS:
        return None
    levels = coarsest.grey[v[sky], u[sky]].astype(np.float64)
    other = float(np.mean(np.abs(levels - median(levels)) > OTHER_SHARE * step))
    if other > MOST_OTHER:
        return Refusal(Outcome.NO_LIMB, f"{other:.0%} of what lies outside the best curve is no space")
    return None


def _lit(step: FloatArray, deep: FloatArray) -> NDArray[np.bool_]:
    """Return at which points of a limb the Earth is lit at the limb itself, and not only further inside."""
    size = max(len(step) // PIECES, 1)
    at_limb, inside = (uniform_filter1d(np.abs(some), size, mode="nearest") for some in (step, deep))
    share = at_limb / np.maximum(inside, np.finfo(float).tiny)
    return np.asarray(share >= FADED_SHARE * percentile(share, 75.0))


def _trimmed(uv: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray]:
    """Return points and their lines of sight without those beyond 3.5 robust standard deviations of the limb."""
    los = unproject(camera, uv)
    seen = np.isfinite(los).all(axis=1)
    uv, los = uv[seen], los[seen]
    smallest = SMALLEST_TRIM_PX / max(camera.fx, camera.fy)
    for _ in range(2):
        if len(uv) < FEWEST_POINTS:
            break
        angle = off_axis_angle(los, fit_cone(los).axis_cam)
        off = np.abs(angle - median(angle))
        good = off <= max(TRIM_SIGMAS * MEDIAN_TO_SIGMA * median(off), smallest)
        uv, los = uv[good], los[good]
    return uv, los


def _contradicts(one: FoundLimb, other: FoundLimb) -> bool:
    apart = float(off_axis_angle(one.cone.axis_cam, other.cone.axis_cam))
    sigma = np.hypot(one.uncertainty.sigma_axis_rad, other.uncertainty.sigma_axis_rad)
    return bool(apart > max(LARGEST_SIGMA_RAD, SIGMAS * sigma))


def _agrees(axis_cam: FloatArray, rough_nadir: tuple[FloatArray, float] | None) -> bool:
    """Whether a cone is where a rough direction of the nadir, with its sigma, has it; any where there is none."""
    if rough_nadir is None:
        return True
    nadir_cam, sigma_rad = rough_nadir
    return float(off_axis_angle(axis_cam, nadir_cam)) <= ROUGH_SIGMAS * float(np.hypot(sigma_rad, LARGEST_SIGMA_RAD))


def find_edges_only(image: FloatArray, camera: CameraModel, full_scale: float | None = None) -> LimbPoints | Refusal:
    """Return every refined edge point, without a test that it is limb; arguments as for :func:`find_limb`."""
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
    """Return every Canny pixel unrefined and untested, with the threshold :data:`LIMB_SHARE`; see :func:`find_limb`."""
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
    return Edges(edges.uv[rows], edges.gradient[rows])


def _inside_image_circle(edges: Edges, camera: CameraModel, rim_px: int) -> Edges:
    """Leave out the lens's own edge: a perfect cone with nothing outside, everything a limb is."""
    if camera.image_circle_rad is None:
        return edges
    outwards = edges.uv - (camera.cx, camera.cy)
    length = np.maximum(np.hypot(*outwards.T), 1e-9)[:, None]
    further = unproject(camera, edges.uv + rim_px * outwards / length)
    return _take(edges, np.asarray(np.isfinite(further).all(axis=1)))


def _refused(picture: Picture, dazzled: bool, first: Refusal | None) -> Refusal:
    """Return why a picture without a limb has none; ``first``: what was said of its most probable curve."""
    saturated, full_scale = picture.saturated, picture.full_scale
    if dazzled:
        why = "no other edge" if first is None else first.reason
        return Refusal(Outcome.SUN_GLARE, f"a saturated blob is in view; without it, {why}")
    if saturated.mean() > 0.5:
        return Refusal(Outcome.SATURATED, f"{saturated.mean():.0%} of the pixels are saturated and no limb is left")
    if full_scale is not None:
        # a converter's black level is not light: what counts is how far the brightest pixels rise above the rest
        middle, bright = np.percentile(picture.grey, (50.0, 99.9))
        if bright - middle < DARK_CONTRAST * full_scale and bright < DARK_LEVEL * full_scale:
            return Refusal(Outcome.DARK, f"no edge, and a flat {middle / full_scale:.0%} of full scale")
    return Refusal(Outcome.NO_LIMB, "no edge stands out of the noise") if first is None else first
