"""The image model of the whole profile of the limb: what its pixels see, in air that varies along it.

A pixel whose ray passes at the height ``h`` (:mod:`.profile_pixels`), between two nodes of azimuth, is ::

    I = b + g l P_s(h - H + c (s^2 + 1/12)) + noise,        P = mean + sum_k a_k f_k

with the profiles of :mod:`.air`, blurred by ``s`` and a lens of sharpness ``q`` (:mod:`.blurred`), linear between the
nodes, and ``l`` the level per radiance. ``c (s^2 + 1/12)`` is the shift of a bent limb by blur, ``H`` the height of the
pose: a lift of all air. The image's own unknowns are ``ln s``, ``q``, ``ln g`` and ``b``; the air's are the unit
unknowns ``z`` behind the coefficients ``a``.

Within a choice of pixels the distances across the limb are linear in the displacement from its pose: a displacement of
``u`` neglects ``u^2 / 2`` over the distance of the limb, 60 m for a pixel of 19 km.

**Equations.** A pixel depends on the functions at the two nodes of its sector alone: rows ``[F (1 - t), F t, shared]``.
One product per sector gives all sums over its pixels; those of the waves along the limb follow from sums at the nodes,
of which only neighbours couple.

**Noise** (:mod:`.noise`): components by level, by the square of what clouds can change (the radiance of the limb's
brightest height, blurred, below the highest clouds), and by the square of the slope (errors of the lens model).
What the modes leave of the air is in the least variance, common over some height and length.

**Lower end.** The variance of the lowest pixels grows smoothly to infinity with the depth at which they see the ground,
so that no pixel enters or leaves a fit at once.

**Neglected.** Correlation of residuals beyond the largest square of pixels that is tested.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.sparse import csr_array
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.air import LEFT_LENGTH_RAD, LEFT_M, KnownAir, NodeAir, common_air
from horizonval.estimation.fit.blurred import AROUND, REACH_BLURS, BlurredProfiles, around_of
from horizonval.estimation.fit.image import LENS, POSE, Chosen, ImageModel, Look, OwnPrior, ShotState
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.fit.noise import PixelNoise, correlated, floor_of, variance_of
from horizonval.estimation.fit.pixels import level_distance, with_errors
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.profile_pixels import NoLimbError, ProfilePixels, profile_pixels
from horizonval.estimation.limb.picture import rounding_variance
from horizonval.estimation.observation import Lens
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import off_axis_angle

BLUR, SHARPNESS, GAIN, BACKGROUND, OWN = 0, 1, 2, 3, 4
"""Places of an image's own unknowns (ln blur, sharpness, ln gain, background), and how many there are."""
CLOUD_TOP_M = 16e3
"""Height of tropical cloud tops."""
DEPTH_PX = 0.5
"""Depth at which the window ends below the ground, and the depth over which it ends. Lines that end farther before
the limb see other air, ground and clouds than those that pass it."""
NEAR_PX = 0.5
"""Way of the limb up to which pixels stay chosen: distances are then linear to a thousandth of a pixel."""


@dataclass(frozen=True)
class ProfileKnowledge:
    """Prior knowledge of a profile fit.

    ``mean``: prior pose, ``height_m`` being the lift of the air; ``information``: shape (7, 7), of a step from it.
    ``blur_px``, ``blur_log_sigma``: of the lens; ``lens``: blur over the field and diffraction from the camera file.
    ``sharpness``, ``sharpness_sigma``: shape of the lens's blur (:mod:`.blurred`), which no file states. ``gain``,
    ``gain_log_sigma``: levels per table radiance on the axis; an infinite sigma for an uncalibrated detector.
    """

    ellipsoid: Ellipsoid
    mean: LimbPose
    information: FloatArray
    air: KnownAir
    blur_px: float = 0.7
    blur_log_sigma: float = 0.3
    lens: Lens = field(default_factory=Lens)
    sharpness: float = 0.5
    sharpness_sigma: float = 0.5
    gain: float = 1.0
    gain_log_sigma: float = np.inf

    @property
    def own(self) -> FloatArray:
        """Prior values of an image's own unknowns, shape (4,)."""
        return np.array([np.log(self.blur_px), self.sharpness, np.log(self.gain), 0.0])


@dataclass(frozen=True)
class ProfileLook:
    """Predicted pixels, shape (n,) each.

    ``own``: shape (4,), the image's own unknowns; ``by_turn``: shape (3, n), derivatives of the distances across the
    limb by a turn from here; ``place``, ``share``: of the height grid; ``at``, ``parts``: shape (8, n), numbers of the
    coefficients at both nodes that make a pixel's value, and their weights; ``across_m``: distance across the limb;
    ``level``: radiance; ``changes``: shape (3, n), derivatives by distance across the limb [1/m], ln blur, sharpness;
    ``brightest``: largest radiance of the profile there; ``kept``: share of a radiance change that survives the
    converter's floor in the mean.
    """

    own: FloatArray
    by_turn: FloatArray
    place: NDArray[np.intp]
    share: FloatArray
    at: NDArray[np.intp]
    parts: FloatArray
    across_m: FloatArray
    level: FloatArray
    changes: FloatArray
    brightest: FloatArray
    kept: FloatArray
    residuals: FloatArray
    penalty: float = 0.0


class ProfileModel:
    """The pixels that see the profile at a pose; see :class:`horizonval.estimation.fit.image.ImageModel`.

    ``image``: shape (H, W), NaN where missing; ``lens``: shape (4,), errors of the lens that ``camera`` has already;
    ``blur_px``: for the window's width; ``tighter``: factor on the information on blur and sharpness; ``before``: model
    of a pose near by, whose nodes and air are kept. ``below_clouds`` (n,): share of a pixel's radiance from below the
    highest clouds. Raises ``LinAlgError``: too little limb in view.
    """

    def __init__(
        self,
        image: FloatArray,
        camera: CameraModel,
        pose: LimbPose,
        lens: FloatArray,
        blur_px: float,
        knowledge: ProfileKnowledge,
        tighter: float = 1.0,
        before: ProfileModel | None = None,
    ) -> None:
        self.pose, self.lens, self.knowledge, self.camera = pose, lens.copy(), knowledge, camera
        self.tighter = tighter
        high = knowledge.air.heights_m[1]
        axes = knowledge.ellipsoid.axes_m
        to_limb_2 = max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0)
        pixel_m = np.sqrt(to_limb_2) / max(camera.fx, camera.fy)
        widest = blur_px * float(knowledge.lens.ratios.max())
        reach = REACH_BLURS * float(np.sqrt(widest**2 + PIXEL_VARIANCE)) * pixel_m
        # Half of it beyond the table is too little to see of it.
        rim = 0.5 * reach
        bottom, top = -1.5 * DEPTH_PX * pixel_m, high + max(rim, 4.0 * pixel_m)
        self.curve = curve = 0.5 * axes[0] / to_limb_2
        nodes = None if before is None else before.near.nodes
        near = profile_pixels(image, camera, pose, lens, knowledge.ellipsoid, (bottom, top), high + rim, nodes)
        self.near: ProfilePixels = near
        ends, _ = level_distance(np.array([bottom, top]), curve)
        self._bottom, self._taper = ends[0], DEPTH_PX * pixel_m
        off_axis = off_axis_angle(near.nodes.los_cam, np.array([0.0, 0.0, 1.0]))
        if before is None:
            # A twentieth of the air's scale height, or a seventh of the blur: the nadir moves by up to 0.03 of its
            # sigma, with 8 steps a pixel by up to 0.7, since sampled lenses show waves of half a pixel.
            step, first = max(400.0, pixel_m / 12.0), ends[0] - reach
            count = next_fast_len(int(np.ceil((ends[1] + reach - first) / step)), real=True)
            grid = (first, first + (count - 0.5) * step, step)
            self.air = knowledge.air.nodes(near.nodes.normal_cam, near.nodes.los_cam, pose, grid, curve)
            self.tables = BlurredProfiles(self.air.functions, step, near.nodes.boxes_m, knowledge.lens, off_axis)
        else:
            self.air, self.tables = before.air, before.tables
        self.floor = floor_of(near.space, float(np.nanmin(image)))
        i, t = near.sector, near.along
        self._lift = near.nodes.lift_m[i] * (1.0 - t) + near.nodes.lift_m[i + 1] * t
        variances = knowledge.lens.ratios**2 @ knowledge.lens.shares(off_axis)
        self._variance = variances[i] + (variances[i + 1] - variances[i]) * t
        self.width_m, self.pixel_m = near.nodes.width_m[i], float(np.median(near.nodes.width_m))
        soft_m = np.sqrt(blur_px**2 * self._variance + PIXEL_VARIANCE) * self.width_m
        self.below_clouds = ndtr((CLOUD_TOP_M - near.height_m) / soft_m)
        # The integral of a normal correlation of the length l is (2 pi)^1/2 l.
        alike_m2 = LEFT_M * np.sqrt(2.0 * np.pi) * LEFT_LENGTH_RAD * MEAN_RADIUS_M
        self._left_px = np.maximum(alike_m2 / self.width_m**2 / near.every, 1.0)
        self._least = rounding_variance(near.values)
        self._last: tuple[FloatArray, ProfileLook] | None = None

    def held(self, tighter: float) -> ProfileModel:
        """Return the same pixels with another factor on the information on blur and sharpness."""
        one = copy(self)
        one.tighter = tighter
        return one

    def moved(self, own: FloatArray, step: FloatArray) -> FloatArray:
        """Return the own unknowns after a step."""
        return own + step

    def prior(self, pose: LimbPose, own: FloatArray) -> OwnPrior:
        """Return the priors of lens and gain, and that of the background where a floor cuts space off."""
        known, information, wanted = self.knowledge, np.zeros(OWN), self.knowledge.own - own
        information[:BACKGROUND] = np.array([known.blur_log_sigma, known.sharpness_sigma, known.gain_log_sigma]) ** -2.0
        information[[BLUR, SHARPNESS]] *= self.tighter
        if self.floor is not None:
            information[BACKGROUND], wanted[BACKGROUND] = self.floor.sigma**-2, self.floor.background - own[BACKGROUND]
        first = POSE + LENS
        whole = np.zeros(first + OWN)
        whole[first:] = information
        right = np.zeros(first + OWN)
        right[first:] = information * wanted
        return OwnPrior(np.diag(whole), right, float(information @ wanted**2))

    def reach(self, step: FloatArray) -> float:
        """Return how far a step goes, 1 at the end of the derivatives' range."""
        own = step[POSE + LENS :]
        # Derivatives hold for two scale heights of the air or some pixels.
        most_px = max(15e3 / self.pixel_m, 3.0)
        logs = float(np.abs(own[[BLUR, GAIN]]).max()) / 0.5
        return max(self.motion_px(step) / most_px, logs)

    def way(self, pose: LimbPose, lens: FloatArray) -> FloatArray:
        """Return the step (7 + 4 + own) to a pose and errors of the lens, without own unknowns."""
        return np.concatenate([self.pose.step_to(pose), lens - self.lens, np.zeros(OWN)])

    def motion_px(self, step: FloatArray) -> float:
        """Return by how much a step (7 + 4 + own) moves the limb where it moves it most [px]."""
        moved = step[:POSE] @ self.near.by_pose + step[POSE : POSE + LENS] @ self.near.by_lens
        return float(np.abs(moved).max()) / self.pixel_m

    def look(
        self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray, weights: FloatArray | None = None
    ) -> ProfileLook:
        """Return the pixels as predicted; ``weights`` are not needed."""
        at = np.concatenate([pose.cam_from_itrs.ravel(), pose.r_itrs, [pose.height_m], lens, own[:GAIN], air])
        if self._last is None or not np.array_equal(self._last[0], at):
            self._last = at, self._look(*self.near.moved(pose, lens), own, air)
        look = self._last[1]
        shown = own[BACKGROUND] + float(np.exp(own[GAIN])) * self.near.light * look.level
        kept = np.ones_like(shown)
        if self.floor is not None:
            shown, kept = self.floor.expected(shown)
        return replace(look, own=own, kept=kept, residuals=self.near.values - shown)

    def _look(self, across: FloatArray, by_turn: FloatArray, own: FloatArray, unknowns: FloatArray) -> ProfileLook:
        """Return the radiance of the pixels, without gain and background."""
        near, air = self.near, self.air
        blur, sharpness = float(np.exp(own[BLUR])), float(own[SHARPNESS])
        across = across + self._lift * (blur**2 * self._variance + PIXEL_VARIANCE)
        on_grid = (across - air.bottom_m) / air.step_m
        size = air.functions.shape[2]
        place = np.clip(on_grid.astype(np.intp), 1, size - 3)
        share = np.clip(on_grid - place, 0.0, 1.0)
        changes = self.tables.changes(air.coefficients(unknowns), blur, sharpness)
        at = np.add.outer(np.concatenate([AROUND, size + AROUND]), near.sector * size + place)
        parts, steeper = (
            np.concatenate([weights * (1.0 - near.along), weights * near.along]) for weights in around_of(share)
        )
        level, by_blur, by_sharpness = (np.einsum("in,in->n", np.take(one, at), parts) for one in changes)
        slope = np.einsum("in,in->n", np.take(changes[0], at), steeper) / air.step_m
        largest, i = changes[0].max(axis=1), near.sector
        brightest = largest[i] + (largest[i + 1] - largest[i]) * near.along
        by_all = np.array([slope, by_blur, by_sharpness])
        return ProfileLook(own, by_turn, place, share, at, parts, across, level, by_all, brightest, level, near.values)

    def levels(self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray) -> FloatArray:
        """Return the own unknowns with the gain and background that fit best."""
        dark = own.copy()
        dark[[GAIN, BACKGROUND]] = 0.0
        light, values = self.look(pose, lens, dark, air).level * self.near.light, self.near.values
        rows = np.array([light, np.ones_like(light)])
        gain, background = np.linalg.solve(rows @ rows.T, rows @ values)
        if not gain > 0.0:
            raise NoLimbError("the image is not brighter where the limb's profile is")
        dark[GAIN], dark[BACKGROUND] = np.log(gain), background if self.floor is None else self.floor.background
        return dark

    def noise(self, look: ProfileLook) -> PixelNoise:
        """Return the noise of the pixels by their residuals."""
        near = self.near
        low, high = (self.air.left[near.sector, look.place + k] for k in (0, 1))
        left = (np.exp(look.own[GAIN]) * near.light * (low + look.share * (high - low))) ** 2
        clouds = near.light * look.brightest * self.below_clouds
        per_px = near.light * look.changes[0] * self.width_m
        variance, shown = variance_of(
            look.residuals, near.light * look.level, np.array([clouds**2, per_px**2]), self._least + left
        )
        # Not of a limb that is still displaced, which would hide it.
        if self.tighter == 1.0:
            in_sigmas = look.residuals * np.sqrt(PixelNoise(variance).weights(look.residuals))
            common = correlated(near.columns, near.rows, in_sigmas, float(np.sqrt(near.every)))
            # The mean share counts, since the ratio is that of all pixels together.
            together = 1.0 + (common - 1.0) * shown / max(float(shown.mean()), 1e-300)
            together = together + (self._left_px - 1.0) * np.minimum(left / variance, 1.0)
        else:
            together = np.ones_like(variance)
        depth = np.clip((look.across_m - self._bottom) / self._taper, 0.0, 1.0)
        return PixelNoise(variance, together / np.maximum(depth**2 * (3.0 - 2.0 * depth), 1e-3))

    def linear(self, look: ProfileLook, own: FloatArray, weights: FloatArray) -> ProfileLinear:
        """Return the normal equations at a look."""
        return ProfileLinear(self, look, weights)

    def amplitude(self, look: ProfileLook) -> FloatArray:
        """Return the change of the pixels by that of radiance, shape (n,)."""
        return np.asarray(float(np.exp(look.own[GAIN])) * self.near.light * look.kept)

    def derivatives(self, look: ProfileLook) -> FloatArray:
        """Return the derivatives of the pixels by pose, lens and own unknowns, shape (15, n)."""
        near, blur, amplitude = self.near, float(np.exp(look.own[BLUR])), self.amplitude(look)
        slope, by_blur, by_sharpness = look.changes * amplitude
        rows = np.empty((POSE + LENS + OWN, len(slope)))
        np.multiply(look.by_turn, slope, out=rows[:3])
        np.multiply(near.by_pose[3:], slope, out=rows[3:POSE])
        np.multiply(near.by_lens, slope, out=rows[POSE : POSE + LENS])
        own_rows = rows[POSE + LENS :]
        own_rows[BLUR] = by_blur + slope * ((2.0 * blur**2) * self._variance * self._lift)
        own_rows[SHARPNESS], own_rows[GAIN], own_rows[BACKGROUND] = by_sharpness, amplitude * look.level, look.kept
        return rows


class ProfileLinear:
    """Normal equations at one look; see :class:`horizonval.estimation.fit.image.Linear`."""

    exact: ClassVar[bool] = True

    def __init__(self, model: ProfileModel, look: ProfileLook, weights: FloatArray) -> None:
        self._model, self.look, self.weights = model, look, weights
        near, air = model.near, model.air
        sectors, count = len(near.starts) - 1, len(air.waves)
        blur_px, sharpness = float(np.exp(look.own[BLUR])), float(look.own[SHARPNESS])
        functions = model.tables.values(blur_px, sharpness, 1 + count)[:, 1:]
        table = np.ascontiguousarray(functions.transpose(0, 2, 1)).reshape(-1, count)
        shared = model.derivatives(look)
        root = np.sqrt(weights)
        amplitude = model.amplitude(look) * root
        rows = np.empty((len(weights), 2 * count + len(shared)))
        parts, ends = (look.parts * amplitude).reshape(2, 4, -1), np.arange(0, 4 * len(weights) + 1, 4)
        for node, (part, at) in enumerate(zip(parts, look.at.reshape(2, 4, -1), strict=True)):
            of_node = csr_array((part.T.ravel(), at.T.ravel(), ends), shape=(len(weights), len(table)))
            rows[:, node * count : (node + 1) * count] = of_node @ table
        np.multiply(shared.T, root[:, None], out=rows[:, 2 * count :])
        own, next_ = np.zeros((sectors + 1, count, count)), np.zeros((sectors + 1, count, count))
        mixed = np.zeros((sectors + 1, len(shared), count))
        self.shared = np.zeros((len(shared), len(shared)))
        for k in range(sectors):
            part = rows[near.starts[k] : near.starts[k + 1]]
            gram = part.T @ part
            own[k] += gram[:count, :count]
            own[k + 1] = gram[count : 2 * count, count : 2 * count]
            next_[k] = gram[:count, count : 2 * count]
            mixed[k] += gram[2 * count :, :count]
            mixed[k + 1] = gram[2 * count :, count : 2 * count]
            self.shared += gram[2 * count :, 2 * count :]
        self.mixed = np.einsum("ikj,ij->kj", mixed[:, :, air.function], air.wave)
        self.air = _of_waves(air, own, next_)

    def rights(self, look: Look, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the right sides: the gradient at another look, exact there."""
        assert isinstance(look, ProfileLook)
        weighed = weights * look.residuals
        model, air, size = self._model, self._model.air, self._model.air.functions.shape[2]
        values = look.parts * (model.amplitude(look) * weighed)
        on_grid = np.bincount(look.at.ravel(), values.ravel(), len(model.near.starts) * size)
        on_nodes = np.asarray(on_grid.reshape(-1, size), dtype=np.float64)
        pull = model.tables.pull(on_nodes, float(np.exp(look.own[BLUR])), float(look.own[SHARPNESS]))
        of_air = np.einsum("ij,ij->j", pull[:, 1 + air.function], air.wave)
        return model.derivatives(look) @ weighed, np.asarray(of_air)


def _of_waves(air: NodeAir, own: FloatArray, next_: FloatArray) -> FloatArray:
    """Return the equations of the air's unknowns from those of node coefficients; only neighbours couple."""
    function, waves = air.function, air.wave
    matrix = np.empty((len(function), len(function)))
    last = 0
    # The rows of one function at a time stay in a processor's cache; what is above the diagonal is below it too.
    for j, wave in enumerate(air.waves):
        first, last = last, last + wave.shape[1]
        before = function[:last]
        spread = own[:, j, before] * waves[:, :last]
        spread[:-1] += next_[:-1, j, before] * waves[1:, :last]
        spread[1:] += next_[:-1, before, j] * waves[:-1, :last]
        rows = wave.T @ spread
        matrix[first:last, :last] = rows
        matrix[:first, first:last] = rows[:, :first].T
    return matrix


@dataclass(frozen=True)
class ProfileImage:
    """An image of a shot. ``turn``: shape (3, 3), camera from body; ``table``: hashable source of its air."""

    image: FloatArray
    camera: CameraModel
    knowledge: ProfileKnowledge
    turn: FloatArray = field(default_factory=lambda: np.eye(3))
    table: Hashable = None


class ProfileChooser:
    """Chooses the pixels of all images of a shot; see :class:`horizonval.estimation.fit.image.Chooser`."""

    def __init__(self, images: Sequence[ProfileImage]) -> None:
        self._images = images

    def __call__(
        self, state: ShotState, lens: FloatArray, most: int | None, tighter: float, before: Chosen | None
    ) -> Chosen:
        """Return the pixels near the limb at a state; the number of pixels is always the same."""
        old = [None] * len(self._images) if before is None else [as_profile(model) for model in before.models]
        ways = [
            np.zeros(POSE + LENS + OWN) if model is None else model.way(state.pose.of_camera(one.turn), lens)
            for one, model in zip(self._images, old, strict=True)
        ]
        # Within the reach of derivatives a node is beside the limb by less than the nodes are apart.
        same_air = before is not None and all(
            model is not None and model.reach(way) < 1.0 for model, way in zip(old, ways, strict=True)
        )
        models: list[ProfileModel] = []
        for one, own, near_by, way in zip(self._images, state.own, old, ways, strict=True):
            if same_air and near_by is not None and near_by.motion_px(way) < NEAR_PX:
                models.append(near_by.held(tighter))
                continue
            camera = with_errors(one.camera, lens)
            pose, blur_px = state.pose.of_camera(one.turn), float(np.exp(own[BLUR]))
            known = near_by if same_air else None
            models.append(ProfileModel(one.image, camera, pose, lens, blur_px, one.knowledge, tighter, known))
        if before is not None and same_air:
            return Chosen(models, before.columns, state)
        air = common_air([model.air for model in models], [one.table for one in self._images])
        for model, own_air in zip(models, air.images, strict=True):
            model.air = own_air
        # Unknowns at other nodes say nothing of these.
        state = replace(state, air=np.zeros(air.count))
        if before is None:
            owns = tuple(
                model.levels(model.pose, lens, own, np.zeros(model.air.wave.shape[1]))
                for model, own in zip(models, state.own, strict=True)
            )
            state = replace(state, own=owns)
        return Chosen(models, air.columns, state)


def as_profile(model: ImageModel) -> ProfileModel:
    """Return a model as the one of a profile that it is."""
    assert isinstance(model, ProfileModel)
    return model
