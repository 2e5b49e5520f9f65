"""The horizon of a sphere is a cone of sight lines, and a cone is a plane through unit vectors.

Every line of sight ``u`` to the limb makes the angle rho with the nadir ``n``::

    u . n = cos rho

so the tips of the sight lines lie in a plane with normal ``n`` at distance ``cos rho`` from the eye. The unknowns
``n / cos rho`` enter linearly (``u . m = 1``); the plane is fitted here by orthogonal regression, which is the same
problem with ``|n| = 1`` kept: it stays finite at rho = 90 deg, where ``m`` does not, and it shrinks the radius of a
short noisy arc ``cos^2 rho`` times less than ordinary least squares does (Deng et al., Aerospace 10, 371, 2023).

No starting value, no image-plane ellipse or hyperbola, no special case for wide fields. Nothing here knows an image or
a sensor: estimators fit what they find, and scoring asks with it what the exact horizon in view determines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.directions import cross


@dataclass(frozen=True)
class Cone:
    """A circular cone of sight lines.

    Attributes
    ----------
    axis_cam : ndarray, shape (3,)
        Unit vector, inside the cone (``cos_rho >= 0``).
    cos_rho : float
        Cosine of the half-angle.
    """

    axis_cam: FloatArray
    cos_rho: float

    @property
    def rho_rad(self) -> float:
        """Half-angle [rad]. The arc cosine loses digits below a degree; see :func:`fit_cone` for small cones."""
        return float(np.arccos(np.clip(self.cos_rho, -1.0, 1.0)))


def fit_cone(los_cam: FloatArray) -> Cone:
    """Fit the cone through lines of sight by orthogonal regression.

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
        Unit vectors, n >= 3.

    Returns
    -------
    Cone
        Its axis is the side towards which the arc bends, ``cos_rho >= 0``.

    Raises
    ------
    ValueError
        With fewer than three points.
    """
    if len(los_cam) < 3:
        raise ValueError(f"a cone needs three lines of sight, not {len(los_cam)}")
    middle = los_cam.mean(axis=0)
    # Singular vectors of the differences, not of a covariance: a cone of 0.25 deg would lose half of the digits.
    _, _, rows = np.linalg.svd(los_cam - middle, full_matrices=False)
    axis = rows[-1]
    cos_rho = float(axis @ middle)
    if cos_rho < 0:
        axis, cos_rho = -axis, -cos_rho
    return Cone(axis_cam=axis, cos_rho=cos_rho)


def cones_through(first: FloatArray, second: FloatArray, third: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return axes (n, 3) and cosines (n,) of the cones through n triples of unit vectors, each of shape (n, 3).

    Degenerate triples (two equal vectors) give an axis of zeros.
    """
    normal = np.stack(cross((second - first).T, (third - first).T), axis=-1)
    length = np.linalg.norm(normal, axis=1)
    axis = normal / np.where(length > 0, length, 1.0)[:, None]
    cosine = np.einsum("ij,ij->i", axis, first)
    sign = np.where(cosine < 0, -1.0, 1.0)
    return axis * sign[:, None], cosine * sign
