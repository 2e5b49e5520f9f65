"""Image in, limb points out: the limb that makes the picture most probable, coarse to fine.

1. The picture is reduced by halves (:mod:`.pyramid`); at small sizes cones through agreeing edge points are proposed
   (:mod:`.proposals`).
2. Each is judged by the likelihood of the pixels across it, with a limb there and without (:mod:`.evidence`), the Earth
   the brighter side or the darker. The best is fitted anew at each larger size.
3. A limb is claimed where most of the cone in view shows, with space outside of it, and where it determines a nadir.
   Another cone with half of its likelihood and another nadir makes it ambiguous.
4. Its points are measured at the finest size that still shows it (:mod:`.locate`).

A saturated blob that looks like the Sun is named where no limb is found.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.cone import ConeUncertainty, cone_uncertainty, near_cone
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
    DARK_CONTRAST,
    DARK_LEVEL,
    FEWEST_POINTS,
    MEDIAN_TO_SIGMA,
    LimbPoints,
    Picture,
    median,
    percentile,
    picture_of,
)
from horizonval.estimation.limb.proposals import propose
from horizonval.estimation.limb.pyramid import LARGEST_FINE_PX, levels_of, trace_limb
from horizonval.estimation.observation import Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

NOTHING_KNOWN = Prior()


def shows_sun(saturated: NDArray[np.bool_]) -> bool:
    """Return whether the largest blob of saturated pixels (:func:`.picture.saturated_pixels`) looks like the Sun.

    The Sun is three by three pixels at least, since hot pixels are fewer, fills most of its box and 0.3 of the image's
    smaller side at most, is round unless the image's rim cuts it, and is most of what is saturated: sunlit clouds
    saturate in many patches. Most is a share of 0.6.
    """
    height, width = saturated.shape
    pixels = int(np.count_nonzero(saturated))
    largest = 0.3 * min(height, width)
    # Nothing, or more than the largest Sun could be most of.
    if pixels < 9 or 0.6 * pixels > largest**2:
        return False
    _, _, stats, _ = cv2.connectedComponentsWithStats(saturated.view(np.uint8), connectivity=8)
    left, top, wide, high, area = (int(one) for one in stats[1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])])
    at_rim = left == 0 or top == 0 or left + wide == width or top + high == height
    longer = max(wide, high)
    even = at_rim or min(wide, high) > 0.6 * longer
    return bool(even and area >= max(0.6 * max(pixels, wide * high), 9) and longer < largest)


STILL_SEEN = 0.25
"""Likelihood relative to the largest over all sizes, down to which the search follows a limb to smaller pixels: half
the pixel size halves contrast over noise, and quarters the log likelihood."""
COARSE_PX = 144
"""Longer side of the level that a coarse search ends at: a tenth of its pixel is less than a pixel of a megapixel."""
WHOLE = 0.9
"""Visible share of the cone's limb above which no other cone is searched. A limb with its Earth inside along less of it
is none: chance gives half, a dark cloud hides a tenth."""
SMALLEST_FILL = 0.3
"""Smallest visible share of the cone's limb in view: the Sun lights half a full disc, clouds hide some of it."""
RIVAL_SHARE = 0.5
"""Log likelihood of a rival, relative to the best curve, that puts it in doubt: limb half as long."""
SIGMAS = 5.0
"""Threshold of all consistency tests: two Gaussian degrees of freedom exceed it four times in a million."""
LARGEST_RHO_RAD = float(np.deg2rad(82.0))
"""A camera 60 km up sees the Earth at 82 deg; nothing orbits there, and a prior says whose camera is lower."""
LARGEST_SIGMA_RAD = float(np.deg2rad(2.0))
"""Largest standard deviation of the nadir; beyond, dependent methods cannot distinguish a limb from a line."""
LEAST_SIGMAS = 3.0
"""Smallest brightness of the Earth over the pixel noise: less is below ten electrons, and masked noise looks like a
disc. Within as many standard deviations a rough nadir and a limb agree."""


def find_limb(
    image: FloatArray, camera: CameraModel, full_scale: float | None = None, prior: Prior = NOTHING_KNOWN
) -> LimbPoints | Refusal:
    """Return the sub-pixel points of the Earth's limb in order, or why there are none.

    ``image``: shape (H, W), grey levels monotonic in radiance; anything else is refused. ``camera``: of the image's
    size; ``full_scale``: digital number of saturation; ``prior``: its altitude bounds the angular radius, and its
    attitude decides between two curves.
    """
    found = find_limb_and_picture(Observation(image, camera, full_scale=full_scale, prior=prior))
    return found if isinstance(found, Refusal) else found[0]


def find_limb_and_picture(observation: Observation, *, coarse: bool = False) -> tuple[LimbPoints, Picture] | Refusal:
    """Return the limb of an observation and the picture that it was found in, or why there is none.

    ``coarse``: the start of a fit, right to some pixels, is enough: the search ends at a copy of :data:`COARSE_PX`.
    """
    camera = observation.camera
    picture = picture_of(observation.image, camera, observation.full_scale)
    if isinstance(picture, Refusal):
        return picture
    found = _Search(picture, camera, observation.prior, coarse).limb()
    return found if isinstance(found, Refusal) else (found, picture)


def altitude_in_air_m(prior: Prior) -> float | None:
    """Return the lowest altitude that is known of a camera if it is below all orbits, else None."""
    altitude, sigma = prior.altitude_m, prior.altitude_sigma_m
    if altitude is None and prior.r_itrs is not None:
        altitude, sigma = float(np.linalg.norm(prior.r_itrs)) - prior.sphere_radius_m, prior.position_sigma_m
    if altitude is None or sigma is None:
        return None
    # Below 1 km the ground is what limits a view.
    lowest = max(altitude - SIGMAS * sigma, 1e3)
    return lowest if prior.sphere_radius_m > (prior.sphere_radius_m + lowest) * np.sin(LARGEST_RHO_RAD) else None


def largest_rho_rad(prior: Prior) -> float:
    """Return the largest angular radius of a limb: that of an orbit, or of a camera that is known to be lower."""
    lowest = altitude_in_air_m(prior)
    if lowest is None:
        return LARGEST_RHO_RAD
    rho = float(np.arcsin(prior.sphere_radius_m / (prior.sphere_radius_m + lowest)))
    return min(rho + LARGEST_SIGMA_RAD, 0.5 * np.pi)


@dataclass(frozen=True)
class _Candidate:
    """A cone, the number of the level that it was last fitted to, and what that shows of it."""

    axis_cam: FloatArray
    rho_rad: float
    number: int
    evidence: Evidence

    def same(self, other: _Candidate) -> bool:
        """Whether two cones have the same limb in view, to the pixels of the coarser one."""
        off = off_axis_angle(self.evidence.los, other.axis_cam) - other.rho_rad
        return bool(median(np.abs(off)) < SHIFTS_PX[-1] * max(self.evidence.px_rad, other.evidence.px_rad))


@dataclass(frozen=True)
class _FoundLimb:
    """A limb that is believed: its points, the cone through them, its log likelihood, and its visible share."""

    points: LimbPoints
    axis_cam: FloatArray
    uncertainty: ConeUncertainty
    score: float
    explained: float

    def contradicts(self, other: _FoundLimb) -> bool:
        apart = float(off_axis_angle(self.axis_cam, other.axis_cam))
        sigma = np.hypot(self.uncertainty.sigma_axis_rad, other.uncertainty.sigma_axis_rad)
        return bool(apart > max(LARGEST_SIGMA_RAD, SIGMAS * sigma))


class _Search:
    """The search in one picture."""

    def __init__(self, picture: Picture, camera: CameraModel, prior: Prior, coarse: bool) -> None:
        self.picture, self.camera, self.rough_nadir = picture, camera, prior.rough_nadir
        self.largest_rho_rad = largest_rho_rad(prior)
        self.levels = levels_of(picture, camera)
        sides = [max(level.grey.shape) for level in self.levels]
        self.coarse = next((k for k, side in enumerate(sides) if side <= COARSE_PX), len(sides) - 1) if coarse else None

    def limb(self) -> LimbPoints | Refusal:
        """Return the limb's points, or why there are none."""
        verdicts = sorted(self._verdicts(), key=lambda one: -one[0])
        accepted = [one for _, one in verdicts if isinstance(one, _FoundLimb)]
        doubts = [(score, one) for score, one in verdicts if isinstance(one, Refusal)]
        # A refused limb that is far more probable is the right one, so that no other is returned.
        if not accepted or (doubts and accepted[0].score < RIVAL_SHARE * doubts[0][0]):
            short = (one for _, one in doubts if one.status is Outcome.SHORT_ARC)
            return self._refused(next(short, doubts[0][1] if doubts else None))
        rivals = [one for one in accepted if one.score > RIVAL_SHARE * accepted[0].score]
        rivals = [one for one in rivals if self._agrees(one.axis_cam)] or rivals
        best = rivals[0]
        if any(best.contradicts(rival) for rival in rivals[1:]):
            return Refusal(Outcome.AMBIGUOUS, "two curves could be the limb and disagree on the nadir")
        return best.points

    def _verdicts(self) -> list[tuple[float, _FoundLimb | Refusal]]:
        """Return verdict and score of every level's most probable cones, smallest level first."""
        verdicts: list[tuple[float, _FoundLimb | Refusal]] = []
        # A cone that is refused at a small level may show at larger ones.
        accepted: list[_Candidate] = []
        for number in range(len(self.levels) - 1, -1, -1):
            if max(self.levels[number].grey.shape) > LARGEST_FINE_PX and number < len(self.levels) - 1:
                break
            for one in self._proposed(number):
                if any(one.same(other) for other in accepted):
                    continue
                found = self._followed(one, self._last(one))
                verdict = self._judged(found)
                if isinstance(verdict, Refusal) and self.coarse and self._at_sectors(found):
                    found = self._followed(found, 0)
                    verdict = self._judged(found)
                verdicts.append((found.evidence.score, verdict))
                if isinstance(verdict, _FoundLimb):
                    accepted.append(found)
            limbs = [one for _, one in verdicts if isinstance(one, _FoundLimb)]
            if any(one.explained > WHOLE and self._agrees(one.axis_cam) for one in limbs):
                break
        return verdicts

    def _agrees(self, axis_cam: FloatArray) -> bool:
        """Whether a cone is where a rough direction of the nadir has it; any where there is none."""
        if self.rough_nadir is None:
            return True
        nadir_cam, sigma_rad = self.rough_nadir
        off = float(off_axis_angle(axis_cam, nadir_cam))
        return off <= LEAST_SIGMAS * float(np.hypot(sigma_rad, LARGEST_SIGMA_RAD))

    def _proposed(self, number: int) -> list[_Candidate]:
        """Return the most probable cones of a level, the most probable first."""
        found: list[_Candidate] = []
        largest = min(self.largest_rho_rad + LARGEST_SIGMA_RAD, 0.5 * np.pi)
        for axis, rho in propose(self.levels[number], self.camera, largest):
            evidence = weigh(self.levels[number], self.camera, axis, rho)
            if evidence is not None and evidence.explained >= 0.5 * SMALLEST_FILL and evidence.score > 0.0:
                found.append(_Candidate(axis, rho, number, evidence))
                if evidence.explained > WHOLE and self._agrees(axis):
                    break
        # The most probable cone is followed to larger levels, and what might contradict it.
        return sorted(found, key=lambda one: -one.evidence.score)[:2]

    def _followed(self, start: _Candidate, last: int) -> _Candidate:
        """Return a cone fitted to one level after another, down to the finest that still shows it, at most ``last``."""
        best, largest = start, start.evidence.score
        for number in range(max(start.number - 1, last), last - 1, -1):
            here = self._fitted(number, best)
            if here is None:
                break
            # A limb that is resolved gains nothing from smaller pixels and soon exceeds the window.
            resolved = here.evidence.width_px == WIDTHS_PX[-1]
            if here.evidence.score < (0.7 if resolved else STILL_SEEN) * largest:
                break
            best, largest = here, max(largest, here.evidence.score)
        if self._at_sectors(best):
            return best
        # What the level shows is that of a cone of this level.
        here = self._fitted(best.number, best)
        return best if here is None or here.evidence.score < 0.7 * best.evidence.score else here

    def _fitted(self, number: int, start: _Candidate) -> _Candidate | None:
        """Return the cone through the sectors that show a limb, and what a level shows of it."""
        shown = start.evidence.los[start.evidence.shows]
        axis, rho = start.axis_cam, start.rho_rad
        # Near the image's border few profiles of a small level are whole, and a larger one has more.
        if len(shown) >= 3:
            axis = fit_cone(shown).axis_cam
            rho = float(off_axis_angle(shown, axis).mean())
        evidence = weigh(self.levels[number], self.camera, axis, rho)
        return None if evidence is None else _Candidate(axis, rho, number, evidence)

    def _judged(self, found: _Candidate) -> _FoundLimb | Refusal:
        """Decide whether a cone is the limb."""
        evidence, level, camera = found.evidence, self.levels[found.number], self.camera
        # A tenth of the width is half a pixel from straight in the smallest image from low orbit.
        shortest = 0.2 * camera.width
        if evidence.arc_px < 0.4 * shortest:
            return Refusal(Outcome.NO_LIMB, f"the longest consistent curve measures {evidence.arc_px:.0f} px")
        if evidence.arc_px < shortest:
            return Refusal(Outcome.SHORT_ARC, f"{evidence.arc_px:.0f} px of limb in view; {shortest:.0f} are needed")
        step = abs(median(evidence.step[evidence.shows]))
        for wrong, reason in (
            (evidence.explained < SMALLEST_FILL, f"{evidence.explained:.0%} of the best curve in the image is a limb"),
            (
                evidence.bright_side < WHOLE,
                f"the best curve's inside is what its edge says along {evidence.bright_side:.0%} of it only",
            ),
            (step < LEAST_SIGMAS * self._grain(found), "the best curve's inside is noise"),
        ):
            if wrong:
                return Refusal(Outcome.NO_LIMB, reason)
        uv, los = self._points(found)
        good = near_cone(los, 1.0 / max(camera.fx, camera.fy))
        uv, los = uv[good], los[good]
        if len(uv) < FEWEST_POINTS:
            return Refusal(Outcome.SHORT_ARC, f"{len(uv)} limb points; {FEWEST_POINTS} are needed")
        axis = fit_cone(los).axis_cam
        rho = float(off_axis_angle(los, axis).mean())
        try:
            uncertainty = cone_uncertainty(los, axis, rho)
        except np.linalg.LinAlgError:
            return Refusal(Outcome.SHORT_ARC, "the points do not determine a cone")
        if rho > self.largest_rho_rad:
            reason = f"the curve's angular radius of {np.rad2deg(rho):.1f} deg is no orbit's horizon"
            return Refusal(Outcome.NO_LIMB, reason)
        if np.pi / 2 - rho < SIGMAS * uncertainty.sigma_rho_rad:
            return Refusal(Outcome.SHORT_ARC, "the curve is straight within its noise: the Earth's side is unknown")
        if uncertainty.sigma_axis_rad > LARGEST_SIGMA_RAD:
            sigma = np.rad2deg(uncertainty.sigma_axis_rad)
            return Refusal(Outcome.SHORT_ARC, f"the arc determines the nadir only to {sigma:.1f} deg")
        points = LimbPoints(uv, los, int(level.scale))
        return _FoundLimb(points, axis, uncertainty, evidence.score, evidence.explained)

    def _points(self, found: _Candidate) -> tuple[FloatArray, FloatArray]:
        """Return places (n, 2) of a curve's limb and lines of sight (n, 3): of its sectors, or of its pixels."""
        evidence, camera = found.evidence, self.camera
        if self._at_sectors(found):
            los = evidence.los[evidence.shows]
            uv, seen = project(camera, los)
        else:
            level, width = self.levels[found.number], evidence.width_px
            uv, steps, deep = points_of(level, camera, found.axis_cam, found.rho_rad, width, evidence.bright_inside)
            uv = uv[_lit(steps, deep)] if len(uv) else uv
            los = unproject(camera, uv)
            seen = np.asarray(np.isfinite(los).all(axis=1))
        return uv[seen], los[seen]

    def _last(self, found: _Candidate) -> int:
        """Return the number of the level that the search for a curve ends at.

        Discs that the image holds as a whole are far away: all of their unknowns lie within some pixels.
        """
        wide = found.rho_rad * self.camera.fx > 0.5 * min(self.camera.width, self.camera.height)
        return 0 if self.coarse is None or not wide else self.coarse

    def _at_sectors(self, found: _Candidate) -> bool:
        """Whether the places of a curve's sectors are enough for a coarse search."""
        return self.coarse is not None and self._last(found) == self.coarse <= found.number

    def _grain(self, found: _Candidate) -> float:
        """Return the standard deviation of a pixel's noise inside a curve: of differences of neighbours, half."""
        finest, scale = self.levels[0], self.levels[found.number].scale
        trace = trace_limb(self.camera, found.axis_cam, found.rho_rad, 2.0, PROFILES * MOST_SECTORS)
        inside = inner_reach(trace, found.rho_rad, scale) * scale
        # Whole pixels: between them noise is smoothed.
        places = np.rint(trace.uv + inside * trace.inwards)
        (one, other), known = finest.at(np.array([places, places + np.array([1.0, 0.0])]))
        difference = np.abs(one - other)[known.all(axis=0)]
        return MEDIAN_TO_SIGMA * median(difference) / np.sqrt(2.0) if len(difference) else 0.0

    def _refused(self, first: Refusal | None) -> Refusal:
        """Return why a picture without a limb has none; ``first``: what was said of its most probable curve."""
        picture, full_scale = self.picture, self.picture.full_scale
        if shows_sun(picture.saturated):
            why = "no other edge" if first is None else first.reason
            return Refusal(Outcome.SUN_GLARE, f"a saturated blob is in view; without it, {why}")
        share = float(picture.saturated.mean())
        if share > 0.5:
            return Refusal(Outcome.SATURATED, f"{share:.0%} of the pixels are saturated and no limb is left")
        if full_scale is not None:
            # a converter's black level is not light: what counts is how far the brightest pixels rise above the rest
            middle, bright = (percentile(picture.grey, q) for q in (50.0, 99.9))
            if bright - middle < DARK_CONTRAST * full_scale and bright < DARK_LEVEL * full_scale:
                return Refusal(Outcome.DARK, f"no edge, and a flat {middle / full_scale:.0%} of full scale")
        return Refusal(Outcome.NO_LIMB, "no edge stands out of the noise") if first is None else first


def _lit(step: FloatArray, deep: FloatArray) -> NDArray[np.bool_]:
    """Return at which points of a limb the Earth is lit at the limb itself, and not only further inside."""
    # In 32 pieces of the limb: clouds vary faster along it than sunlight.
    size = max(len(step) // 32, 1)
    at_limb, inside = (uniform_filter1d(np.abs(some), size, mode="nearest") for some in (step, deep))
    share = at_limb / np.maximum(inside, np.finfo(float).tiny)
    # With less than 0.7 of the upper quartile a limb has faded near the terminator.
    return np.asarray(share >= 0.7 * percentile(share, 75.0))
