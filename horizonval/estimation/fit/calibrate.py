"""Self-calibration: the camera that makes the limbs of many images most probable.

Every image is a shot of one bundle (:mod:`.bundle`), by the whole profile of the limb where tables of its air exist,
else by its edge. Focal length, principal point, distortion, mounting and the mean height of all limbs are shared; pose,
radiance, blur and air are unknowns of each image. Every image is fitted alone first, with the camera as given and the
mounting free; images for which that fails are left out. The claim is the covariance of what is shared.

**Degenerate cases.** Where the limb stays at one position in the image, focal length is known only as well as the
limb's angular radius, ``d ln f ~ (dh / d) / (sin rho cos rho)`` with ``d`` the distance to the limb, and the height of
all limbs is one unknown with the prior's whole sigma. Attitudes that move the limb across the image determine it.
Principal point and mounting move the limb equally except for the square of the field; the yaw of the mounting about the
nadir is seen through the Earth's flattening and other rolls alone. What the images do not determine keeps its prior,
and is named.

**Neglected.** Errors of the stated attitude and position that successive images share, except a turn of the mounting.
Images of one location see the same air: the claim is then too small.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Progress, Silent
from horizonval.estimation.fit.bundle import HEIGHT, SHARED, TURN, Bundle, Shot, ShotPrior
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX, EdgeChooser, EdgeImage
from horizonval.estimation.fit.image import LENS
from horizonval.estimation.fit.known import ellipsoid_start, limb_height_prior
from horizonval.estimation.fit.known_profile import known_profile
from horizonval.estimation.fit.pixels import pixel_at_limb_m, with_errors
from horizonval.estimation.fit.profile import ProfileImage
from horizonval.estimation.fit.profile_fit import profile_shot
from horizonval.estimation.fit.solver import SolverOptions, Stage, solve
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import compose

METHOD = "limb-calibrate"
FOCAL, POINT, BEND = 0, slice(1, 3), 3
"""Places of focal length, principal point and distortion among the shared unknowns; see :mod:`.bundle`."""
ALONE = SolverOptions(stages=(Stage(pixels=1500, tighter=10.0, tolerance=1.0),))
"""Settings of the fit of one image, which starts the bundle: few pixels, the blur of the lens nearly fixed."""
FEW = SolverOptions(stages=(Stage(pixels=1500, tolerance=1.0, settle=False),))
"""Settings of the first fit of all images: until the camera is right to about a standard deviation."""
ALL = SolverOptions(stages=(Stage(tolerance=0.1),))
"""Settings of the last fit: to a tenth of a standard deviation, a hundredth of the claimed variance."""
NAMES = (
    *("focal length", "principal point u", "principal point v", "distortion"),
    *("mounting x", "mounting y", "mounting z"),
)
"""Names of a covariance's rows."""


@dataclass(frozen=True)
class CameraCalibration:
    """A camera determined from many images.

    ``covariance`` (7, 7): of ln f, principal point (2) [px], distortion at the farthest corner [px], turn of the camera
    in its own axes (3) [rad]. ``change`` and ``prior_sigma`` (7,): from the given camera, in the same terms.
    ``height_m``, ``height_sigma_m``: common departure of all limbs from their known heights. ``left_out``: why images
    were not used.
    """

    camera: CameraModel
    q_cam_from_body: FloatArray
    covariance: FloatArray
    change: FloatArray
    prior_sigma: FloatArray
    height_m: float
    height_sigma_m: float
    frames: int
    left_out: tuple[str, ...]
    steps: int

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, shape (7,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def not_determined(self) -> tuple[str, ...]:
        """Names of what the images say little of, and the priors most."""
        # Images determine an unknown whose standard deviation they halve.
        open_ = self.sigma > 0.5 * self.prior_sigma
        return tuple(name for k, name in enumerate(NAMES) if open_[k] and k != BEND)


def calibrate(observations: Sequence[Observation], progress: Progress | None = None) -> CameraCalibration | Refusal:
    """Return the camera that took all images, or why they do not determine its focal length.

    ``observations``: images of one camera, each with position and attitude in its prior. With time and wavelengths the
    whole profile of the air is fitted, as `limb-profile` does; without, edges of an unknown height. The calibration's
    sigmas are the prior of the shared unknowns; default 5 %, 20 px and 2 deg. ``progress``: called for every image, and
    after each step over all images.
    """
    progress = progress or Silent()
    gathered = gather(observations, progress)
    if isinstance(gathered, Refusal):
        return gathered
    bundle, left_out = gathered
    try:
        solve(bundle, FEW, progress)
        for shot in bundle.shots:
            # Nodes of the air along the limb are those of the camera as it is now.
            shot.chosen = None
        solution = solve(bundle, ALL, progress)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"{METHOD}: {e}")
    first, shared, of_camera = observations[0], bundle.shared, slice(0, TURN.stop)
    found = CameraCalibration(
        camera=with_errors(first.camera, shared[:LENS]),
        q_cam_from_body=compose(Rotation.from_rotvec(shared[TURN]).as_quat(), first.q_cam_from_body),
        covariance=solution.covariance[of_camera, of_camera],
        change=shared[of_camera],
        prior_sigma=bundle.sigmas[of_camera],
        height_m=float(shared[HEIGHT]),
        height_sigma_m=float(np.sqrt(solution.covariance[HEIGHT, HEIGHT])),
        frames=len(bundle.shots),
        left_out=left_out,
        steps=len(solution.steps[0]),
    )
    if NAMES[FOCAL] in found.not_determined:
        return Refusal(
            Outcome.AMBIGUOUS,
            f"the focal length is not observable: {100 * found.sigma[FOCAL]:.3g} % of "
            f"{100 * found.prior_sigma[FOCAL]:.3g} % are left; turn the body so that the limb crosses the image, or "
            "know the height of the limb",
        )
    return found


Gathered = tuple[Bundle, tuple[str, ...]]
"""A bundle of the images of one camera, each fitted alone, and why others are left out."""


def gather(observations: Sequence[Observation], progress: Progress) -> Gathered | Refusal:
    """Return the bundle of images of one camera: of profiles where the air is known, else of edges.

    The result is a refusal for what no image can be fitted with, and for too few images with a limb.
    """
    if not observations:
        return Refusal(Outcome.BAD_INPUT, "no image to calibrate with")
    first = observations[0]
    for number, observation in enumerate(observations, 1):
        if observation.camera != first.camera or not np.array_equal(observation.q_cam_from_body, first.q_cam_from_body):
            return Refusal(Outcome.BAD_INPUT, f"image {number} is of another camera or mounting than the first")
    known = known_profile(first, METHOD)
    by_edge = isinstance(known, Refusal) and known.status is Outcome.BAD_INPUT
    return edges_of(observations, progress) if by_edge else profiles_of(observations, progress)


def profiles_of(observations: Sequence[Observation], progress: Progress) -> Gathered | Refusal:
    """Return the bundle of images that are fitted by whole profiles of the limb."""
    sigmas = prior_sigmas(observations[0], observations[0].prior.air_height_sigma_m)

    def shot_of(observation: Observation) -> Shot | Refusal:
        known = known_profile(observation, METHOD)
        if isinstance(known, Refusal):
            return known
        camera, knowledge = observation.camera, known.knowledge
        start = known.start(camera, float(np.hypot(known.tilt_sigma_rad, sigmas[TURN].max())))
        image = ProfileImage(known.picture.unclipped, camera, knowledge)
        return profile_shot([image], ShotPrior(knowledge.mean, knowledge.information), start)

    return _gathered(observations, sigmas, shot_of, progress)


def edges_of(observations: Sequence[Observation], progress: Progress) -> Gathered | Refusal:
    """Return the bundle of images that are fitted by the limb's edge."""
    first = observations[0]
    misplaced_m = 0.0
    if first.prior.r_itrs is not None:
        # The model's edge may be displaced by the same share of a pixel in all images.
        radius_m = first.prior.sphere_radius_m if first.prior.shape == "sphere" else WGS84.a_m
        misplaced_m = MISPLACED_PX * pixel_at_limb_m(first.camera, first.prior.r_itrs, radius_m)

    def shot_of(observation: Observation) -> Shot | Refusal:
        start = ellipsoid_start(observation, METHOD)
        if isinstance(start, Refusal):
            return start
        image, known = EdgeImage(start.picture.grey, observation.camera, np.eye(3)), start.knowledge
        # A real edge is no exponential: a profile cut off three pixels from the border misplaces it by 0.3 px.
        chooser = EdgeChooser([image], known, whole=1.0)
        return Shot(chooser, ShotPrior(known.mean, known.information), chooser.start(start.pose))

    height_m = float(np.hypot(limb_height_prior(first)[1], misplaced_m))
    return _gathered(observations, prior_sigmas(first, height_m), shot_of, progress)


def _gathered(
    observations: Sequence[Observation],
    sigmas: FloatArray,
    shot_of: Callable[[Observation], Shot | Refusal],
    progress: Progress,
) -> Gathered | Refusal:
    """Return the bundle; ``shot_of``: the shot of an image near its limb."""
    shots: list[Shot] = []
    left_out: list[str] = []
    of_mounting = np.where(np.arange(SHARED) < LENS, 0.0, sigmas)
    for number, observation in enumerate(observations, 1):
        progress.step("calibrate", f"image {number} of {len(observations)}")
        try:
            shot = shot_of(observation)
            if isinstance(shot, Refusal):
                if shot.status is Outcome.BAD_INPUT:
                    return shot
                left_out.append(f"image {number}: {shot.reason}")
                continue
            solve(Bundle([shot], of_mounting), ALONE)
        except np.linalg.LinAlgError as e:
            left_out.append(f"image {number}: {e}")
            continue
        shots.append(shot)
    if len(shots) < 2:
        reason = f"{len(shots)} images with a limb; two are needed; " + "; ".join(left_out[:3])
        return Refusal(Outcome.NO_LIMB, reason)
    return Bundle(shots, sigmas), tuple(left_out)


def prior_sigmas(observation: Observation, height_sigma_m: float) -> FloatArray:
    """Return prior standard deviations (8,) of the shared unknowns; ``height_sigma_m``: common height of all limbs."""
    sigmas, said = np.zeros(SHARED), observation.calibration
    # Without a statement 5 % and 20 px, as a data sheet has them, and 2 deg, as a workshop mounts; no distortion.
    sigmas[FOCAL], sigmas[POINT], sigmas[TURN], sigmas[HEIGHT] = 0.05, 20.0, np.radians(2.0), height_sigma_m
    if said is not None:
        sigmas[FOCAL] = said.focal_length_sigma or sigmas[FOCAL]
        sigmas[POINT] = said.principal_point_sigma_px or sigmas[POINT]
        sigmas[TURN] = max(said.mounting_sigma_rad) or sigmas[TURN]
        sigmas[BEND] = said.distortion_sigma_px
    return sigmas
