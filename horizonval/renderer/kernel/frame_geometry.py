r"""What is geometric about a frame: its rays, its lights, the planet, and how far directions lie from the limb.

**Rays of the camera**, from pixel coordinates to directions, are in Float64. Written independently of
``geometry.camera`` so that the rendered edge and the analytic horizon share no projection code. Pixel ``(0, 0)`` is the
centre of the upper left pixel.

Brown-Conrady is inverted by Newton's method from the distorted point. Where a lens is so strong that this misses
the answer or ends beyond a fold, the answer is followed from the axis outwards instead. A fisheye's polynomial is
inverted by bisection, then Newton, between the axis and the angle where it turns back. Pixels beyond that angle get
rays at it; they lie outside the image circle. A unified lens is inverted in closed form after its distortion.

**Ray coordinates**: two numbers for every ray from one camera, in which a table of what rays meet is smooth. In the
stretched space (see :mod:`horizonval.renderer.planet`) the ellipsoid is a sphere of radius a. A ray has an azimuth
:math:`\alpha` about the direction to the sphere's centre, 0 towards the north, and a nadir angle :math:`\theta`. Seen
from o' its miss distance is ``|o'| sin(theta)``: a on the hard limb, exactly. The second number depends on what the ray
meets:

- ground: the elevation e at which it arrives there, ``|o'| sin(theta) = a cos(e)``. Radiance is smooth in e
  up to grazing rays, where the distance from the limb has a square root;
- limb, seen from outside the air: the height ``m = |o'| sin(theta) - a`` of its lowest point;
- limb and sky, seen from inside the air: the angle ``theta - theta_limb``, up to the zenith.

Each is mapped to ``x = asinh(v / w) / asinh(v_max / w)``: dense within w of the limb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, Projection
from horizonval.geometry.rotation import perpendicular
from horizonval.renderer.kernel.clouds import GapMap
from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.surface import Ground
from horizonval.renderer.planet import Planet, cross_squared, dot
from horizonval.renderer.position import Position
from horizonval.renderer.refraction import BendingField
from horizonval.renderer.types import Number, Values, Vec, constant, constant_vector, inverse_root

UNDISTORT_STEPS = 8
_STAGES, _STRONG_STEPS = 16, 32
"""For strong lenses.

Stages from the axis to a pixel, one Newton step each, and steps at the end (linear near a fold).
"""
_BISECTIONS = 26
_FISHEYE_STEPS = 4


@dataclass(frozen=True)
class RayCamera:
    """A camera and its attitude as kernel data: size-1 arrays, so that frames share one compiled kernel.

    ``values``: fx, fy, cx, cy and the distortion (k1 k2 p1 p2 k3 and perhaps k4 k5 k6 s1 s2 s3 s4, or k1 k2 k3 k4 0 of
    a fisheye); ``rows``: the nine entries of the rotation from camera axes to Earth-fixed axes. ``distorted``: a
    pinhole or unified lens with distortion; ``stages``: see :func:`_stages`. ``widest``: off-axis angle up to which a
    fisheye's polynomial grows. ``circle``: size of the image circle, see :meth:`sees`; None where it fills the image.
    ``skew``: of the pixel axes over fx, None for 0; ``shape``: xi, alpha and beta of a unified lens, else None.
    """

    values: Values
    rows: Values
    projection: Projection
    distorted: bool = False
    stages: int = 1
    widest: mi.Float64 | None = None
    circle: mi.Float64 | None = None
    skew: mi.Float64 | None = None
    shape: Values | None = None

    @classmethod
    def of(cls, camera: CameraModel, itrs_from_cam: NDArray[np.float64]) -> RayCamera:
        """Build from intrinsics and a rotation matrix, shape (3, 3)."""
        numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
        distorted = camera.projection in ("pinhole", "unified") and any(camera.distortion)
        shape = camera.shape if camera.projection == "unified" else None
        circle = _circle(camera)
        return cls(
            [constant(v) for v in numbers],
            [constant(v) for v in itrs_from_cam.ravel()],
            camera.projection,
            distorted,
            _stages(camera) if distorted else 1,
            constant(_widest(camera.distortion)) if camera.projection == "fisheye" else None,
            None if circle is None else constant(circle),
            constant(camera.skew) if camera.skew else None,
            None if shape is None else [constant(v) for v in shape],
        )

    def direction(self, u: mi.Float64, v: mi.Float64) -> Vec:
        """Return unit directions in Earth-fixed axes through pixel coordinates (column, row)."""
        return self._rotate(*self._in_camera_axes(u, v))

    def sees(self, u: mi.Float64, v: mi.Float64) -> mi.Bool:
        """Return whether pixels lie in the image circle.

        In focal lengths for a fisheye, else the chord to the boresight.
        """
        assert self.circle is not None
        if self.projection == "fisheye":
            x, y = self._normalised(u, v)
            return dr.sqrt(x * x + y * y) <= self.circle
        x, y, z = self._in_camera_axes(u, v)
        return dr.sqrt(x * x + y * y + (z - 1.0) * (z - 1.0)) <= self.circle

    def _normalised(self, u: mi.Float64, v: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        fx, fy, cx, cy = self.values[:4]
        x, y = (u - cx) / fx, (v - cy) / fy
        return (x if self.skew is None else x - self.skew * y), y

    def _in_camera_axes(self, u: mi.Float64, v: mi.Float64) -> Vec:
        x, y = self._normalised(u, v)
        if self.projection == "equal_angle":
            sin_y, cos_y = dr.sincos(y)
            sin_x, cos_x = dr.sincos(x)
            return cos_y * sin_x, sin_y, cos_y * cos_x
        if self.projection == "fisheye":
            radius = dr.sqrt(x * x + y * y)
            sin_t, cos_t = dr.sincos(self._off_axis(radius))
            scale = dr.select(radius > 1e-12, sin_t / dr.maximum(radius, 1e-300), 1.0)
            return x * scale, y * scale, cos_t
        if self.distorted:
            x, y = self._undistort(x, y)
        if self.shape is not None:
            return _from_sphere(self.shape, x, y)
        s = inverse_root(dr.fma(x, x, dr.fma(y, y, 1.0)))
        return x * s, y * s, s

    def _off_axis(self, radius: mi.Float64) -> mi.Float64:
        """Invert a fisheye's polynomial ``t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) = radius``."""
        k = self.values[4:8]
        assert self.widest is not None
        low, high = dr.zeros(mi.Float64, dr.width(radius)), self.widest

        def excess(t: mi.Float64) -> mi.Float64:
            return _fisheye(k, t) - radius

        for _ in range(_BISECTIONS):
            t = 0.5 * (low + high)
            over = excess(t) > 0.0
            low, high = dr.select(over, low, t), dr.select(over, t, high)
        t = 0.5 * (low + high)
        for _ in range(_FISHEYE_STEPS):
            t = dr.clip(t - excess(t) / dr.maximum(_fisheye_slope(k, t), 1e-12), low, high)
        return t

    def _undistort(self, xd: mi.Float64, yd: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Invert Brown-Conrady as :func:`_invert` does; in a loop, which compiles in a thirtieth of the time."""
        k, stages = self.values[4:], constant(float(self.stages))
        count = dr.opaque(mi.UInt32, self.stages - 1 + (UNDISTORT_STEPS if self.stages == 1 else _STRONG_STEPS), 1)

        def body(i: mi.UInt32, x: mi.Float64, y: mi.Float64) -> tuple[mi.UInt32, mi.Float64, mi.Float64]:
            share = dr.minimum(mi.Float64(i) + 1.0, stages) / stages
            return i + 1, *_newton(k, x, y, xd * share, yd * share)

        start = mi.UInt32(0), xd / stages, yd / stages
        _, x, y = dr.while_loop(start, lambda i, *_: i < count, body, label="undistort")
        return x, y

    def _rotate(self, x: mi.Float64, y: mi.Float64, z: mi.Float64) -> Vec:
        m = self.rows
        a, b, c = (m[k] * x + m[k + 1] * y + m[k + 2] * z for k in (0, 3, 6))
        return a, b, c


def _from_sphere(shape: Values, x: mi.Float64, y: mi.Float64) -> Vec:
    """Return the unit direction of a unified lens at coordinates without distortion, of slope 1 on the axis.

    ``(x, y, w)`` points from the shifted centre to the unit sphere, which it leaves at ``t`` times its length.
    """
    xi, alpha, beta = shape
    x, y = x / (1.0 + xi), y / (1.0 + xi)
    q = dr.fma(x, x, y * y)
    root = dr.sqrt(dr.maximum(1.0 - beta * q * (2.0 * alpha - 1.0), 0.0))
    w = (1.0 - beta * q * alpha * alpha) / dr.maximum(alpha * root + (1.0 - alpha), 1e-300)
    t = (xi * w + dr.sqrt(dr.maximum(w * w + q * (1.0 - xi * xi), 0.0))) / (q + w * w)
    z = t * w - xi
    s = inverse_root(t * t * q + z * z)
    return t * x * s, t * y * s, z * s


def _fisheye(k: Sequence[Number] | Sequence[float], t: Number) -> Number:
    s = t * t
    return t * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))


def _fisheye_slope(k: Sequence[Number] | Sequence[float], t: Number) -> Number:
    s = t * t
    return 1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])))


def _widest(k: Sequence[float]) -> float:
    """Return the angle, at most pi, at which a fisheye's polynomial stops to grow; to rounding, by sign change."""
    t = np.linspace(0.0, math.pi, 2**16 + 1)
    falling = np.flatnonzero(_fisheye_slope(k, t) <= 0.0)
    if not falling.size:
        return math.pi
    low, high = float(t[falling[0] - 1]), float(t[falling[0]])
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _fisheye_slope(k, middle) > 0.0 else (low, middle)
    return low


def _circle(camera: CameraModel) -> float | None:
    half = camera.image_circle_rad
    if half is None:
        return None
    return float(_fisheye(camera.distortion, half)) if camera.projection == "fisheye" else 2.0 * math.sin(half / 2.0)


def _invert(k: Sequence[Number] | Sequence[float], xd: Number, yd: Number, stages: int) -> tuple[Number, Number]:
    """Invert Brown-Conrady; from the distorted point in one stage, else from the axis outwards."""
    x, y = xd / stages, yd / stages
    for stage in range(1, stages):
        x, y = _newton(k, x, y, xd * (stage / stages), yd * (stage / stages))
    for _ in range(UNDISTORT_STEPS if stages == 1 else _STRONG_STEPS):
        x, y = _newton(k, x, y, xd, yd)
    return x, y


def _newton(
    k: Sequence[Number] | Sequence[float], x: Number, y: Number, xd: Number, yd: Number
) -> tuple[Number, Number]:
    k1, k2, p1, p2, k3, *more = k
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    if more:
        k4, k5, k6, s1, s2, s3, s4 = more
        over = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        radial = radial * over
        slope = (slope - 2.0 * radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) * over
    fx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - xd
    fy = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - yd
    jxx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    jxy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    jyy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    jyx = jxy
    if more:
        fx, fy = fx + r2 * (s1 + r2 * s2), fy + r2 * (s3 + r2 * s4)
        a, b = 2.0 * s1 + 4.0 * r2 * s2, 2.0 * s3 + 4.0 * r2 * s4
        jxx, jxy, jyx, jyy = jxx + a * x, jxy + a * y, jyx + b * x, jyy + b * y
    det = jxx * jyy - jxy * jyx
    return x - (jyy * fx - jxy * fy) / det, y - (jxx * fy - jyx * fx) / det


def _stages(camera: CameraModel) -> int:
    """Return in how many stages :func:`_invert` must go: 1 if that ends where many do, all over the image."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 33), np.linspace(-0.5, camera.height - 0.5, 33))
    xd, yd = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    xd = xd - camera.skew * yd if camera.skew else xd
    with np.errstate(all="ignore"):
        few, many = (_invert(camera.distortion, xd, yd, stages) for stages in (1, _STAGES))
        apart = np.hypot(few[0] - many[0], few[1] - many[1])
    return 1 if bool(np.all(apart < 1e-12)) else _STAGES


@dataclass(frozen=True)
class MoonInFrame:
    """The Moon of a frame; ``disc``: as the camera sees it; ``light``: unit vector from the Earth's centre to the Moon.

    ``nearness``: irradiance at the camera over that at the Earth's centre; ``lights_earth``: whether ground and air are
    visible in its light.
    """

    disc: Disc
    nearness: float
    light: Vec
    lights_earth: bool


@dataclass(frozen=True)
class FrameGeometry:
    """Everything geometric about one frame. ``origin`` and ``sun`` hold size-1 arrays.

    ``ground`` is None for a Lambert ground without clouds. ``sunless``: all air and ground in view lie in the Earth's
    shadow. ``glow_top_m``: nothing shines above; at least ``top_m``. With refraction ``planet``, ``top_m`` and
    ``origin`` are apparent ones, among which light goes straight, and ``bending`` says by how much it bends.
    ``gap_maps``: one per layer of thin cloud, None for one without gaps; empty where none has any. ``every_cell``: cut
    all pixels into cells (see ``cells``).
    """

    rays: RayCamera
    width: int
    height: int
    origin: Vec
    sun: Vec
    sun_radius: mi.Float64
    planet: Planet
    top_m: float
    subsamples: int
    ground: Ground | None = None
    moon: MoonInFrame | None = None
    sunless: bool = False
    glow_top_m: float = 0.0
    bending: BendingField | None = None
    gap_maps: tuple[GapMap | None, ...] = ()
    every_cell: bool = False

    def column_and_row(self, pixel: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        """Return column and row of pixel numbers. The image's width is data: frames of all sizes share kernels."""
        number, width = mi.Float64(pixel), constant(self.width)
        row = dr.floor((number + 0.5) / width)
        return dr.fma(-row, width, number), row

    @cached_property
    def position(self) -> Position:
        """The camera's position."""
        x, y, z = (float(c[0]) for c in self.origin)
        return Position(self.planet, (x, y, z))

    def coordinates(self, top_m: float) -> RayCoordinates:
        """Return the coordinates of the camera's rays; nothing is above ``top_m``."""
        return RayCoordinates.of(self.planet, np.array(self.position.place_m), top_m)

    @property
    def highest_m(self) -> float:
        """Rays that stay above see space alone."""
        return max(self.top_m, self.glow_top_m)


def limb_function(view: FrameGeometry, d: Vec, height_m: float = 0.0) -> mi.Float64:
    """Return a smooth function of directions, positive inside the Earth raised by ``height_m``.

    About the angle from its limb.
    """
    planet = view.planet
    o1, a = planet.stretch(view.origin, height_m), planet.a_m + height_m
    distance2 = dr.maximum(dot(o1, o1), a**2 * (1.0 + 1e-12))
    per_radian = dr.sqrt(distance2 - a**2) / a
    f = (1.0 - planet.miss_distance(view.origin, d, height_m)) / per_radian
    # the line's other half: behind the camera there is no Earth
    return dr.select(dot(o1, planet.stretch(d, height_m)) < 0.0, f, -1.0)


GROUND_DENSE_RAD, LIMB_DENSE_M, SKY_DENSE_RAD = 0.1, 25e3, 0.02
GROUND_NODES, LIMB_NODES, SKY_NODES = 96, 512, 512
"""Nodes along the axes. From a balloon at 30 km they are 150 m apart at the tropopause: a window is within 0.06 %."""


@dataclass(frozen=True)
class RayAxis:
    """The mapping from x in [0, 1] to a coordinate v in [0, most]; ``count`` nodes, even in x."""

    dense: float
    most: float
    count: int

    def nodes(self) -> FloatArray:
        """Return v at the nodes."""
        return self.dense * np.sinh(np.linspace(0.0, 1.0, self.count) * math.asinh(self.most / self.dense))

    def value(self, x: FloatArray) -> FloatArray:
        """Return v at x."""
        return np.asarray(self.dense * np.sinh(x * math.asinh(self.most / self.dense)))

    def place(self, v: mi.Float64) -> mi.Float64:
        """Return the place of kernel values in steps from the first node, within the axis."""
        u = dr.clip(v, 0.0, constant(self.most)) * constant(1.0 / self.dense)
        x = dr.log(u + dr.sqrt(dr.fma(u, u, 1.0))) * constant((self.count - 1) / math.asinh(self.most / self.dense))
        return dr.minimum(x, self.count - 1.0)


@dataclass(frozen=True)
class RayCoordinates:
    """The rays of one camera position.

    ``origin``: camera [m]; ``distance_m``: from the centre, in the stretched space; ``axes``: rows north, west and up,
    in the stretched space; ``inside``: whether the camera is inside the air, which decides what ``limb`` measures.
    """

    planet: Planet
    origin: FloatArray
    distance_m: float
    axes: FloatArray
    ground: RayAxis
    limb: RayAxis
    inside: bool

    @classmethod
    def of(cls, planet: Planet, origin: FloatArray, top_m: float) -> RayCoordinates:
        """Build for a camera at ``origin``; nothing is above ``top_m``."""
        stretched = origin * np.array([1.0, 1.0, planet.a_m / planet.b_m])
        r = max(float(np.linalg.norm(stretched)), planet.a_m * (1.0 + 1e-12))
        up = stretched / np.linalg.norm(stretched)
        north = np.array([0.0, 0.0, 1.0]) - up[2] * up
        length = float(np.linalg.norm(north))
        north = north / length if length > 1e-9 else perpendicular(up)
        axes = np.stack([north, np.cross(up, north), up])
        ground = RayAxis(GROUND_DENSE_RAD, 0.5 * math.pi, GROUND_NODES)
        # heights grow by the stretching: a ray that misses even so meets nothing
        most_m = top_m * planet.a_m / planet.b_m * 1.01
        inside = r < planet.a_m + most_m
        if inside:
            limb = RayAxis(SKY_DENSE_RAD, math.pi - math.asin(planet.a_m / r), SKY_NODES)
        else:
            limb = RayAxis(LIMB_DENSE_M, most_m, LIMB_NODES)
        return cls(planet, origin, r, axes, ground, limb, inside)

    def directions(self, v: FloatArray, azimuth: FloatArray, to_ground: bool) -> FloatArray:
        """Return unit directions at coordinates ``v`` of an axis under azimuths; they broadcast, shape (..., 3)."""
        a, r = self.planet.a_m, self.distance_m
        if to_ground:
            sine = a / r * np.cos(v)
            cosine = np.sqrt(np.maximum((1.0 - sine) * (1.0 + sine), 0.0))
        elif self.inside:
            theta = math.asin(a / r) + v
            sine, cosine = np.sin(theta), np.cos(theta)
        else:
            sine = np.minimum((a + v) / r, 1.0)
            cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
        along = [sine * np.cos(azimuth), sine * np.sin(azimuth), -cosine]
        # no product of matrices: it rounds by how many rays there are
        d = sum(c[..., None] * axis for c, axis in zip(np.broadcast_arrays(*along), self.axes, strict=True))
        d = d * np.array([1.0, 1.0, self.planet.b_m / a])
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))

    def place(self, o: Vec, d: Vec, to_ground: bool) -> tuple[mi.Float64, mi.Float64]:
        """Return ``(place on the axis [steps], azimuth [rad])`` of kernel directions; ``o`` is the camera."""
        a = self.planet.a_m
        o1, d1 = self.planet.stretch(o), self.planet.stretch(d)
        length2 = dot(d1, d1)
        miss = dr.sqrt(cross_squared(o1, d1) / length2)
        x, y = (dot(d1, constant_vector(axis)) for axis in self.axes[:2])
        azimuth = dr.atan2(y, x)
        if to_ground:
            rise = dr.sqrt(dr.maximum((a - miss) * (a + miss), 0.0))
            return self.ground.place(dr.atan2(rise, miss)), azimuth
        if self.inside:
            theta = dr.atan2(miss, -dot(o1, d1) * inverse_root(length2))
            return self.limb.place(theta - constant(math.asin(a / self.distance_m))), azimuth
        # away from the Earth nothing is met: as above the air
        return self.limb.place(dr.select(dot(o1, d1) < 0.0, miss - a, constant(self.limb.most))), azimuth
