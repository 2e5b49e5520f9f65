"""Fisher information of the limb in an image, stored with the image and added over heads.

**Pixels.** A pixel of mean ``I`` and variance ``v``, independent and nearly normal, adds ``J^T J / v``, with ``J`` the
derivatives of its mean by the unknowns. Those by the pose follow from the motion of the limb: ``J_k = I_F dF/dk`` with
``I_F = grad I . grad F / |grad F|^2``. The gradient of the image is that of a quintic spline through its pixels, with
the lens's fall-off divided out before and multiplied back after.

**Motion of the limb.** Scaled by the axes ``s`` the ellipsoid is the unit sphere, the camera is at ``p = r / s`` and
looks along ``e = d / s``. The tangent cone's function (:func:`horizonval.geometry.horizon.limb_side`, scaled)::

    F = -p . e - sqrt(|p|^2 - 1) |e|

is positive inside the limb and zero on it, and its derivatives are closed::

    dF/de = -p - k e / |e|,    dF/dp = -e - |e| p / k,    k = sqrt(|p|^2 - 1)
    dF/dd = (dF/de) / s,       dF/dr = (dF/dp) / s
    dF/dh = -sum over axes of (p dF/dp + e dF/de) / s          all axes longer by the height h of the limb
    dF/dtheta = d x dF/dd                                     the camera turns by theta

Radiance that depends on the height over the ground moves with the contours of F, hence ``dI = (dI/dF) dF``.

**Unknowns.** Twelve are kept: turn, position, height of the limb, and the planet's shape, whose surface departs from a
sphere towards the unit vector ``u`` by ``u^T Q u`` with a symmetric ``Q`` without trace (5 numbers). For ``by_noise``
everything else is known. For ``by_knowledge`` these are free and eliminated:

- the level of space and the gain of all radiance, without a prior;
- the gain along the limb, by pieces of azimuth, correlated: :data:`LIGHT_SIGMA`;
- the blur of the lens, ``d2I/dx2 / 2`` across the limb by its variance: :data:`BLUR_VARIANCE_SIGMA`;
- how far up the limb's radiance reaches, ``-height dI/dheight`` by its logarithm: :data:`STRETCH_SIGMA`;
- the relief, the height by pieces of azimuth (:mod:`horizonval.earth.limb_heights`).

With ``M = [[A, B], [B^T, D]]`` of kept and eliminated unknowns what remains is Schur's complement ``A - B D^-1 B^T``.
It is found one unknown after the other, ``M' = M - m m^T / m_k`` with ``m`` column k of M, which needs no pivots for
positive definite matrices. Libraries round by the number of their threads; stored information has to be the same bytes
everywhere.

Pixels from :data:`INSIDE_PX` inside the limb to :data:`OUTSIDE_PX`, or :data:`OUTSIDE_M`, outside are used.

**Neglected.** All but the *position* of the limb. How its radiance changes along it (the Sun's angle, coasts, clouds)
tells a turn about the nadir to a method with a template, and so do landmarks. Where yaw is known or does not matter the
bound is that of the renderer's derivatives to 1 %; on a sunlit limb with a position, and a yaw known to 2 deg, these
give half of it. Undersampling: the spline's slope of a sharp edge is 0.3 % too small with a lens blur of 0.7 px, 1 %
with 0.5 px, 3 % with 0.4 px and 10 % without, and the bound as much too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import SOLAR_RELIEF, THERMAL_RELIEF, Relief
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import tangent_basis
from horizonval.sensor.expected_image import ExpectedImage, expected_image
from horizonval.spec.camera import CameraSpec

KEY = "information"
"""Key of the information in an image's settings."""
SCHEMA = 2
POSE, SHAPE = 7, 5
UNKNOWNS = POSE + SHAPE
"""Turn (3), position (3), height of the limb, shape of the planet (5)."""


@dataclass(frozen=True, eq=False)
class LimbInformation:
    """Information of one image, or the sum of several.

    ``by_noise`` and ``by_knowledge`` have the shape (12, 12): turn of the body about its axes [1/rad^2], position in
    Earth-fixed axes, height of the limb, and the planet's shape along :data:`SHAPES` [1/m^2]. ``limb_height_m`` is the
    height of the limb where the most informative pixels look past the Earth.
    """

    by_noise: FloatArray
    by_knowledge: FloatArray
    limb_height_m: float

    def __add__(self, other: LimbInformation) -> LimbInformation:
        """Return the information of two images of one pose."""
        weights = np.array([np.trace(one.by_noise[:3, :3]) for one in (self, other)])
        heights = np.array([self.limb_height_m, other.limb_height_m])
        mean = float(weights @ heights / weights.sum()) if weights.sum() > 0.0 else 0.0
        return LimbInformation(self.by_noise + other.by_noise, self.by_knowledge + other.by_knowledge, mean)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data: upper triangles, row by row."""
        upper = np.triu_indices(UNKNOWNS)
        return {
            "schema": SCHEMA,
            "by_noise": _digits(self.by_noise[upper]),
            "by_knowledge": _digits(self.by_knowledge[upper]),
            "limb_height_m": round(self.limb_height_m, 1),
        }

    @classmethod
    def from_dict(cls, data: Any) -> LimbInformation | None:
        """Rebuild from :meth:`to_dict`; None where there is nothing, or what another version means by it."""
        if not isinstance(data, dict) or data.get("schema") != SCHEMA:
            return None
        return cls(_symmetric(data["by_noise"]), _symmetric(data["by_knowledge"]), float(data["limb_height_m"]))


def carried(image: DetectorImage) -> LimbInformation | None:
    """Return the information that an image carries; None where it carries none."""
    return LimbInformation.from_dict(image.observation.get(KEY))


def _digits(values: FloatArray) -> list[float]:
    return [float(f"{value:.12g}") for value in values]


def _symmetric(upper: Sequence[float]) -> FloatArray:
    matrix = np.zeros((UNKNOWNS, UNKNOWNS))
    matrix[np.triu_indices(UNKNOWNS)] = upper
    return matrix + np.triu(matrix, 1).T


def without_last(information: FloatArray, kept: int) -> FloatArray:
    """Return the information on the first ``kept`` unknowns, shape (kept, kept), with all others free.

    The matrix (N, N) is symmetric, and positive definite in what is eliminated.
    """
    left = information.copy()
    for k in range(len(left) - 1, kept - 1, -1):
        column = left[:k, k] / left[k, k]
        left[:k, :k] -= column[:, None] * left[k, :k]
    return left[:kept, :kept]


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric positive definite matrix, shape (N, N)."""
    count = len(matrix)
    both = np.zeros((2 * count, 2 * count))
    both[count:, count:] = matrix
    both[:count, count:] = both[count:, :count] = np.eye(count)
    found = -without_last(both, count)
    return 0.5 * (found + found.T)


@dataclass(frozen=True, eq=False)
class LimbMotion:
    """Derivatives of F for n pixels.

    ``value`` (n,): F. ``by_pixel`` (2, n): by column and row [1/px]. ``by_pose`` (7, n): by a turn in camera axes
    [1/rad], by position in Earth-fixed axes [1/m], by the height of the limb [1/m].
    """

    value: FloatArray
    by_pixel: FloatArray
    by_pose: FloatArray

    @property
    def distance_px(self) -> FloatArray:
        """How far inside the limb the pixels lie in the image, shape (n,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.value / np.hypot(*self.by_pixel))

    @property
    def height_m(self) -> FloatArray:
        """How high above the limb the pixels look past the Earth, shape (n,): the rise that brings the limb to them."""
        return np.asarray(-self.value / self.by_pose[6])


def limb_motion(
    camera: CameraModel, uv: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray
) -> LimbMotion:
    """Return how the limb moves over pixels.

    Parameters
    ----------
    camera : CameraModel
    uv : ndarray, shape (n, 2)
    cam_from_itrs : ndarray, shape (3, 3)
    r_itrs : ndarray, shape (3,)
        Outside the ellipsoid [m].
    axes_m : ndarray, shape (3,)
        Semi-axes, the height of the limb included.

    Returns
    -------
    LimbMotion
        NaN where a pixel sees nothing. An image of one row has no change by row, one of one column none by column.
    """
    p = r_itrs / axes_m
    k = float(np.sqrt(p @ p - 1.0))
    los = unproject(camera, uv).T
    scaled = (cam_from_itrs.T @ los) / axes_m[:, None]
    length = np.linalg.norm(scaled, axis=0)
    by_scaled = -p[:, None] - k * scaled / length
    by_place = -scaled - length * (p / k)[:, None]
    by_direction = cam_from_itrs @ (by_scaled / axes_m[:, None])
    by_height = -((p / axes_m) @ by_place + np.einsum("ij,ij->j", scaled / axes_m[:, None], by_scaled))
    by_pixel = np.zeros((2, uv.shape[0]))
    for axis, size in enumerate((camera.width, camera.height)):
        if size > 1:
            half = np.array([0.5, 0.0]) if axis == 0 else np.array([0.0, 0.5])
            across = unproject(camera, uv + half).T - unproject(camera, uv - half).T
            by_pixel[axis] = np.einsum("ij,ij->j", by_direction, across)
    turn = np.cross(los, by_direction, axis=0)
    return LimbMotion(
        value=-p @ scaled - k * length,
        by_pixel=by_pixel,
        by_pose=np.concatenate([turn, by_place / axes_m[:, None], by_height[None]]),
    )


INSIDE_PX, OUTSIDE_PX, OUTSIDE_M = 12.0, 12.0, 100e3
"""Wider than what methods use: pixels farther away have no slope that depends on the limb's position."""
LIGHT_SIGMA, LIGHT_CORRELATION_RAD = 0.1, 0.1
"""Of the brightness along the limb: Sun, clouds and the lens change it by a tenth."""
BLUR_VARIANCE_SIGMA = 0.5
"""Of the variance of the lens's blur [px^2]: between none and one of 0.9 px."""
STRETCH_SIGMA = 0.2
"""Of the logarithm of the thickness of the air's light: climates and haze change a scale height by a fifth."""
PIECES = 256
"""Of azimuth, round the horizon: half the shortest correlation length of reliefs."""
FEWEST_PIECES = 8
"""Smallest number of pieces across the limb in view."""
SLOPE = np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0
"""Derivative of a quintic B-spline at its knots."""
BEND = np.array([1.0, 2.0, -6.0, 2.0, 1.0]) / 6.0
"""Second derivative of it."""
VALUE = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0
SHORTEST_SPLINE_PX = 6
SHAPES = np.array(
    [
        np.array(rows) / norm
        for rows, norm in (
            ([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 2.0]], np.sqrt(6.0)),
            ([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 0.0]], np.sqrt(2.0)),
            ([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], np.sqrt(2.0)),
            ([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], np.sqrt(2.0)),
            ([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]], np.sqrt(2.0)),
        )
    ]
)
"""Symmetric matrices without trace, orthonormal: a flattening ``f`` is ``-f R (z z^T - 1/3)``, and with a pole ``z``
anywhere its five components have the variance ``2/15 (f R)^2`` each."""
_SQUARE_PX = 8
_NUISANCES = 4
"""Level of space, gain, blur, air; the twelve come before them, the relief and the gain along the limb after."""


def limb_information(
    expected: ExpectedImage,
    camera: CameraModel,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    reliefs: Sequence[Relief] = (),
    *,
    body_from_cam: FloatArray | None = None,
) -> LimbInformation | None:
    """Return what the limb in an image says of the pose; None without limb in it.

    ``reliefs``: how the height of the limb varies along it. ``body_from_cam``: the turn is then about the body's axes,
    else about the camera's.
    """
    chosen = _near(camera, cam_from_itrs, r_itrs, ellipsoid)
    if chosen is None:
        return None
    columns, rows = chosen
    # The fall-off of the lens stays with the pixels: what moves is the light before it.
    lens = np.where(expected.illumination > 0.0, expected.illumination, 1.0)
    slopes, bends = _slopes((expected.mean - expected.zero) / lens, columns, rows)
    slopes, bends = slopes * lens[rows, columns], bends * lens[rows, columns]
    keep = expected.reads[rows, columns] & np.isfinite(slopes).all(axis=0)
    columns, rows, slopes, bends = columns[keep], rows[keep], slopes[:, keep], bends[:, keep]
    uv = np.column_stack([columns, rows]).astype(np.float64)
    # The limb in the image is above the ground, at the height of the most informative pixels.
    height = 0.0
    for _ in range(2):
        motion = limb_motion(camera, uv, cam_from_itrs, r_itrs, ellipsoid.axes_m + height)
        lit = np.isfinite(motion.value) & np.isfinite(motion.by_pixel).all(axis=0)
        motion, uv = _taken(motion, lit), uv[lit]
        columns, rows, slopes, bends = columns[lit], rows[lit], slopes[:, lit], bends[:, lit]
        size = (motion.by_pixel**2).sum(axis=0)
        by_limb = np.einsum("ij,ij->j", slopes, motion.by_pixel) / size
        variance = expected.variance[rows, columns]
        weight = (by_limb * motion.by_pose[6]) ** 2 / variance
        if not weight.sum() > 0.0:
            return None
        height += float(weight @ motion.height_m / weight.sum())
        if not np.sum((r_itrs / (ellipsoid.axes_m + height)) ** 2) > 1.0:
            # Light that no limb below the camera could be: what shows most is not the limb.
            return None
    pose = by_limb * motion.by_pose
    if body_from_cam is not None:
        pose[:3] = body_from_cam @ pose[:3]
    light = expected.mean[rows, columns] - float(np.min(expected.mean[rows, columns]))
    normal = motion.by_pixel / np.sqrt(size)
    bend = normal[0] ** 2 * bends[0] + normal[1] ** 2 * bends[1] + 2.0 * normal[0] * normal[1] * bends[2]
    nuisances = np.array([np.ones_like(light), light, 0.5 * bend, -motion.height_m * pose[6]])
    return _of_points(pose, nuisances, np.sqrt(variance), camera, uv, cam_from_itrs, r_itrs, ellipsoid, reliefs, height)


def edge_information(
    camera: CameraModel,
    uv: FloatArray,
    sigma_px: FloatArray,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    reliefs: Sequence[Relief] = (),
    *,
    body_from_cam: FloatArray,
) -> LimbInformation | None:
    """Return the information of edge points of the horizon, before there is an image; None where there is none.

    ``uv``: points on the hard horizon, shape (n, 2). ``sigma_px``: standard deviation of each across the horizon, (n,).
    Brightness, blur and thickness of the limb are taken as known: their errors are part of ``sigma_px``.
    """
    motion = limb_motion(camera, uv, cam_from_itrs, r_itrs, ellipsoid.axes_m)
    size = np.hypot(*motion.by_pixel)
    good = np.isfinite(motion.by_pose).all(axis=0) & (size > 0.0)
    if not good.any():
        return None
    pose = motion.by_pose[:, good] / size[good]
    pose[:3] = body_from_cam @ pose[:3]
    none = np.zeros((_NUISANCES, pose.shape[1]))
    return _of_points(pose, none, sigma_px[good], camera, uv[good], cam_from_itrs, r_itrs, ellipsoid, reliefs, 0.0)


def _of_points(
    pose: FloatArray,
    nuisances: FloatArray,
    sigma: FloatArray,
    camera: CameraModel,
    uv: FloatArray,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    reliefs: Sequence[Relief],
    height_m: float,
) -> LimbInformation:
    """Return the information of n independent points, whose derivatives by pose (7, n) and nuisances (4, n) are given.

    ``sigma``: of each point, in the unit of the derivatives' numerator.
    """
    nadir_itrs = -r_itrs / np.linalg.norm(r_itrs)
    across = tangent_basis(nadir_itrs).T @ (cam_from_itrs.T @ unproject(camera, uv).T)
    sin_rho = ellipsoid.mean_radius_m / float(np.linalg.norm(r_itrs))
    level = tangent_basis(nadir_itrs) @ (across / np.linalg.norm(across, axis=0))
    # From the Earth's centre a point of the limb lies 90 deg - rho from the place below the camera.
    to_limb = np.sqrt(1.0 - sin_rho**2) * level - sin_rho * nadir_itrs[:, None]
    shapes = pose[6] * np.einsum("in,kij,jn->kn", to_limb, SHAPES, to_limb)
    jacobian = np.concatenate([pose, shapes, nuisances]) / sigma
    known = _eliminated(jacobian, np.arctan2(across[1], across[0]), reliefs)
    return LimbInformation(_gram(jacobian[:UNKNOWNS]), known, height_m)


def _near(
    camera: CameraModel, cam_from_itrs: FloatArray, r_itrs: FloatArray, ellipsoid: Ellipsoid
) -> tuple[Any, Any] | None:
    """Return columns and rows of pixels near the limb; squares are looked at first."""

    def inside(uv: FloatArray, spare_px: float) -> Any:
        with np.errstate(invalid="ignore"):
            motion = limb_motion(camera, uv, cam_from_itrs, r_itrs, ellipsoid.axes_m)
            x = motion.distance_px
            return (x <= INSIDE_PX + spare_px) & ((x >= -OUTSIDE_PX - spare_px) | (motion.height_m <= OUTSIDE_M))

    across = np.arange(0, camera.width, _SQUARE_PX)
    down = np.arange(0, camera.height, _SQUARE_PX)
    corner = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    middle = np.minimum(corner + _SQUARE_PX // 2, [camera.width - 1, camera.height - 1]).astype(np.float64)
    # A square whose middle sees nothing may still hold pixels at the edge of the image circle.
    unseen = ~np.isfinite(limb_motion(camera, middle, cam_from_itrs, r_itrs, ellipsoid.axes_m).value)
    some = corner[inside(middle, 1.5 * _SQUARE_PX) | unseen]
    offset = np.stack(np.meshgrid(np.arange(_SQUARE_PX), np.arange(_SQUARE_PX)), axis=-1).reshape(-1, 2)
    pixels = (some[:, None, :] + offset[None]).reshape(-1, 2)
    pixels = pixels[(pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)]
    pixels = pixels[inside(pixels.astype(np.float64), 0.0)]
    return (pixels[:, 0], pixels[:, 1]) if len(pixels) else None


def _taken(motion: LimbMotion, which: Any) -> LimbMotion:
    return LimbMotion(motion.value[which], motion.by_pixel[:, which], motion.by_pose[:, which])


def _slopes(image: FloatArray, columns: Any, rows: Any) -> tuple[FloatArray, FloatArray]:
    """Return the slopes by column and row (2, n), and the second derivatives uu, vv, uv (3, n), of a spline."""
    coefficients, kernels = image, []
    for axis in (0, 1):
        if image.shape[axis] >= SHORTEST_SPLINE_PX:
            coefficients = ndimage.spline_filter1d(coefficients, 5, axis=axis, mode="mirror")
            kernels.append((VALUE, SLOPE, BEND))
        else:
            none = np.zeros(5)
            kernels.append((np.array([0.0, 0.0, 1.0, 0.0, 0.0]), none, none))
    padded = np.pad(coefficients, 2, mode="reflect" if min(image.shape) > 2 else "edge")
    wide = padded.shape[1]
    first = rows * wide + columns
    near = padded.ravel()[first[:, None, None] + np.arange(5)[:, None] * wide + np.arange(5)]

    def derivative(by_column: int, by_row: int) -> FloatArray:
        return np.asarray(near @ kernels[1][by_column] @ kernels[0][by_row])

    return (
        np.array([derivative(1, 0), derivative(0, 1)]),
        np.array([derivative(2, 0), derivative(0, 2), derivative(1, 1)]),
    )


def _eliminated(jacobian: FloatArray, azimuth: FloatArray, reliefs: Sequence[Relief]) -> FloatArray:
    """Return the information (12, 12) of pose, height and shape with all else free.

    Along the limb relief and gain are unknowns of pieces of azimuth: their derivatives are those of the height and of
    the gain of the pixels of a piece, so that sums over pieces of products of all columns are all that is needed.
    """
    span = 2.0 * np.pi - float(np.diff(np.sort(azimuth), append=np.min(azimuth) + 2.0 * np.pi).max())
    # A short piece of limb has finer pieces, or its relief could not bend within one.
    pieces = PIECES * 2 ** int(np.clip(np.ceil(np.log2(FEWEST_PIECES * 2.0 * np.pi / PIECES / max(span, 1e-9))), 0, 8))
    piece = np.floor((azimuth + np.pi) / (2.0 * np.pi) * pieces).astype(int) % pieces
    order = np.argsort(piece, kind="stable")
    seen, starts = np.unique(piece[order], return_index=True)
    parts = np.split(jacobian[:, order], starts[1:], axis=1)
    grams = np.array([_gram(part) for part in parts])
    own = UNKNOWNS + _NUISANCES
    count, gain = len(seen), UNKNOWNS + 1
    total = np.zeros((own + 2 * count, own + 2 * count))
    total[:own, :own] = grams.sum(axis=0)
    centre = (seen + 0.5) * 2.0 * np.pi / pieces - np.pi
    for k, column in enumerate((POSE - 1, gain)):
        first = own + k * count
        place = slice(first, first + count)
        total[place, :own] = grams[:, column, :]
        total[:own, place] = grams[:, column, :].T
        total[place, place] = np.diag(grams[:, column, column])
    heights, gains = slice(own, own + count), slice(own + count, own + 2 * count)
    total[heights, gains] = total[gains, heights] = np.diag(grams[:, POSE - 1, gain])
    apart = np.abs(centre[:, None] - centre[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    relief = np.zeros_like(apart)
    for one in reliefs:
        relief += one.sigma_m**2 * np.exp(-0.5 * (apart / one.correlation_rad) ** 2)
    total[heights, heights] += _precision(relief, 1.0)
    uneven = LIGHT_SIGMA**2 * np.exp(-0.5 * (apart / LIGHT_CORRELATION_RAD) ** 2)
    total[gains, gains] += _precision(uneven, 1e-4)
    total[gain + 1, gain + 1] += BLUR_VARIANCE_SIGMA**-2
    total[gain + 2, gain + 2] += STRETCH_SIGMA**-2
    # A row of space or of gain that no pixel tells from another must not make the matrix singular, nor the gain of a
    # single pixel, of which nothing is known and which nothing depends on.
    diagonal = np.arange(UNKNOWNS, len(total))
    own_size = total[diagonal, diagonal]
    total[diagonal, diagonal] = np.where(own_size > 0.0, own_size * (1.0 + 1e-12), 1.0)
    size = np.sqrt(np.maximum(np.diag(total), 1e-300))
    scaled = total / np.outer(size, size)
    left = without_last(scaled, UNKNOWNS)
    return np.asarray(0.5 * (left + left.T) * np.outer(size[:UNKNOWNS], size[:UNKNOWNS]))


def _precision(covariance: FloatArray, least_sigma: float) -> FloatArray:
    """Return the inverse of a covariance whose values are also off by a little of their own each."""
    return inverse(covariance + least_sigma**2 * np.eye(len(covariance)))


def _gram(jacobian: FloatArray) -> FloatArray:
    """Return sums over pixels of products of columns, always in the same order."""
    return np.asarray(np.einsum("in,jn->ij", jacobian, jacobian))


def information_of(frame: RadianceFrame, camera: CameraSpec, band: str | None = None) -> LimbInformation | None:
    """Return the information of one band of a noiseless frame seen by a camera; None without limb in it."""
    truth = frame.truth
    kinds = {one.name: one.kind for one in camera.band}
    solar = kinds[band or camera.band[0].name] == "solar"
    return limb_information(
        expected_image(frame, camera, band),
        truth.camera_model,
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.r_itrs),
        truth.ellipsoid,
        SOLAR_RELIEF if solar else THERMAL_RELIEF,
        body_from_cam=Rotation.from_quat(truth.q_cam_from_body).inv().as_matrix(),
    )


def informed(image: DetectorImage, frame: RadianceFrame) -> DetectorImage:
    """Return an image that carries the information of its frame, so that it can be scored without."""
    camera = CameraSpec.model_validate(image.observation.get("camera", image.truth.camera))
    found = information_of(frame, camera, image.band)
    return replace(image, observation={**image.observation, KEY: None if found is None else found.to_dict()})
