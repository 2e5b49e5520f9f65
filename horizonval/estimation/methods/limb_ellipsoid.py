"""The limb of the Earth's ellipsoid by maximum likelihood of the pixels across it, position and coarse attitude known.

Position and turn about the nadir (to a degree or two) give the limb's departure from a circle, up to 400 arcsec in low
orbit, which methods of a cone take for tilt. The prior is rows of the fit: position (3), attitude (3), height of the
limb. The method claims the geocentric nadir, as the methods of a cone do. It refuses without a position and an
attitude: a sphere of the local radius would be another method (``limb-sphere``). Start:
:mod:`horizonval.estimation.fit.known`.
"""

from __future__ import annotations

from horizonval.core.outcome import Refusal
from horizonval.estimation.fit.claim import claim
from horizonval.estimation.fit.guard import accepted
from horizonval.estimation.fit.known import ellipsoid_start
from horizonval.estimation.observation import Estimator, Fit, Observation


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image, a position and a coarse attitude."""
    found = ellipsoid_start(observation, "limb-ellipsoid")
    if isinstance(found, Refusal):
        return found
    fit = claim(found.picture, observation, found.pose, found.knowledge)
    return accepted(fit, observation.prior.accept_rad)


ESTIMATOR = Estimator(
    name="limb-ellipsoid",
    title="Limb of the Earth's ellipsoid, maximum likelihood of the pixels, position known",
    run=run,
    estimates="geocentric",
    claim="likelihood",
)
