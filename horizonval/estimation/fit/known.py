"""Priors of a fit of the limb as information, and the positions along the limb at which heights are evaluated.

Information is the inverse of a covariance: unknown quantities have zero, fixed ones a large value. Free and known
altitude, sphere and ellipsoid are therefore the same fit with other rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief
from horizonval.estimation.fit.image import LENS
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, sphere


@dataclass(frozen=True)
class ArcPlaces:
    """Positions along the limb.

    ``los_cam``, ``up_cam``: shape (n, 3), unit lines of sight and verticals; ``cam_from_itrs``: shape (3, 3);
    ``pixel_m``: shape (n,), height per pixel.
    """

    los_cam: FloatArray
    up_cam: FloatArray
    cam_from_itrs: FloatArray
    pixel_m: FloatArray


class LimbHeights(Protocol):
    """What is known of the limb's height along it; :class:`.uneven_limb.UnevenLimb` is."""

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return heights above the pose's [m] and covariance [m^2], at azimuths (n,) about the nadir [rad]."""


LOCAL_RADIUS_SHARE = float(np.sqrt(4.0 / 45.0))
"""Standard deviation of ``sin^2`` latitude over the sphere; times flattening and radius, 6.4 km of local radius."""
BLUR_PX = 0.7
"""Standard deviation of a usual lens's blur."""
FIXED_ANGLE_RAD = 1e-6
FIXED_LENGTH_M = 0.1
"""Sigmas of what is no unknown: below what an image shows (0.2 arcsec of yaw, 0.01 of altitude), above rounding."""


@dataclass(frozen=True)
class Sliver:
    """The unlit part of a disc: at the angle ``a`` from the darkest point of the limb the terminator lies ``depth cos^2
    a`` inside of it, on that half of the disc.

    ``darkest``: shape (3,), direction from the nadir to that point, in the axes of the knowledge; ``depth_px``: mean,
    and as much for its standard deviation.
    """

    darkest: FloatArray
    depth_px: float


@dataclass(frozen=True)
class LimbKnowledge:
    """What is known beside the image.

    Attributes
    ----------
    ellipsoid : Ellipsoid
        Of the planet without air.
    mean : LimbPose
        The priors' values.
    information : ndarray, shape (7, 7)
        Inverse covariance about ``mean`` of a step from it: rotation vector in camera axes [rad], position [m], limb
        height [m].
    blur_px : float
        Of the lens, standard deviation.
    blur_log_sigma : float
        Of its logarithm.
    scale_height_m, scale_sigma_m : float
        Of the soft limb; both 0 for a hard one.
    reliefs : tuple of Relief
        How the height of the limb varies along it.
    flattened_m : float
        Flattening times radius of the planet where ``ellipsoid`` is a sphere in its place.
    uneven : LimbHeights, optional
        How the height of the limb varies along it, in place of the reliefs.
    middle_sigma_m : float
        Of the height in which the limb's light has its middle, that of the edge and the scale height together, of which
        ``mean`` and ``scale_height_m`` are the sum: where pixels are larger than the air is deep, no more is seen of
        the two. Infinite where only each of them is known.
    lens_sigmas : ndarray, shape (4,)
        Of errors of the camera: ln focal length, principal point [px], distortion at the farthest corner [px]; 0 for
        what is exact.
    sliver : Sliver, optional
        What of a whole disc the Sun may not light.
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
    sliver: Sliver | None = None

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
    information[:3, :3] = along / FIXED_ANGLE_RAD**2
    information[3:6, 3:6] = across / FIXED_LENGTH_M**2 + along / max(altitude_sigma_m, FIXED_LENGTH_M) ** 2
    information[6, 6] = 1.0 / max(height_sigma_m, FIXED_LENGTH_M) ** 2
    pose = LimbPose(np.eye(3), -(radius_m + altitude_m) * n, height_m)
    return Ellipsoid(radius_m, radius_m), pose, information


def tilted_to(
    mean: LimbPose, information: FloatArray, nadir_cam: FloatArray, sigma_rad: float
) -> tuple[LimbPose, FloatArray]:
    """Return pose and information of a sphere fit (:func:`sphere_knowledge`) with a rough direction of the nadir.

    ``nadir_cam``: shape (3,), unit vector, right to ``sigma_rad`` in each of two directions across it.
    """
    mean = turned_to(mean, -nadir_cam * np.linalg.norm(mean.r_itrs))
    information = information.copy()
    information[:3, :3] += (np.eye(3) - np.outer(nadir_cam, nadir_cam)) / sigma_rad**2
    return mean, information


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
