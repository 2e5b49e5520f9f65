"""What a fit of the limb's profile is given of an observation (tables, priors), and the pose at which it starts.

The start needs only a coarse attitude. Pixels of a coarse copy of the image are compared with the prediction of the
tables at every tilt of a grid about the prior's nadir. With gain and background free, ``R^2`` the square of the
correlation of image and prediction, ``n`` pixels and a prior of the tilt ``N(0, s^2)``::

    2 ln likelihood = -n ln(1 - R^2) - |tilt|^2 / s^2

The grid is refined around the maximum until its step is within the fit's basin. No edges and no thresholds are used;
whether the tilt is right is decided by the fit.

Heights are those of a sphere by its angle from the nadir, corrected at every pixel for the ellipsoid at the prior: over
some degrees of tilt the effect of the flattening changes by less than a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.air import KnownAir, sun_of_time
from horizonval.estimation.fit.heights import SUN_SIGMA_RAD
from horizonval.estimation.fit.known import placed_knowledge
from horizonval.estimation.fit.pixels import ray_height
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.profile import ProfileKnowledge
from horizonval.estimation.fit.profile_pixels import NoLimbError
from horizonval.estimation.fit.templates import LimbTemplates, is_of_band, shipped_templates, templates_of
from horizonval.estimation.limb.picture import Picture, picture_of, pixel_directions
from horizonval.estimation.observation import Lens, Observation
from horizonval.estimation.prior import BY_LATITUDE_MONTH, GAIN_SIGMA
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import angular_radius
from horizonval.geometry.rotation import tangent_basis
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs

COARSE_PX = 56
"""Longer side of the coarse copy [px], with some thousand pixels."""
COMPARED_PX = 500
"""Number of pixels of the coarse copy that are compared with the prediction."""
REACH_SIGMA = 3.5
"""Range of the tilt search in prior sigmas: all but one of five hundred."""
STEPS = 10
"""Steps of the first grid to either side."""
FINER, FINER_STEPS = 3.0, 3
"""Factor by which finer grids shrink the step, and their steps to either side."""
FINEST_M, FINEST_PX = 4e3, 0.5
"""Finest step, height at the limb or pixels, the larger of both: within the range of a fit's derivatives."""
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
    """Return the prior's pose, tilted to where the image resembles the limb most.

    ``heights_m``: first and last height of the table; ``profiles``: function of normals (m, 3), lines of sight (m, 3)
    in camera axes and heights (n,) to profiles (m, n). Raises ``LinAlgError``: no tilt makes the image like a limb.
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
    # An odd step takes no columns out.
    every = max(1, len(values) // COMPARED_PX) | 1
    seen = _Seen(*(part[..., ::every] for part in (values, los, light, radius, bin_ * len(grid))))
    while True:
        # Three running means are as good as a Gaussian.
        width = 1 + int(max(step, pixel_rad) * to_limb / GRID_M)
        blurred = table
        for _ in range(3):
            blurred = uniform_filter1d(blurred, width, axis=1, mode="nearest")
        offsets = step * np.arange(-reach, reach + 1)
        tilts = best + np.array(np.meshgrid(offsets, offsets)).reshape(2, -1).T
        nadirs = n + tilts @ across.T
        nadirs /= np.linalg.norm(nadirs, axis=1)[:, None]
        likelihood = seen.likelihood(nadirs, distance, grid[0], blurred) - (tilts**2).sum(axis=1) / tilt_sigma_rad**2
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
    """Pixels (n,) of the coarse copy; ``radius``: offset of tangent radii [m], ``row``: start of a table row."""

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
    directions = pixel_directions(camera)
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
    """Return ``-n ln(1 - R^2)`` of pictures (m, n), centred in place, against one; 0 for constant or negative ones."""
    centred = values - values.mean()
    predicted -= predicted.mean(axis=1)[:, None]
    power = np.einsum("ij,ij->i", predicted, predicted).astype(np.float64)
    common = (predicted @ centred).astype(np.float64)
    alike = np.where((power > 0.0) & (common > 0.0), common**2 / np.maximum(power * (centred @ centred), 1e-300), 0.0)
    return np.asarray(-len(values) * np.log(np.maximum(1.0 - alike, 1e-7)))


TABLE_ENDING = ".npz"
"""Suffix of a climate that is a table of profiles."""


@dataclass(frozen=True)
class KnownProfile:
    """A picture, and what is known of its limb. ``tilt_sigma_rad``: of the attitude that is stated."""

    picture: Picture
    knowledge: ProfileKnowledge
    air: KnownAir
    tilt_sigma_rad: float

    def start(self, camera: CameraModel, tilt_sigma_rad: float) -> LimbPose:
        """Return a pose near the limb, tilted from the prior within its sigma.

        Raises ``LinAlgError``: no tilt makes the image like a limb.
        """
        known = self.knowledge

        def means(normal: FloatArray, los: FloatArray, height_m: FloatArray) -> FloatArray:
            return self.air.means(normal, los, known.mean, height_m)

        return start_pose(
            self.picture.grey, camera, known.mean, tilt_sigma_rad, known.ellipsoid, self.air.heights_m, means
        )

    def limb(self, pose: LimbPose) -> tuple[FloatArray, float, float]:
        """Return nadir, angular radius and angle to the top of the air [rad] of a limb seen from a pose."""
        ellipsoid, (_, top_m) = self.knowledge.ellipsoid, self.air.heights_m
        bare, high = (angular_radius(pose.r_itrs, ellipsoid.raised(height)) for height in (0.0, top_m))
        return pose.nadir_cam, bare, high - bare


def known_profile(observation: Observation, method: str) -> KnownProfile | Refusal:
    """Return what is known, or why it is too little; ``method`` is named in refusals."""
    prior = observation.prior
    missing = what_is_missing(observation)
    if missing:
        return Refusal(Outcome.BAD_INPUT, f"{method} needs {missing}")
    assert prior.r_itrs is not None
    assert prior.position_sigma_m is not None
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    assert prior.epoch_utc is not None
    assert observation.band_kind is not None
    assert observation.band_um is not None
    templates = _templates(observation.band_kind, observation.band_um, prior.climate, method)
    if isinstance(templates, Refusal):
        return templates
    picture = picture_of(observation.image, observation.camera, observation.full_scale)
    if isinstance(picture, Refusal):
        return picture
    try:
        towards_sun_itrs, sun_distance_m = sun_itrs(prior.epoch_utc)
    except UserError as e:
        return Refusal(Outcome.BAD_INPUT, f"{method}: the prior's {e.what}; expected {e.expected}")
    # Tables of sunlit bands have the Sun at its mean distance.
    sunlight = (AU_M / sun_distance_m) ** 2 if observation.band_kind == "solar" else 1.0
    air = KnownAir(templates, prior.epoch_utc, observation.sun_cam, known_sun_itrs(observation, towards_sun_itrs))
    calibration = {}
    if observation.radiance_per_dn is not None and observation.band_width_um is not None:
        calibration = {
            "gain": sunlight * observation.band_width_um / observation.radiance_per_dn,
            "gain_log_sigma": GAIN_SIGMA[observation.band_kind] if prior.gain_sigma is None else prior.gain_sigma,
        }
    ellipsoid, mean, information = placed_knowledge(observation, 0.0, prior.air_height_sigma_m)
    knowledge = ProfileKnowledge(
        ellipsoid,
        mean,
        information,
        air.heights_m,
        air.nodes,
        blur_px=prior.lens_blur_px,
        lens=observation.lens or Lens(),
        **calibration,
    )
    return KnownProfile(picture, knowledge, air, float(prior.attitude_sigma_rad.max()))


def known_sun_itrs(observation: Observation, towards_sun_itrs: FloatArray) -> FloatArray | None:
    """Return the Sun's direction as the time says it, None if a Sun sensor contradicts it."""
    prior = observation.prior
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    reading = SUN_SIGMA_RAD if prior.sun_sigma_rad is None else prior.sun_sigma_rad
    sigma = math.hypot(float(prior.attitude_sigma_rad.max()), reading)
    cam_from_itrs = Rotation.from_quat(prior.q_cam_from_itrs).as_matrix()
    return sun_of_time(towards_sun_itrs, observation.sun_cam, cam_from_itrs, sigma)


def what_is_missing(observation: Observation) -> str:
    """Return what a fit of the profile cannot do without and is not given; empty for nothing."""
    prior = observation.prior
    if prior.r_itrs is None:
        return "a prior of the position (position_itrs_km)"
    if prior.q_cam_from_itrs is None:
        return "a prior of the attitude (q_cam_from_itrs)"
    if prior.epoch_utc is None:
        return "the time (epoch_utc)"
    if observation.band_kind is None or observation.band_um is None:
        return "the camera's one band (kind and wavelengths)"
    if prior.climate not in (None, BY_LATITUDE_MONTH) and not prior.climate.lower().endswith(TABLE_ENDING):
        table = f"`horizonval templates SUITE --air {prior.climate} -o X.npz`"
        known = f'climate = "{BY_LATITUDE_MONTH}", or a table of {table}'
        return f"the air by latitude and month ({known}; found {prior.climate!r})"
    return ""


def _templates(
    band_kind: Literal["solar", "thermal"], band_um: tuple[float, float], climate: str | None, method: str
) -> LimbTemplates | Refusal:
    """Return the profiles of a band: those of the prior's file, or the shipped ones."""
    low, high = band_um
    if climate is None or not climate.lower().endswith(TABLE_ENDING):
        shipped = shipped_templates(band_kind, band_um)
        reason = f"{method} has no profiles of {low:g} to {high:g} um"
        return Refusal(Outcome.BAD_INPUT, reason) if shipped is None else shipped
    try:
        table = templates_of(Path(climate))
    except UserError as e:
        return Refusal(Outcome.BAD_INPUT, f"{method}: {e.line()}")
    if not is_of_band(table, band_kind, band_um):
        reason = "{}: {} profiles of {:g} to {:g} um".format(climate, table.band_kind, *table.band_um)
        return Refusal(Outcome.BAD_INPUT, f"{reason}, not {band_kind} ones of {low:g} to {high:g} um")
    return table
