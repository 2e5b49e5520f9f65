"""Christian and Robinson's horizon navigation on Canny's pixels: a linear problem, no start and no altitude.

Lines of sight ``u`` to the limb of a sphere obey ``u . m = 1`` with ``m = nadir / cos rho`` (J. A. Christian and S. B.
Robinson, J. Guidance, Control, and Dynamics 39, 2757, 2016). ``m`` is solved for by least squares. What is claimed is
the scatter of the equations through the normal matrix, as any least-squares fit claims it: pixels that are wrong
together, by an air that stands above the ground say, are not in it.
"""

from __future__ import annotations

import numpy as np

import horizonval as hv
from horizonval_peers.canny import edges, lines_of_sight, no_edges
from horizonval_peers.picture import fit_of


def run(observation: hv.Observation) -> hv.Fit | hv.Refusal:
    """Return the nadir from every edge pixel."""
    points = edges(observation)
    if len(points) == 0:
        return no_edges()
    rays = lines_of_sight(observation, points)
    m, _, rank, _ = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)
    length = float(np.linalg.norm(m))
    if rank < 3 or length <= 1.0:
        return hv.Refusal(hv.Outcome.NOT_CONVERGED, "the edges lie on no cone", points)
    nadir = m / length
    residuals = rays @ m - 1.0
    covariance_m = residuals @ residuals / (len(rays) - 3) * np.linalg.inv(rays.T @ rays)
    across = (np.eye(3) - np.outer(nadir, nadir)) / length
    return fit_of(observation, nadir, points, across @ covariance_m @ across.T, float(np.arccos(1.0 / length)))


ESTIMATOR = hv.Estimator("canny-christian-robinson", "Christian and Robinson on Canny's pixels", run)
