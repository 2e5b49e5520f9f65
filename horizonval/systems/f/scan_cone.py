r"""Where the beam of a conical scanner meets the horizon: closed forms, without any renderer.

The beam turns about the axis s at the half-angle g. With unit vectors e, f across s and the phase p (0 nearest to the
body's z axis, growing as s turns f behind e)::

    d(p) = s cos g + (e cos p + f sin p) sin g

*Sphere.* The horizon lies at the angle rho from the nadir n, ``d . n = cos rho``. With ``e . n = A cos q`` and
``f . n = A sin q``::

    cos(p - q) = (cos rho - cos g (s . n)) / (A sin g)

The Earth is entered at ``q - dp`` and left at ``q + dp``: q is the middle of the chord, 2 dp its length.

*Ellipsoid.* The horizon is ``d^T Q d = 0`` (:func:`horizonval.geometry.horizon.tangent_cone`). With ``t = tan(p / 2)``
the vector ``(1 + t^2) d`` is a polynomial of second degree in t, and the condition one of fourth degree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import limb_side, tangent_cone

ON_HORIZON = 1e-6
"""Of the limb function, which is 1e-16 on roots that lie ahead, and of the size of 1 on those behind the observer."""


@dataclass(frozen=True)
class ScanCone:
    """A beam that turns about an axis.

    Attributes
    ----------
    half_angle_rad : float
        Between beam and axis.
    axis, start, quarter : ndarray, shape (3,)
        Orthonormal, in body axes: the spin axis, the direction across it at phase 0, and at a quarter turn.
    """

    half_angle_rad: float
    axis: FloatArray
    start: FloatArray
    quarter: FloatArray

    @classmethod
    def to_the_right(cls, half_angle_rad: float, tilt_rad: float = 0.0) -> ScanCone:
        """Return a scanner whose axis points along the body's y axis, lowered towards z by ``tilt_rad``."""
        c, s = math.cos(tilt_rad), math.sin(tilt_rad)
        axis, start = np.array([0.0, c, s]), np.array([0.0, -s, c])
        return cls(half_angle_rad, axis, start, np.cross(axis, start))

    def directions(self, phase_rad: ArrayLike, off_rad: float = 0.0) -> FloatArray:
        """Return the beam at phases (...), shape (..., 3), or a line beside it by ``off_rad`` of the half-angle."""
        phase = np.asarray(phase_rad, dtype=np.float64)[..., None]
        g = self.half_angle_rad + off_rad
        across = np.cos(phase) * self.start + np.sin(phase) * self.quarter
        return math.cos(g) * self.axis + math.sin(g) * across

    def slopes(self, phase_rad: ArrayLike) -> FloatArray:
        """Return the derivative of :meth:`directions` by the phase, shape (..., 3)."""
        phase = np.asarray(phase_rad, dtype=np.float64)[..., None]
        return math.sin(self.half_angle_rad) * (np.cos(phase) * self.quarter - np.sin(phase) * self.start)


def sphere_crossings(cone: ScanCone, nadir_body: ArrayLike, rho_rad: float) -> tuple[float, float] | None:
    """Return the phases at which the beam enters and leaves a sphere of angular radius rho, None where it does not."""
    nadir = np.asarray(nadir_body, dtype=np.float64)
    across = np.array([cone.start @ nadir, cone.quarter @ nadir])
    far = math.hypot(*across) * math.sin(cone.half_angle_rad)
    gap = math.cos(rho_rad) - math.cos(cone.half_angle_rad) * float(cone.axis @ nadir)
    if abs(gap) >= far:
        return None
    middle, half = math.atan2(across[1], across[0]), math.acos(gap / far)
    return middle - half, middle + half


def ellipsoid_crossings(
    cone: ScanCone, itrs_from_body: FloatArray, r_itrs: ArrayLike, ellipsoid: Ellipsoid
) -> tuple[float, float] | None:
    """Return the phases at which the beam enters and leaves an ellipsoid, None where it does not.

    Parameters
    ----------
    cone : ScanCone
    itrs_from_body : ndarray, shape (3, 3)
    r_itrs : array_like, shape (3,)
        Observer [m].
    ellipsoid : Ellipsoid
    """
    q = tangent_cone(r_itrs, ellipsoid)
    c, s = math.cos(cone.half_angle_rad), math.sin(cone.half_angle_rad)
    fixed, start, quarter = (itrs_from_body @ v for v in (c * cone.axis, s * cone.start, s * cone.quarter))
    zero, one, two = fixed + start, 2.0 * quarter, fixed - start
    quartic = [
        two @ q @ two,
        2 * two @ q @ one,
        2 * two @ q @ zero + one @ q @ one,
        2 * one @ q @ zero,
        zero @ q @ zero,
    ]
    roots = np.roots(quartic)
    phase = 2.0 * np.arctan(roots[np.abs(roots.imag) < 1e-9].real)
    direction = cone.directions(phase) @ itrs_from_body.T
    ahead = np.abs(limb_side(direction, r_itrs, ellipsoid)) < ON_HORIZON
    phase, direction = phase[ahead], direction[ahead]
    if len(phase) != 2:
        return None
    inwards = np.einsum("ij,jk,ik->i", direction, q, cone.slopes(phase) @ itrs_from_body.T) > 0.0
    entered, left = float(phase[inwards][0]), float(phase[~inwards][0])
    return entered, left if left > entered else left + math.tau
