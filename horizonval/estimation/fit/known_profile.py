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
from horizonval.estimation.fit.air import KnownAir
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
from horizonval.geometry.horizon import angular_radius
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs


def start_pose(image: FloatArray, camera: CameraModel, known: ProfileKnowledge, tilt_sigma_rad: float) -> LimbPose:
    """Return the prior's pose, tilted to where the image resembles the limb most.

    ``tilt_sigma_rad``: prior standard deviation of the tilt. Raises ``LinAlgError``: no tilt makes the image like a
    limb.
    """
    prior, axes, heights_m = known.mean, known.ellipsoid.axes_m, known.air.heights_m
    values, los, pixel_rad = _coarse(image, camera)
    distance = float(np.linalg.norm(prior.r_itrs))
    to_limb = float(np.sqrt(max(distance**2 - axes[0] ** 2, 1.0)))
    cosine, n = to_limb / distance, prior.nadir_cam
    sine, across = np.sqrt(1.0 - cosine**2), tangent_basis(n)
    # The table has 24 azimuths and steps of a kilometre.
    azimuths, grid_m = 24, 1e3
    angle = 2.0 * np.pi * np.arange(azimuths) / azimuths
    outwards = across @ np.array([np.cos(angle), np.sin(angle)])
    grid = np.arange(heights_m[0], heights_m[1] + 60e3, grid_m)
    up, towards = (cosine * outwards - sine * n[:, None]).T, (sine * outwards + cosine * n[:, None]).T
    table = known.air.means(up, towards, prior, grid)
    first, second = across.T @ los
    row = np.mod(np.rint(np.arctan2(second, first) * (azimuths / (2.0 * np.pi))).astype(np.int32), azimuths)
    # What a sphere's heights need to be the ellipsoid's. Beyond a right angle from the nadir there is only space.
    ray = ray_height(los, prior.cam_from_itrs, prior.r_itrs, axes)
    sphere = distance * np.sqrt(np.maximum(1.0 - (n @ los) ** 2, 0.0))
    bottom = (np.where(n @ los > 0.0, sphere - ray.height_m, 0.0) + grid[0]) / grid_m
    light = np.maximum(los[2], 0.0) ** 4 if camera.projection == "pinhole" else np.ones(len(values))
    # Numbers of 24 bits are right to some metres from low orbit, to some tens from the geostationary ring.
    grey, lines, lowest, lit = (x.astype(np.float32) for x in (values - values.mean(), los, bottom, light))
    # Half a pixel or 4 km at the limb are within the range of a fit's derivatives; 3.5 sigmas hold all but one of 500.
    steps, finest = 10, max(4e3 / to_limb, 0.5 * pixel_rad)
    step, best, score = 3.5 * tilt_sigma_rad / steps, np.zeros(2), np.inf
    while True:
        # Three running means are as good as a Gaussian.
        blurred, width = table, 1 + int(max(step, pixel_rad) * to_limb / grid_m)
        for _ in range(3):
            blurred = uniform_filter1d(blurred, width, axis=1, mode="nearest")
        offsets = step * np.arange(-steps, steps + 1)
        tilts = best + np.array(np.meshgrid(offsets, offsets)).reshape(2, -1).T
        nadirs = n + tilts @ across.T
        nadirs /= np.linalg.norm(nadirs, axis=1)[:, None]
        cosines = nadirs.astype(np.float32) @ lines
        height = np.sqrt(np.maximum(1.0 - cosines * cosines, 0.0)) * np.float32(distance / grid_m) - lowest
        place = np.clip(height, 0, len(grid) - 1).astype(np.int32) + row * np.int32(len(grid))
        predicted = np.take(blurred.astype(np.float32), place) * ((cosines > 0.0) * lit)
        predicted -= predicted.mean(axis=1)[:, None]
        power, common = np.einsum("ij,ij->i", predicted, predicted), np.maximum(predicted @ grey, 0.0)
        likeness = common.astype(float) ** 2 / np.maximum(power.astype(float) * float(grey @ grey), 1e-300)
        merit = len(values) * np.log(np.maximum(1.0 - likeness, 1e-7)) + (tilts**2).sum(axis=1) / tilt_sigma_rad**2
        i = int(np.argmin(merit))
        best, score = tilts[i], float(merit[i])
        if step <= finest:
            break
        step, steps = step / 3.0, 3
    if not score < 0.0:
        raise NoLimbError("no tilt near the prior's makes the image like a limb")
    nadir = n + across @ best
    turn = Rotation.align_vectors(nadir[None], n[None])[0] if best.any() else Rotation.identity()
    return LimbPose(turn.as_matrix() @ prior.cam_from_itrs, prior.r_itrs, prior.height_m)


def _coarse(image: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray, float]:
    """Return levels (n,) and lines of sight (3, n) of 500 pixels of a coarse copy, and its pixels' angle."""
    factor = max(1, int(np.ceil(max(camera.width, camera.height) / 56)))
    rows, columns = camera.height // factor, camera.width // factor
    cut = image[: rows * factor, : columns * factor]
    values = np.asarray(cv2.resize(cut, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float64).ravel()
    middle = (factor - 1) // 2
    los = pixel_directions(camera)[middle : rows * factor : factor, middle : columns * factor : factor].reshape(-1, 3)
    seen = np.flatnonzero(np.isfinite(los).all(axis=1))
    fewest = 100
    if len(seen) < fewest:
        raise NoLimbError(f"{len(seen)} pixels of a coarse copy; {fewest} are needed")
    # An odd step takes no columns out.
    seen = seen[:: max(1, len(seen) // 500) | 1]
    return values[seen], los[seen].T, factor / max(camera.fx, camera.fy)


TABLE_ENDING = ".npz"
"""Suffix of a climate that is a table of profiles."""


@dataclass(frozen=True)
class KnownProfile:
    """A picture, and what is known of its limb. ``tilt_sigma_rad``: of the attitude that is stated."""

    picture: Picture
    knowledge: ProfileKnowledge
    tilt_sigma_rad: float

    def start(self, camera: CameraModel, tilt_sigma_rad: float) -> LimbPose:
        """Return a pose near the limb, tilted from the prior within its sigma; see :func:`start_pose`."""
        return start_pose(self.picture.grey, camera, self.knowledge, tilt_sigma_rad)

    def limb(self, pose: LimbPose) -> tuple[FloatArray, float, float]:
        """Return nadir, angular radius and angle to the top of the air [rad] of a limb seen from a pose."""
        ellipsoid, (_, top_m) = self.knowledge.ellipsoid, self.knowledge.air.heights_m
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
        air,
        blur_px=prior.lens_blur_px,
        lens=observation.lens or Lens(),
        **calibration,
    )
    return KnownProfile(picture, knowledge, float(prior.attitude_sigma_rad.max()))


def known_sun_itrs(observation: Observation, towards_sun_itrs: FloatArray) -> FloatArray | None:
    """Return the Sun's direction by the time, None if a Sun sensor contradicts it: the clock may be wrong."""
    prior = observation.prior
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    if observation.sun_cam is None:
        return towards_sun_itrs
    reading = SUN_SIGMA_RAD if prior.sun_sigma_rad is None else prior.sun_sigma_rad
    sigma = math.hypot(float(prior.attitude_sigma_rad.max()), reading)
    by_time = Rotation.from_quat(prior.q_cam_from_itrs).apply(towards_sun_itrs)
    # Chance is five sigmas off in two axes once in 270 000.
    return towards_sun_itrs if off_axis_angle(observation.sun_cam, by_time) <= 5.0 * sigma else None


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
