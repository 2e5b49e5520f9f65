"""What a fit of the limb's profile leans on beside the image, and what it gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.air import NodeAir
from horizonval.estimation.observation import Lens
from horizonval.geometry.ellipsoid import Ellipsoid


@dataclass(frozen=True)
class ProfileKnowledge:
    """What is known beside the image.

    Attributes
    ----------
    mean : LimbPose
        The priors' values; ``height_m`` is the lift of the air.
    information : ndarray, shape (7, 7)
        About ``mean`` of a step from it, as in :class:`horizonval.estimation.likelihood.knowledge.LimbKnowledge`.
    heights_m : tuple of float
        First and last height of the table.
    air : callable
        From normals (m, 3) and lines of sight (m, 3) in camera axes, a pose, and a grid of distances across the limb
        (first, last, step) with their curve, to the air.
    blur_px, blur_log_sigma : float
        Of the lens.
    lens : Lens
        What is told of it beside.
    sharpness, sharpness_sigma : float
        Of the lens, as :mod:`.blurred` has it: nobody says it of a lens.
    gain, gain_log_sigma : float
        Levels per radiance of the table on the axis; an infinite sigma where the detector is not calibrated.
    """

    ellipsoid: Ellipsoid
    mean: LimbPose
    information: FloatArray
    heights_m: tuple[float, float]
    air: Callable[[FloatArray, FloatArray, LimbPose, tuple[float, float, float], float], NodeAir]
    blur_px: float = 0.7
    blur_log_sigma: float = 0.3
    lens: Lens = field(default_factory=Lens)
    sharpness: float = 0.5
    sharpness_sigma: float = 0.5
    gain: float = 1.0
    gain_log_sigma: float = np.inf


@dataclass(frozen=True)
class ProfileFit:
    """The most probable pose.

    Attributes
    ----------
    covariance : ndarray, shape (7, 7)
        Of a step from the pose: noise, priors and air.
    relief_covariance : ndarray, shape (7, 7)
        The air's part of it.
    improbable : float
        Largest coefficient of a mode anywhere along the limb, in its own standard deviations.
    explained : float
        Share of the pixels' variance that the prediction explains.
    uv : ndarray, shape (m, 2)
    residuals_rad : ndarray, shape (m,)
    steps : ndarray, shape (k, 7)
    growth, growth_sigma : float
        By how much the logarithm of the blur changes over the limb in view, as far as the pixels say; of several heads
        it is asked of each alone.
    """

    pose: LimbPose
    blur_px: float
    gain: float
    background: float
    covariance: FloatArray
    relief_covariance: FloatArray
    improbable: float
    explained: float
    uv: FloatArray
    residuals_rad: FloatArray
    steps: FloatArray
    growth: float = 0.0
    growth_sigma: float = np.inf


class NoLimbError(np.linalg.LinAlgError):
    """Nothing in the image is like the limb that is predicted.

    Other errors of the equations are of a fit that went astray.
    """
