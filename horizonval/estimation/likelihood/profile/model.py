"""Pixels selected at a pose, their prediction near it, and the equations of a step.

Within a selection the distances across the limb are linear in the displacement from its pose: a displacement of ``u``
neglects ``u^2 / 2`` over the distance of the limb, 60 m for a pixel of 19 km.

The functions of the air are smooth over a fifth of a pixel. Their products with each other and with the other
derivatives are therefore summed on a grid of heights by sector first, so that their cost does not grow with the pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len
from scipy.sparse import csr_array
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.profile.air import BUMP_M, EARTH_RADIUS_M, LEFT_LENGTH_RAD
from horizonval.estimation.likelihood.profile.blurred import BlurredProfiles, blur_after
from horizonval.estimation.likelihood.profile.knowledge import ProfileKnowledge
from horizonval.estimation.likelihood.profile.noise import Floor, floor_of
from horizonval.estimation.likelihood.profile.pixels import level_distance, profile_pixels
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.rotation import off_axis_angle

AXIS_CAM = np.array([0.0, 0.0, 1.0])
EIGHTHS = 9
POSE = 7
"""Turn, position, lift."""
BLUR, SHARPNESS, GAIN, BACKGROUND, SHARED = 7, 8, 9, 10, 11
"""Places of the other shared unknowns, and how many there are."""
LEAST_GAIN = 0.2
"""Smallest share of the gain after a step."""
CLOUD_TOP_M = 16e3
"""Height of tropical cloud tops."""
DEPTH_PX = 0.5
"""Smallest depth of the window below the ground. Lines that end farther before the limb see other air, ground and
clouds than those that pass it."""
SPACE_PX = 4.0
"""Smallest height of the window above the air."""
GRID_RIMS = 2.0
"""Extension of the height grid beyond the window, in rims: its ends are five blurs and a lift away."""
FINEST_STEP_M, STEPS_PER_PIXEL = 250.0, 32.0
"""Step of the height grid: a thirtieth of the air's scale height, or a twentieth of the blur."""
STEPS_OF_AIR = 8.0
"""Steps per pixel of the grid on which products of the air's derivatives are summed: a sixth of the blur. Parabolas
leave 1e-4, which only slows the fit; the gradient is exact."""
SOME = 500
"""Pixels that tell how far a step moves the limb: it moves evenly along it."""
EDGE_BLURS = 2.5
"""Distance from the table's ends, in blurs, within which pixels see beyond it."""


@dataclass(frozen=True)
class Guess:
    """The unknowns; ``away`` (7,) is the way from the pose that the pixels were chosen for."""

    away: FloatArray
    blur: float
    sharpness: float
    gain: float
    background: float
    air: FloatArray

    def moved(self, step: FloatArray) -> Guess:
        """Return the unknowns after a step: the shared ones, then those of the air."""
        # Brightness is a product of gain and air: taken like this, it moves as the derivatives say, however far.
        brighter = max(1.0 + float(step[GAIN]), LEAST_GAIN)
        return Guess(
            self.away + step[:POSE],
            blur_after(self.blur, self.sharpness, float(step[BLUR]), float(step[SHARPNESS])),
            self.sharpness + float(step[SHARPNESS]),
            self.gain * brighter,
            self.background + float(step[BACKGROUND]),
            self.air + step[SHARED:] / brighter,
        )


def priors_beside_pose(known: ProfileKnowledge, now: Guess, floor: Floor | None) -> tuple[FloatArray, FloatArray]:
    """Return information (11,) and step of the priors of all shared unknowns but the pose.

    ``floor``: dark pixels at the floor, which together constrain the background as one pixel does.
    """
    information, wanted = np.zeros(SHARED), np.zeros(SHARED)
    rows = [BLUR, SHARPNESS, GAIN]
    information[rows] = np.array([known.blur_log_sigma, known.sharpness_sigma, known.gain_log_sigma]) ** -2.0
    wanted[rows] = np.log(known.blur_px / now.blur), known.sharpness - now.sharpness, np.log(known.gain / now.gain)
    if floor is not None:
        information[BACKGROUND], wanted[BACKGROUND] = floor.sigma**-2, floor.background - now.background
    return information, wanted


@dataclass(frozen=True)
class Seen:
    """Predicted pixels, shape (n,) each.

    ``share``: interpolation weight of the next grid point; ``level``: radiance; ``changes``: shape (3, n), derivatives
    by distance across the limb [1/m], ln blur, sharpness; ``brightest``: maximum radiance of the profile there;
    ``kept``: share of a radiance change that survives the converter's floor in the mean.
    """

    place: np.ndarray
    share: FloatArray
    level: FloatArray
    changes: FloatArray
    brightest: FloatArray
    kept: FloatArray
    residuals: FloatArray


@dataclass(frozen=True)
class Equations:
    """Normal equations of a step without priors, in blocks of the shared unknowns and of those of the air."""

    shared: FloatArray
    mixed: FloatArray
    air: FloatArray
    right: FloatArray
    right_air: FloatArray


class ProfileModel:
    """The pixels that see the profile at a pose.

    ``image``: shape (H, W), NaN where missing; ``blur_px``: of the lens, for the window's width; ``most``: thin out
    evenly to about so many pixels. ``by_lens`` (c, n): derivatives of distances across the limb by lens errors;
    ``moved``: displacement by the lens; ``off_axis`` (n,): squared angles from the axis over the image's largest;
    ``below_clouds`` (n,): share of a pixel's radiance from below the highest clouds; ``left_alike`` (n,): number of
    pixels with correlated neglected bumps. Raises ``LinAlgError``: too little limb in view.
    """

    def __init__(
        self,
        image: FloatArray,
        camera: CameraModel,
        pose: LimbPose,
        blur_px: float,
        knowledge: ProfileKnowledge,
        most: int | None = None,
    ) -> None:
        self.pose = pose
        _, high = knowledge.heights_m
        axes = knowledge.ellipsoid.axes_m
        to_limb_2 = max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0)
        pixel_m = np.sqrt(to_limb_2) / max(camera.fx, camera.fy)
        widest = blur_px * float(knowledge.lens.ratios.max())
        rim = EDGE_BLURS * float(np.sqrt(widest**2 + PIXEL_VARIANCE)) * pixel_m
        bottom = pose.height_m - DEPTH_PX * pixel_m
        top = high + max(rim, SPACE_PX * pixel_m) + pose.height_m
        self.curve = curve = 0.5 * axes[0] / to_limb_2
        self.near = near = profile_pixels(image, camera, pose, knowledge.ellipsoid, (bottom, top), curve, most)
        ends, _ = level_distance(np.array([bottom, top]), curve)
        step = max(FINEST_STEP_M, pixel_m / STEPS_PER_PIXEL)
        self.every = max(1, int(pixel_m / STEPS_OF_AIR / step))
        # A whole number of steps of the coarse grid.
        first, coarse = ends[0] - GRID_RIMS * rim, self.every * step
        last = first + coarse * next_fast_len(int(np.ceil((ends[1] + GRID_RIMS * rim - first) / coarse)), real=True)
        self.air = knowledge.air(near.normal_cam, near.los_cam, pose, (first, last - 0.5 * step, step), curve)
        lens, off_axis = knowledge.lens, off_axis_angle(near.los_cam, AXIS_CAM)
        self.tables = BlurredProfiles(self.air.functions, self.air.step_m, near.boxes_m, lens, off_axis)
        self.floor = floor_of(near.values[near.ray.height_m > high + rim + pose.height_m], float(np.nanmin(image)))
        across, by_height = level_distance(near.ray.height_m - pose.height_m, curve)
        self._across = across
        lowering = -np.ones((1, len(across)))
        self.by_pose = np.concatenate([near.ray.by_rotation, near.ray.by_position, lowering]) * by_height
        self.by_lens = np.zeros((0, len(across)))
        self.moved: FloatArray | float = 0.0
        i, t = near.sector, near.along
        self._lift = near.lift_m[i] * (1.0 - t) + near.lift_m[i + 1] * t
        variances = lens.ratios**2 @ lens.shares(off_axis)
        self._variance = variances[i] + (variances[i + 1] - variances[i]) * t
        shares = off_axis_share(camera, near.los_cam)
        self.off_axis = shares[i] * (1.0 - t) + shares[i + 1] * t
        self.width_m = near.width_m[i]
        self._some = slice(None, None, max(1, len(across) // SOME))
        soft_m = np.sqrt(blur_px**2 * self._variance + PIXEL_VARIANCE) * self.width_m
        self.below_clouds = ndtr((CLOUD_TOP_M - near.ray.height_m) / soft_m)
        self.left_alike = np.maximum(BUMP_M * LEFT_LENGTH_RAD * EARTH_RADIUS_M / self.width_m**2, 1.0)

    def motion_px(self, step: FloatArray) -> float:
        """Return by how much a step moves the limb where it moves it most [px]."""
        moved = step[:POSE] @ self.by_pose[:, self._some]
        return float(np.abs(moved).max() / np.median(self.near.width_m))

    def look(self, now: Guess) -> Seen:
        """Return the pixels as the unknowns say they are."""
        near, air = self.near, self.air
        lift = self._lift * (now.blur**2 * self._variance + PIXEL_VARIANCE)
        across = self._across + self.moved + now.away @ self.by_pose + lift
        at = (across - air.bottom_m) / air.step_m
        size = air.functions.shape[2]
        place = np.clip(at.astype(np.intp), 0, size - 2)
        share = np.clip(at - place, 0.0, 1.0)
        changes = self.tables.changes(air.coefficients(now.air), now.blur, now.sharpness)
        # Between two heights a parabola that their slopes bend: model and derivative are of one piece.
        bend = np.zeros_like(changes[:1])
        bend[..., :-1] = (0.5 * air.step_m) * (changes[1, :, :-1] - changes[1, :, 1:])
        level, slope, by_blur, by_sharpness, bent = self._read(np.concatenate([changes, bend]), place, share).T
        level = level + share * (1.0 - share) * bent
        shown = now.background + now.gain * near.light * level
        kept = np.ones_like(shown)
        if self.floor is not None:
            shown, kept = self.floor.expected(shown)
        largest, i = changes[0].max(axis=1), near.sector
        brightest = largest[i] + (largest[i + 1] - largest[i]) * near.along
        by_all = np.array([slope, by_blur, by_sharpness])
        return Seen(place, share, level, by_all, brightest, kept, near.values - shown)

    def neglected(self, now: Guess, look: Seen) -> FloatArray:
        """Return the standard deviation of what the prediction leaves out of the pixels, shape (n,)."""
        before, after = (self.air.neglected[self.near.sector, look.place + k] for k in (0, 1))
        return np.asarray(now.gain * self.near.light * (before + look.share * (after - before)))

    def _read(self, tables: FloatArray, place: np.ndarray, share: FloatArray) -> FloatArray:
        """Return tables (c, m, n) at places of the grid and shares of the next, shape (n, c)."""
        near, size = self.near, tables.shape[2]
        rows = np.ascontiguousarray(tables.transpose(1, 2, 0)).reshape(-1, len(tables))
        first, along = near.sector * size + place, near.along
        before, after = (1.0 - share)[:, None], share[:, None]
        left = rows[first] * before
        left += rows[first + 1] * after
        first += size
        right = rows[first] * before
        right += rows[first + 1] * after
        right -= left
        right *= along[:, None]
        left += right
        return left

    def equations(
        self,
        now: Guess,
        look: Seen,
        inverse_variance: FloatArray,
        by_level: FloatArray | None = None,
        *,
        of_growth: bool = False,
    ) -> Equations:
        """Return the normal equations of a step.

        ``by_level``: addition to the residuals (n,) for noise that depends on the level; gain and background omit it,
        since they scale the noise. ``of_growth``: add a last shared unknown, the growth of ln blur with ``off_axis``.
        """
        near = self.near
        root = np.sqrt(inverse_variance)
        kept = root * look.kept
        amplitude = now.gain * near.light * kept
        residuals = root * look.residuals
        on_level = residuals if by_level is None else root * (look.residuals + by_level)
        shared = self._shared(now, amplitude, kept, look.level, look.changes)
        if of_growth:
            shared = np.concatenate([shared, self.off_axis[None] * shared[BLUR]])
        sums, squares = self._by_sector(look, amplitude, shared)
        functions = self.tables.values(now.blur, now.sharpness, self.every)[:, 1:]
        bends = _bends(functions)
        before, after = (functions[:-1], bends[:-1]), (functions[1:], bends[1:])
        own = np.zeros((len(functions), functions.shape[1], functions.shape[1]))
        own[:-1] += _products(before, squares[0], before)
        own[1:] += _products(after, squares[2], after)
        next_ = _products(before, squares[1], after)
        to_others = np.zeros((*functions.shape[:2], len(shared)))
        for to_node, node, (level, bent) in zip((to_others[:-1], to_others[1:]), (before, after), sums, strict=True):
            to_node += node[0] @ level + node[1] @ bent
        waves, function = self.air.wave, self.air.function
        pull = self._pull(now, look, amplitude * on_level)
        right = shared @ on_level
        right[[GAIN, BACKGROUND]] = shared[[GAIN, BACKGROUND]] @ residuals
        return Equations(
            shared @ shared.T,
            np.einsum("ijk,ij->kj", to_others[:, function], waves),
            self._of_waves(own, next_),
            right,
            np.einsum("ij,ij->j", pull[:, function], waves),
        )

    def _shared(
        self, now: Guess, amplitude: FloatArray, root: FloatArray, level: FloatArray, changes: FloatArray
    ) -> FloatArray:
        """Return the weighed derivatives by the shared unknowns, and by those of the lens, shape (11 + c, n)."""
        slope, by_blur, by_sharpness = changes * amplitude
        shared = np.empty((SHARED + len(self.by_lens), len(root)))
        np.multiply(self.by_pose, slope, out=shared[:POSE])
        np.multiply(self.by_lens, slope, out=shared[SHARED:])
        shared[BLUR] = by_blur + slope * ((2.0 * now.blur**2) * self._variance * self._lift)
        shared[SHARPNESS], shared[GAIN], shared[BACKGROUND] = by_sharpness, amplitude * level, root
        return shared

    def _pull(self, now: Guess, look: Seen, on_level: FloatArray) -> FloatArray:
        """Return what pixels (n,) want of the coefficients at the nodes, shape (m, k): as :meth:`look` has them."""
        near, size = self.near, self.air.functions.shape[2]
        first, places = near.sector * size + look.place, (len(near.starts)) * size
        level, bent, parabola = np.zeros(places), np.zeros(places), look.share * (1.0 - look.share)
        for weight, at in ((on_level * (1.0 - near.along), first), (on_level * near.along, first + size)):
            after = weight * look.share
            before = weight - after
            level += np.bincount(at, before, places)
            level += np.bincount(at + 1, after, places)
            bent += np.bincount(at, before * parabola, places)
            bent += np.bincount(at + 1, after * parabola, places)
        bent *= 0.5 * self.air.step_m
        bent[size - 1 :: size] = 0.0
        slope = bent.copy()
        slope[1:] -= bent[:-1]
        by_node = self.tables.pull(level.reshape(-1, size), slope.reshape(-1, size), now.blur, now.sharpness)
        return by_node[:, 1:]

    def _by_sector(
        self, look: Seen, amplitude: FloatArray, others: FloatArray
    ) -> tuple[list[list[FloatArray]], FloatArray]:
        """Return sums over a sector's pixels near a point of the coarse grid.

        A function at the share ``s`` past a point is ``(1 - s)`` of the value there, ``s`` of the next and ``s (1 -
        s)`` of the bend. ``sums`` (m, places, c): amplitude times others (c, n), for a sector's first and last node, by
        value and bend. ``squares`` (3, m, 5, places): squared amplitude for node pairs first-first, first-last,
        last-last, by value-value, value-next, value-bend, next-bend and bend-bend.
        """
        near, every = self.near, self.every
        sectors, size = len(near.starts) - 1, 1 + (self.air.functions.shape[2] - 1) // every
        whole, rest = np.divmod(look.place, every)
        after = (rest + look.share) / every
        before, along, first = 1.0 - after, near.along, near.sector * size + whole
        bend, n, places = after * before, len(first), sectors * size
        one, two = np.arange(n + 1, dtype=np.int32), np.arange(0, 2 * n + 1, 2, dtype=np.int32)
        at = np.empty((n, 2), dtype=np.int32)
        at[:, 0], at[:, 1] = first, first + 1
        values = np.ascontiguousarray((others * amplitude).T)
        sums = []
        for weight in (1.0 - along, along):
            parts = np.empty((n, 2))
            np.multiply(before, weight, out=parts[:, 0])
            np.multiply(after, weight, out=parts[:, 1])
            level = csr_array((parts.ravel(), at.ravel(), two), shape=(n, places + 1))
            bent = csr_array((bend * weight, at[:, 0], one), shape=(n, places + 1))
            sums.append([(matrix.T @ values)[:-1].reshape(sectors, size, -1) for matrix in (level, bent)])
        square = amplitude**2
        last = square * along
        of_last = last * along
        squares = np.empty((3, 5, places))
        for kind, out in zip((square - 2.0 * last + of_last, last - of_last, of_last), squares, strict=True):
            out[0] = np.bincount(first, kind * before**2, places)
            out[0, 1:] += np.bincount(first, kind * after**2, places)[:-1]
            both = kind * bend
            out[1] = np.bincount(first, both, places)
            out[2] = np.bincount(first, both * before, places)
            out[3] = np.bincount(first, both * after, places)
            out[4] = np.bincount(first, both * bend, places)
        return sums, squares.reshape(3, 5, sectors, size).transpose(0, 2, 1, 3)

    def _of_waves(self, own: FloatArray, next_: FloatArray) -> FloatArray:
        """Return the equations of the air's unknowns from those of node coefficients; only neighbours couple."""
        function, waves = self.air.function, self.air.wave
        matrix = np.empty((len(function), len(function)))
        last = 0
        # The rows of one function at a time stay in a processor's cache; what is above the diagonal is below it too.
        for j, wave in enumerate(self.air.waves):
            first, last = last, last + wave.shape[1]
            before = function[:last]
            spread = own[:, j, before] * waves[:, :last]
            spread[:-1] += next_[:, j, before] * waves[1:, :last]
            spread[1:] += next_[:, before, j] * waves[:-1, :last]
            rows = wave.T @ spread
            matrix[first:last, :last] = rows
            matrix[:first, first:last] = rows[:, :first].T
        return matrix


def off_axis_share(camera: CameraModel, los_cam: FloatArray) -> FloatArray:
    """Return squared angles from the axis over the largest in a grid of every eighth pixel, shape (m,)."""
    columns, rows = (np.linspace(0.0, size - 1.0, EIGHTHS) for size in (camera.width, camera.height))
    some = unproject(camera, np.stack(np.meshgrid(columns, rows), axis=-1))
    farthest = float(np.nanmax(off_axis_angle(some, AXIS_CAM)))
    return np.asarray((off_axis_angle(los_cam, AXIS_CAM) / farthest) ** 2)


def _bends(functions: FloatArray) -> FloatArray:
    """Return what a parabola between a place and the next has beyond a straight line at its middle, times four."""
    bends = np.zeros_like(functions)
    bends[..., 1:-2] = functions[..., 1:-2] + functions[..., 2:-1] - functions[..., :-3] - functions[..., 3:]
    bends *= 0.25
    return bends


def _products(
    one: tuple[FloatArray, FloatArray], squares: FloatArray, other: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return the products (m, k, k) of functions and their bends (m, k, n) each, by sums (m, 5, n) over the pixels."""
    (level, bend), (other_level, other_bend) = one, other
    own, both, with_bend, next_with_bend, bends = (squares[:, None, i] for i in range(5))
    of_level = level * own + bend * with_bend
    of_level[..., :-1] += level[..., 1:] * both[..., :-1]
    of_level[..., 1:] += level[..., :-1] * both[..., :-1] + bend[..., :-1] * next_with_bend[..., :-1]
    of_bend = level * with_bend + bend * bends
    of_bend[..., :-1] += level[..., 1:] * next_with_bend[..., :-1]
    return np.asarray(of_level @ other_level.transpose(0, 2, 1) + of_bend @ other_bend.transpose(0, 2, 1))
