r"""Position from points of the limb without a start and without steps: Christian and Robinson's method.

Divided by the semi-axes of an ellipsoid, lines of sight to its limb become lines of sight ``e`` to the limb of a unit
sphere, which lie on a cone about the direction to its centre (J. A. Christian and S. B. Robinson, "Noniterative
horizon-based optical navigation by Cholesky factorization", J. Guidance, Control, and Dynamics 39, 2757, 2016, section
III; J. A. Christian, IEEE Access 9, 2021, section V)::

    e_i . m = 1,    |m| = 1 / cos rho',    sin rho' = 1 / |p|,    r = axes * p,    p = -|p| m / |m|

with ``p`` the scaled position. They solve for ``m`` by least squares; here the same cone is fitted by orthogonal
regression (:func:`horizonval.geometry.horizon.fit_cone`), which shrinks the radius of a short noisy arc less. A sphere
is the special case of equal axes, in which the camera's own axes do for the planet's.

It weighs the points as the scaling leaves them, to the flattening of 0.3 %: a start for a fit, not an answer.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import fit_cone


def position_from_limb(los_cam: FloatArray, cam_from_itrs: FloatArray, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the position [m] in Earth-fixed axes, shape (3,), from which points of the limb are seen.

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight, n >= 3.
    cam_from_itrs : ndarray, shape (3, 3)
        Rotation matrix. Of a sphere any will do, the identity say: the position is then in camera axes.
    ellipsoid : Ellipsoid
        Whose limb is seen: the Earth raised by the height of the limb.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points determine no cone narrower than a half space.
    """
    scaled = (los_cam @ cam_from_itrs) / ellipsoid.axes_m
    cone = fit_cone(scaled / np.linalg.norm(scaled, axis=1)[:, None])
    # Of the tips of unit vectors the plane may lie so that rounding takes it outside the unit sphere.
    sin_rho = float(np.sqrt(max((1.0 - cone.cos_rho) * (1.0 + cone.cos_rho), 0.0)))
    if not (sin_rho > 0.0 and cone.cos_rho > 0.0):
        raise np.linalg.LinAlgError("the points determine no cone of a planet's limb")
    return np.asarray(-ellipsoid.axes_m * cone.axis_cam / sin_rho)
