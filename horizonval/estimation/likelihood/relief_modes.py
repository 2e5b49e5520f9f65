r"""The uneven height of the limb as modes, unknowns of a fit whose prior is one row each.

Along the limb the height departs from its mean by a random function of azimuth with the covariance ``K(phi) = s^2
exp(-phi^2 / (2 l^2))`` (:mod:`horizonval.earth.limb_heights`). On ``m`` nodes ``K = V diag(w) V^T``, and ::

    height(phi_j) = sum over modes of  z_i sqrt(w_i) V_ji,      z_i ~ N(0, 1)

says the same with unit normal unknowns (Karhunen and Loeve). The fit then knows which changes along the arc it may not
take for a tilt, and its covariance holds what they leave: nothing is added afterwards.

A sphere fitted to the oblate Earth has one relief more. Of every direction of the pole alike, the limb of a planet of
flattening ``f`` departs from a sphere's by ``-f R (u . pole)^2``, with ``u`` from the centre to the point of the limb;
the covariance of that, over the poles of :mod:`horizonval.earth.limb_heights`, is added to ``K``.

Modes that together hold less than :data:`LEFT_OUT` of the variance are left out; between nodes the modes are linear.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, oblate_limbs

LEFT_OUT = 1e-3
"""Of the variance of the heights: 3 % of their standard deviation, spread over waves too short to act as a tilt."""
NODES_PER_LENGTH = 2.0
"""Per correlation length: a Gaussian covariance sampled at half of its length loses 2e-4 of its variance between."""
MOST_NODES = 96
"""A full circle of 6.3 rad at correlation lengths of 0.13 rad; shorter reliefs are then resolved by their mean over a
node, which is what a tilt feels of them."""


OBLATE_LENGTH_RAD = 0.5
"""Of the limb of an ellipsoid, two waves round a circle: nodes as for a relief of this length."""


def relief_nodes(span_rad: float, shortest_rad: float) -> FloatArray:
    """Return azimuths [rad], shape (m,), from 0 to the span, close enough for a relief of that correlation length."""
    count = int(np.clip(np.ceil(NODES_PER_LENGTH * span_rad / shortest_rad) + 1, 3, MOST_NODES))
    return np.linspace(0.0, span_rad, count)


def relief_modes(
    span_rad: float, reliefs: tuple[Relief, ...], flattened_m: float = 0.0, rho_rad: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return nodes of azimuth [rad], shape (m,), and the modes there [m], shape (k, m).

    Parameters
    ----------
    span_rad : float
        Azimuth from the first to the last pixel of the limb in view.
    reliefs : tuple of Relief
        Independent contributions; without any there are no modes.
    flattened_m : float
        Flattening times radius of a planet that is fitted as a sphere; 0 where its shape is known.
    rho_rad : float
        Angular radius of the planet, for its flattening.
    """
    if not reliefs and flattened_m == 0.0:
        return np.array([0.0, span_rad]), np.zeros((0, 2))
    shortest = min([relief.correlation_rad for relief in reliefs] or [OBLATE_LENGTH_RAD])
    nodes = relief_nodes(span_rad, shortest)
    width = nodes[1] - nodes[0]
    apart = np.abs(nodes[:, None] - nodes[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    heights = np.zeros_like(apart)
    for relief in reliefs:
        # The mean over the width of a node, a box of variance width^2 / 12 at both ends, in place of single points.
        square = relief.correlation_rad**2
        wide = square + width**2 / 6.0
        heights += relief.sigma_m**2 * np.sqrt(square / wide) * np.exp(-0.5 * apart**2 / wide)
    return nodes, modes_of(heights + oblate_covariance(nodes, flattened_m, rho_rad))


def oblate_covariance(nodes: FloatArray, flattened_m: float, rho_rad: float) -> FloatArray:
    """Return what the flattening makes of a sphere's limb at azimuths (m,), all poles alike [m^2], shape (m, m)."""
    if flattened_m == 0.0:
        return np.zeros((len(nodes), len(nodes)))
    limbs = oblate_limbs(np.column_stack([np.cos(nodes), np.sin(nodes)]), rho_rad, flattened_m) / np.tan(rho_rad)
    limbs -= limbs.mean()
    return np.asarray(limbs @ limbs.T / limbs.shape[1])


def modes_of(covariance: FloatArray) -> FloatArray:
    """Return the modes, shape (k, m), of a covariance of heights (m, m)."""
    variance, vectors = np.linalg.eigh(covariance)
    variance, vectors = np.maximum(variance[::-1], 0.0), vectors[:, ::-1]
    kept = int(np.searchsorted(np.cumsum(variance), (1.0 - LEFT_OUT) * variance.sum())) + 1
    return np.asarray(np.sqrt(variance[:kept])[:, None] * vectors.T[:kept])
