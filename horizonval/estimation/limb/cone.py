"""How well points of a limb determine the cone fitted to them.

The fit itself is :func:`horizonval.geometry.horizon.fit_cone`. Its residual ``u . n - cos rho`` is ``sin rho`` times
the angle between the point and the fitted limb, for every point. With ``t`` the unit direction from the axis
towards a point, an angle ``e`` of the point outwards moves axis and half-angle by the least-squares solution of
``t . dn + drho = e``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, TRIM_SIGMAS, median
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

SMALLEST_TRIM_PX = 0.3
"""Points nearer than this to the cone are kept whatever the spread: the scatter of single points at full contrast."""
SLOW_PX = 0.01
"""Rms error of sub-pixel points of a sharp limb without noise: mostly the lens's blur of shaded ground."""
SOFT_SLOW_PX = 0.07
"""The same on limbs with air, over frames from 300 to 36 000 km."""
SLOW_PATTERNS = 4.0
"""Number of independent values of it along an arc: it varies as slowly as the limb's direction against the pixels."""


def arc_order(los_cam: FloatArray, axis: FloatArray) -> NDArray[np.int64]:
    """Return the order of lines of sight along the limb (by azimuth about the axis)."""
    across = los_cam @ tangent_basis(axis)
    return np.argsort(np.arctan2(across[:, 1], across[:, 0]), kind="stable").astype(np.int64)


def inwards_of(los: FloatArray, axis: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) across lines of sight (n, 3) towards an axis."""
    inwards = axis - los * (los @ axis)[:, None]
    return np.asarray(inwards / np.linalg.norm(inwards, axis=1)[:, None])


def near_cone(los_cam: FloatArray, px_rad: float, fewest: int = 8) -> NDArray[np.intp]:
    """Return the rows of lines of sight (n, 3) without those far from the cone through the rest."""
    rows = np.arange(len(los_cam))
    while len(rows) >= fewest:
        off = off_axis_angle(los_cam[rows], fit_cone(los_cam[rows]).axis_cam)
        off = np.abs(off - median(off))
        good = off <= max(TRIM_SIGMAS * MEDIAN_TO_SIGMA * median(off), SMALLEST_TRIM_PX * px_rad)
        if good.all():
            break
        rows = rows[good]
    return rows


def cone_gain(los_cam: FloatArray, axis: FloatArray) -> FloatArray:
    """Return how (axis along basis 1, basis 2, half-angle) move with angles of points outwards, shape (3, n).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. Raises ``LinAlgError`` if the points
    (n, 3) do not determine a cone.
    """
    across = los_cam @ tangent_basis(axis)
    across /= np.linalg.norm(across, axis=1)[:, None]
    jacobian = np.column_stack([across, np.ones(len(across))])
    return np.asarray(np.linalg.solve(jacobian.T @ jacobian, jacobian.T))


@dataclass(frozen=True)
class ConeUncertainty:
    """How well points determine a cone.

    ``basis``: shape (3, 2), tangent directions at the axis; ``covariance``: shape (3, 3), [rad^2] of (axis along basis
    1, axis along basis 2, half-angle); ``correlation_length``: number of neighbouring points that carry the information
    of one (1: independent noise).
    """

    basis: FloatArray
    covariance: FloatArray
    correlation_length: float

    @property
    def covariance_axis(self) -> FloatArray:
        """Covariance of the axis vector, shape (3, 3), singular along the axis."""
        return np.asarray(self.basis @ self.covariance[:2, :2] @ self.basis.T)

    @property
    def sigma_axis_rad(self) -> float:
        """Standard deviation of the axis in its worst direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))

    @property
    def sigma_rho_rad(self) -> float:
        """Standard deviation of the half-angle."""
        return float(np.sqrt(self.covariance[2, 2]))


def noise_bias(los_cam: FloatArray, axis: FloatArray, rho_rad: float, sigma_rad: float) -> FloatArray:
    """Return how far noise across the limb pulls the fit by :func:`fit_cone`, in mean: (basis 1, basis 2, half-angle).

    A point off by the angle ``e`` has ``u = u0 + e w - e^2/2 u0``, ``w = cos rho t - sin rho n``. With ``s^2`` the mean
    of ``e^2``, the normal equations of ``u . n - cos rho`` keep in mean the right-hand side ``s^2 cos rho sin rho (3/2
    sum t, 1/2 n)``, which turns the axis towards a short arc and narrows the cone. Raises ``LinAlgError`` if the points
    do not determine a cone.

    ``los_cam``: shape (n, 3); ``axis``: shape (3,); ``sigma_rad``: standard deviation of a point across the limb [rad].
    """
    gain = cone_gain(los_cam, axis)
    across = los_cam @ tangent_basis(axis)
    across /= np.linalg.norm(across, axis=1)[:, None]
    left = np.append(1.5 * across.sum(axis=0), 0.5 * len(across))
    return np.asarray(sigma_rad**2 / np.tan(rho_rad) * (gain @ gain.T @ left))


def cone_uncertainty(los_cam: FloatArray, axis: FloatArray, rho_rad: float) -> ConeUncertainty:
    """Return :func:`cone_scatter` widened by the outer product of :func:`noise_bias`, which the fit still contains."""
    scatter = cone_scatter(los_cam, axis, rho_rad)
    sigma = float(np.std(off_axis_angle(los_cam, axis) - rho_rad))
    bias = noise_bias(los_cam, axis, rho_rad, sigma)
    return replace(scatter, covariance=scatter.covariance + np.outer(bias, bias))


def cone_scatter(los_cam: FloatArray, axis: FloatArray, rho_rad: float) -> ConeUncertainty:
    """Return the covariance of a cone fitted by angles, without any bias.

    It is ``s^2 G G^T`` with the gain ``G`` and the residual variance ``s^2`` for ``n - 3`` degrees of freedom. Real
    limb residuals are correlated along the arc (clouds, oblateness): ``s^2`` is multiplied by the sum of the measured
    autocorrelation up to the first lag at which it is no longer significant. Raises ``LinAlgError`` if the points do
    not determine a cone.

    ``los_cam``: shape (n, 3), n >= 4 points, in any order; ``axis``: shape (3,).
    """
    gain = cone_gain(los_cam, axis)
    residual = off_axis_angle(los_cam, axis) - rho_rad
    length = _correlation_length(residual[arc_order(los_cam, axis)])
    # Information of n / length points decides both the variance's degrees of freedom and its size.
    variance = float(residual @ residual) / max(len(residual) - 3.0 * length, 1.0)
    return ConeUncertainty(tangent_basis(axis), variance * length * gain @ gain.T, length)


def slow_error(los_cam: FloatArray, axis: FloatArray, px_rad: float, slow_px: float = SLOW_PX) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of a fitted cone from slow errors of sub-pixel points.

    They are systematic: more points do not reduce them, and residuals hardly show them. ``los_cam``: shape (n, 3);
    ``px_rad``: angle of a pixel; ``slow_px``: rms error of a point. Raises ``LinAlgError``: the points do not determine
    a cone.
    """
    gain = cone_gain(los_cam, axis)
    return np.asarray((slow_px * px_rad) ** 2 * len(los_cam) / SLOW_PATTERNS * (gain @ gain.T))


def _correlation_length(residual: FloatArray) -> float:
    """Return 1 + 2 sum of the autocorrelation up to its first insignificant lag, at most a quarter of the points."""
    n = len(residual)
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if power == 0.0 or n < 8:
        return 1.0
    spectrum = np.fft.rfft(centred, 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n] / power
    last = n // 4
    small = np.flatnonzero(correlation[1:last] < 2.0 / np.sqrt(n))
    stop = int(small[0]) + 1 if small.size else last
    return float(np.clip(1.0 + 2.0 * correlation[1:stop].sum(), 1.0, n / 4.0))
