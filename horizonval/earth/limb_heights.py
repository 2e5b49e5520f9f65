r"""What a circular cone cannot say of the Earth: how far a limb that is no circle pulls the nadir of a fitted cone.

A limb that stands ``h`` above the sphere at azimuth phi is seen ``delta = h tan(rho) / R`` outside of it. To first
order the fitted axis ``n`` and half-angle ``rho`` then move by the least-squares answer to

    t(phi) . dn + drho = delta(phi),        (dn, drho) = G delta,      G = (J^T J)^-1 J^T,  J = [t, 1]

with ``t`` the unit direction from the axis towards the point. A constant height moves ``rho`` alone; a bow of one
kilometre over a 50 deg piece of limb, seen from 500 km, moves the nadir by 0.3 deg. The covariance of the heights
along the limb is hence carried to the nadir as ``G K G^T``. It does not shrink with the number of points, and it is
kept apart from the noise.

**Oblateness.** The radius of the ellipsoid in the direction ``u`` from its centre is ``a (1 - f (u . z)^2)`` to first
order in the flattening, ``z`` the pole. A method that knows neither place nor heading must take every direction of
the pole as equally likely; the covariance is the mean over poles spread evenly over the sphere. Up to 0.17 deg rms,
most of it the angle between geocentric and geodetic vertical.

**Relief.** Height of the visible limb over the ground varies with the Sun's angle along the limb, with clouds and with
the temperature of the air. It is taken as a random function of azimuth with a standard deviation and a correlation
length, ``K(phi) = s^2 exp(-phi^2 / (2 l^2))``.

Second orders are neglected: (delta / rho)^2 is 1e-5.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_relief import Relief
from horizonval.geometry.directions import fibonacci_sphere, tangent_basis

MOST_POINTS = 240
"""Points that stand for all of them: the heights are smooth, and the matrix of their covariance is not made large."""
POLES = 400


def systematic_covariance(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    *,
    flattening: float,
    reliefs: tuple[Relief, ...],
    earth_radius_m: float,
    estimates: Literal["geocentric", "geodetic"] = "geocentric",
    gain: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance [rad^2] of (axis along basis 1, along basis 2, half-angle), shape (3, 3).

    The basis is :func:`horizonval.geometry.directions.tangent_basis` of the axis.

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight to the limb points used, n >= 3.
    axis_cam : ndarray, shape (3,)
    rho_rad : float
    flattening : float
        Of the planet; 0 for a sphere.
    reliefs : tuple of Relief
        Independent contributions.
    earth_radius_m : float
    estimates : {"geocentric", "geodetic"}
        Which vertical the axis is compared with: what is left of oblateness depends on it.
    gain : ndarray, shape (3, n), optional
        How far a limb that is seen one radian further out at each of the points moves (axis 1, axis 2, half-angle) of a
        method that is no fit of a cone; all points are then used.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not determine a cone.
    """
    thin = gain is None and len(los_cam) > 3
    some = los_cam[:: max(1, -(-len(los_cam) // MOST_POINTS))] if thin else los_cam
    basis = tangent_basis(axis_cam)
    across = some @ basis
    across = across / np.linalg.norm(across, axis=1)[:, None]
    if gain is None:
        jacobian = np.column_stack([across, np.ones(len(some))])
        gain = np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T
    covariance = gain @ relief_covariance(across, rho_rad, reliefs, earth_radius_m) @ gain.T
    if flattening != 0.0:
        moved = _oblate_moves(across, gain, rho_rad, flattening, estimates)
        covariance = covariance + moved @ moved.T / moved.shape[1]
    return np.asarray(0.5 * (covariance + covariance.T))


def relief_covariance(
    across: FloatArray, rho_rad: float, reliefs: tuple[Relief, ...], earth_radius_m: float
) -> FloatArray:
    """Return the covariance [rad^2], shape (n, n), of how far outside of the cone the relief lets a limb be seen.

    Parameters
    ----------
    across : ndarray, shape (n, 2)
        Unit directions from the axis towards the points, in its tangent basis.
    rho_rad : float
    reliefs : tuple of Relief
    earth_radius_m : float
    """
    azimuth = np.arctan2(across[:, 1], across[:, 0])
    apart = np.abs(azimuth[:, None] - azimuth[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    heights = np.zeros((len(across), len(across)))
    for relief in reliefs:
        heights += relief.sigma_m**2 * np.exp(-0.5 * (apart / relief.correlation_rad) ** 2)
    return np.asarray((np.tan(rho_rad) / earth_radius_m) ** 2 * heights)


def oblate_limbs(across: FloatArray, rho_rad: float, flattening: float) -> FloatArray:
    """Return how far outside of a cone [rad] an ellipsoid's limb is seen, shape (n, poles), for poles spread evenly.

    Parameters
    ----------
    across : ndarray, shape (n, 2)
        As for :func:`relief_covariance`.
    rho_rad, flattening : float
    """
    # From the Earth's centre a tangent point lies 90 deg - rho from the sub-satellite point, which is opposite to the
    # nadir.
    points = np.column_stack([np.cos(rho_rad) * across, np.full(len(across), -np.sin(rho_rad))])
    return np.asarray(-flattening * np.tan(rho_rad) * (points @ _poles().T) ** 2)


def _oblate_moves(
    across: FloatArray, gain: FloatArray, rho_rad: float, flattening: float, estimates: str
) -> FloatArray:
    """Return the errors (3, poles) of (axis 1, axis 2, half-angle), in axes (basis 1, basis 2, nadir)."""
    pole = _poles()
    moved = gain @ oblate_limbs(across, rho_rad, flattening)
    if estimates == "geodetic":
        # The normal at the foot leans from the radius towards the pole by f sin(2 lat) R / (R + H): down leans away.
        moved[:2] -= 2.0 * flattening * np.sin(rho_rad) * pole[:, 2] * pole[:, :2].T
    moved[2] -= moved[2].mean()
    return moved


@cache
def _poles() -> FloatArray:
    """Return unit vectors spread evenly over the sphere (Fibonacci's spiral), shape (POLES, 3)."""
    return fibonacci_sphere(POLES)
