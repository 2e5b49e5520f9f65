"""Anisotropic reflection of the Sun's beam by snow, relative to a Lambert surface.

For weakly absorbing snow, with cosines mu_sun and mu_view to the vertical and the scattering angle theta in degrees,

    R_0 = (A + B (mu_sun + mu_view) + C mu_sun mu_view + p(theta)) / (4 (mu_sun + mu_view)),
    p = 11.1 exp(-0.087 theta) + 1.1 exp(-0.014 theta),    A = 1.247, B = 1.186, C = 5.157

(A. A. Kokhanovsky and E. P. Zege, Appl. Opt. 43, 1589 (2004); A. A. Kokhanovsky, J. Geophys. Res. 118, 9325 (2013)).
The factor is ``R_0 / N(mu_sun)`` with N the mean of R_0 over the upper hemisphere, weighted by mu_view, so that snow
reflects the share of the beam given by its albedo at any Sun. N is 0.99 to 1.02 for the Sun more than 9 deg high; the
factor violates reciprocity by as much.

Neglected: in the near infrared absorbing snow is more anisotropic than white snow and reflects more of a low Sun;
sastrugi reduce the forward peak under a low Sun (S. G. Warren, R. E. Brandt, P. O'Rawe Hinton, J. Geophys. Res. 103,
25789 (1998)). The form is valid to zenith angles of 75 deg or so; cosines are at least :data:`LEAST_COSINE`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

A, B, C = 1.247, 1.186, 5.157
LEAST_COSINE = 0.15
NODES = 65
"""Size of the table of N, even in the cosine of the Sun's zenith angle."""


def reflection_function(mu_sun: ArrayLike, mu_view: ArrayLike, cosine: ArrayLike) -> FloatArray:
    """Return R_0.

    ``mu_sun``, ``mu_view``: cosines of the angles between the vertical and Sun and observer. ``cosine``: that of the
    angle between the directions to Sun and observer.
    """
    sun, view = (np.maximum(np.asarray(mu, dtype=np.float64), LEAST_COSINE) for mu in (mu_sun, mu_view))
    theta = np.degrees(np.arccos(np.clip(-np.asarray(cosine, dtype=np.float64), -1.0, 1.0)))
    p = 11.1 * np.exp(-0.087 * theta) + 1.1 * np.exp(-0.014 * theta)
    return np.asarray((A + B * (sun + view) + C * sun * view + p) / (4.0 * (sun + view)))


@cache
def mean_reflection() -> FloatArray:
    """Return N at :data:`NODES` cosines of the Sun's zenith angle."""
    x, w = np.polynomial.legendre.leggauss(48)
    mu = 0.5 * (x + 1.0)
    azimuth = (np.arange(128) + 0.5) * np.pi / 128
    sun = np.linspace(0.0, 1.0, NODES)[:, None, None]
    view = mu[None, :, None]
    sines = np.sqrt((1.0 - sun**2) * (1.0 - view**2))
    found = reflection_function(sun, view, sun * view + sines * np.cos(azimuth))
    mean = np.asarray(np.sum(w * mu * found.mean(axis=-1), axis=-1))
    mean.setflags(write=False)
    return mean
