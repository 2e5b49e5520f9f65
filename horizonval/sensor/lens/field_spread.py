"""A point spread that widens towards the corners.

The standard deviation of the Gaussian is given against the field angle, linear between entries, constant beyond them.
Light from a place between two entries is shared between their two Gaussians so that the mixture has the variance wanted
there::

    w = (sigma^2 - sigma_a^2) / (sigma_b^2 - sigma_a^2)

The shares of every pixel sum up to 1 and each Gaussian keeps its light, so that none is lost or made. The mixture's
shape is not Gaussian between the entries: closer entries, better shape. An even scene gets a dent or a bump of some
0.6 % where the widening sets in or ends at once (0.6 to 1.5 pixels over 30 deg of a 200-pixel image), as light that
spreads unevenly does.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray


def shares(angle_deg: FloatArray, table_deg: list[float], table_sigma: list[float]) -> list[tuple[float, FloatArray]]:
    """Return for each entry its sigma and the share of every pixel's light, shape of ``angle_deg``, that it spreads."""
    share_by_entry = [np.zeros_like(angle_deg) for _ in table_deg]
    angle = np.clip(angle_deg, table_deg[0], table_deg[-1])
    low = np.clip(np.searchsorted(table_deg, angle, side="right") - 1, 0, max(len(table_deg) - 2, 0))
    for i in range(len(table_deg) - 1):
        here = low == i
        along = (angle[here] - table_deg[i]) / (table_deg[i + 1] - table_deg[i])
        a, b = table_sigma[i], table_sigma[i + 1]
        sigma = a + (b - a) * along
        share = along if a == b else (sigma**2 - a**2) / (b**2 - a**2)
        share_by_entry[i][here] += 1 - share
        share_by_entry[i + 1][here] += share
    if len(table_deg) == 1:
        share_by_entry[0][:] = 1.0
    return list(zip(table_sigma, share_by_entry, strict=True))
