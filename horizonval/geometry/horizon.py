"""The exact horizon of an ellipsoid.

Scaled by the axes ``(a, a, b)`` the ellipsoid is the unit sphere and the observer stands at ``p``. The directions ``d``
(scaled: ``d'``) that touch it form a cone::

    (p . d')^2 = (|p|^2 - 1) |d'|^2    or    d^T Q d = 0,  Q = S (p p^T - (|p|^2 - 1) I) S,  S = diag(1/a, 1/a, 1/b)

with ``d^T Q d > 0`` for lines through the ellipsoid (J. A. Christian, "Horizon-based optical navigation", IEEE Access
9, 2021, equations 14 to 19). The points touched lie in the polar plane ``p . x' = 1``: on the unit sphere a circle
about ``p / |p|^2`` of radius ``sqrt(1 - 1/|p|^2)``, on the ellipsoid an ellipse. Directions to them are written as the
difference already cancelled, ``-k p + sqrt(k) (u cos t + w sin t)`` with ``k = 1 - 1/|p|^2``, so that every altitude
keeps full precision.

**Cones.** Every line of sight ``u`` to the limb of a sphere makes the angle rho with the nadir ``n``::

    u . n = cos rho

so the tips of the sight lines lie in a plane with normal ``n`` at distance ``cos rho``. The plane is fitted by
orthogonal regression with ``|n| = 1``: it stays finite at rho = 90 deg, and it shrinks the radius of a short noisy arc
``cos^2 rho`` times less than ordinary least squares for ``n / cos rho`` does (Deng et al., Aerospace 10, 371, 2023). It
needs no starting value and no special case for wide fields.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geocentric_nadir, itrs_from_geodetic
from horizonval.geometry.frames import north_east, rotate
from horizonval.geometry.rotation import cross


def _outside(r_itrs: ArrayLike, ellipsoid: Ellipsoid) -> tuple[FloatArray, float]:
    """Return the scaled observer ``p`` and ``|p|^2 - 1``; raises UserError on or below the surface."""
    p = np.asarray(r_itrs, float) / ellipsoid.axes_m
    k = float(p @ p) - 1.0
    if not (k > 0.0 and math.isfinite(k)):
        raise UserError("the observer is not above the surface", expected="an altitude above 0")
    return p, k


def tangent_cone(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the symmetric matrix ``Q``, shape (3, 3), of the tangent cone from one point.

    ``d^T Q d`` is positive for lines that pass through the ellipsoid, zero for tangents, negative for lines that miss.
    It does not tell ahead from behind; :func:`limb_side` does. Scaled with ``a`` so that Q is without unit.
    """
    p, k = _outside(r_itrs, ellipsoid)
    s = ellipsoid.a_m / ellipsoid.axes_m
    return s[:, None] * (np.outer(p, p) - k * np.eye(3)) * s[None, :]


def limb_side(d_itrs: ArrayLike, r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return ``(-p.d' - sqrt(|p|^2 - 1) |d'|) / |d|``, shape (...): positive towards the Earth, zero on the horizon.

    Smooth and single-valued over the whole sky: the function to find roots of.
    """
    p, k = _outside(r_itrs, ellipsoid)
    d = np.asarray(d_itrs, float)
    d1 = d * (ellipsoid.a_m / ellipsoid.axes_m)
    return (-(d1 @ p) - math.sqrt(k) * np.linalg.norm(d1, axis=-1)) / np.linalg.norm(d, axis=-1)


def _circle(r_itrs: ArrayLike, ellipsoid: Ellipsoid, t: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return scaled observer, tangency point minus observer (scaled), and its derivative by ``t``."""
    p, k = _outside(r_itrs, ellipsoid)
    along = p / np.linalg.norm(p)
    axis = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([-1.0, 0.0, 0.0])
    u = axis - (axis @ along) * along
    u /= np.linalg.norm(u)
    w = np.cross(u, along)
    k /= k + 1.0
    c, s = np.cos(np.asarray(t, float))[..., None], np.sin(np.asarray(t, float))[..., None]
    return p, -k * p + math.sqrt(k) * (c * u + s * w), math.sqrt(k) * (-s * u + c * w)


def tangency_points(r_itrs: ArrayLike, ellipsoid: Ellipsoid, t: ArrayLike) -> FloatArray:
    """Return the surface points [m], shape (..., 3), that the horizon's rays touch.

    ``t`` [rad], shape (...), runs round the polar-plane ellipse: from the northernmost point through east (away from
    the poles; within 26 deg of a pole it starts towards longitude 180 deg).
    """
    p, x, _ = _circle(r_itrs, ellipsoid, t)
    return (p + x) * ellipsoid.axes_m


def horizon_directions(r_itrs: ArrayLike, ellipsoid: Ellipsoid, t: ArrayLike) -> FloatArray:
    """Return the unit directions, shape (..., 3), of the horizon at parameters ``t`` of :func:`tangency_points`."""
    d = _circle(r_itrs, ellipsoid, t)[1] * ellipsoid.axes_m
    return d / np.linalg.norm(d, axis=-1)[..., None]


def horizon_cam(
    r_itrs: ArrayLike, q_cam_from_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84, n: int = 720
) -> FloatArray:
    """Return ``n`` unit directions of the horizon in camera axes, shape (n, 3), at equal steps of the parameter."""
    return rotate(q_cam_from_itrs, horizon_directions(r_itrs, ellipsoid, np.arange(n) * (2 * math.pi / n)))


def horizon_by_azimuth(r_itrs: ArrayLike, ellipsoid: Ellipsoid, azimuth_rad: ArrayLike) -> FloatArray:
    """Return the angle [rad], shape (...), between geocentric nadir and horizon at azimuths about that nadir.

    With ``z`` the nadir and ``m`` the level direction at the azimuth (from north towards east), the cone is a quadratic
    in the cotangent; its larger root is the half of the cone that lies ahead.
    """
    q = tangent_cone(r_itrs, ellipsoid)
    z = geocentric_nadir(r_itrs)
    north, east = north_east(r_itrs)
    azimuth = np.asarray(azimuth_rad, float)[..., None]
    m = np.cos(azimuth) * north + np.sin(azimuth) * east
    a = z @ q @ z
    b = m @ q @ z
    c = np.einsum("...i,ij,...j->...", m, q, m)
    root = np.sqrt(b**2 - a * c)
    cot = np.where(b > 0.0, -c / np.where(b > 0.0, b + root, 1.0), (root - b) / a)
    return np.arctan2(1.0, cot)


_VANTAGE_M = 4e6
"""Distance from the lowest points of :func:`rays_along_parallels` to their origins, far outside the air."""


def rays_along_parallels(
    latitude_rad: ArrayLike, height_m: ArrayLike, ellipsoid: Ellipsoid = WGS84
) -> tuple[FloatArray, FloatArray]:
    """Return origins [m] and directions, shapes (m, n, 3), of rays to the east with given lowest points.

    The lowest point lies at latitude (m,) and geodetic height (n,). Within 500 km on either side the ray leaves the
    parallel by less than 0.4 deg up to 60 deg of latitude.
    """
    latitude, height = np.meshgrid(np.asarray(latitude_rad, float), np.asarray(height_m, float), indexing="ij")
    lowest = itrs_from_geodetic(latitude, 0.0, height, ellipsoid)
    east = np.array([0.0, 1.0, 0.0])
    return lowest - _VANTAGE_M * east, np.broadcast_to(east, lowest.shape)


def angular_radius(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> float:
    """Return the Earth's angular radius [rad]: the horizon's angle to the geocentric nadir, mean over azimuth.

    For a sphere ``asin(R / D)``. The mean over 720 azimuths of a function this smooth is exact to rounding.
    """
    return float(np.mean(horizon_by_azimuth(r_itrs, ellipsoid, np.arange(720) * (2 * math.pi / 720))))


def signed_limb_angle(d_itrs: ArrayLike, r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the angle [rad], shape (...), of directions (..., 3) to the nearest limb point, positive inside the Earth.

    The nearest horizon direction is found from the best of 16 around the horizon by safeguarded Newton on the curve's
    parameter; the angle is stationary there, so its error is of second order in the parameter's.
    """
    d = np.asarray(d_itrs, float)
    d = d / np.linalg.norm(d, axis=-1)[..., None]
    sign = np.where(limb_side(d, r_itrs, ellipsoid) >= 0.0, 1.0, -1.0)
    step = math.pi / 8
    starts = step * np.arange(16)
    t = starts[np.argmax(d @ horizon_directions(r_itrs, ellipsoid, starts).T, axis=-1)]
    low, high = t - step, t + step
    for _ in range(40):
        h, h1, h2 = _horizon_derivatives(r_itrs, ellipsoid, t)
        slope, curvature = np.einsum("...i,...i->...", d, h1), np.einsum("...i,...i->...", d, h2)
        low, high = np.where(slope >= 0.0, t, low), np.where(slope <= 0.0, t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = t - slope / curvature
        new = np.where((curvature < 0.0) & (new >= low) & (new <= high), new, 0.5 * (low + high))
        done = np.all(np.abs(new - t) < 1e-9)
        t = new
        if done:
            break
    h = horizon_directions(r_itrs, ellipsoid, t)
    angle = np.arctan2(np.linalg.norm(np.cross(d, h), axis=-1), np.einsum("...i,...i->...", d, h))
    return sign * angle


def _horizon_derivatives(
    r_itrs: ArrayLike, ellipsoid: Ellipsoid, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the unit horizon direction and its first two derivatives by the parameter, each shape (..., 3)."""
    p, x, x1 = _circle(r_itrs, ellipsoid, t)
    k = float(p @ p)
    axes = ellipsoid.axes_m
    # On the circle x = centre + radius vector, so the second derivative is centre - x, centre = -(1 - 1/|p|^2) p.
    y, y1, y2 = x * axes, x1 * axes, (-(1.0 - 1.0 / k) * p - x) * axes

    def dot(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.einsum("...i,...i->...", a, b)[..., None]

    n = np.sqrt(dot(y, y))
    h = y / n
    n1 = dot(h, y1)
    h1 = (y1 - n1 * h) / n
    n2 = dot(h1, y1) + dot(h, y2)
    h2 = (y2 - n2 * h - 2.0 * n1 * h1) / n
    return h, h1, h2


def _in_image(camera: CameraModel, uv: FloatArray, in_front: NDArray[np.bool_]) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return (
            in_front
            & (uv[..., 0] >= -0.5)
            & (uv[..., 0] <= camera.width - 0.5)
            & (uv[..., 1] >= -0.5)
            & (uv[..., 1] <= camera.height - 0.5)
        )


class _PoseHorizon:
    """The horizon of one pose in one camera, as a function of its parameter."""

    def __init__(
        self, camera: CameraModel, q_cam_from_itrs: ArrayLike, r_itrs: ArrayLike, ellipsoid: Ellipsoid
    ) -> None:
        self.camera, self.r_itrs, self.ellipsoid = camera, np.asarray(r_itrs, float), ellipsoid
        self.q_cam_from_itrs = np.asarray(q_cam_from_itrs, float)

    def pixels(self, t: ArrayLike) -> tuple[FloatArray, NDArray[np.bool_]]:
        d_cam = rotate(self.q_cam_from_itrs, horizon_directions(self.r_itrs, self.ellipsoid, t))
        uv, in_front = project(self.camera, d_cam)
        return uv, _in_image(self.camera, uv, in_front)

    def arcs(self) -> list[tuple[float, float]]:
        """Return the parameter intervals inside the image, ends bisected; ``[(0, 2 pi)]`` if all of it is."""
        # A sixteenth of the narrower field per step, as long as that stays affordable: an arc that cuts off less of a
        # corner than one step shows is missed.
        field = min(self.camera.width / self.camera.fx, self.camera.height / self.camera.fy)
        n = int(np.clip(16 * 2 * math.pi / field, 4096, 262144))
        t: FloatArray = np.arange(n, dtype=np.float64) * (2 * math.pi / n)
        inside = self.pixels(t)[1]
        if inside.all():
            return [(0.0, 2 * math.pi)]
        entering = np.flatnonzero(inside & ~np.roll(inside, 1))
        leaving = np.flatnonzero(inside & ~np.roll(inside, -1))
        if entering.size == 0:
            return []
        if leaving[0] < entering[0]:
            leaving = np.roll(leaving, -1)
        first = self._border(t[entering] - 2 * math.pi / n, t[entering])
        last = self._border(t[leaving] + 2 * math.pi / n, t[leaving])
        last = np.where(last < first, last + 2 * math.pi, last)
        return list(zip(first.tolist(), last.tolist(), strict=True))

    def _border(self, outside: FloatArray, inside: FloatArray) -> FloatArray:
        for _ in range(60):
            middle = 0.5 * (outside + inside)
            within = self.pixels(middle)[1]
            outside, inside = np.where(within, outside, middle), np.where(within, middle, inside)
        return inside


def _crossings(view: _PoseHorizon, axis: int, values: FloatArray) -> FloatArray:
    """Return the other coordinate where the horizon crosses ``uv[axis] = value``: (n, k), rising, NaN-padded."""
    found: list[list[float]] = [[] for _ in values]
    where, low, high = [], [], []
    for first, last in view.arcs():
        t = np.linspace(first, last, 4097)
        coordinate = view.pixels(t)[0][:, axis]
        below = coordinate[None, :] <= values[:, None]
        index, start = np.nonzero(below[:, 1:] != below[:, :-1])
        where.append(index)
        low.append(t[start])
        high.append(t[start + 1])
    if where:
        index, t0, t1 = np.concatenate(where), np.concatenate(low), np.concatenate(high)
        falling = view.pixels(t0)[0][:, axis] > values[index]
        for _ in range(56):
            middle = 0.5 * (t0 + t1)
            on_first_side = (view.pixels(middle)[0][:, axis] > values[index]) == falling
            t0, t1 = np.where(on_first_side, middle, t0), np.where(on_first_side, t1, middle)
        other = view.pixels(0.5 * (t0 + t1))[0][:, 1 - axis]
        for i, value in zip(index.tolist(), other.tolist(), strict=True):
            found[i].append(value)
    width = max((len(f) for f in found), default=0) or 1
    return np.array([sorted(f) + [math.nan] * (width - len(f)) for f in found], float).reshape(len(found), width)


def horizon_rows(
    camera: CameraModel,
    q_cam_from_itrs: ArrayLike,
    r_itrs: ArrayLike,
    columns: ArrayLike,
    ellipsoid: Ellipsoid = WGS84,
) -> FloatArray:
    """Return the sub-pixel rows, shape (n, k), at which the horizon crosses n columns, fractional or not.

    Rows rise; ``k`` is the largest number of crossings of any column (at least 1), NaN where a column has fewer. They
    are bisected on the exact curve to rounding (1e-9 px). Two crossings closer than 1/4096 of the visible arc are not
    seen.
    """
    view = _PoseHorizon(camera, q_cam_from_itrs, r_itrs, ellipsoid)
    return _crossings(view, 0, np.asarray(columns, float).reshape(-1))


def horizon_columns(
    camera: CameraModel,
    q_cam_from_itrs: ArrayLike,
    r_itrs: ArrayLike,
    rows: ArrayLike,
    ellipsoid: Ellipsoid = WGS84,
) -> FloatArray:
    """Return the sub-pixel columns at which the horizon crosses rows; see :func:`horizon_rows`."""
    view = _PoseHorizon(camera, q_cam_from_itrs, r_itrs, ellipsoid)
    return _crossings(view, 1, np.asarray(rows, float).reshape(-1))


@dataclass(frozen=True)
class Cone:
    """A circular cone of sight lines: unit axis inside the cone, and cosine of the half-angle, not below 0."""

    axis_cam: FloatArray
    cos_rho: float

    @property
    def rho_rad(self) -> float:
        """Half-angle [rad]. The arc cosine loses digits below a degree; see :func:`fit_cone` for small cones."""
        return float(np.arccos(np.clip(self.cos_rho, -1.0, 1.0)))


def fit_cone(los_cam: FloatArray) -> Cone:
    """Fit the cone through n >= 3 unit lines of sight by orthogonal regression; its axis is where the arc bends to."""
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
