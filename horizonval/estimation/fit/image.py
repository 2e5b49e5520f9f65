"""Image models: what the pixels of one image are, given unknowns, and how they change with them.

A model is made for the pixels that are near the limb at some pose. Its unknowns are the pose of the camera (7: turn in
camera axes, position, height of the limb), errors of the lens (4: ln focal length, principal point [px], distortion at
the farthest corner [px]), what the image has of its own (blur and levels), and the air: unknowns with a unit normal
prior each. The bundle (:mod:`.bundle`) adds the priors of pose and air, and decides what several images share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.noise import PixelNoise
from horizonval.estimation.fit.pose import LimbPose

POSE = 7
"""Turn of the camera [rad] (3), position [m] (3), height of the limb [m]."""
LENS = 4
"""ln focal length, principal point [px] (2), distortion at the farthest corner [px]."""


class Look(Protocol):
    """Pixels as the unknowns predict them."""

    @property
    def residuals(self) -> FloatArray:
        """Measured minus predicted grey levels, shape (n,)."""

    @property
    def penalty(self) -> float:
        """Squared departures of unknowns that the model has eliminated from their priors, in sigmas."""


class Linear(Protocol):
    """Normal equations of the pixels at one look, without priors of pose, own unknowns and air.

    ``shared``: shape (s, s), of pose, lens and own unknowns; ``mixed``: shape (s, k); ``air``: shape (k, k); ``exact``:
    whether the right sides at another look are the gradient there, and not by the derivatives of the first.
    """

    exact: ClassVar[bool]
    shared: FloatArray
    mixed: FloatArray
    air: FloatArray

    def rights(self, look: Any, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the right sides, shapes (s,) and (k,), at another look."""


@dataclass(frozen=True)
class OwnPrior:
    """Prior of an image's own unknowns, as rows of the equations of its shared unknowns (pose 7, lens 4, own).

    ``information``: shape (s, s); ``right``: shape (s,), information times the step to the prior's values;
    ``penalty``: squared departure from the prior in sigmas.
    """

    information: FloatArray
    right: FloatArray
    penalty: float


class ImageModel(Protocol):
    """The pixels of one image near the limb; it is given back no other looks than its own."""

    def moved(self, own: FloatArray, step: FloatArray) -> FloatArray:
        """Return the own unknowns, shape (own,), after a step of them."""

    def prior(self, pose: LimbPose, own: FloatArray) -> OwnPrior:
        """Return the prior of the own unknowns at present values; that of the pose alone is the bundle's."""

    def reach(self, step: FloatArray) -> float:
        """Return how far a step (7 + 4 + own) goes, 1 where derivatives end to hold."""

    def motion_px(self, step: FloatArray) -> float:
        """Return by how much a step (7 + 4 + own) moves the limb where it moves it most [px]."""

    def look(
        self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray, weights: FloatArray | None
    ) -> Look:
        """Return the pixels as predicted.

        ``weights``: inverse variances (n,) so far, by which the model eliminates what it does not leave to the bundle.
        """

    def noise(self, look: Any) -> PixelNoise:
        """Return the variance model of the pixels, estimated from their residuals."""

    def linear(self, look: Any, own: FloatArray, weights: FloatArray) -> Linear:
        """Return the normal equations at a look; ``weights``: inverse variances, shape (n,)."""


@dataclass(frozen=True)
class ShotState:
    """Unknowns of a shot: pose of the body, own unknowns of every image, air."""

    pose: LimbPose
    own: tuple[FloatArray, ...]
    air: FloatArray


@dataclass(frozen=True)
class Chosen:
    """Pixels chosen near the limb at a state.

    ``models``: of every image; ``columns``: indices of each image's unknowns among those of the air; ``state``: the
    same unknowns, the air's on the models' nodes.
    """

    models: Sequence[ImageModel]
    columns: Sequence[NDArray[np.intp]]
    state: ShotState


class Chooser(Protocol):
    """Chooses the pixels of all images of a shot."""

    def __call__(
        self, state: ShotState, lens: FloatArray, most: int | None, tighter: float, before: Chosen | None
    ) -> Chosen:
        """Return the pixels near the limb at a state.

        ``lens``: shape (4,), errors of the lens; ``most``: for a first part of the way, about so many pixels per image,
        or fewer unknowns; ``tighter``: factor on the priors' information on the blur; ``before``: the choice so far,
        whose air serves where the state is near. Raises ``LinAlgError``: too little limb in view.
        """
