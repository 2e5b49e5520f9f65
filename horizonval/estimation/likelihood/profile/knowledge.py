"""What a fit of the limb's profile leans on beside the image, and what it gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.profile.air import NodeAir
from horizonval.estimation.observation import Lens
from horizonval.geometry.ellipsoid import Ellipsoid


@dataclass(frozen=True)
class ProfileKnowledge:
    """Prior knowledge of a profile fit.

    ``mean``: prior pose, ``height_m`` being the lift of the air; ``information``: shape (7, 7), of a step from it, as
    in :class:`horizonval.estimation.fit.known.LimbKnowledge`. ``heights_m``: first and last height of the
    table. ``air``: function of normals (m, 3), lines of sight (m, 3) in camera axes, pose, grid of distances (first,
    last, step) and their curve. ``blur_px``, ``blur_log_sigma``: of the lens; ``lens``: blur over the field and
    diffraction from the camera file. ``sharpness``, ``sharpness_sigma``: shape of the lens's blur (:mod:`.blurred`),
    which no file states. ``gain``, ``gain_log_sigma``: levels per table radiance on the axis; an infinite sigma for an
    uncalibrated detector.
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

    ``covariance`` (7, 7): of a step from the pose, from noise, priors and air; ``relief_covariance``: the air's part.
    ``improbable``: largest mode coefficient along the limb, in standard deviations. ``explained``: share of the pixels'
    variance that the prediction explains. ``uv`` (m, 2), ``residuals_rad`` (m,), ``steps`` (k, 7). ``growth``,
    ``growth_sigma``: change of ln blur over the limb in view; for several heads, of each alone.
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
    """Nothing in the image resembles the predicted limb; other errors of the equations mean divergence."""
