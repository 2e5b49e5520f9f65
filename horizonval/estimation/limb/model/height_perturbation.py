r"""What a limb of uneven height does to a fitted cone: the move of the nadir for known heights, covariance for unknown.

As in :mod:`horizonval.earth.limb_heights`: a limb that stands ``h`` above the sphere is seen ``delta = h
tan(rho) / R`` outside of it, and the fitted cone moves by the least-squares answer to ``t(phi) . dn + drho =
delta(phi)``.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.height.uneven_limb import SUNS
from horizonval.estimation.limb.model.sunlit import height_under
from horizonval.geometry.rotation import fibonacci_sphere, tangent_basis

MOST_POINTS = 60
"""Points that stand for all of them: heights are smooth along the limb."""


def cone_perturbation(
    los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, heights_m: FloatArray, earth_radius_m: float
) -> FloatArray:
    """Return how far heights move the fitted cone: (axis along basis 1, basis 2, half-angle) [rad], shape (k, 3).

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
    axis_cam : ndarray, shape (3,)
    rho_rad : float
    heights_m : ndarray, shape (k, n)
    earth_radius_m : float

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not determine a cone.
    """
    across = los_cam @ tangent_basis(axis_cam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    jacobian = np.column_stack([across, np.ones(len(across))])
    gain = np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T
    return np.asarray(heights_m @ gain.T * (math.tan(rho_rad) / earth_radius_m))


def unknown_sun_covariance(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    blur_rad: FloatArray,
    earth_radius_m: float,
    band_um: tuple[float, float] | None = None,
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of a cone through a sunlit limb for a method that knows no Sun.

    Every Sun that lights the whole arc is taken to be equally likely. Parameters as above; ``blur_rad`` and ``band_um``
    as for :func:`horizonval.estimation.limb.model.sunlit.sunlit_limb`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not determine a cone.
    """
    stride = max(1, len(los_cam) // MOST_POINTS)
    los_cam, blur_rad = los_cam[::stride], blur_rad[::stride]
    height, zenith = height_under(los_cam, axis_cam, rho_rad, fibonacci_sphere(SUNS), blur_rad, band_um)
    lit = (zenith.max(axis=1) <= 0.5 * np.pi) & np.isfinite(height).all(axis=1)
    if not lit.any():
        return np.zeros((3, 3))
    moved = cone_perturbation(los_cam, axis_cam, rho_rad, height[lit], earth_radius_m)
    moved[:, 2] -= moved[:, 2].mean()
    return np.asarray(moved.T @ moved / len(moved))
