"""What a fit of the limb's profile is given of an observation: tables of its air, priors, and where to start."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.lens import Lens
from horizonval.estimation.likelihood.height.uneven_limb import SUN_SIGMA_RAD
from horizonval.estimation.likelihood.knowledge import LimbPose, placed_knowledge
from horizonval.estimation.likelihood.profile.knowledge import ProfileKnowledge
from horizonval.estimation.likelihood.profile.known_air import KnownAir, sun_of_time
from horizonval.estimation.likelihood.profile.start import start_pose
from horizonval.estimation.likelihood.templates import LimbTemplates, is_of_band, shipped_templates, templates_of
from horizonval.estimation.limb.finder import picture_of
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.observation import Observation
from horizonval.estimation.prior import BY_LATITUDE_MONTH
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs

LIFT_SIGMA_M = 300.0
"""Of the height of all air: what is left when its profile is known. The pressure at sea level differs from the
climate's by 10 hPa, which is 80 m; the geoid departs from the ellipsoid by 30 m."""
TABLE_ENDING = ".npz"
"""Of a climate that is a table of profiles."""
GAIN_SIGMA = {"thermal": 0.02, "solar": 0.05}
"""Of a calibrated detector's gain, and of the transmission of its lens. A black body before the lens calibrates
thermal ones; of visible ones data sheets and integrating spheres are right to some per cent. Assumptions."""


@dataclass(frozen=True)
class KnownProfile:
    """A picture, and what is known of its limb.

    Attributes
    ----------
    picture : Picture
    knowledge : ProfileKnowledge
    air : KnownAir
    tilt_sigma_rad : float
        Of the attitude that is stated.
    """

    picture: Picture
    knowledge: ProfileKnowledge
    air: KnownAir
    tilt_sigma_rad: float

    def start(self, camera: CameraModel, tilt_sigma_rad: float) -> LimbPose:
        """Return a pose near the limb, at a tilt within so much of the prior's.

        Raises
        ------
        numpy.linalg.LinAlgError
            No tilt makes the image like a limb.
        """
        known = self.knowledge

        def means(normal: FloatArray, los: FloatArray, height_m: FloatArray) -> FloatArray:
            return self.air.means(normal, los, known.mean, height_m)

        return start_pose(
            self.picture.grey, camera, known.mean, tilt_sigma_rad, known.ellipsoid, self.air.heights_m, means
        )


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
            "gain_log_sigma": GAIN_SIGMA[observation.band_kind],
        }
    lens = observation.lens or Lens()
    ellipsoid, mean, information = placed_knowledge(observation, 0.0, LIFT_SIGMA_M)
    knowledge = ProfileKnowledge(ellipsoid, mean, information, air.heights_m, air.nodes, lens=lens, **calibration)
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
