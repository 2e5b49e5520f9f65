"""Self-calibration: the camera that makes the limbs of many frames most probable.

Frames are used by the whole profile of the limb where tables of its air exist, else by its edge. Focal length,
principal point, distortion and mounting are shared by all frames; pose, radiance, blur and air are unknowns of each
frame. Gauss-Newton maximises the likelihood of all pixels, with each frame's unknowns eliminated (Schur's complement;
Triggs, McLauchlan, Hartley and Fitzgibbon, "Bundle adjustment", 2000, section 6). With a frame's normal matrix in
separate and shared unknowns::

    N_i = [[X, Z], [Z^T, S]],    step_c = (sum (S - Z^T X^-1 Z) + P_c)^-1 sum (b_c - Z^T X^-1 b_x) + ...,
    C = (sum (S - Z^T X^-1 Z) + P_c)^-1

``C`` is the claimed covariance of the camera.

**Degenerate cases.** A disc of one size fits a short focal length under a low orbit and a long one under a high orbit:
where the limb stays at one position in the image, focal length is known only as well as the limb's angular radius, ``d
ln f ~ (dh / d) / (sin rho cos rho)`` with ``d`` the distance to the limb, and the height of all limbs is one unknown
with the prior's whole sigma. Attitudes that move the limb across the image determine it. Principal point and mounting
move the limb equally except for the square of the field; the yaw of the mounting about the nadir is seen through the
Earth's flattening and other rolls alone. What the frames do not determine keeps its prior, and is named.

**Neglected.** Errors of the stated attitude and position that successive frames share, except a turn of the mounting.
Frames of one location see the same air: the claim is then too large.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.core.progress import Progress, Silent
from horizonval.estimation.fit.claim import limb_scale
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.start import ellipsoid_start, limb_height_prior
from horizonval.estimation.lens_error import k1_per_px
from horizonval.estimation.likelihood.calibration.edge_frame import EdgeFrame
from horizonval.estimation.likelihood.calibration.profile_frame import ProfileFrame
from horizonval.estimation.likelihood.calibration.shared import (
    BEND,
    FOCAL,
    HEIGHT,
    POINT,
    SHARED,
    TURN,
    SharedUnknowns,
    prior_sigmas,
)
from horizonval.estimation.likelihood.profile.known_profile import known_profile
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import compose

Known = TypeVar("Known")
FEWEST_FRAMES = 2
MOST_TOGETHER = 2
"""Largest number of pixels binned into one, each way. With two, limbs four pixels deep give the right focal length.
With four, the lens is sharper than a sixth of the wide pixel, whose square is no Gaussian, and the focal length is
wrong by four sigma."""


class CalibrationFrame(Protocol):
    """A frame with unknowns of its own."""

    def equations(self, shared: SharedUnknowns, *, held: bool) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix (8, 8) and right side (8,) of what is shared, the frame's own eliminated."""

    def step(self, of_shared: FloatArray, share: float = 1.0) -> None:
        """Take a share of the frame's own step for a step of what is shared, shape (8,)."""


@dataclass(frozen=True)
class CalibrationFrames:
    """Frames of a calibration.

    ``left_out``: why other images are not used; ``whole``: shape (8,), camera errors per unit of the frames' unknowns,
    whose pixels may be wider; ``height_sigma_m``: of the common height of all limbs.
    """

    frames: Sequence[CalibrationFrame]
    left_out: tuple[str, ...]
    whole: FloatArray
    height_sigma_m: float


def frames_of(observations: Sequence[Observation]) -> CalibrationFrames | Refusal:
    """Return the frames of images of one camera, or why they are too few. ``observations``: at least one."""
    first = observations[0]
    bends = first.calibration is not None and first.calibration.distortion_sigma_px > 0.0
    known = known_profile(first, "limb-calibrate")
    by_profile = not (isinstance(known, Refusal) and known.status is Outcome.BAD_INPUT)
    return _profiles(observations, bends=bends) if by_profile else _edges(observations, bends=bends)


def _profiles(observations: Sequence[Observation], *, bends: bool) -> CalibrationFrames | Refusal:
    first = observations[0]
    height_sigma_m = first.prior.air_height_sigma_m
    turn_sigma = float(prior_sigmas(first, height_sigma_m)[TURN].max())
    frames: list[CalibrationFrame] = []
    left_out: list[str] = []
    usable = _usable(observations, known_profile, left_out)
    if isinstance(usable, Refusal):
        return usable
    for number, known in usable.items():
        try:
            frames.append(ProfileFrame(known, first.camera, turn_sigma, bends=bends))
        except np.linalg.LinAlgError as e:
            left_out.append(f"image {number + 1}: {e}")
    if len(frames) < FEWEST_FRAMES:
        return _too_few(len(frames), left_out)
    return CalibrationFrames(frames, tuple(left_out), np.ones(SHARED), height_sigma_m)


def _edges(observations: Sequence[Observation], *, bends: bool) -> CalibrationFrames | Refusal:
    first = observations[0]
    left_out: list[str] = []
    starts = _usable(observations, ellipsoid_start, left_out)
    if isinstance(starts, Refusal):
        return starts
    if len(starts) < FEWEST_FRAMES:
        return _too_few(len(starts), left_out)
    # As in single images: limbs of many pixels' depth are read in wider ones, here the same in all images.
    scale = min(MOST_TOGETHER, *(limb_scale(first.camera, start.pose, start.knowledge) for start in starts.values()))
    frames = []
    for number, start in starts.items():
        frame = EdgeFrame(start, first.camera, bends=bends, scale=scale)
        try:
            frame.choose(frame.told)
        except np.linalg.LinAlgError as e:
            left_out.append(f"image {number + 1}: {e}")
            continue
        frames.append(frame)
    if len(frames) < FEWEST_FRAMES:
        return _too_few(len(frames), left_out)
    # The model's edge may be displaced by the same share of a pixel in all frames.
    misplaced_m = MISPLACED_PX * float(np.median([one.pixel_m for one in frames]))
    height_sigma = float(np.hypot(limb_height_prior(first)[1], misplaced_m))
    return CalibrationFrames(
        frames, tuple(left_out), _of_whole_pixels(first.camera, frames[0].told, scale, bends=bends), height_sigma
    )


def _usable(
    observations: Sequence[Observation], look: Callable[[Observation, str], Known | Refusal], left_out: list[str]
) -> dict[int, Known] | Refusal:
    """Return what is known of images by their numbers; a refusal where one is told wrongly. Others are left out."""
    found: dict[int, Known] = {}
    for number, observation in enumerate(observations):
        known = look(observation, "limb-calibrate")
        if not isinstance(known, Refusal):
            found[number] = known
        elif known.status is Outcome.BAD_INPUT:
            return known
        else:
            left_out.append(f"image {number + 1}: {known.reason}")
    return found


def _too_few(count: int, left_out: list[str]) -> Refusal:
    return Refusal(
        Outcome.NO_LIMB, f"{count} images with a limb; {FEWEST_FRAMES} are needed; " + "; ".join(left_out[:3])
    )


def _of_whole_pixels(camera: CameraModel, small: CameraModel, scale: int, *, bends: bool) -> FloatArray:
    """Return how much of the camera's own errors, shape (8,), one of those in wider pixels is."""
    whole = np.ones(SHARED)
    whole[POINT] = scale
    if bends and scale > 1:
        whole[BEND] = k1_per_px(small) / k1_per_px(camera)
    return whole


MOST_STEPS, SETTLING_STEPS = 60, 5
"""Gauss-Newton's; pixels and weights are chosen anew while it settles."""
FALLEN, LEAST_SHARE = 0.5, 0.125
"""Ratio of successive squared steps below which the search converges, and the smallest share of a step."""
AS_PREDICTED = 1.2
"""Times what a share of a step leaves of the next one's square, if all is linear: then it may be a larger one."""
CONVERGED = 1e-4
"""Square of a step over its covariance: a hundredth of a standard deviation."""
DETERMINED = 0.5
"""Largest ratio of posterior to prior sigma of an unknown that the frames determine."""
NAMES = (
    "focal length",
    "principal point u",
    "principal point v",
    "distortion",
    "mounting x",
    "mounting y",
    "mounting z",
)
"""Names of a covariance's rows."""


@dataclass(frozen=True)
class CameraCalibration:
    """A camera determined from many frames.

    ``covariance`` (7, 7): of ln f, principal point (2) [px], distortion at the farthest corner [px], turn of the camera
    in its own axes (3) [rad]. ``change`` and ``prior_sigma`` (7,): from the given camera, in the same terms.
    ``height_m``, ``height_sigma_m``: common departure of all limbs from their known heights. ``left_out``: why frames
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
        """Names of what the frames say little of, and the priors most."""
        open_ = self.sigma > DETERMINED * self.prior_sigma
        return tuple(name for k, name in enumerate(NAMES) if open_[k] and k != BEND)

    def __repr__(self) -> str:
        percent = 100.0 * self.sigma[FOCAL]
        return f"<CameraCalibration fx {self.camera.fx:.4f} px to {percent:.4f} %, {self.frames} frames>"


def calibrate(observations: Sequence[Observation], progress: Progress | None = None) -> CameraCalibration | Refusal:
    """Return the camera that took all images, or why they do not determine its focal length.

    ``observations``: images of one camera, each with position and attitude in its prior. With time and wavelengths the
    whole profile of the air is fitted, as `limb-profile` does; without, edges of an unknown height. The calibration's
    sigmas are the prior of the shared unknowns; default 5 %, 20 px and 2 deg. ``progress``: called after each of the 10
    to 60 steps over all images.
    """
    if not observations:
        return Refusal(Outcome.BAD_INPUT, "no image to calibrate with")
    first = observations[0]
    for number, observation in enumerate(observations):
        if observation.camera != first.camera or not np.array_equal(observation.q_cam_from_body, first.q_cam_from_body):
            return Refusal(Outcome.BAD_INPUT, f"image {number + 1} is of another camera or mounting than the first")
    gathered = frames_of(observations)
    if isinstance(gathered, Refusal):
        return gathered
    frames, left_out, whole = gathered.frames, gathered.left_out, gathered.whole
    sigmas = prior_sigmas(first, gathered.height_sigma_m)
    try:
        found_small, small_covariance, steps = _solve(frames, sigmas / whole, progress or Silent())
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"limb-calibrate: {e}")
    shared = SharedUnknowns(found_small.values * whole)
    covariance = small_covariance * np.outer(whole, whole)
    of_camera = slice(0, TURN.stop)
    found = CameraCalibration(
        camera=shared.camera(first.camera),
        q_cam_from_body=compose(Rotation.from_rotvec(shared.values[TURN]).as_quat(), first.q_cam_from_body),
        covariance=covariance[of_camera, of_camera],
        change=shared.values[of_camera],
        prior_sigma=sigmas[of_camera],
        height_m=float(shared.values[HEIGHT]),
        height_sigma_m=float(np.sqrt(covariance[HEIGHT, HEIGHT])),
        frames=len(frames),
        left_out=left_out,
        steps=steps,
    )
    if NAMES[FOCAL] in found.not_determined:
        return Refusal(
            Outcome.AMBIGUOUS,
            f"the focal length is not observable: {100 * found.sigma[FOCAL]:.3g} % of {100 * sigmas[FOCAL]:.3g} % are "
            "left; turn the body so that the limb crosses the image, or know the height of the limb",
        )
    return found


def _solve(
    frames: Sequence[CalibrationFrame], sigmas: FloatArray, progress: Progress
) -> tuple[SharedUnknowns, FloatArray, int]:
    """Return the most probable shared unknowns, their covariance (8, 8), and the number of steps."""
    shared = SharedUnknowns(np.zeros(SHARED))
    share, before = 1.0, np.inf
    for number in range(MOST_STEPS):
        held = number >= SETTLING_STEPS
        # In units of the priors' sigmas: theirs is the unit matrix.
        normal, right = np.eye(SHARED), -shared.values / np.where(sigmas > 0.0, sigmas, 1.0)
        for frame in frames:
            of_frame, pull = frame.equations(shared, held=held)
            normal += of_frame * np.outer(sigmas, sigmas)
            right += pull * sigmas
        inverse = np.linalg.inv(normal)
        step = inverse @ right
        covariance = inverse * np.outer(sigmas, sigmas)
        square = float(step @ normal @ step)
        if held and square > max(FALLEN, AS_PREDICTED * (1.0 - share) ** 2) * before:
            # To and fro across the best place, as softness and blur of edges go: half of a step ends it.
            share = max(0.5 * share, LEAST_SHARE)
        elif square < AS_PREDICTED * (1.0 - share) ** 2 * before:
            share = min(2.0 * share, 1.0)
        before = square if held else np.inf
        shared = SharedUnknowns(shared.values + share * sigmas * step)
        progress.step("calibration", f"step {number + 1} of at most {MOST_STEPS}, {math.sqrt(square):.2g} sigma long")
        for frame in frames:
            frame.step(sigmas * step, share)
        if held and square < CONVERGED:
            return shared, covariance, number + 1
    raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")
