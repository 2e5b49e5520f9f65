"""What is taken for known of the limb's air where no prior says it: wide enough for every band that is rendered."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_relief import limb_height_m, reliefs
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import Ellipsoid

SCALE_HEIGHT_M = 7e3
"""Of the air's density from the ground to 60 km: 6 to 8.5 km."""
SCALE_SIGMA_M = 4e3
"""Of the light's: a bare planet has none, haze and ozone stretch it by half."""


def limb_height_prior(observation: Observation) -> tuple[float, float]:
    """Return the mean height of the limb and its standard deviation [m]: the prior's, or that of any air.

    Between the lowest and the highest limb of a band every height is alike: the variance of an even distribution is a
    twelfth of its square width.
    """
    prior = observation.prior
    if prior.limb_height_m is not None and prior.limb_height_sigma_m is not None:
        return prior.limb_height_m, prior.limb_height_sigma_m
    low, high = limb_height_m(observation.band_kind)
    return 0.5 * (low + high), (high - low) / float(np.sqrt(12.0))


def knowledge_in_air(
    observation: Observation, planet: Ellipsoid, mean: LimbPose, information: FloatArray, flattened_m: float = 0.0
) -> LimbKnowledge:
    """Return what is known of a limb whose air is any of the observation's band.

    Parameters
    ----------
    observation : Observation
    planet, mean, information, flattened_m
        As of :class:`LimbKnowledge`; information of shape (7, 7).
    """
    return LimbKnowledge(
        planet,
        mean,
        information,
        scale_height_m=SCALE_HEIGHT_M,
        scale_sigma_m=SCALE_SIGMA_M,
        reliefs=reliefs(observation.band_kind),
        flattened_m=flattened_m,
    )
