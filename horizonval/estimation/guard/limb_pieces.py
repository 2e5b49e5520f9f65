r"""What every piece of a limb shows: whether the edge that was fitted is there, with its sign, and nowhere else.

The limb in view is cut into pieces, :data:`PIECES` of every sector of a fit. The pixels of a piece are explained by
``b + (a + c x) E(x) + noise``, with ``E`` the edge of the fitted limb and ``x`` the pixels inside it. A piece *shows*
the limb where the step ``a`` has the sign of the whole limb's and stands :data:`STEP_SIGMAS` of its own standard
deviations out of the noise.

Not all of a limb is *due* to show. Of a sunlit one it is what the Sun's direction says is lit, and where that is not
known half a round of azimuth, the one with the most light: a sphere is lit over half of its limb from anywhere. In a
thermal band all of it is.

A *rival* is another place, beyond the reach of any air, at which the pieces show as large a step of the same sign: of
two limbs one cannot be chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import limb_height_m
from horizonval.estimation.likelihood.edge_profile import PIXEL_VARIANCE, EdgeProfile, edge_profile
from horizonval.estimation.likelihood.fit import LimbLikelihoodFit
from horizonval.estimation.likelihood.knowledge import LimbKnowledge
from horizonval.estimation.likelihood.light import MIDDLE_LEVEL, light_basis, weighed
from horizonval.estimation.likelihood.limb_angle import limb_angle
from horizonval.estimation.likelihood.limb_pixels import LimbPixels, limb_pixels
from horizonval.estimation.likelihood.pixels import image_scale, near_pixels
from horizonval.estimation.limb.model.sunlit import sun_angles
from horizonval.estimation.observation import Observation
from horizonval.geometry.rotation import tangent_basis

BoolArray = NDArray[np.bool_]

PIECES = 3
"""Of a sector of 24 px of limb: 8 px long and 20 across, 160 pixels that know a step of one pixel's noise to a sixth of
itself, and four dozen of which a picture of 160 px holds more than ten."""
STEP_SIGMAS = 5.0
"""Rose's criterion, for a piece in place of a pixel."""
LEAST_NOISE = 1e-3
"""Of a pixel's variance over that of all residuals: keeps the equations regular."""
RIVAL_STEP = 0.5
"""Of the limb's own step: half of it is the level at which edges are placed."""
RIVAL_WIDTH_PX = 3.0
"""To either side of a rival's place: an edge of a lens of 0.7 px lasts two."""
FARTHEST_RIVAL_PX = 40.0
RIVAL_STEPS_PX = 2.0


@dataclass(frozen=True)
class LimbPieces:
    """What m pieces of a limb show.

    Attributes
    ----------
    steps : ndarray, shape (m,)
        Step of every piece over its standard deviation, positive where it has the whole limb's sign.
    due : ndarray of bool, shape (m,)
    bright_inside : bool
    edge_misfit : float
        Mean square of the residuals across the edge, less the noise that the pixels to both sides of it have, over the
        square of the limb's step.
    rival_shown : int
        Pieces that are due and show some other place as well.
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


def limb_pieces(
    image: FloatArray, observation: Observation, found: LimbLikelihoodFit, knowledge: LimbKnowledge
) -> LimbPieces:
    """Return what the pieces of a fitted limb show.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    observation : Observation
        Camera, band and Sun are used.
    found : LimbLikelihoodFit
    knowledge : LimbKnowledge
        Of the fit.

    Raises
    ------
    numpy.linalg.LinAlgError
        Too little limb in view.
    """
    blur = float(np.sqrt(found.blur_px**2 + PIXEL_VARIANCE))
    near = limb_pixels(image, observation.camera, found.pose, knowledge, blur, found.scale_height_m)
    x, edge = _edge(near, found, knowledge, blur)
    light = weighed(light_basis(edge.level, x, near.along), near.values, near.sectors.starts)
    level = np.clip(edge.level, 0.0, 1.0)
    expected = light.variance[0] + (light.variance[1] - light.variance[0]) * level
    # Space of whole levels may be all alike: it is known to a level then, and not for sure.
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


def _edge(
    near: LimbPixels, found: LimbLikelihoodFit, knowledge: LimbKnowledge, blur: float
) -> tuple[FloatArray, EdgeProfile]:
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
    found: LimbLikelihoodFit,
    knowledge: LimbKnowledge,
    near: LimbPixels,
    starts: NDArray[np.intp],
    needed: FloatArray,
    due: BoolArray,
) -> int:
    """Return the number of pieces that show some place that is no part of the limb, each its own.

    ``needed``: signed step, shape (m,), that a rival must reach in every piece.
    """
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
