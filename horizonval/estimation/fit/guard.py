"""The guard: is what the image shows at the predicted limb the limb that the fit or the points predict?

The pixels about the predicted limb are examined on both sides and with nothing but its geometry: the limb in view is
cut into *pieces* of some 8 px, and the pixels of a piece are ``b + (a + c x) E(x - d) + noise``, with ``x`` the
distance inside the predicted limb, ``E`` the edge of :mod:`.light`, and its position ``d``, blur and softness common to
all pieces. Levels are eliminated; three unknowns and a few linear steps remain. What a fit's window, prior or air hides
shows here. The tests, all at the level :data:`CHANCE`:

1. *Levels*: no more than half of the limb is saturated.
2. *Share*: the pieces in view and lit show the edge, with one sign.
3. *Uniqueness*: no second edge runs along the limb.
4. *Position*: the edge lies within the heights of the air, and is as even along itself as the relief of clouds.
5. *Blur*: the edge is no wider than the lens makes it; in the infrared it may be a pixel wider (cirrus above clouds).
6. *Rows and columns*: the position of the limb does not jump from one row, or column, to the next (torn, frozen and
   interlaced readout). Differences of neighbours are free of all that changes slowly: air, relief, errors of the lens.
7. *Prior*: the pose departs from its prior as chance has it, by the Mahalanobis distance; the claim is widened by the
   departures that are improbable.

Tests 1 to 4 serve methods of points, too, which a symmetric blur does not mislead. Before a fit, rows and columns that
hold one value or the same as their neighbours are left out (:func:`without_lost_lines`), and so is light beyond the air
(:mod:`horizonval.estimation.limb.foreign`).

**Limits.** A mirrored image, and a principal point beyond its stated uncertainty (a tilt is the same image), are not
seen by any test of one image. An error of the altitude is seen only where the image determines the altitude.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation
from scipy.special import bdtr, chdtri, ndtri

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.light import INSIDE_PX, OUTSIDE_PX, PIXEL_VARIANCE, edge_profile, from_widest_gap
from horizonval.estimation.fit.noise import NORMAL_QUARTILE, PixelNoise
from horizonval.estimation.fit.pixels import near_pixels, pixel_at_limb_m
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.limb.cone import inwards_of
from horizonval.estimation.limb.picture import median, rounding_variance, scale_as_deep, smaller
from horizonval.estimation.observation import Fit, Lens, Observation
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import tangent_basis

BoolArray = NDArray[np.bool_]

CHANCE = 1e-6
"""Probability with which a test refuses an undisturbed image; all thresholds follow from it."""
SIGMAS = -float(ndtri(0.5 * CHANCE))
"""The same for one normal variable, either way: 4.9 standard deviations."""

PIECE_PX = 8.0
"""Length of a piece along the limb: 8 px by 20 px measure a step to a sixth of the pixel noise, and the place of a full
step to a hundredth of a pixel at one per cent of noise."""
FEWEST_OF_PIECE = 50
"""Fewest pixels of a piece, of 160, where they are thinned."""
MOST_PIXELS = 8000
"""Number of pixels of a large image that are examined."""
LEAST_WIDTH_PX = 0.3
"""Smallest blur, including the pixel's extent, which is 0.29 px."""
LARGEST_STEP = (1.0, 0.4, 0.5)
"""Largest step of place [px], ln blur and scale height in its scale, within the reach of the derivatives."""
INDEPENDENT_LINES = 12
"""Lines whose shifts count as independent: the phases of pixels across an oblique limb repeat themselves."""
COIN = 0.1
"""Chance of as many pieces of one sign, if signs are random, below which they are a limb: four pieces, the shortest
limb of a search, can reach it."""
BLUR_SIGMA = 0.08
"""Relative standard deviation of a stated blur: a modulation transfer function is measured to some per cent, and
focus changes with temperature. At :data:`SIGMAS` a lens is taken for 1.5 times as soft."""
UNSTATED_BLUR_SIGMA = 0.3
"""The same of a lens whose file states none."""
CLOUDY_BLUR_PX = 1.0
"""Least blur that the air may add in the infrared, where cirrus and the clouds below make two limbs: 0.8 px
with pixels of 20 km. Unknown blur of this size does no harm to the fits."""
DIFFRACTION_BLUR = 0.45
"""Standard deviation of the Gaussian nearest to an aperture's spread, in wavelengths times f-number."""
PLACED_PX = 3.0
"""How far a claim may place the limb beyond the air: methods with whole pixels."""
LARGEST_RELIEF_M, LARGEST_RELIEF_PX = 15e3, 0.5
"""Largest relief of a limb along itself: cloud tops reach the tropopause; and what an exponential edge misses of a
limb whose softness changes."""
FARTHEST_EDGE_PX, STRIP_PX = 40, 3
"""How far from the limb a second edge is sought, and the width of the strips along it: an odd number of strips."""
PULLED = 2.0, 3.0
"""Departure from a prior, in what chance makes of it, from which the claim is widened and where it is in full: chance
alone exceeds these in 5 and 0.3 % of frames."""
LEAST_LEARNT, LEAST_LEARNT_BY_EDGE = 0.0025, 0.01
"""Least share of a prior's variance that a departure is compared with, of a profile and of an edge. A fit is converged
to 0.05 of a standard deviation, the root of the first; model errors of an edge look like as much as the second."""


@dataclass(frozen=True)
class LimbView:
    """Pixels about a predicted limb in order of azimuth, in m pieces of k pixels.

    ``columns``, ``rows``, ``values``, ``x``: shape (m, k), the last the distance inside the limb [px]; ``by_column``,
    ``by_row``: shape (m, k), its change per pixel; ``soft``: shape (m, k), pixels per metre of height; ``los_cam``:
    shape (m, 3), to the middle of the pieces; ``pixel_m``: height that a pixel sees; ``every``: one of so many pixels
    is taken.
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    values: FloatArray
    x: FloatArray
    by_column: FloatArray
    by_row: FloatArray
    soft: FloatArray
    los_cam: FloatArray
    pixel_m: float
    every: int


def limb_view(image: FloatArray, camera: CameraModel, pose: LimbPose, axes_m: FloatArray, air_px: float) -> LimbView:
    """Return the pixels about a limb; raises ``LinAlgError``: none in view.

    ``image``: shape (H, W), NaN where it is not to be examined; ``axes_m``: shape (3,), of the planet with its limb's
    height; ``air_px``: how far outside of that the edge may lie.
    """
    near = near_pixels(camera, pose, axes_m, OUTSIDE_PX + air_px, INSIDE_PX, MOST_PIXELS)
    seen = np.isfinite(image[near.rows, near.columns]) & near.in_view(camera)
    by_column, by_row = -near.gradient / near.width_m
    x = near.x_px
    limb_px = near.every * int(np.count_nonzero(np.abs(x[seen]) < 0.5))
    pieces = min(int(limb_px / PIECE_PX), int(np.count_nonzero(seen)) // FEWEST_OF_PIECE)
    if pieces < 1:
        raise np.linalg.LinAlgError(f"{limb_px} pixels of limb in view; {PIECE_PX:.0f} are needed")
    across = tangent_basis(pose.nadir_cam).T @ near.los_cam[:, seen]
    order, _ = from_widest_gap(np.arctan2(across[1], across[0]))
    each = len(order) // pieces
    some = np.linspace(0.0, len(order) - 1.0, pieces * each).astype(np.intp)
    chosen = np.flatnonzero(seen)[order[some]].reshape(pieces, each)
    x = x[chosen]
    middles = chosen[np.arange(pieces), np.argmin(np.abs(x), axis=1)]
    return LimbView(
        near.columns[chosen],
        near.rows[chosen],
        np.asarray(image[near.rows[chosen], near.columns[chosen]], dtype=np.float64),
        x,
        by_column[chosen],
        by_row[chosen],
        1.0 / near.width_m[chosen],
        near.los_cam[:, middles].T,
        float(np.median(near.width_m[chosen])),
        near.every,
    )


@dataclass(frozen=True)
class SeenEdge:
    """What m pieces of k pixels of a limb show.

    ``place_px``: of the edge, inside the predicted limb; ``blur_px``: of the lens; ``blur_sigma``: of its logarithm.
    Shape (m,) each: ``steps``, of radiance, positive with the whole limb's sign, and ``step_sigmas``; ``off_px``, how
    far inside the common edge a piece has its edge, and ``off_sigmas``. Shape (m, k) each: ``slope``, change of
    radiance per pixel inside, ``residuals``, ``weights``.
    """

    place_px: float
    blur_px: float
    blur_sigma: float
    bright_inside: bool
    steps: FloatArray
    step_sigmas: FloatArray
    off_px: FloatArray
    off_sigmas: FloatArray
    slope: FloatArray
    residuals: FloatArray
    weights: FloatArray

    @property
    def shown(self) -> BoolArray:
        """Which pieces show the edge."""
        return self.steps > SIGMAS * self.step_sigmas


def seen_edge(
    view: LimbView, blur_px: float, scale_m: float, scale_sigma_m: float, between_px: tuple[float, float]
) -> SeenEdge:
    """Return the edge in the pixels of a view; raises ``LinAlgError`` where there is none.

    ``blur_px``: of the lens, to start from; ``scale_m``, ``scale_sigma_m``: scale height of the limb and what is known
    of it; ``between_px``: range of places.
    """
    unit_m = max(scale_m, 1.0)
    known = unit_m / max(scale_sigma_m, 1e-3 * unit_m)
    least = np.array([between_px[0], np.log(LEAST_WIDTH_PX), 0.0])
    most = np.array([between_px[1], np.log(OUTSIDE_PX), np.inf])
    now = np.array([_steepest(view, between_px), 0.5 * np.log(blur_px**2 + PIXEL_VARIANCE), scale_m / unit_m])
    # Few pixels find the edge, all of them measure it.
    every = max(2 * view.x.shape[1] // FEWEST_OF_PIECE, 1)
    least_variance = rounding_variance(view.values)
    few = (view.values[:, ::every], view.x[:, ::every], unit_m * view.soft[:, ::every], least_variance)
    weights = np.ones_like(few[1])
    for _ in range(12):
        before, look = now, _look(now, *few, weights)
        weights = look.weights
        now = np.clip(now + look.step(known, scale_m / unit_m - now[2])[0], least, most)
        if (np.abs(now - before) < 0.2 * np.array(LARGEST_STEP)).all():
            break
    pixels = (view.values, view.x, unit_m * view.soft, least_variance)
    # Across a hard edge a pixel does not change with a place beyond the pixel; a softened one reaches farther.
    soft = _look(np.array([now[0], max(now[1], 0.0), now[2]]), *pixels, np.ones_like(view.x))
    look = _look(now, *pixels, soft.weights)
    step, covariance = look.step(known, scale_m / unit_m - now[2])
    now = np.clip(now + step, least, most)
    step_sigmas = np.sqrt(np.maximum(look.inverse[:, 1, 1], 1e-300))
    sign = float(np.sign(np.sum(look.levels[:, 1] / step_sigmas**2))) or 1.0
    information = np.maximum(soft.normal[:, 0, 0], 1e-300)
    return SeenEdge(
        place_px=float(now[0]),
        blur_px=float(np.sqrt(max(np.exp(2.0 * now[1]) - PIXEL_VARIANCE, 0.0))),
        blur_sigma=float(np.sqrt(max(covariance[1, 1], 0.0))),
        bright_inside=sign > 0.0,
        steps=sign * look.levels[:, 1],
        step_sigmas=step_sigmas,
        off_px=soft.right[:, 0] / information,
        off_sigmas=information**-0.5,
        slope=look.slope,
        residuals=look.residuals,
        weights=look.weights,
    )


@dataclass(frozen=True)
class _Look:
    """An edge in m pieces of k pixels.

    ``levels``: shape (m, 3), ``b``, ``a``, ``c`` of ``b + (a + c x) E``; ``inverse``: shape (m, 3, 3), of their normal
    matrices; ``normal``, ``right``: shape (m, 3, 3) and (m, 3), equations of place, ln blur and scale without the
    levels; ``slope``, ``residuals``, ``weights``: shape (m, k).
    """

    levels: FloatArray
    inverse: FloatArray
    normal: FloatArray
    right: FloatArray
    slope: FloatArray
    residuals: FloatArray
    weights: FloatArray

    def step(self, known: float, short: float) -> tuple[FloatArray, FloatArray]:
        """Return the step of place, ln blur and scale by least squares, shape (3,), and its covariance.

        ``known``: square root of the information of the scale; ``short``: what it lacks of its mean.
        """
        normal, right = self.normal.sum(axis=0), self.right.sum(axis=0)
        normal[2, 2] += known**2
        right[2] += known**2 * short
        size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-12, hermitian=True) / np.outer(size, size)
        step = np.clip(inverse @ right, -np.array(LARGEST_STEP), LARGEST_STEP)
        if not np.isfinite(step).all():
            raise np.linalg.LinAlgError("the pixels about the limb show no edge")
        return step, inverse


def _look(
    now: FloatArray, values: FloatArray, x: FloatArray, soft: FloatArray, least_variance: float, weights: FloatArray
) -> _Look:
    """Return the edge of a place, ln blur and scale in pixels (m, k), its levels with given weights.

    ``x``: distances inside the predicted limb [px]; ``soft``: its softness by the unit of the scale.
    """
    x, blur = x - now[0], float(np.exp(now[1]))
    edge = edge_profile(x, blur, soft * now[2] if now[2] > 0.0 else None)
    basis = np.stack([np.ones_like(x), edge.level, edge.level * x], axis=1)
    weighted = basis * weights[:, None]
    inverse = _inverse(basis @ weighted.transpose(0, 2, 1))
    levels = (inverse @ (weighted @ values[:, :, None]))[:, :, 0]
    residuals = values - (levels[:, None] @ basis)[:, 0]
    space, earth = (_median_square(residuals[there]) for there in (edge.level < 0.1, edge.level > 0.9))
    least = max(least_variance, 1e-12 * float(np.mean(residuals**2)) + 1e-300)
    weights = PixelNoise(np.maximum(space + (earth - space) * np.clip(edge.level, 0.0, 1.0), least)).weights(residuals)
    step = levels[:, 1:2] + levels[:, 2:] * x
    slope = step * edge.slope + levels[:, 2:] * edge.level
    ours = np.stack([-slope, step * edge.by_blur * blur, step * edge.by_scale * soft], axis=1)
    weighted = ours * weights[:, None]
    mixed = weighted @ basis.transpose(0, 2, 1)
    gain = mixed @ _inverse((basis * weights[:, None]) @ basis.transpose(0, 2, 1))
    right = (weighted - gain @ (basis * weights[:, None])) @ residuals[:, :, None]
    normal = weighted @ ours.transpose(0, 2, 1) - gain @ mixed.transpose(0, 2, 1)
    return _Look(levels, inverse, normal, right[:, :, 0], slope, residuals, weights)


def _steepest(view: LimbView, between_px: tuple[float, float]) -> float:
    """Return the place in a range at which the mean profile across the limb is steepest [px inside]."""
    depth = np.rint(view.x.ravel()).astype(np.intp)
    lowest = int(depth.min())
    counts = np.bincount(depth - lowest)
    means = np.bincount(depth - lowest, view.values.ravel()) / np.maximum(counts, 1)
    change = np.where((counts[2:] > 0) & (counts[:-2] > 0), np.abs(means[2:] - means[:-2]), 0.0)
    places = np.arange(lowest + 1, lowest + len(counts) - 1)
    change[(places < between_px[0]) | (places > between_px[1])] = 0.0
    return float(places[int(np.argmax(change))]) if change.any() else 0.5 * sum(between_px)


def _inverse(normal: FloatArray) -> FloatArray:
    """Return the inverses of normal matrices (m, 3, 3), of singular ones too."""
    size = np.sqrt(np.maximum(np.einsum("pii->pi", normal), 1e-300))
    outer = size[:, :, None] * size[:, None, :]
    return np.asarray(np.linalg.inv(normal / outer + 1e-10 * np.eye(3)) / outer)


def _median_square(residuals: FloatArray) -> float:
    return (median(np.abs(residuals)) / NORMAL_QUARTILE) ** 2 if len(residuals) else 0.0


def due_pieces(view: LimbView, seen: SeenEdge, nadir_cam: FloatArray, observation: Observation) -> BoolArray:
    """Return which pieces must show the limb, shape (m,): of a sunlit limb the lit ones, else half of the round."""
    if observation.band_kind == "thermal":
        return np.ones(len(seen.steps), dtype=bool)
    if observation.sun_cam is not None:
        lit = inwards_of(view.los_cam, nadir_cam) @ observation.sun_cam < 0.0
        if lit.any():
            return np.asarray(lit)
    across = view.los_cam @ tangent_basis(nadir_cam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    brightest = np.maximum(seen.steps, 0.0) @ across
    return np.asarray(across @ brightest >= 0.0)


def jumps(view: LimbView, seen: SeenEdge, lines: NDArray[np.intp], along: FloatArray) -> float:
    """Return how improbably the limb's place changes from a line of pixels to the next, over the threshold.

    The image would have to be shifted along every line by ``s`` to explain the residuals; for ``k`` differences of
    neighbours ``sum (s_i+1 - s_i)^2 / variance`` has the distribution of chi-squared, and the largest term that of the
    largest of ``k`` squared normals.

    ``lines``: shape (m, k), rows or columns; ``along``: shape (m, k), change of the distance inside the limb along
    them.
    """
    # Where a lit limb ends, what a piece shows changes within it.
    shown = minimum_filter1d(seen.shown, 3, mode="nearest")
    if not shown.any():
        return 0.0
    lines, along, weights, slope, residuals, x = (
        one[shown].ravel() for one in (lines, along, seen.weights, seen.slope, seen.residuals, view.x)
    )
    # Thinned pixels lie at other distances from the limb in one line than in the next; so many together do not.
    lines = (lines - lines.min()) // view.every
    by_shift = slope * along
    information = weights * by_shift**2
    known = np.maximum(np.bincount(lines, information), 1e-300)
    shift = np.bincount(lines, weights * by_shift * residuals) / known
    # What misplaces the limb across itself shifts a line by more, the more obliquely it crosses.
    across = np.maximum(np.bincount(lines, information * np.abs(along)) / known, 1e-3)
    # Lines that end before they cross the limb see its tails, in which no exponential is right.
    beside = np.bincount(lines, x > seen.place_px), np.bincount(lines, x < seen.place_px)
    crossed = (beside[0] > 0) & (beside[1] > 0)

    def squares(apart: int, misplaced_px: float) -> FloatArray:
        variance = 1.0 / known + (misplaced_px / across) ** 2
        found = (shift[apart:] - shift[:-apart]) ** 2 / (variance[apart:] + variance[:-apart])
        return np.asarray(found[crossed[apart:] & crossed[:-apart]])

    # A line and the next have most of what misplaces an exponential edge in common.
    one, two, single = squares(1, MISPLACED_PX), squares(2, MISPLACED_PX), squares(1, 0.4 * MISPLACED_PX)
    if not len(one) or not len(two):
        return 0.0
    # Clouds, coasts and compression shift lines, too, but not every second one, and not one much more than all others.
    free = min(len(one), INDEPENDENT_LINES)
    of_one, of_two, usual = (max(median(each) / NORMAL_QUARTILE**2, 1.0) for each in (one, two, single))
    every = of_one / of_two / (float(chdtri(free, CHANCE)) / free)
    return max(every, float(single.max()) / usual / float(ndtri(0.5 * CHANCE / len(single))) ** 2)


def second_edge(image: FloatArray, view: LimbView, seen: SeenEdge, due: BoolArray, air_px: float) -> float | None:
    """Return the distance inside the limb [px] of another edge that runs along it, out of reach of the air, or None.

    It is a step of half of the limb's, with its sign, in most pieces that are due: rings of glare, apertures.
    """
    # The image along four lines across every piece, in strips.
    middle = np.flatnonzero(due), np.argmin(np.abs(view.x), axis=1)[due]
    inwards = np.stack([view.by_column[middle], view.by_row[middle]])[:, :, None, None]
    depth = np.arange(-FARTHEST_EDGE_PX, FARTHEST_EDGE_PX + 1.0)[:, None]
    depth = depth + (seen.place_px - view.x[middle])[:, None, None]
    beside = PIECE_PX * (np.arange(4) / 4.0 - 0.375) * np.stack([-inwards[1], inwards[0]])
    at = np.stack([view.columns[middle], view.rows[middle]])[:, :, None, None] + depth * inwards + beside
    columns, rows = np.rint(at).astype(np.intp)
    inside = (columns >= 0) & (columns < image.shape[1]) & (rows >= 0) & (rows < image.shape[0])
    values = np.where(inside, image[np.where(inside, rows, 0), np.where(inside, columns, 0)], np.nan)
    values = values.reshape(len(values), -1, 4 * STRIP_PX)
    good = np.isfinite(values)
    means = np.where(good, values, 0.0).sum(axis=2) / np.where(good.any(axis=2), good.sum(axis=2), np.nan)
    # An edge lies in a strip or at its borders: the strips to both sides differ by more than shading makes them.
    change = (means[:, 2:] - means[:, :-2]) * (1.0 if seen.bright_inside else -1.0)
    step = change[:, 2:-2] - 0.5 * (change[:, 4:] + change[:, :-4])
    place = STRIP_PX * (np.arange(step.shape[1]) - step.shape[1] // 2)
    with np.errstate(invalid="ignore"):
        shows = (step >= 0.5 * np.abs(seen.steps[due])[:, None]) & (np.abs(place) >= max(STRIP_PX, air_px) + STRIP_PX)
    count = maximum_filter1d(shows, 3, axis=1).sum(axis=0)
    return float(place[np.argmax(count)]) if count.max() >= _needed(len(shows)) else None


def examined(
    image: FloatArray,
    observation: Observation,
    pose: LimbPose,
    ellipsoid: Ellipsoid,
    *,
    in_air: bool,
    points: FloatArray,
    uneven_px: float = 0.0,
    by_pixels: bool = True,
) -> Refusal | None:
    """Return why the pixels about a predicted limb do not bear it out, if they do not.

    ``image``: shape (H, W), NaN where the fit had no pixels; ``ellipsoid``: of the planet; ``in_air``: whether the edge
    may be anywhere in the air above the pose's limb, or is at it; ``points``: shape (k, 2), for refusals;
    ``uneven_px``: by how much the fit has the limb depart from the pose's; ``by_pixels``: whether the pose is of a fit
    of the pixels, which blur and torn lines mislead, or of points.
    """
    prior, camera = observation.prior, observation.camera
    pixel_m = pixel_at_limb_m(camera, pose.r_itrs, float(ellipsoid.axes_m[0]))
    # A limb that is many pixels deep is no edge in the image's own pixels.
    scale = scale_as_deep(camera, pixel_m, prior.limb_scale_height_m)
    if scale > 1:
        image, camera = smaller(image, camera, scale)
    pixel_m *= scale
    low, high = limb_height_m(observation.band_kind)
    axes = ellipsoid.axes_m + (0.0 if in_air else pose.height_m)
    # Height and softness of a limb are hard to tell apart: an edge may be found lower than the fit has it.
    between = (-high / pixel_m - PLACED_PX, (-low if in_air else high - low) / pixel_m + PLACED_PX)
    lens = observation.lens or Lens()
    own_px = prior.lens_blur_px if lens.blur_px is None else lens.blur_px
    own_px = float(np.hypot(own_px, DIFFRACTION_BLUR * lens.diffraction_px)) / scale

    def tests() -> Iterator[Test]:
        due = due_pieces(view, seen, pose.nadir_cam, observation)
        yield _lost(view, seen, due, observation.full_scale)
        yield _misplaced(view, seen, due, between, uneven_px / scale)
        other_px = second_edge(image, view, seen, due, (high - low) / view.pixel_m)
        if other_px is not None:
            yield Outcome.AMBIGUOUS, f"a second edge runs along the limb, {other_px:.0f} px inside of it"
        if by_pixels:
            # Air is no exponential: its edge is wider than the lens by up to the scale height.
            air_px = prior.limb_scale_height_m / view.pixel_m
            if observation.band_kind == "thermal":
                air_px = max(air_px, CLOUDY_BLUR_PX / scale)
            yield _blurred(seen, lens, own_px, scale, air_px)
            yield _torn(view, seen)

    try:
        view = limb_view(image, camera, pose, axes, high / pixel_m)
        seen = seen_edge(view, own_px, prior.limb_scale_height_m, prior.limb_scale_height_sigma_m, between)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the limb that the claim predicts: {e}", points)
    return next((Refusal(*test, points) for test in tests() if test is not None), None)


Test = tuple[Outcome, str] | None
"""Why a limb is not believed."""


def _needed(count: int | np.signedinteger) -> int:
    """Return how many of so many pieces are more than chance makes of them."""
    return int(np.argmax(bdtr(np.arange(count + 1.0), count, 0.5) >= 1.0 - COIN)) + 1


def _lost(view: LimbView, seen: SeenEdge, due: BoolArray, full_scale: float | None) -> Test:
    """Test whether the limb is saturated, or not there."""
    if full_scale is not None:
        x = view.x - seen.place_px
        inside = (x > 0.5) & (x < 0.5 * INSIDE_PX)
        full = (inside & (view.values >= full_scale)).sum(axis=1) > 0.5 * inside.sum(axis=1)
        if np.mean(full) > 0.5:
            return Outcome.SATURATED, f"{np.mean(full):.0%} of the limb is saturated"
    count, shown = np.count_nonzero(due), np.count_nonzero(due & seen.shown)
    # Of fewer than four pieces, as between saturated ones, no number excludes chance: what the fit explains decides.
    if shown and not shown < _needed(count) <= count:
        return None
    return Outcome.NO_LIMB, f"{shown} of {count} pieces of the predicted limb show an edge; {_needed(count)} are needed"


def _misplaced(
    view: LimbView,
    seen: SeenEdge,
    due: BoolArray,
    between_px: tuple[float, float],
    uneven_px: float,
) -> Test:
    """Test whether the edge lies where air may be, and is as even as clouds and terminator."""
    if not between_px[0] < seen.place_px < between_px[1]:
        return Outcome.AMBIGUOUS, f"the image shows no limb within {PLACED_PX:.0f} px of the air's heights"
    off, sigmas = np.sort(seen.off_px[due & seen.shown]), seen.off_sigmas[due & seen.shown]
    # A body or a boom may hide a tenth of the pieces to either side.
    few = int(0.1 * (len(off) - 1))
    far = float(off[-1 - few] - off[few]) - SIGMAS * median(sigmas)
    if far <= LARGEST_RELIEF_M / view.pixel_m + LARGEST_RELIEF_PX + uneven_px:
        return None
    return Outcome.AMBIGUOUS, f"the limb in the image departs from the fitted one by {far:.1f} px along itself"


def _blurred(seen: SeenEdge, lens: Lens, own_px: float, scale: int, air_px: float) -> Test:
    """Test whether the edge is no wider than lens and air make it, ``own_px`` and ``air_px``, ``scale`` pixels each."""
    known = UNSTATED_BLUR_SIGMA if lens.blur_px is None else BLUR_SIGMA
    margin = float(np.exp(SIGMAS * np.hypot(known, seen.blur_sigma)))
    widest = margin * max(own_px * float(lens.ratios.max()), LEAST_WIDTH_PX)
    if seen.blur_px <= np.hypot(widest, air_px):
        return None
    stated = "" if lens.blur_px is not None else ", if its file states none (optics.psf_sigma_px)"
    blur, own = scale * seen.blur_px, scale * own_px
    return Outcome.AMBIGUOUS, f"the limb is blurred by {blur:.1f} px, the camera's own blur is {own:.1f} px{stated}"


def _torn(view: LimbView, seen: SeenEdge) -> Test:
    for word, lines, along in (("row", view.rows, view.by_column), ("column", view.columns, view.by_row)):
        if jumps(view, seen, lines, along) > 1.0:
            return Outcome.AMBIGUOUS, f"the limb jumps from one {word} of pixels to the next"
    return None


def without_lost_lines(image: FloatArray) -> FloatArray:
    """Return an image (H, W) with NaN in rows and columns that a readout has lost: of one value, or copied.

    Lines of space may be of one value too: those beside them are then of that value for the most part.
    """
    lost = [_lost_lines(lines) for lines in (image, image.T)]
    if not any(one.any() for one in lost):
        return image
    image = np.array(image, dtype=np.float64)
    image[lost[0]] = np.nan
    image[:, lost[1]] = np.nan
    return image


def _lost_lines(lines: FloatArray) -> BoolArray:
    """Return which rows of an array are lost: of one value or copied, and unlike what is about them."""
    # Black space is of one value too; most of its neighbours then have that value, and most of a copied line has it.
    even = lines.min(axis=1) == lines.max(axis=1)
    copied = np.zeros(len(lines), dtype=bool)
    copied[1:] = (lines[1:] == lines[:-1]).all(axis=1) & ~even[1:]
    suspects = lines[copied]
    if len(suspects):
        copied[copied] = np.mean(suspects == np.median(suspects, axis=1)[:, None], axis=1) < 0.5
    lost = copied
    for first, last in np.flatnonzero(np.diff(np.pad(even, 1).astype(np.int8))).reshape(-1, 2):
        # At the image's border nothing tells space from loss.
        inside = first > 0 and last < len(lines)
        lost[first:last] = inside and (np.mean(lines[[first - 1, last]] == lines[first, 0], axis=1) < 0.5).all()
    return lost


class Found(Protocol):
    """What a fit of the limb gives.

    ``covariance``, ``relief_covariance``: shape (7, 7), of a step of the pose, and the part of the limb's relief;
    ``uv``: shape (k, 2); ``uneven_px``: by how much it has the limb depart from that of a planet.
    """

    @property
    def pose(self) -> LimbPose: ...
    @property
    def covariance(self) -> FloatArray: ...
    @property
    def relief_covariance(self) -> FloatArray: ...
    @property
    def uv(self) -> FloatArray: ...
    @property
    def uneven_px(self) -> float: ...


class Known(Protocol):
    """A prior pose and the information about a step from it, shape (7, 7)."""

    @property
    def mean(self) -> LimbPose: ...
    @property
    def information(self) -> FloatArray: ...


F = TypeVar("F", bound=Found)


def pulled(
    pose: LimbPose,
    covariance: FloatArray,
    mean: LimbPose,
    information: FloatArray,
    points: FloatArray,
    least_learnt: float = LEAST_LEARNT,
) -> Refusal | FloatArray:
    """Return by what the departure from the prior widens the claim, shape (7, 7), or why the claim is refused.

    In units of the prior's standard deviations the covariance ``C`` of a fit has the eigenvalues ``p``. Along each
    direction the pose departs from the prior by ``d``, of variance ``1 - p`` by chance. The sum of ``d^2 / (1 - p)``
    has the distribution of chi-squared. An improbable departure widens the claim by what the prior makes of the pose,
    ``p d / (1 - p)``, as if it were as wrong as the image says.
    """
    size = np.sqrt(np.diag(information)).clip(1e-300)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) / np.outer(size, size))
    free = values > 1e-12 * values[-1]
    root = (vectors[:, free] * np.sqrt(values[free])).T * size
    left, axes = np.linalg.eigh(root @ covariance @ root.T)
    # What scatters beyond chance has widened the covariance, that of unseen directions beyond their prior: a prior that
    # is wrong is no reason to know less of it.
    widened = max(float(left[-1]), 1.0)
    left, covariance = left / widened, covariance / widened
    learnt = 1.0 - left
    off = axes.T @ (root @ -pose.step_to(mean))
    # An image that says nothing about a direction does not move the pose along it: a departure there is no measure of
    # how wrong the prior is, and only one beyond the prior itself is improbable.
    learnt = np.where(learnt > least_learnt, learnt, 1.0)
    square = off**2 / learnt
    # Where the image determines more than the prior the two must agree, since nothing would widen the claim.
    seen = left < 0.5
    total = float(square[seen].sum())
    if seen.any() and total > float(chdtri(np.count_nonzero(seen), CHANCE)):
        sigmas = float(np.sqrt(total))
        return Refusal(
            Outcome.AMBIGUOUS, f"the limb lies {sigmas:.0f} sigma from the position and attitude of the prior", points
        )
    added = np.zeros((7, 7))
    for k in np.flatnonzero(square > PULLED[0] ** 2):
        beyond = min((float(np.sqrt(square[k])) - PULLED[0]) / (PULLED[1] - PULLED[0]), 1.0)
        wrong = (beyond * float(off[k] / learnt[k])) * (covariance @ root.T @ axes[:, k])
        added += np.outer(wrong, wrong)
    return added


def agreeing(
    found: F, known: Known, least_learnt: float = LEAST_LEARNT, plain: FloatArray | None = None
) -> F | Refusal:
    """Return a fit with its claim widened by the departure from its prior, or why that is refused: :func:`pulled`.

    ``plain``: shape (7, 7), covariance of the fit's equations alone, where scatter has widened the fit's.
    """
    wrong = pulled(
        found.pose, found.covariance if plain is None else plain, known.mean, known.information, found.uv, least_learnt
    )
    if isinstance(wrong, Refusal):
        return wrong
    relief = found.relief_covariance + wrong
    return replace(found, covariance=found.covariance + wrong, relief_covariance=relief)  # type: ignore[type-var]


def guarded_fit(
    fit: Callable[[FloatArray], F],
    image: FloatArray,
    observation: Observation,
    ellipsoid: Ellipsoid,
    *,
    in_air: bool,
) -> F | Refusal:
    """Return the fit of an image (H, W) without its lost lines, or why it is not believed.

    ``fit``: of an image with NaN where it has no pixels; others as for :func:`examined`.
    """
    image = without_lost_lines(image)
    found = fit(image)
    refusal = examined(
        image, observation, found.pose, ellipsoid, in_air=in_air, points=found.uv, uneven_px=found.uneven_px
    )
    return found if refusal is None else refusal


def heads_refused(
    images: Mapping[str, FloatArray], observation: Observation, found: Found, ellipsoid: Ellipsoid, *, in_air: bool
) -> dict[str, Refusal]:
    """Return the heads whose limb is not as a common pose predicts it, and why.

    ``images``: shape (H, W) each, by the heads' names; ``found``: in axes of the body; others as for :func:`examined`.
    """
    refused = {}
    for name, image in images.items():
        head = observation.heads[name]
        pose = found.pose.of_camera(Rotation.from_quat(head.q_cam_from_body).as_matrix())
        image = without_lost_lines(image)
        points = np.empty((0, 2))
        refusal = examined(image, head, pose, ellipsoid, in_air=in_air, points=points, uneven_px=found.uneven_px)
        if refusal is not None:
            refused[name] = refusal.of_head(name)
    return refused


def accepted(found: Fit | Refusal, largest_rad: float) -> Fit | Refusal:
    """Return an answer, or refuse one that does not determine the nadir to a standard deviation in its worst way."""
    if isinstance(found, Refusal):
        return found
    basis = tangent_basis(np.asarray(found.nadir_cam))
    sigma = float(np.sqrt(np.linalg.eigvalsh(basis.T @ found.total_covariance_nadir_cam @ basis)[-1]))
    if sigma <= largest_rad:
        return found
    known_deg, accepted_deg = np.degrees(sigma), np.degrees(largest_rad)
    reason = f"the method determines the nadir to {known_deg:.2f} deg, {accepted_deg:.2g} deg are accepted"
    return Refusal(Outcome.SHORT_ARC, f"{reason} (prior: accept_deg)", found.points)
