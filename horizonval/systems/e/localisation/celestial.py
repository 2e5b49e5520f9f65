"""Right ascension, declination and distance from the Earth's centre, and errors in them.

Axes: celestial (``gcrs``). ``tan a = y / x``, ``sin d = z / |r|``. The error of the right ascension is the angle
about the axis, not multiplied by the cosine of the declination: an arc on the sky is smaller.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

ARCSEC = np.pi / 648000.0


def celestial(r_gcrs: ArrayLike) -> FloatArray:
    """Return right ascension and declination [rad] and distance [m], shape (..., 3), of positions (..., 3) [m]."""
    r = np.asarray(r_gcrs, float)
    x, y, z = np.moveaxis(r, -1, 0)
    return np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(r, axis=-1)], axis=-1)


def celestial_errors(r_gcrs: ArrayLike, truth_gcrs: ArrayLike) -> FloatArray:
    """Return errors of right ascension and declination [arcsec] and distance [km], shape (..., 3)."""
    e = celestial(r_gcrs) - celestial(truth_gcrs)
    e[..., 0] = np.remainder(e[..., 0] + np.pi, 2.0 * np.pi) - np.pi
    return e / np.array([ARCSEC, ARCSEC, 1e3])


def rms(errors: ArrayLike) -> FloatArray:
    """Return the root mean square over the instants (last axis but one), shape (..., 3)."""
    return np.sqrt(np.mean(np.asarray(errors, float) ** 2, axis=-2))


def normalised_squares(r_gcrs: ArrayLike, covariances: ArrayLike, truth_gcrs: ArrayLike) -> FloatArray:
    """Return ``e^T P^-1 e``, shape (...), of positions (..., 3): 3 on average where the covariance is honest."""
    e = np.asarray(r_gcrs, float) - np.asarray(truth_gcrs, float)
    return np.einsum("...i,...i->...", e, np.linalg.solve(np.asarray(covariances, float), e[..., None])[..., 0])
