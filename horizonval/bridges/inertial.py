"""States among the stars as requests for images.

Simulators count position, velocity and attitude from the axes of the stars, with the attitude as modified Rodrigues
parameters ``sigma_BN = e tan(phi / 4)``, which turn the frame ``N`` about the axis ``e`` by ``phi`` into ``B``. The
matrix ``[BN]`` takes components in ``N`` to components in ``B``: it is our ``q_body_from_gcrs``, and the inverse of the
rotation of vectors that scipy makes of the same parameters.

``N`` is taken for ``gcrs``. A simulator's J2000 axes differ from it by 23 milliarcseconds.
"""

from __future__ import annotations

import math
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.geometry.tle import EARTH_RATE_RAD_S


def quaternion_of_mrp(sigma_bn: ArrayLike) -> FloatArray:
    """Return ``q_body_from_gcrs``, shape (4,), scalar last, of modified Rodrigues parameters, shape (3,)."""
    return Rotation.from_mrp(np.asarray(sigma_bn, float)).inv().as_quat(canonical=True)


def mrp_of_quaternion(q_body_from_gcrs: ArrayLike) -> FloatArray:
    """Return the modified Rodrigues parameters of the shorter turn, shape (3,), of a quaternion, shape (4,)."""
    return Rotation.from_quat(np.asarray(q_body_from_gcrs, float)).inv().as_mrp()


def request_of_state(
    epoch_utc: datetime,
    r_gcrs: ArrayLike,
    v_gcrs: ArrayLike,
    sigma_bn: ArrayLike,
    omega_bn_body: ArrayLike = (0.0, 0.0, 0.0),
) -> dict[str, Any]:
    """Return the keywords of :meth:`horizonval.Client.image` that say where a spacecraft is and how it is turned.

    Parameters
    ----------
    epoch_utc : datetime
    r_gcrs, v_gcrs : array_like, shape (3,)
        Position [m] from the Earth's centre and velocity [m/s].
    sigma_bn : array_like, shape (3,)
        Modified Rodrigues parameters.
    omega_bn_body : array_like, shape (3,)
        Angular velocity against the stars in body axes [rad/s]; it blurs the exposure.

    Raises
    ------
    UserError
        An epoch outside 1960 to 2099.
    """
    turn = itrs_from_gcrs(epoch_utc)
    r_itrs = turn @ np.asarray(r_gcrs, float)
    v_itrs = turn @ np.asarray(v_gcrs, float) - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r_itrs)
    body_from_gcrs = Rotation.from_quat(quaternion_of_mrp(sigma_bn))
    return {
        "epoch": epoch_utc,
        "position_itrs_km": [x / 1e3 for x in r_itrs.tolist()],
        "velocity_itrs_km_s": [x / 1e3 for x in v_itrs.tolist()],
        "q_body_from_itrs": (body_from_gcrs * Rotation.from_matrix(turn.T)).as_quat(canonical=True).tolist(),
        "rate_deg_s": [math.degrees(float(x)) for x in np.asarray(omega_bn_body, float)],
        "hold": "inertial",
    }
