"""The start of a fit of the limb: a closed form of the position, default knowledge of the air, priors of the ellipsoid.

**Closed form** (Christian and Robinson). Divided by the semi-axes of an ellipsoid, lines of sight to its limb become
lines of sight ``e`` to the limb of a unit sphere, which lie on a cone about the direction to its centre (J. A.
Christian and S. B. Robinson, "Noniterative horizon-based optical navigation by Cholesky factorization", J. Guidance,
Control, and Dynamics 39, 2757, 2016, section III; J. A. Christian, IEEE Access 9, 2021, section V)::

    e_i . m = 1,    |m| = 1 / cos rho',    sin rho' = 1 / |p|,    r = axes * p,    p = -|p| m / |m|

with ``p`` the scaled position. They solve for ``m`` by least squares; here the cone is fitted by orthogonal regression
(:func:`horizonval.geometry.horizon.fit_cone`), which shrinks the radius of a short noisy arc less. A sphere is the case
of equal axes, in which camera axes suffice. The scaling changes the points' weights by the flattening, 0.3 %, which is
good enough for a start.

**Start of the ellipsoid's fit.** The closed form gives a position in the axes of the attitude's prior; the camera is
turned by the smallest rotation that brings its direction to the prior's. Yaw and distance are the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.atmosphere.climate import month_of
from horizonval.earth.limb_heights import limb_height_m, reliefs
from horizonval.estimation.fit.heights import SUN_SIGMA_RAD, UnevenLimb, band_heights
from horizonval.estimation.fit.known import LimbKnowledge, placed_knowledge, turned_to
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import lens_sigmas
from horizonval.estimation.limb.finder import altitude_in_air_m, find_limb_and_picture
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import fit_cone


def position_from_limb(los_cam: FloatArray, cam_from_itrs: FloatArray, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the Earth-fixed position [m], shape (3,), from which points of the limb are seen.

    ``los_cam``: shape (n, 3), unit lines of sight, n >= 3; ``cam_from_itrs``: shape (3, 3), for a sphere any rotation,
    with the identity giving camera axes; ``ellipsoid``: the Earth raised by the limb's height. Raises ``LinAlgError``:
    no cone narrower than a half space.
    """
    scaled = (los_cam @ cam_from_itrs) / ellipsoid.axes_m
    cone = fit_cone(scaled / np.linalg.norm(scaled, axis=1)[:, None])
    # Of the tips of unit vectors the plane may lie so that rounding takes it outside the unit sphere.
    sin_rho = float(np.sqrt(max((1.0 - cone.cos_rho) * (1.0 + cone.cos_rho), 0.0)))
    if not (sin_rho > 0.0 and cone.cos_rho > 0.0):
        raise np.linalg.LinAlgError("the points determine no cone of a planet's limb")
    return np.asarray(-ellipsoid.axes_m * cone.axis_cam / sin_rho)


MIDDLE_SIGMA_M = 1e3
"""Standard deviation of the middle height of a known profile: sunlit limbs of one air scatter by 0.8 km, plus a
margin."""


def limb_height_prior(observation: Observation) -> tuple[float, float]:
    """Return mean and standard deviation [m] of the limb's height: the prior's, or uniform over the band's range.

    To a camera within the air the limb may be anything from the ground to its own height.
    """
    prior = observation.prior
    if prior.limb_height_m is not None and prior.limb_height_sigma_m is not None:
        return prior.limb_height_m, prior.limb_height_sigma_m
    low, high = limb_height_m(observation.band_kind)
    if (altitude := altitude_in_air_m(prior)) is not None:
        low, high = 0.0, min(high, altitude)
    return 0.5 * (low + high), (high - low) / float(np.sqrt(12.0))


def knowledge_in_air(
    observation: Observation,
    planet: Ellipsoid,
    mean: LimbPose,
    information: FloatArray,
    flattened_m: float = 0.0,
    *,
    of_height: bool = False,
    placed: bool = False,
    in_body_axes: bool = False,
) -> LimbKnowledge:
    """Return the knowledge of a limb in any air of the observation's band.

    ``information``: shape (7, 7); ``of_height``: whether the height is the limb's above the planet
    (:func:`limb_height_prior`), or stands for the planet's with only variations along the limb known; ``placed``:
    whether the pose has Earth-fixed axes; ``in_body_axes``: whether its turns refer to the spacecraft instead of the
    camera.
    """
    prior = observation.prior
    sun = observation.sun_cam
    if sun is not None and in_body_axes:
        sun = Rotation.from_quat(observation.q_cam_from_body).inv().apply(sun)
    knowledge = LimbKnowledge(
        planet,
        mean,
        information,
        blur_px=prior.lens_blur_px,
        scale_height_m=prior.limb_scale_height_m,
        scale_sigma_m=prior.limb_scale_height_sigma_m,
        reliefs=reliefs(observation.band_kind, prior.limb_relief_m),
        flattened_m=flattened_m,
        lens_sigmas=lens_sigmas(observation.calibration),
    )
    if observation.band_kind is None or observation.band_um is None or prior.limb_relief_m is not None:
        return knowledge
    heights = band_heights(observation.band_kind, observation.band_um, prior.limb_scale_height_m)
    if heights is None:
        return knowledge
    given = prior.limb_height_m is not None
    thermal = observation.band_kind == "thermal"
    uneven = UnevenLimb(
        heights,
        sun_cam=None if thermal else sun,
        sun_sigma_rad=SUN_SIGMA_RAD if prior.sun_sigma_rad is None else prior.sun_sigma_rad,
        month=month_of(prior.epoch_utc) if thermal and placed and prior.epoch_utc is not None else None,
        thermal=thermal,
        reliefs=knowledge.reliefs,
        typical_m=mean.height_m if of_height and not given else None,
    )
    # What bands show of the air's height is seen from above all of it.
    known = of_height and not given and altitude_in_air_m(prior) is None
    return replace(knowledge, uneven=uneven, middle_sigma_m=MIDDLE_SIGMA_M if known else np.inf)


@dataclass(frozen=True)
class EllipsoidStart:
    """A picture with its limb found, a start within some pixels of it, and what is known."""

    picture: Picture
    pose: LimbPose
    knowledge: LimbKnowledge


def ellipsoid_start(observation: Observation, method: str) -> EllipsoidStart | Refusal:
    """Return the start of a fit from the prior's position and attitude, or why there is none, naming ``method``."""
    prior = observation.prior
    if prior.r_itrs is None or prior.position_sigma_m is None:
        return Refusal(Outcome.BAD_INPUT, f"{method} needs a prior of the position (position_itrs_km)")
    if prior.q_cam_from_itrs is None or prior.attitude_sigma_rad is None:
        open_ = "" if prior.nadir_cam is None else "; nadir_cam leaves the turn about the vertical open"
        return Refusal(Outcome.BAD_INPUT, f"{method} needs a prior of the attitude (q_cam_from_itrs){open_}")
    searched = find_limb_and_picture(observation, coarse=True)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    ellipsoid, mean, information = placed_knowledge(observation, *limb_height_prior(observation))
    try:
        seen = position_from_limb(found.los_cam, mean.cam_from_itrs, ellipsoid.raised(mean.height_m))
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), found.uv)
    knowledge = knowledge_in_air(observation, ellipsoid, mean, information, of_height=True, placed=True)
    return EllipsoidStart(picture, turned_to(mean, seen), knowledge)
