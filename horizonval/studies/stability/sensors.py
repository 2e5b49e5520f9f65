"""What four horizon heads make of their profiles: located edges or mean radiances, and from those pitch and roll.

A head at azimuth alpha (from forward to the right) that sees the horizon too high by a small angle e is in error as if
the body were turned by pitch theta and roll phi::

    e = -theta cos alpha + phi sin alpha + c

c, common to all heads, is what a wrong altitude does. Least squares over four heads a quarter turn apart::

    theta = -(sum of e cos alpha) / 2,    phi = (sum of e sin alpha) / 2

so that an error of one head alone enters pitch or roll by half. Positive pitch lifts the nose, positive roll lowers the
right side, as in :mod:`horizonval.geometry.frames`.

*Edge sensor.* e is the located angle less the angle at which the ellipsoid, raised by one constant height, would stand:
oblateness is known and corrected for, and so is the horizon's mean height over the year.

*Field sensor.* A square field of width w stands with its centre on that same nominal horizon at x; its output is the
mean radiance ``V(x) = 1/w * integral of L over (x - w/2, x + w/2)``. Lifted by e, the horizon shows it more Earth:
``dV = e (L(x - w/2) - L(x + w/2)) / w``. The sensor divides the change of V by the mean slope of the year, so that
brighter air passes for a higher horizon. For a step of height L at x, brighter by a fraction f in one head:
e = f w / 2, the half of it in pitch. Left out: that the horizon is curved across the field (0.005 deg for 2 deg at
900 km, alike in all heads).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray


def attitude_error(excess_rad: ArrayLike, azimuth_rad: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return pitch and roll errors [rad], shape (...), of heads that see the horizon too high.

    Parameters
    ----------
    excess_rad : array_like, shape (..., h)
        By how much the horizon stands too high in each head.
    azimuth_rad : array_like, shape (h,)
        Of the heads, from forward to the right; three or more that are not all alike.
    """
    alpha = np.asarray(azimuth_rad, dtype=np.float64)
    design = np.stack([-np.cos(alpha), np.sin(alpha), np.ones_like(alpha)], axis=-1)
    solution = np.asarray(excess_rad, dtype=np.float64) @ np.linalg.pinv(design).T
    return solution[..., 0], solution[..., 1]


def interpolate(x: ArrayLike, at: ArrayLike, values: ArrayLike) -> FloatArray:
    """Return values (..., n), given at places (..., n) or (n,) that rise, linearly at places x (...)."""
    values = np.asarray(values, dtype=np.float64)
    shape, n = values.shape[:-1], values.shape[-1]
    places = np.broadcast_to(np.asarray(at, dtype=np.float64), values.shape).reshape(-1, n)
    wanted = np.broadcast_to(np.asarray(x, dtype=np.float64), shape).reshape(-1)
    rows = zip(wanted, places, values.reshape(-1, n), strict=True)
    return np.array([np.interp(*row) for row in rows]).reshape(shape)


def edge_excess(edge_height: ArrayLike, nominal_height: float, height: ArrayLike, offset_rad: ArrayLike) -> FloatArray:
    """Return by how much edges stand above the nominal horizon [rad].

    Parameters
    ----------
    edge_height : array_like, shape (...)
        Height at which each head locates the horizon.
    nominal_height : float
        The constant height the sensor is calibrated to, same unit.
    height : array_like, shape (n,)
        Lowest heights of a head's rays, rising.
    offset_rad : array_like, shape (..., n)
        Angles of those rays above the ellipsoid's horizon.
    """
    return interpolate(edge_height, height, offset_rad) - interpolate(nominal_height, height, offset_rad)


def field_output(
    centre_rad: ArrayLike, width_rad: float, offset_rad: ArrayLike, radiance: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the mean radiance in square fields and its slope against the field's centre, shapes (...).

    Parameters
    ----------
    centre_rad : array_like, shape (...)
        Angle of the field's centre above the ellipsoid's horizon.
    width_rad : float
    offset_rad, radiance : array_like, shape (..., n)
        A head's profile, angles rising; no radiance above the last of them.

    Raises
    ------
    ValueError
        The field reaches below the profile: a defect of the caller.

    Notes
    -----
    The profile is taken as a monotone cubic between its rays and integrated exactly.
    """
    offset, radiance = np.broadcast_arrays(np.asarray(offset_rad, float), np.asarray(radiance, float))
    shape, n = radiance.shape[:-1], radiance.shape[-1]
    centre = np.broadcast_to(np.asarray(centre_rad, float), shape).reshape(-1)
    mean, slope = np.empty(centre.size), np.empty(centre.size)
    for i, (x, angle, value) in enumerate(zip(centre, offset.reshape(-1, n), radiance.reshape(-1, n), strict=True)):
        low, high = x - width_rad / 2, x + width_rad / 2
        if low < angle[0]:
            raise ValueError(f"the field reaches {angle[0] - low:g} rad below the profile")
        curve = PchipInterpolator(angle, value)
        mean[i] = float(curve.integrate(low, min(high, angle[-1]))) / width_rad if low < angle[-1] else 0.0
        ends = [float(curve(end)) if end <= angle[-1] else 0.0 for end in (low, high)]
        slope[i] = (ends[1] - ends[0]) / width_rad
    return mean.reshape(shape), slope.reshape(shape)


def field_excess(output: ArrayLike, nominal_output: float, nominal_slope: float) -> FloatArray:
    """Return by how much the horizon seems to stand too high [rad], shape (...), to heads of nominal gain.

    ``nominal_slope`` is that of :func:`field_output`, negative: a field that is lifted sees less Earth.
    """
    return (np.asarray(output, dtype=np.float64) - nominal_output) / -nominal_slope
