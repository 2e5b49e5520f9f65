"""An observation as a detector with wider pixels would have made it: limbs many pixels deep are edges there."""

from __future__ import annotations

from dataclasses import replace

from horizonval.estimation.limb.smaller import smaller
from horizonval.estimation.observation import Observation


def in_wider_pixels(observation: Observation, scale: int) -> Observation:
    """Return what pixels ``scale`` times as wide would have seen; columns and rows left over are cut."""
    if scale == 1:
        return observation
    image, camera = smaller(observation.image, observation.camera, scale)
    lens = None if observation.lens is None else observation.lens.in_wider_pixels(scale)
    return replace(observation, image=image, camera=camera, lens=lens)
