"""The limb of the Earth's ellipsoid by maximum likelihood of the pixels across it, position and coarse attitude known.

Where the satellite stands over the ellipsoid, and which way the camera is turned about the nadir to a degree or two,
says how the limb departs from a circle: by up to 400 arcsec in low orbit, which methods of a cone take for tilt. What a
prior knows is rows of the fit: position (3), attitude (3), height of the limb. It claims the geocentric nadir, as the
methods of a cone do, so that they can be compared; roll and pitch are against it.

It needs a position and an attitude, and refuses without: a sphere of the local radius would be another method, with
other errors (``limb-sphere``).

Where it starts: :mod:`horizonval.estimation.likelihood.start`.
"""

from __future__ import annotations

from horizonval.core.outcome import Refusal
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.likelihood.claim import claim
from horizonval.estimation.likelihood.start import ellipsoid_start
from horizonval.estimation.observation import Estimator, Fit, Observation


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image, a position and a coarse attitude."""
    found = ellipsoid_start(observation, "limb-ellipsoid")
    if isinstance(found, Refusal):
        return found
    return claim(found.picture, observation, found.pose, found.knowledge)


ESTIMATOR = Estimator(
    name="limb-ellipsoid",
    title="Limb of the Earth's ellipsoid, maximum likelihood of the pixels, position known",
    run=with_lens_error(run),
    estimates="geocentric",
    claim="likelihood",
)
