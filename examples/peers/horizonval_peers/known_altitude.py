"""The same pixels with the altitude known: two tilts of a cone of a given angle, by Gauss and Newton.

``u . n = cos rho`` with ``sin rho = R / (R + h)`` of a sphere; the start is the mean of the lines of sight, turned to
where the Earth is by Christian and Robinson's linear problem.
"""

from __future__ import annotations

import numpy as np

import horizonval as hv
from horizonval_peers.canny import edges, lines_of_sight, no_edges
from horizonval_peers.picture import fit_of

STEPS = 20
CONVERGED_RAD = 1e-10


def run(observation: hv.Observation) -> hv.Fit | hv.Refusal:
    """Return the nadir from every edge pixel and the altitude that the prior states."""
    altitude_m = observation.prior.altitude_m
    if altitude_m is None:
        return hv.Refusal(hv.Outcome.NOT_CONVERGED, "the altitude is not known")
    points = edges(observation)
    if len(points) == 0:
        return no_edges()
    rays = lines_of_sight(observation, points)
    radius_m = observation.prior.sphere_radius_m
    rho = float(np.arcsin(radius_m / (radius_m + altitude_m)))
    nadir = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
    nadir /= np.linalg.norm(nadir)
    for _ in range(STEPS):
        basis = np.linalg.svd(nadir[None, :])[2][1:].T
        jacobian, residuals = rays @ basis, np.cos(rho) - rays @ nadir
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        nadir = nadir + basis @ step
        nadir /= np.linalg.norm(nadir)
        if np.abs(step).max() < CONVERGED_RAD:
            break
    else:
        return hv.Refusal(hv.Outcome.NOT_CONVERGED, f"no convergence in {STEPS} steps", points)
    variance = residuals @ residuals / (len(rays) - 2)
    covariance = basis @ (variance * np.linalg.inv(jacobian.T @ jacobian)) @ basis.T
    return fit_of(observation, nadir, points, covariance, rho)


ESTIMATOR = hv.Estimator("canny-known-altitude", "A cone of known angle on Canny's pixels", run)
