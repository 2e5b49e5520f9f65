"""What is known before a fit of the limb: the planet, priors as information, the air, and where the fit starts.

Information is the inverse of a covariance: unknown quantities have zero, fixed ones a large value. Free and known
altitude, sphere and ellipsoid are therefore the same fit with other rows.

**Start: a closed form of the position** (Christian and Robinson). Divided by the semi-axes of an ellipsoid, lines of
sight to its limb become lines of sight ``e`` to the limb of a unit sphere, which lie on a cone about the direction to
its centre (J. A. Christian and S. B. Robinson, "Noniterative horizon-based optical navigation by Cholesky
factorization", J. Guidance, Control, and Dynamics 39, 2757, 2016, section III; J. A. Christian, IEEE Access 9, 2021,
section V)::

    e_i . m = 1,    |m| = 1 / cos rho',    sin rho' = 1 / |p|,    r = axes * p,    p = -|p| m / |m|

with ``p`` the scaled position. They solve for ``m`` by least squares; here the cone is fitted by orthogonal regression
(:func:`horizonval.geometry.horizon.fit_cone`), which shrinks the radius of a short noisy arc less. A sphere is the case
of equal axes, in which camera axes suffice. The ellipsoid's position is in the axes of the attitude's prior; the camera
is turned by the smallest rotation that brings its direction to the prior's. Yaw and distance are the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.atmosphere.climate import month_of
from horizonval.earth.limb_heights import Relief, limb_height_m, reliefs
from horizonval.estimation.fit.heights import BLUR_PX, SUN_SIGMA_RAD, LimbHeights, UnevenLimb, band_heights
from horizonval.estimation.fit.image import LENS
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.fit.pose import FIXED_LENGTH_M, LimbPose
from horizonval.estimation.lens_error import lens_sigmas
from horizonval.estimation.limb.finder import altitude_in_air_m, find_limb_and_picture
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, sphere
from horizonval.geometry.horizon import fit_cone

LOCAL_RADIUS_SHARE = float(np.sqrt(4.0 / 45.0))
"""Standard deviation of ``sin^2`` latitude over the sphere; times flattening and radius, 6.4 km of local radius."""


@dataclass(frozen=True)
class LimbKnowledge:
    """What is known of a limb besides its image.

    ``ellipsoid``: of the planet without air; ``mean``: the priors' values; ``information``: shape (7, 7), inverse
    covariance about ``mean`` of a step from it (rotation vector in camera axes [rad], position [m], limb height [m]).
    ``blur_px``, ``blur_log_sigma``: blur of the lens and the standard deviation of its logarithm; ``scale_height_m``,
    ``scale_sigma_m``: of the soft limb, both 0 for a hard one.

    ``reliefs``: how the height of the limb varies along it; ``uneven``: the same from tables of the band, in place of
    the reliefs; ``flattened_m``: flattening times radius of the planet where ``ellipsoid`` is a sphere in its place.
    ``middle_sigma_m``: of the height of the limb and the scale height together. Where pixels are larger than the air is
    deep, no more is seen of the two. Infinite where only each of them is known. ``lens_sigmas``: shape (4,), of errors
    of the camera: ln focal length, principal point [px], distortion at the farthest corner [px]; 0 for what is exact.
    """

    ellipsoid: Ellipsoid
    mean: LimbPose
    information: FloatArray
    blur_px: float = BLUR_PX
    blur_log_sigma: float = 0.7
    scale_height_m: float = 0.0
    scale_sigma_m: float = 0.0
    reliefs: tuple[Relief, ...] = ()
    flattened_m: float = 0.0
    uneven: LimbHeights | None = None
    middle_sigma_m: float = np.inf
    lens_sigmas: FloatArray = field(default_factory=lambda: np.zeros(LENS))

    @property
    def soft(self) -> bool:
        """Whether the limb may be soft."""
        return self.scale_height_m > 0.0 or self.scale_sigma_m > 0.0

    @property
    def own(self) -> FloatArray:
        """Own unknowns of an image at the prior's values, ln blur and scale height, shape (2,)."""
        return np.array([0.5 * np.log(self.blur_px**2 + PIXEL_VARIANCE), self.scale_height_m])

    def in_wider_pixels(self, scale: int) -> LimbKnowledge:
        """Return what is known of the same limb in pixels ``scale`` times as wide."""
        px = np.array([1.0, scale, scale, scale])
        return replace(self, blur_px=self.blur_px / scale, lens_sigmas=self.lens_sigmas / px)


def sphere_knowledge(
    nadir_cam: FloatArray,
    radius_m: float,
    altitude_m: float,
    altitude_sigma_m: float = np.inf,
    height_m: float = 0.0,
    height_sigma_m: float = 0.0,
) -> tuple[Ellipsoid, LimbPose, FloatArray]:
    """Return planet, pose and information of a sphere fit, in axes that equal the camera's at the start.

    Unknowns are two tilts, the altitude and the limb height. A turn about the nadir, or a shift off the vertical,
    changes a sphere's limb only as tilts do and is fixed. ``nadir_cam``: shape (3,), unit vector at the start;
    ``altitude_sigma_m``: infinite for an unknown altitude.
    """
    n = nadir_cam
    along = np.outer(n, n)
    across = np.eye(3) - along
    information = np.zeros((7, 7))
    # A milliradian about the nadir: two tilts together make a turn, too.
    information[:3, :3] = along / 1e-3**2
    information[3:6, 3:6] = across / FIXED_LENGTH_M**2 + along / max(altitude_sigma_m, FIXED_LENGTH_M) ** 2
    information[6, 6] = 1.0 / max(height_sigma_m, FIXED_LENGTH_M) ** 2
    pose = LimbPose(np.eye(3), -(radius_m + altitude_m) * n, height_m)
    return sphere(radius_m), pose, information


def sphere_start(
    observation: Observation, los: FloatArray, *, in_body_axes: bool = False
) -> tuple[LimbPose, LimbKnowledge]:
    """Return start and knowledge of a sphere fit by points of the limb, unit lines of sight (n, 3).

    Altitude and height change a sphere's limb equally, and only priors distinguish them: without a prior of the
    altitude the limb is taken for the sphere. A rough direction of the nadir is a prior of the tilts. Raises
    ``LinAlgError``: no cone of a planet's limb.
    """
    prior = observation.prior
    radius, flattened = prior.sphere_radius_m, prior.flattening * prior.sphere_radius_m
    known = prior.altitude_m is not None and prior.altitude_sigma_m is not None
    height, height_sigma = limb_height_prior(observation) if known else (0.0, 0.0)
    r = position_from_limb(los, np.eye(3), sphere(radius + height))
    altitude, sigma = float(np.linalg.norm(r)) - radius, np.inf
    if prior.altitude_m is not None and prior.altitude_sigma_m is not None:
        altitude, sigma = prior.altitude_m, float(np.hypot(prior.altitude_sigma_m, LOCAL_RADIUS_SHARE * flattened))
    nadir = -r / np.linalg.norm(r)
    planet, mean, information = sphere_knowledge(nadir, radius, altitude, sigma, height, height_sigma)
    if prior.nadir_cam is not None and prior.rough_nadir is not None and not in_body_axes:
        rough, sigma_rad = prior.rough_nadir
        mean = turned_to(mean, -rough * np.linalg.norm(mean.r_itrs))
        information[:3, :3] += (np.eye(3) - np.outer(rough, rough)) / sigma_rad**2
    of_height = known and not in_body_axes
    knowledge = knowledge_in_air(
        observation, planet, mean, information, flattened, of_height=of_height, in_body_axes=in_body_axes
    )
    return LimbPose(np.eye(3), r, height), knowledge


def placed_knowledge(
    observation: Observation, height_m: float, height_sigma_m: float, *, in_body_axes: bool = False
) -> tuple[Ellipsoid, LimbPose, FloatArray]:
    """Return planet, prior pose and its information, of an observation with position and attitude in its prior.

    ``in_body_axes``: pose and turns refer to the spacecraft instead of the camera.
    """
    prior = observation.prior
    assert prior.r_itrs is not None
    assert prior.position_sigma_m is not None
    assert prior.q_cam_from_itrs is not None
    assert prior.attitude_sigma_rad is not None
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body)
    axes_from_itrs = Rotation.from_quat(prior.q_cam_from_itrs)
    turns = np.diag(prior.attitude_sigma_rad**-2.0)
    if in_body_axes:
        axes_from_itrs = cam_from_body.inv() * axes_from_itrs
    else:
        turns = cam_from_body.as_matrix() @ turns @ cam_from_body.as_matrix().T
    information = np.zeros((7, 7))
    information[:3, :3] = turns
    information[3:6, 3:6] = np.eye(3) / prior.position_sigma_m**2
    information[6, 6] = height_sigma_m**-2
    planet = sphere(prior.sphere_radius_m) if prior.shape == "sphere" else WGS84
    return planet, LimbPose(axes_from_itrs.as_matrix(), prior.r_itrs, height_m), information


def turned_to(mean: LimbPose, r_seen_itrs: FloatArray) -> LimbPose:
    """Return a pose after the shortest turn that brings the Earth to the direction of ``r_seen_itrs``, shape (3,)."""
    axes = mean.cam_from_itrs
    turn = Rotation.align_vectors([axes @ r_seen_itrs], [axes @ mean.r_itrs])[0].as_matrix()
    return replace(mean, cam_from_itrs=turn @ axes)


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
    # What bands show of the air's height is seen from above all of it. Sunlit limbs of one air scatter by 0.8 km.
    known = of_height and not given and altitude_in_air_m(prior) is None
    return replace(knowledge, uneven=uneven, middle_sigma_m=1e3 if known else np.inf)


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
