r"""A pose near the limb from a coarse attitude alone: the tilt at which the predicted picture is most like the image.

Pixels of a coarse copy of the image are compared with what the profiles of the table make of them at every tilt of a
grid about the prior's nadir. With gain and background free, ``R^2`` the square of the correlation of both, ``n`` pixels
and a prior of the tilt ``N(0, s^2)``::

    2 ln likelihood = -n ln(1 - R^2) - |tilt|^2 / s^2

The best place is looked at again with a finer grid, until a step is less than what a fit can take. Nothing is searched
for in the image itself: no edge, no threshold. That the best tilt is right is for the fit to show.

Heights are those of a sphere by its angle from the nadir, corrected at every pixel by what the ellipsoid makes of them
at the prior: the flattening changes over some degrees of tilt by less than a pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.knowledge import NoLimbError
from horizonval.estimation.likelihood.profile.ray_height import ray_height
from horizonval.estimation.limb.pixel_directions import PIXEL_DIRECTIONS
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import tangent_basis

COARSE_PX = 56
"""Of the longer side of the coarse copy: some thousand pixels."""
FIRST_PX = 500
"""Of the coarse copy that the first grid is compared with, about so many: a profile as blurred as its step is wide has
no more to show."""
REACH_SIGMA = 3.5
"""Of the tilt's prior that is looked at: all but one of five hundred."""
STEPS = 10
"""To either side of the first grid."""
FINER, FINER_STEPS = 3.0, 3
"""By which the step shrinks, and to how many steps to either side the finer grids reach."""
FINEST_M, FINEST_PX = 4e3, 0.5
"""Of height at the limb and in pixels, the larger of the two: within reach of a fit's derivatives."""
AZIMUTHS = 24
GRID_M = 1e3
FEWEST_PIXELS = 100


def start_pose(
    image: FloatArray,
    camera: CameraModel,
    prior: LimbPose,
    tilt_sigma_rad: float,
    ellipsoid: Ellipsoid,
    heights_m: tuple[float, float],
    profiles: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
) -> LimbPose:
    """Return the prior's pose, tilted to where the image is most like the limb.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : CameraModel
    prior : LimbPose
    tilt_sigma_rad : float
    ellipsoid : Ellipsoid
    heights_m : tuple of float
        First and last height of the table.
    profiles : callable
        From normals (m, 3) and lines of sight (m, 3) in camera axes, and heights (n,), to profiles (m, n).

    Raises
    ------
    numpy.linalg.LinAlgError
        No tilt makes the image like a limb.
    """
    values, los, light, pixel_rad = _coarse(image, camera)
    distance = float(np.linalg.norm(prior.r_itrs))
    n = prior.nadir_cam
    across = tangent_basis(n)
    ray = ray_height(los, prior.cam_from_itrs, prior.r_itrs, ellipsoid.axes_m)
    sphere = distance * np.sqrt(np.maximum(1.0 - (n @ los) ** 2, 0.0))
    # Beyond a right angle from the nadir there is only space.
    radius = np.where(n @ los > 0.0, sphere - ray.height_m, 0.0)
    first, second = across.T @ los
    bin_ = np.mod(np.rint(np.arctan2(second, first) * (AZIMUTHS / (2.0 * np.pi))).astype(np.intp), AZIMUTHS)
    to_limb = float(np.sqrt(max(distance**2 - ellipsoid.axes_m[0] ** 2, 1.0)))
    grid = np.arange(heights_m[0], heights_m[1] + 60e3, GRID_M)
    angle = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    outwards = across @ np.array([np.cos(angle), np.sin(angle)])
    cosine = to_limb / distance
    sine = np.sqrt(1.0 - cosine**2)
    table = profiles((cosine * outwards - sine * n[:, None]).T, (sine * outwards + cosine * n[:, None]).T, grid)
    step = REACH_SIGMA * tilt_sigma_rad / STEPS
    best, score, reach = np.zeros(2), -np.inf, STEPS
    finest = max(FINEST_M / to_limb, FINEST_PX * pixel_rad)
    every = max(1, len(values) // FIRST_PX) | 1
    seen = _Seen(values, los, light, radius, bin_ * len(grid))
    first = _Seen(*(part[..., ::every] for part in (values, los, light, radius, bin_ * len(grid))))
    while True:
        blurred = gaussian_filter1d(table, max(step, pixel_rad) * to_limb * 0.5 / GRID_M, axis=1, mode="nearest")
        offsets = step * np.arange(-reach, reach + 1)
        tilts = best + np.array(np.meshgrid(offsets, offsets)).reshape(2, -1).T
        nadirs = n + tilts @ across.T
        nadirs /= np.linalg.norm(nadirs, axis=1)[:, None]
        alike = (first if reach == STEPS else seen).likelihood(nadirs, distance, grid[0], blurred)
        likelihood = alike - (tilts**2).sum(axis=1) / tilt_sigma_rad**2
        i = int(np.argmax(likelihood))
        best, score = tilts[i], float(likelihood[i])
        if step <= finest:
            break
        step, reach = step / FINER, FINER_STEPS
    if not score > 0.0:
        raise NoLimbError("no tilt near the prior's makes the image like a limb")
    nadir = n + across @ best
    nadir /= np.linalg.norm(nadir)
    turn = Rotation.align_vectors(nadir[None], n[None])[0] if best.any() else Rotation.identity()
    return LimbPose(turn.as_matrix() @ prior.cam_from_itrs, prior.r_itrs, prior.height_m)


@dataclass(frozen=True)
class _Seen:
    """Pixels (n,) of the coarse copy.

    Attributes
    ----------
    values : ndarray, shape (n,)
    los : ndarray, shape (3, n)
    light : ndarray, shape (n,)
    radius : ndarray, shape (n,)
        What is taken from the distance at which they pass the centre [m].
    row : ndarray of int, shape (n,)
        Where in the flat table their azimuth's row begins.
    """

    values: FloatArray
    los: FloatArray
    light: FloatArray
    radius: FloatArray
    row: np.ndarray

    def likelihood(self, nadirs: FloatArray, distance_m: float, bottom_m: float, table: FloatArray) -> FloatArray:
        """Return what pictures at nadirs (m, 3) make of the pixels, shape (m,); numbers of 24 bits tell them apart."""
        cosine = nadirs.astype(np.float32) @ self.los.astype(np.float32)
        # A sine of 24 bits is right to some metres from low orbit, to some tens from the geostationary ring.
        height = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0)) * np.float32(distance_m / GRID_M)
        height -= ((self.radius + bottom_m) / GRID_M).astype(np.float32)
        np.clip(height, 0, table.shape[1] - 1, out=height)
        place = height.astype(np.int32)
        place += self.row.astype(np.int32)
        predicted = np.take(table.astype(np.float32), place)
        predicted *= (cosine > 0.0) * self.light.astype(np.float32)
        return _likelihood(predicted, self.values.astype(np.float32))


def _coarse(image: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return levels (n,), lines of sight (3, n) and light (n,) of a coarse copy, and its pixels' angle."""
    factor = max(1, int(np.ceil(max(camera.width, camera.height) / COARSE_PX)))
    rows, columns = camera.height // factor, camera.width // factor
    cut = image[: rows * factor, : columns * factor]
    values = np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float64).ravel()
    directions = PIXEL_DIRECTIONS.of(camera)
    middle = (factor - 1) // 2
    los = directions[middle : rows * factor : factor, middle : columns * factor : factor].reshape(-1, 3)
    seen = np.isfinite(los).all(axis=1)
    if seen.sum() < FEWEST_PIXELS:
        raise NoLimbError(f"{int(seen.sum())} pixels of a coarse copy; {FEWEST_PIXELS} are needed")
    los, values = los[seen].T, values[seen]
    light = np.ones(len(values))
    if camera.projection == "pinhole":
        light = np.asarray(np.maximum(los[2], 0.0) ** 4)
    return values, los, light, factor / max(camera.fx, camera.fy)


def _likelihood(predicted: FloatArray, values: FloatArray) -> FloatArray:
    """Return ``-n ln(1 - R^2)`` of pictures (m, n), which it centres, against one, shape (m,).

    0 of pictures of one level and of negatives.
    """
    centred = values - values.mean()
    predicted -= predicted.mean(axis=1)[:, None]
    power = np.einsum("ij,ij->i", predicted, predicted).astype(np.float64)
    common = (predicted @ centred).astype(np.float64)
    alike = np.where((power > 0.0) & (common > 0.0), common**2 / np.maximum(power * (centred @ centred), 1e-300), 0.0)
    return np.asarray(-len(values) * np.log(np.maximum(1.0 - alike, 1e-7)))
