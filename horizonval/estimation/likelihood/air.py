"""What is taken for known of the limb's air where no prior says it, of bands with shipped profiles and of others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.climate import month_of
from horizonval.earth.limb_heights import limb_height_m, reliefs
from horizonval.estimation.likelihood.height.band_heights import band_heights
from horizonval.estimation.likelihood.height.uneven_limb import SUN_SIGMA_RAD, UnevenLimb
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import Ellipsoid

SCALE_HEIGHT_M = 7e3
"""Of the air's density from the ground to 60 km: 6 to 8.5 km."""
SCALE_SIGMA_M = 4e3
"""Of the light's: a bare planet has none, haze and ozone stretch it by half."""
MIDDLE_SIGMA_M = 1e3
"""Of the middle of a limb's light, where its profile is known: what sunlit limbs under a high Sun, all of one air,
scattered by about the known height, 0.8 km on 32 frames of the nightly suite, and a little more for other pixels."""


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
    observation: Observation,
    planet: Ellipsoid,
    mean: LimbPose,
    information: FloatArray,
    flattened_m: float = 0.0,
    *,
    of_height: bool = False,
    placed: bool = False,
) -> LimbKnowledge:
    """Return what is known of a limb whose air is any of the observation's band.

    Parameters
    ----------
    observation : Observation
    planet, mean, information, flattened_m
        As of :class:`LimbKnowledge`; information of shape (7, 7).
    of_height : bool, optional
        Whether the height is that of the limb above the planet, of :func:`limb_height_prior`. Without, it stands in for
        the planet's own, and only what changes along the limb is known.
    placed : bool, optional
        Whether the pose has Earth-fixed axes.
    """
    prior = observation.prior
    knowledge = LimbKnowledge(
        planet,
        mean,
        information,
        scale_height_m=SCALE_HEIGHT_M,
        scale_sigma_m=SCALE_SIGMA_M,
        reliefs=reliefs(observation.band_kind),
        flattened_m=flattened_m,
    )
    if observation.band_kind is None or observation.band_um is None:
        return knowledge
    heights = band_heights(observation.band_kind, observation.band_um, SCALE_HEIGHT_M)
    if heights is None:
        return knowledge
    given = prior.limb_height_m is not None
    thermal = observation.band_kind == "thermal"
    uneven = UnevenLimb(
        heights,
        sun_cam=None if thermal else observation.sun_cam,
        sun_sigma_rad=SUN_SIGMA_RAD if prior.sun_sigma_rad is None else prior.sun_sigma_rad,
        month=month_of(prior.epoch_utc) if thermal and placed and prior.epoch_utc is not None else None,
        thermal=thermal,
        reliefs=reliefs(observation.band_kind),
        typical_m=mean.height_m if of_height and not given else None,
    )
    known = of_height and not given
    return replace(knowledge, uneven=uneven, middle_sigma_m=MIDDLE_SIGMA_M if known else np.inf)
