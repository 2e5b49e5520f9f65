"""The whole profile of the limb by maximum likelihood, against rendered profiles of the air of the place and month.

``limb-ellipsoid`` takes the limb for an edge of one shape at a height that is not known. Here the brightness over
height, from the ground to where nothing shines any more, is that of tables made with the renderer: the mean of air,
haze, cloud and ground at a latitude and in a month (or under a Sun), and how far and in which shapes they differ from
it. The shapes' coefficients are unknowns that vary along the limb, each with its own prior, so that the height of the
limb comes from its brightness and softness too, and the claim holds what the air leaves open.

It needs a position, an attitude to some degrees, a time and the wavelengths of the camera, and refuses without. The
tables are those that are shipped, or the file of `horizonval templates` that the prior's ``climate`` names. The
start is the tilt near the prior's attitude at which the predicted picture is most like the image: no search for edges.

What it refuses: an image that no tilt makes like a limb, or of which the fit explains less than
:data:`LEAST_EXPLAINED`; an air more than :data:`MOST_IMPROBABLE` from its tables; an attitude more than
:data:`MOST_SIGMA` standard deviations from the prior's.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.likelihood.claim import fit_of
from horizonval.estimation.likelihood.height.uneven_limb import SUN_SIGMA_RAD
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.fit import fit_profile
from horizonval.estimation.likelihood.profile.knowledge import ProfileFit, ProfileKnowledge
from horizonval.estimation.likelihood.profile.known_air import KnownAir, sun_of_time
from horizonval.estimation.likelihood.profile.start import start_pose
from horizonval.estimation.likelihood.templates import LimbTemplates, is_of_band, shipped_templates, templates_of
from horizonval.estimation.limb.finder import picture_of
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.prior import BY_LATITUDE_MONTH, Prior
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.geometry.ephemeris import AU_M, sun_itrs

LIFT_SIGMA_M = 300.0
"""Of the height of all air: what is left when its profile is known. The pressure at sea level differs from the
climate's by 10 hPa, which is 80 m; the geoid departs from the ellipsoid by 30 m."""
TABLE_ENDING = ".npz"
"""Of a climate that is a table of profiles."""
LEAST_EXPLAINED = 0.95
"""Of the variance of the pixels across the limb. Chosen after looking at frames: broken clouds, whose scatter is in the
claim, leave 1 to 3 %; noise explains nothing."""
MOST_IMPROBABLE = 6.0
"""Standard deviations of a shape of the air: an air that the tables do not know. Air is not normal: a sudden warming is
far out and does happen. Chosen after looking at the same frames, whose largest is 3."""
GAIN_SIGMA = {"thermal": 0.02, "solar": 0.05}
"""Of a calibrated detector's gain, and of the transmission of its lens. A black body before the lens calibrates
thermal ones; of visible ones data sheets and integrating spheres are right to some per cent. Assumptions."""
MOST_SIGMA = 5.0
"""Of the attitude's prior: one in two million."""


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image, a position, a coarse attitude, and a time."""
    prior = observation.prior
    missing = _missing(observation)
    if missing:
        return Refusal(Outcome.BAD_INPUT, f"limb-profile needs {missing}")
    assert prior.r_itrs is not None
    assert prior.position_sigma_m is not None
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    assert prior.epoch_utc is not None
    assert observation.band_kind is not None
    assert observation.band_um is not None
    templates = _templates(observation.band_kind, observation.band_um, prior.climate)
    if isinstance(templates, Refusal):
        return templates
    picture = picture_of(observation.image, observation.camera, observation.full_scale)
    if isinstance(picture, Refusal):
        return picture
    ellipsoid = sphere(prior.sphere_radius_m) if prior.shape == "sphere" else WGS84
    towards_sun_itrs, sun_distance_m = sun_itrs(prior.epoch_utc)
    # Tables of sunlit bands have the Sun at its mean distance.
    sunlight = (AU_M / sun_distance_m) ** 2 if observation.band_kind == "solar" else 1.0
    mean = LimbPose(Rotation.from_quat(prior.q_cam_from_itrs).as_matrix(), prior.r_itrs)
    air = KnownAir(templates, prior.epoch_utc, observation.sun_cam, known_sun_itrs(observation, towards_sun_itrs))
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body).as_matrix()
    information = np.zeros((7, 7))
    information[:3, :3] = cam_from_body @ np.diag(prior.attitude_sigma_rad**-2.0) @ cam_from_body.T
    information[3:6, 3:6] = np.eye(3) / prior.position_sigma_m**2
    information[6, 6] = LIFT_SIGMA_M**-2
    calibration = {}
    if observation.radiance_per_dn is not None and observation.band_width_um is not None:
        calibration = {
            "gain": sunlight * observation.band_width_um / observation.radiance_per_dn,
            "gain_log_sigma": GAIN_SIGMA[observation.band_kind],
        }
    knowledge = ProfileKnowledge(ellipsoid, mean, information, air.heights_m, air.nodes, **calibration)
    try:
        start = start_pose(
            picture.grey,
            observation.camera,
            mean,
            float(prior.attitude_sigma_rad.max()),
            ellipsoid,
            air.heights_m,
            lambda normal, los, height: air.means(normal, los, mean, height),
        )
        found = fit_profile(picture.unclipped, observation.camera, start, knowledge)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NO_LIMB, f"the profile of the limb: {e}")
    doubt = _doubt(found, prior, cam_from_body)
    return fit_of(found, observation, ellipsoid) if doubt is None else doubt


def known_sun_itrs(observation: Observation, towards_sun_itrs: FloatArray) -> FloatArray | None:
    """Return the Sun's direction as the time says it, None if a Sun sensor contradicts it."""
    prior = observation.prior
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    reading = SUN_SIGMA_RAD if prior.sun_sigma_rad is None else prior.sun_sigma_rad
    sigma = math.hypot(float(prior.attitude_sigma_rad.max()), reading)
    cam_from_itrs = Rotation.from_quat(prior.q_cam_from_itrs).as_matrix()
    return sun_of_time(towards_sun_itrs, observation.sun_cam, cam_from_itrs, sigma)


def _missing(observation: Observation) -> str:
    """Return what the method cannot do without and is not given; empty for nothing."""
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
    band_kind: Literal["solar", "thermal"], band_um: tuple[float, float], climate: str | None
) -> LimbTemplates | Refusal:
    """Return the profiles of a band: those of the prior's file, or the shipped ones."""
    low, high = band_um
    if climate is None or not climate.lower().endswith(TABLE_ENDING):
        shipped = shipped_templates(band_kind, band_um)
        reason = f"limb-profile has no profiles of {low:g} to {high:g} um"
        return Refusal(Outcome.BAD_INPUT, reason) if shipped is None else shipped
    try:
        table = templates_of(Path(climate))
    except UserError as e:
        return Refusal(Outcome.BAD_INPUT, f"limb-profile: {e.line()}")
    if not is_of_band(table, band_kind, band_um):
        reason = "{}: {} profiles of {:g} to {:g} um".format(climate, table.band_kind, *table.band_um)
        return Refusal(Outcome.BAD_INPUT, f"{reason}, not {band_kind} ones of {low:g} to {high:g} um")
    return table


def _doubt(found: ProfileFit, prior: Prior, cam_from_body: np.ndarray) -> Refusal | None:
    """Return why the fit is not believed, if it is not."""
    if not found.explained > LEAST_EXPLAINED:
        reason = f"the predicted limb explains {max(found.explained, 0.0):.0%} of the pixels where it should be"
        return Refusal(Outcome.NO_LIMB, reason, found.uv)
    if found.improbable > MOST_IMPROBABLE:
        reason = f"the air would have to be {found.improbable:.1f} standard deviations from what its tables know"
        return Refusal(Outcome.AMBIGUOUS, reason, found.uv)
    coarse = Rotation.from_quat(prior.q_cam_from_itrs)
    turn = cam_from_body.T @ (Rotation.from_matrix(found.pose.cam_from_itrs) * coarse.inv()).as_rotvec()
    sigmas = float(np.abs(turn / prior.attitude_sigma_rad).max())
    if sigmas > MOST_SIGMA:
        return Refusal(Outcome.AMBIGUOUS, f"the limb lies {sigmas:.0f} sigma from the prior's attitude", found.uv)
    return None


ESTIMATOR = Estimator(
    name="limb-profile",
    title="Whole profile of the limb, maximum likelihood with rendered profiles of the air",
    run=with_lens_error(run),
    estimates="geocentric",
)
