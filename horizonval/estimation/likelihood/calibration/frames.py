"""The frames that a calibration can use: by the whole profile of the limb where its air is known, else by its edge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.likelihood.air import limb_height_prior
from horizonval.estimation.likelihood.calibration.edge_frame import EdgeFrame
from horizonval.estimation.likelihood.calibration.profile_frame import ProfileFrame
from horizonval.estimation.likelihood.calibration.shared import BEND, POINT, SHARED, TURN, SharedUnknowns, prior_sigmas
from horizonval.estimation.likelihood.claim import limb_scale
from horizonval.estimation.likelihood.ellipsoid_start import ellipsoid_start
from horizonval.estimation.likelihood.limb_pixels import MISPLACED_PX
from horizonval.estimation.likelihood.profile.known_profile import LIFT_SIGMA_M, known_profile
from horizonval.estimation.miscalibrated import k1_per_px
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel

Known = TypeVar("Known")
FEWEST_FRAMES = 2
MOST_TOGETHER = 2
"""Pixels that are fitted as one, each way. Of four, the lens is sharper than a sixth of the wide pixel, whose square is
no Gaussian then: what that changes of the edge goes with the limb's phase in the pixels, and the focal length of limbs
four pixels deep came out four of its sigma off, or not at all. Of two it came out right in five draws of five; of limbs
eight pixels deep the mounting is up to three of its sigma off. Chosen after seeing those."""


class CalibrationFrame(Protocol):
    """A frame with unknowns of its own."""

    def equations(self, shared: SharedUnknowns, *, held: bool) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix (8, 8) and right side (8,) of what is shared, the frame's own eliminated."""

    def step(self, of_shared: FloatArray, share: float = 1.0) -> None:
        """Take a share of the frame's own step for a step of what is shared, shape (8,)."""


@dataclass(frozen=True)
class CalibrationFrames:
    """What a calibration is solved with.

    Attributes
    ----------
    frames : sequence of CalibrationFrame
    left_out : tuple of str
        Why other images are not used.
    whole : ndarray, shape (8,)
        How much of the camera's own errors one of the frames' unknowns is: their pixels may be wider.
    height_sigma_m : float
        By which all limbs may stand higher or lower together.
    """

    frames: Sequence[CalibrationFrame]
    left_out: tuple[str, ...]
    whole: FloatArray
    height_sigma_m: float


def frames_of(observations: Sequence[Observation]) -> CalibrationFrames | Refusal:
    """Return the frames of images of one camera, or why they are too few.

    Parameters
    ----------
    observations : sequence of Observation
        At least one.
    """
    first = observations[0]
    bends = first.calibration is not None and first.calibration.distortion_sigma_px > 0.0
    known = known_profile(first, "limb-calibrate")
    by_profile = not (isinstance(known, Refusal) and known.status is Outcome.BAD_INPUT)
    return _profiles(observations, bends=bends) if by_profile else _edges(observations, bends=bends)


def _profiles(observations: Sequence[Observation], *, bends: bool) -> CalibrationFrames | Refusal:
    first = observations[0]
    turn_sigma = float(prior_sigmas(first, LIFT_SIGMA_M)[TURN].max())
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
    return CalibrationFrames(frames, tuple(left_out), np.ones(SHARED), LIFT_SIGMA_M)


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
    # The model's edge may be off by a share of a pixel in all frames alike.
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
