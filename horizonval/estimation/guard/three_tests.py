"""Three tests of a claimed nadir against the pixels.

From the claim's nadir and angular radius, or altitude, a limb is predicted, and the most probable limb near it is
fitted to the pixels (:mod:`horizonval.estimation.fit.limb`): a sphere's, of free altitude, with flattening and
relief as unknowns with priors. Limbs many pixels deep are tested in an image with wider pixels. The tests:

1. *chi-squared*: across the edge the pixels may miss the fitted profile by the noise measured on both sides of it, and
   by :data:`PROFILE_SHARE` of the limb's step, since a single exponential does not match the air's profile exactly::

       chi^2 / m = beyond / (PROFILE_SHARE^2 step^2) < Q(chi^2_m, CHANCE) / m

   for ``m`` pieces of limb: errors of the model are correlated within a piece and not between pieces.
2. *explained share*: more pieces of the predicted limb in view must show the edge, with its sign, than chance explains,
   and no other position may show one in as many.
3. *consistency*: the fitted limb must agree with the claimed one to the height of the air and the flattening, and with
   what is known (scale height, altitude, attitude), each by the Mahalanobis distance, :data:`SIGMAS` standard
   deviations of both together.

**Pieces.** The limb in view is cut into :data:`PIECES` of every sector. The pixels of a piece are explained by ``b + (a
+ c x) E(x) + noise``, with ``E`` the edge of the fitted limb and ``x`` the distance inside it in pixels. A piece
*shows* the limb where the step ``a`` has the sign of the whole limb's and exceeds :data:`STEP_SIGMAS` of its standard
deviation. Of a sunlit limb only the lit part is expected to show; where the Sun's direction is unknown this is the half
round of azimuth with the highest radiance. In a thermal band all of the limb is. A *rival* is a position out of reach
of the air at which the pieces show as large a step of the same sign.

**Limit.** An evenly bright disc of a size that nothing known forbids passes: from some altitude the Earth looks so.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.fit.claim import limb_scale
from horizonval.estimation.fit.known import LimbKnowledge, sphere_knowledge
from horizonval.estimation.fit.light import MIDDLE_LEVEL, PIXEL_VARIANCE, EdgeProfile, edge_profile, light_basis
from horizonval.estimation.fit.limb import LimbFit, fit_limb
from horizonval.estimation.fit.pixels import image_scale, limb_angle, near_pixels, pixel_at_limb_m
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.start import knowledge_in_air
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.knowledge import contradicted
from horizonval.estimation.guard.sunlit import sun_angles
from horizonval.estimation.likelihood.light import weighed
from horizonval.estimation.likelihood.pixels import LimbPixels, limb_pixels
from horizonval.estimation.limb.finder import largest_rho_rad
from horizonval.estimation.limb.picture import in_wider_pixels
from horizonval.estimation.observation import Fit, Lens, Observation
from horizonval.geometry.camera import unproject
from horizonval.geometry.horizon import Cone
from horizonval.geometry.rotation import angle_between, off_axis_angle, tangent_basis

BoolArray = NDArray[np.bool_]

PIECES = 3
"""Pieces per sector of 24 px of limb: 8 px by 20 px each, whose 160 pixels measure a step to a sixth of the pixel
noise."""
STEP_SIGMAS = 5.0
"""Rose's criterion, for a piece in place of a pixel."""
LEAST_NOISE = 1e-3
"""Smallest ratio of a pixel's variance to that of all residuals; keeps the equations regular."""
RIVAL_STEP = 0.5
"""Smallest step of a rival relative to the limb's: half is the level at which edges are located."""
RIVAL_WIDTH_PX = 3.0
"""Half-width of a rival's window; an edge blurred by 0.7 px extends over two pixels."""
FARTHEST_RIVAL_PX = 40.0
RIVAL_STEPS_PX = 2.0


@dataclass(frozen=True)
class LimbPieces:
    """What m pieces of a limb show.

    ``steps``: shape (m,), step of every piece over its standard deviation, positive with the whole limb's sign;
    ``due``: shape (m,), pieces expected to show the limb; ``edge_misfit``: mean square residual across the edge minus
    the noise at its sides, over the squared step; ``rival_shown``: number of expected pieces that show another position
    as well.
    """

    steps: FloatArray
    due: BoolArray
    bright_inside: bool
    edge_misfit: float
    rival_shown: int

    @property
    def shown(self) -> int:
        """Number of pieces that are due and show the limb."""
        return int((self.due & (self.steps > STEP_SIGMAS)).sum())


def limb_pieces(image: FloatArray, observation: Observation, found: LimbFit, knowledge: LimbKnowledge) -> LimbPieces:
    """Return what the pieces of a fitted limb show.

    Raises ``LinAlgError``: too little limb in view.

    ``image``: shape (H, W); ``observation``: camera, band and Sun are used; ``knowledge``: of the fit.
    """
    blur = float(np.sqrt(found.blur_px**2 + PIXEL_VARIANCE))
    near = limb_pixels(image, observation.camera, found.pose, knowledge, blur, found.scale_height_m)
    x, edge = _edge(near, found, knowledge, blur)
    light = weighed(light_basis(edge.level, x, near.along), near.values, near.sectors.starts)
    level = np.clip(edge.level, 0.0, 1.0)
    expected = light.variance[0] + (light.variance[1] - light.variance[0]) * level
    # Space may have a single grey level, which bounds its noise but does not make it zero.
    expected = np.maximum(expected, LEAST_NOISE * float(np.mean(light.residuals**2)) + 1e-300)
    starts = np.concatenate(
        [np.linspace(a, b, PIECES, endpoint=False) for a, b in pairwise(near.sectors.starts)]
        + [near.sectors.starts[-1:]]
    ).astype(np.intp)
    steps, sigmas, middles = _steps(near.values, edge.level, x, 1.0 / expected, starts)
    los = near.pixels.los_cam[:, middles].T
    sign = np.sign(np.sum(steps / sigmas**2)) or 1.0
    steps = sign * steps
    due = _due(los, steps, found.pose.nadir_cam, observation)
    between = (edge.level > MIDDLE_LEVEL) & (edge.level < 1.0 - MIDDLE_LEVEL) & (light.weights > 0.0)
    typical = float(np.median(np.abs(steps[due]))) if due.any() else 0.0
    beyond = float(np.mean(light.residuals[between] ** 2 - expected[between])) if between.any() else 0.0
    rival = _rival(image, observation, found, knowledge, near, starts, sign * RIVAL_STEP * np.abs(steps), due)
    misfit = max(beyond, 0.0) / typical**2 if typical > 0.0 else np.inf
    return LimbPieces(steps / sigmas, due, bool(sign > 0.0), misfit, rival)


def _edge(near: LimbPixels, found: LimbFit, knowledge: LimbKnowledge, blur: float) -> tuple[FloatArray, EdgeProfile]:
    """Return the pixels' distance inside the fitted limb, and its edge there."""
    pose = found.pose
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    angle = limb_angle(near.pixels.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    scale = image_scale(angle, near.pixels.by_column, near.pixels.by_row)
    x = (angle.delta + angle.by_height * near.lift_m) / scale
    return x, edge_profile(x, blur, found.scale_height_m * np.abs(angle.by_height) / scale)


def _steps(
    values: FloatArray, level: FloatArray, x: FloatArray, weights: FloatArray, starts: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Return every piece's step, its standard deviation, and the pixel nearest to the limb in its middle."""
    basis = np.array([np.ones_like(x), level, level * x])
    steps, sigmas, middles = [], [], []
    for first, last in pairwise(starts):
        here = slice(first, last)
        weighted = basis[:, here] * weights[here]
        inverse = np.linalg.pinv(weighted @ basis[:, here].T, rcond=1e-12, hermitian=True)
        steps.append(float((inverse @ (weighted @ values[here]))[1]))
        sigmas.append(float(np.sqrt(max(inverse[1, 1], 0.0))))
        middles.append(first + int(np.argmin(np.abs(x[here]))))
    return np.array(steps), np.maximum(sigmas, 1e-300), np.array(middles, dtype=np.intp)


def _due(los_cam: FloatArray, steps: FloatArray, nadir_cam: FloatArray, observation: Observation) -> BoolArray:
    """Return which pieces must show the limb, shape (m,)."""
    if observation.band_kind == "thermal":
        return np.ones(len(steps), dtype=bool)
    if observation.sun_cam is not None:
        lit = sun_angles(los_cam, nadir_cam, observation.sun_cam)[0] < 0.5 * np.pi
        if lit.any():
            return np.asarray(lit)
    across = los_cam @ tangent_basis(nadir_cam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    brightest = np.maximum(steps, 0.0) @ across
    return np.asarray(across @ brightest >= 0.0)


def _rival(
    image: FloatArray,
    observation: Observation,
    found: LimbFit,
    knowledge: LimbKnowledge,
    near: LimbPixels,
    starts: NDArray[np.intp],
    needed: FloatArray,
    due: BoolArray,
) -> int:
    """Return the number of pieces that show a step of at least ``needed``, shape (m,), away from the limb."""
    pose, camera = found.pose, observation.camera
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    far = FARTHEST_RIVAL_PX + RIVAL_WIDTH_PX
    wide = near_pixels(camera, pose.cam_from_itrs, pose.r_itrs, axes, far, far)
    angle = limb_angle(wide.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    scale = image_scale(angle, wide.by_column, wide.by_row)
    x = angle.delta / scale
    low, high = limb_height_m(observation.band_kind)
    air_px = (high - low) * float(np.median(np.abs(angle.by_height) / scale))
    values = np.asarray(image[wide.rows, wide.columns], dtype=float)
    piece = _piece_of(wide.los_cam, near.pixels.los_cam[:, starts[:-1]], pose.nadir_cam)
    count = len(due)
    shown = np.zeros(count, dtype=bool)
    nearest = max(RIVAL_WIDTH_PX, air_px) + RIVAL_WIDTH_PX
    for sign in (1.0, -1.0):
        for place in np.arange(nearest, FARTHEST_RIVAL_PX, RIVAL_STEPS_PX):
            off = x - sign * place
            inner = _means(values, piece, (off >= 0.0) & (off < RIVAL_WIDTH_PX), count)
            outer = _means(values, piece, (off < 0.0) & (off >= -RIVAL_WIDTH_PX), count)
            with np.errstate(invalid="ignore"):
                shown |= due & ((inner - outer) * np.sign(needed) >= np.abs(needed))
    return int(shown.sum())


def _piece_of(los_cam: FloatArray, first_cam: FloatArray, nadir_cam: FloatArray) -> NDArray[np.intp]:
    """Return the number of the piece, shape (n,), in whose azimuth pixels lie; ``first_cam``: its first one, (3, m)."""
    basis = tangent_basis(nadir_cam).T
    begin = basis @ first_cam
    azimuth = np.arctan2(begin[1], begin[0])
    turn = np.mod(azimuth - azimuth[0], 2.0 * np.pi)
    across = basis @ los_cam
    own = np.mod(np.arctan2(across[1], across[0]) - azimuth[0], 2.0 * np.pi)
    return np.asarray(np.searchsorted(np.maximum.accumulate(turn), own, side="right") - 1)


def _means(values: FloatArray, piece: NDArray[np.intp], which: BoolArray, count: int) -> FloatArray:
    """Return the mean of the chosen values of every piece, NaN where there are none."""
    numbers = np.bincount(piece[which], minlength=count)
    sums = np.bincount(piece[which], weights=values[which], minlength=count)
    return np.where(numbers > 0, sums / np.maximum(numbers, 1), np.nan)


PROFILE_SHARE = 0.15
"""Root-mean-square difference, as a share of the step, between a limb's profile and an exponential. Measured: 0.01 to
0.08 under a high Sun and in the infrared, up to 0.16 near the terminator."""
CHANCE = 1e-6
"""Probability that a correct limb is refused by chi-squared."""
COIN = 0.1
"""Chance, under random signs, of as many pieces of one sign, below which they count as a limb. Four pieces, the
shortest limb of a search, can reach it."""
SIGMAS = 5.0
"""Threshold of all consistency tests: two Gaussian degrees of freedom exceed it four times in a million."""
BLURRED = 1.5
"""Largest blur of a fitted edge, of the camera's own. Measured on 130 undisturbed frames: up to 1.1 where pixels are
wider than the air is deep; after motion over 2 px across the limb 1.6 to 1.8."""
AIR_BLUR_M = 7e3
"""What the air adds to it, being no exponential: 4 to 6 km where pixels are of 10 km."""
LEAST_BLUR_PX = 0.4
"""Blur below which pixels hide a lens."""
DIFFRACTION_BLUR = 0.45
"""Standard deviation of the Gaussian nearest to an aperture's spread, in wavelengths times f-number."""
TAIL_PX = 1.0
"""Softness of a limb that lens wings and a bolometer's lag can cause; with pixels of 40 km it exceeds that of any
air."""
PLACED_PX = 3.0
"""Allowed position error of methods with whole pixels, and of the fit where a sector shows little."""


def doubted(claim: Fit, observation: Observation) -> Refusal | None:
    """Return why a claim, with an angular radius or an altitude, is refused, or None."""
    rho = _angular_radius(claim, observation)
    if rho is None:
        return Refusal(Outcome.NOT_CONVERGED, "the claim predicts no limb: it has no angular radius", claim.points)
    # Where the altitude is known its own test decides how large a disc must be.
    smallest = 0.0 if observation.prior.angular_radius is not None else limits.SMALLEST_RHO_RAD
    if not smallest < rho <= largest_rho_rad(observation.prior):
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is no orbit's horizon", claim.points)
    radius = observation.prior.sphere_radius_m
    distance = radius / float(np.sin(rho))
    nadir = np.asarray(claim.nadir_cam)
    planet, mean, information = sphere_knowledge(nadir, radius, distance - radius)
    knowledge = knowledge_in_air(observation, planet, mean, information, observation.prior.flattening * radius)
    start = LimbPose(np.eye(3), -distance * nadir)
    # A limb many pixels deep is no edge in the image's own pixels: it is tested in the wider pixels of the fit.
    scale = limb_scale(observation.camera, start, knowledge)
    observation, knowledge = in_wider_pixels(observation, scale), knowledge.in_wider_pixels(scale)
    image = np.asarray(observation.image, dtype=np.float64)
    try:
        found = fit_limb(image, observation.camera, start, knowledge)
        pieces = limb_pieces(image, observation, found, knowledge)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the limb that the claim predicts: {e}", claim.points)
    for refusal in (_by_chi_squared(pieces, claim), _by_share(pieces, claim)):
        if refusal is not None:
            return refusal
    predicted = Cone(nadir, float(np.cos(rho)))
    for refusal in (
        _by_place(found, predicted, observation, claim),
        _by_blur(found, observation, claim, scale),
        _by_nadir(found, observation, claim),
        contradicted(claim, observation, *_fitted_rho(found, radius)),
    ):
        if refusal is not None:
            return refusal
    return None


def _angular_radius(claim: Fit, observation: Observation) -> float | None:
    if claim.angular_radius_rad is not None:
        return float(claim.angular_radius_rad)
    if claim.altitude_m is None or not claim.altitude_m > 0.0:
        return None
    radius = observation.prior.sphere_radius_m
    return float(np.arcsin(radius / (radius + claim.altitude_m)))


def _by_chi_squared(pieces: LimbPieces, claim: Fit) -> Refusal | None:
    count = len(pieces.steps)
    square = pieces.edge_misfit / PROFILE_SHARE**2
    if square <= float(chi2.isf(CHANCE, count)) / count:
        return None
    share = np.sqrt(pieces.edge_misfit)
    return Refusal(Outcome.NO_LIMB, f"the pixels miss the limb's profile by {share:.0%} of its step", claim.points)


def _by_share(pieces: LimbPieces, claim: Fit) -> Refusal | None:
    due, shown = int(pieces.due.sum()), pieces.shown
    needed = int(binom.isf(COIN, due, 0.5)) + 1
    if shown < needed:
        reason = f"{shown} of {due} pieces of the predicted limb show an edge; {needed} are needed"
        return Refusal(Outcome.NO_LIMB, reason, claim.points)
    if pieces.rival_shown >= needed:
        reason = f"{pieces.rival_shown} of {due} pieces show a second limb beside the first"
        return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
    return None


def _by_place(found: LimbFit, predicted: Cone, observation: Observation, claim: Fit) -> Refusal | None:
    """Refuse a limb that is too soft for air, and one away from the claimed limb.

    A short arc hardly separates tilt from altitude, so the limb in view is compared. Allowed are any height in the air,
    the flattening, and errors of whole pixels.
    """
    pixel_m = pixel_at_limb_m(observation.camera, found.pose.r_itrs, observation.prior.sphere_radius_m)
    prior = observation.prior
    softest_m = prior.limb_scale_height_m + SIGMAS * prior.limb_scale_height_sigma_m
    if found.scale_height_m > max(softest_m, TAIL_PX * pixel_m):
        reason = f"the edge is soft as air of a scale height of {found.scale_height_m / 1e3:.0f} km"
        return Refusal(Outcome.NO_LIMB, reason, claim.points)
    los = unproject(observation.camera, found.uv)
    rho = float(np.arccos(predicted.cos_rho))
    px_per_rad = max(observation.camera.fx, observation.camera.fy)
    off_px = float(np.abs(off_axis_angle(los, predicted.axis_cam) - rho).max()) * px_per_rad
    radius = observation.prior.sphere_radius_m
    low, high = limb_height_m(observation.band_kind)
    heights = high - low + observation.prior.flattening * radius
    if off_px <= heights * np.tan(rho) / radius * px_per_rad + PLACED_PX:
        return None
    return Refusal(Outcome.AMBIGUOUS, f"the most probable limb lies {off_px:.1f} px from the claimed one", claim.points)


def _fitted_rho(found: LimbFit, radius_m: float) -> tuple[float, float]:
    """Return the angular radius of a fitted sphere and its variance [rad^2]."""
    distance = float(np.linalg.norm(found.pose.r_itrs))
    up = found.pose.r_itrs / distance
    rho = float(np.arcsin(radius_m / distance))
    return rho, float(up @ found.covariance[3:6, 3:6] @ up) * float(np.tan(rho) / distance) ** 2


def _by_blur(found: LimbFit, observation: Observation, claim: Fit, scale: int) -> Refusal | None:
    """Refuse an edge that is wider than the camera's lens and the air make it: one that motion or focus has smeared.

    ``observation``: in pixels ``scale`` times as wide as the image's.
    """
    lens = observation.lens or Lens()
    own = observation.prior.lens_blur_px / scale if lens.blur_px is None else max(lens.blur_px, LEAST_BLUR_PX / scale)
    own = float(np.hypot(own, DIFFRACTION_BLUR * lens.diffraction_px)) * float(lens.ratios.max())
    pixel_m = pixel_at_limb_m(observation.camera, found.pose.r_itrs, observation.prior.sphere_radius_m)
    if found.blur_px <= float(np.hypot(BLURRED * own, AIR_BLUR_M / pixel_m)):
        return None
    stated = "" if lens.blur_px is not None else ", if its file states none (optics.psf_sigma_px)"
    reason = (
        f"the limb is blurred by {scale * found.blur_px:.1f} px, the camera's own blur is {scale * own:.1f} px{stated}"
    )
    return Refusal(Outcome.AMBIGUOUS, reason, claim.points)


def _by_nadir(found: LimbFit, observation: Observation, claim: Fit) -> Refusal | None:
    nadir = np.asarray(claim.nadir_cam)
    basis = tangent_basis(nadir)
    by_nadir = found.by_nadir
    claimed = basis.T @ claim.total_covariance_nadir_cam @ basis
    fitted = basis.T @ by_nadir @ found.covariance @ by_nadir.T @ basis
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    off = basis.T @ (found.pose.nadir_cam - nadir)
    if off @ np.linalg.solve(claimed + fitted + floor, off) <= SIGMAS**2:
        return None
    apart = np.degrees(angle_between(found.pose.nadir_cam, nadir))
    reason = f"the most probable limb has its nadir {apart:.2f} deg from the claimed one"
    return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
