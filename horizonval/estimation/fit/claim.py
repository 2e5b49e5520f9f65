"""Claim of an estimator that fits the limb's likelihood: start points in, nadir and covariance or a refusal out.

The edge of the fit is one exponential in a window of some pixels. Where a pixel covers less of the air than its scale
height, the limb is deeper than the window, and the fit converges wrongly or not at all. Such a limb is fitted in a copy
with wider pixels, halved until a pixel covers a scale height. The copy averages the radiance, so that little is lost;
the covariance is that of the copy's pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.guard import LEAST_LEARNT_BY_EDGE, agreeing, guarded_fit
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import INSIDE_PX, LIT_SHARE
from horizonval.estimation.fit.limb import FITTED, LimbFit, fit_limb
from horizonval.estimation.fit.pixels import pixel_at_limb_m
from horizonval.estimation.fit.pose import LimbPose, nadir_derivative
from horizonval.estimation.fit.profile_fit import ProfileFit
from horizonval.estimation.guard.limits import contradicted
from horizonval.estimation.limb.picture import Picture, in_whole, scale_as_deep, smaller
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.frames import roll_pitch_of_nadir
from horizonval.geometry.horizon import angular_radius
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


def claim(picture: Picture, observation: Observation, start: LimbPose, knowledge: LimbKnowledge) -> Fit | Refusal:
    """Return the fit of the limb near a start; ``picture`` is the observation's image."""
    sunless = observation.band_kind != "thermal" and observation.sun_cam is None

    def fit(image: FloatArray) -> LimbFit:
        return _fitted(image, observation.camera, start, knowledge, sunless=sunless)

    try:
        found = guarded_fit(fit, picture.unclipped, observation, knowledge.ellipsoid, in_air=False)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the likelihood of the limb: {e}")
    if isinstance(found, Refusal):
        return found
    found = agreeing(found, knowledge, LEAST_LEARNT_BY_EDGE)
    if isinstance(found, Refusal):
        return found
    claimed = fit_of(found, observation, knowledge.ellipsoid)
    # What a sphere's fit does not use of the prior must agree with it nevertheless.
    radius, distance = observation.prior.sphere_radius_m, float(np.linalg.norm(found.pose.r_itrs))
    rho, sigma_m = float(np.arcsin(min(radius / distance, 1.0))), claimed.sigma_altitude_m or 0.0
    refusal = contradicted(claimed, observation, rho, (float(np.tan(rho)) / distance * sigma_m) ** 2)
    return claimed if refusal is None else refusal


DIMMED_PX = 0.5 * INSIDE_PX
"""Depth inside the limb at which a sector's level is measured, half of the window. At that depth ``x`` a Lambert sphere
of the radius ``r`` at the phase ``p`` has levels that vary by ``m = tan p sqrt(r / 2 x)`` round the limb, so that its
sliver is ``r (1 - cos p) = m^2 x`` wide."""


def with_unlit_part(found: LimbFit, camera: CameraModel) -> LimbFit:
    """Return the fit of a disc whose claim allows for a part that the Sun does not light; of an arc, the fit itself.

    A Sun that is not quite behind the camera leaves a sliver of the disc dark, whose edge is the terminator. It shows
    in levels that fall from one side of the disc to the other. A sliver that lies ``D cos^2 azimuth`` inside one half
    of the limb moves the middle by ``4 D / 3 pi`` and the radius by ``D / 4``, and leaves residuals of ``0.187 D``. Of
    a disc with a large unlit part the limb ends at the terminator, which may bend the ends of the lit limb by all that
    a window hides.
    """
    basis = tangent_basis(found.pose.nadir_cam)
    across = unproject(camera, found.uv) @ basis
    azimuth, lit = np.arctan2(across[:, 1], across[:, 0]), found.levels >= LIT_SHARE * found.levels.max()
    if not _round(azimuth):
        return found
    hidden_px = DIMMED_PX / np.sqrt(3.0)
    if _round(azimuth[lit]):
        rows = np.column_stack([np.ones(len(across)), across / np.linalg.norm(across, axis=1)[:, None]])
        (mean, *slope), *_ = np.linalg.lstsq(rows, found.levels, rcond=None)
        scatter = float(np.mean((found.levels - rows @ np.array([mean, *slope])) ** 2))
        # Clouds make a slope of their own.
        dimmed_2 = (float(slope[0] ** 2 + slope[1] ** 2) + 4.0 * scatter / len(across)) / max(mean**2, 1e-300)
        hidden_px = min(dimmed_2 * DIMMED_PX, hidden_px)
    # By the residuals, which are 0.187 D, where noise does not explain them, and by what leaves none.
    left = np.sqrt(np.mean(found.residuals_rad[lit] ** 2)) / 0.187 if found.scatter > 1.0 else 0.0
    hidden = hidden_px / max(camera.fx, camera.fy)
    distance = float(np.linalg.norm(found.pose.r_itrs))
    up = found.pose.r_itrs / distance
    rho = float(np.median(off_axis_angle(unproject(camera, found.uv), found.pose.nadir_cam)))
    along, added, depth_2 = np.outer(up, up), np.zeros_like(found.covariance), left**2 + hidden**2
    added[3:6, 3:6] = depth_2 * ((4.0 / (3.0 * np.pi) * distance) ** 2 * (np.eye(3) - along))
    added[3:6, 3:6] += depth_2 * (0.25 * distance / np.tan(rho)) ** 2 * along
    widened = replace(found, covariance=found.covariance + added, relief_covariance=found.relief_covariance + added)
    return replace(widened, uneven_px=min(3.0 * hidden_px, DIMMED_PX))


def _round(azimuth: FloatArray) -> bool:
    """Return whether azimuths (n,) of sectors go round a disc and show its shape."""
    if len(azimuth) < 2 * FITTED:
        return False
    azimuth = np.sort(azimuth)
    gap = float(np.diff(azimuth, append=azimuth[0] + 2.0 * np.pi).max())
    # The Sun lights so much of a limb only from behind the camera.
    return 2.0 * np.pi - gap >= np.radians(270.0)


def _fitted(
    image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: LimbKnowledge, *, sunless: bool
) -> LimbFit:
    """Return the fit in pixels as wide as the limb is deep, or in those of the picture where they are as wide.

    ``image``: shape (H, W), linear in radiance, NaN where missing; ``sunless``: whether the Sun may be anywhere, and a
    whole disc have an unlit sliver.
    """
    scale = limb_scale(camera, start, knowledge)
    if scale > 1:
        image, camera = smaller(image, camera, scale)
        knowledge = knowledge.in_wider_pixels(scale)
    found = fit_limb(image, camera, start, knowledge)
    if sunless:
        found = with_unlit_part(found, camera)
    return replace(found, uv=in_whole(found.uv, scale)) if scale > 1 else found


def limb_scale(camera: CameraModel, pose: LimbPose, knowledge: LimbKnowledge) -> int:
    """Return how many pixels together see as much as the air's scale height at the limb: a power of two, or 1.

    An exponential whose scale height is known, or a limb without any relief, which no air makes, is fitted in the
    picture's own pixels.
    """
    if knowledge.uneven is None and not knowledge.reliefs:
        return 1
    pixel_m = pixel_at_limb_m(camera, pose.r_itrs, float(knowledge.ellipsoid.axes_m[0]))
    # Where the limb's shape is known, a pixel may cover less.
    deep_m = min(knowledge.scale_height_m, 2.0 * knowledge.scale_sigma_m)
    return scale_as_deep(camera, pixel_m, deep_m)


def fit_of(found: LimbFit | ProfileFit, observation: Observation, ellipsoid: Ellipsoid) -> Fit:
    """Return a limb's fit in the form of all estimators.

    ``altitude_m``: distance from the Earth's centre minus the assumed sphere's radius, also for an ellipsoid. The noise
    covariance includes what priors leave open; relief of the limb is systematic.
    """
    pose = found.pose
    by_nadir = nadir_derivative(pose)
    relief = by_nadir @ found.relief_covariance @ by_nadir.T
    noise = by_nadir @ (found.covariance - found.relief_covariance) @ by_nadir.T
    nadir_body = Rotation.from_quat(observation.q_cam_from_body).inv().apply(pose.nadir_cam)
    roll, pitch = roll_pitch_of_nadir(nadir_body)
    distance = float(np.linalg.norm(pose.r_itrs))
    up = pose.r_itrs / distance
    return Fit(
        nadir_cam=pose.nadir_cam,
        covariance_nadir_cam=noise,
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        angular_radius_rad=angular_radius(pose.r_itrs, ellipsoid.raised(pose.height_m)),
        altitude_m=distance - observation.prior.sphere_radius_m,
        sigma_altitude_m=float(np.sqrt(max(float(up @ found.covariance[3:6, 3:6] @ up), 0.0))),
        points=found.uv,
        residuals_rad=found.residuals_rad,
        steps=found.steps,
        systematic_nadir_cam=relief,
    )
