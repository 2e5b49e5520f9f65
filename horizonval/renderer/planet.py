"""The ellipsoid inside the renderer: Float64 Dr.Jit, written apart from ``geometry`` so that each can check the other.

Everything rests on one trick: with ``z`` stretched by ``a/b`` the ellipsoid becomes a sphere of radius ``a`` and lines
stay lines with the same parameter. With primed vectors in the stretched space a line ``o + t d`` meets the ellipsoid if
``m = |o' x d'| / |d'| <= a``, and it is nearest to it at ``t = -(o'.d') / |d'|^2``. The form ``a^2 - m^2`` is used
instead of the textbook discriminant ``b^2 - ac``, which cancels at planetary distances.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.types import Real, Vec, Vec3, inverse_root


def dot(p: Vec3[Real], q: Vec3[Real]) -> Real:
    """Return the scalar product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def along(o: Vec3[Real], d: Vec3[Real], t: Real | float) -> Vec3[Real]:
    """Return the point ``o + t d``."""
    return dr.fma(d[0], t, o[0]), dr.fma(d[1], t, o[1]), dr.fma(d[2], t, o[2])


def distance_squared(p: Vec, q: Vec) -> mi.Float64:
    """Return ``|p - q|^2``."""
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return x * x + y * y + z * z


def cross_squared(p: Vec, q: Vec) -> mi.Float64:
    """Return ``|p x q|^2``."""
    x = p[1] * q[2] - p[2] * q[1]
    y = p[2] * q[0] - p[0] * q[2]
    z = p[0] * q[1] - p[1] * q[0]
    return x * x + y * y + z * z


@dataclass(frozen=True)
class Planet:
    """Reference ellipsoid with semi-axes in metres. JsonObject floats: they are constants of the compiled kernel."""

    a_m: float
    b_m: float

    @property
    def mean_radius_m(self) -> float:
        """Radius of the sphere that stands in for the ellipsoid where only curvature counts.

        Tables see local height and solar zenith: optical depths near the horizon go with the square root of the radius,
        0.17 % between equator and pole.
        """
        return (2.0 * self.a_m + self.b_m) / 3.0

    def stretch(self, p: Vec, height_m: float | mi.Float64 = 0.0) -> Vec:
        """Return ``p`` with z scaled so that the ellipsoid with axes ``a + h, b + h`` is a sphere."""
        return p[0], p[1], p[2] * ((self.a_m + height_m) / (self.b_m + height_m))

    def miss_distance(self, o: Vec, d: Vec, height_m: float | mi.Float64 = 0.0) -> mi.Float64:
        """Return ``m / (a + h)``: below 1 for lines that meet the ellipsoid raised by ``height_m``."""
        o1, d1 = self.stretch(o, height_m), self.stretch(d, height_m)
        return dr.sqrt(cross_squared(o1, d1) / dot(d1, d1)) / (self.a_m + height_m)

    def chord(self, o: Vec, d: Vec, height_m: float | mi.Float64 = 0.0) -> tuple[mi.Float64, mi.Float64, mi.Bool]:
        """Return ``(t_mid, t_half, meets)`` of the chord cut out by the ellipsoid raised by ``height_m``.

        ``t_mid`` is the parameter of the point nearest to the surface; the crossings are ``t_mid -+ t_half``.
        ``t_half`` is 0 where the line misses.
        """
        o1, d1 = self.stretch(o, height_m), self.stretch(d, height_m)
        dd = dot(d1, d1)
        gap = (self.a_m + height_m) ** 2 - cross_squared(o1, d1) / dd
        return -dot(o1, d1) / dd, dr.sqrt(dr.maximum(gap, 0.0) / dd), gap > 0.0

    def height_and_normal(self, p: Vec3[Real]) -> tuple[Real, Vec3[Real]]:
        """Return geodetic height [m] and outward normal of the ellipsoid below ``p``.

        One step of Bowring's iteration (1976) from his improved start; the height error is below 1 mm from the surface
        to 2000 km, because the height depends on the latitude error to second order only.
        """
        if self.a_m == self.b_m:
            r = dr.sqrt(dot(p, p))
            s = 1.0 / r
            return r - self.a_m, (p[0] * s, p[1] * s, p[2] * s)
        a, b = self.a_m, self.b_m
        e2 = 1.0 - (b / a) ** 2
        ep2 = (a / b) ** 2 - 1.0
        rho2 = p[0] * p[0] + p[1] * p[1]
        rho = dr.sqrt(rho2)
        r = dr.sqrt(rho2 + p[2] * p[2])
        # reduced latitude beta as a vector, so that the poles need no special case
        cb, sb = a * rho, b * p[2] * (1.0 + ep2 * b / r)
        scale = 1.0 / dr.sqrt(cb * cb + sb * sb)
        cb, sb = cb * scale, sb * scale
        cp, sp = rho - e2 * a * cb * cb * cb, p[2] + ep2 * b * sb * sb * sb
        scale = 1.0 / dr.sqrt(cp * cp + sp * sp)
        cp, sp = cp * scale, sp * scale
        height = rho * cp + p[2] * sp - a * dr.sqrt(1.0 - e2 * sp * sp)
        per_rho = cp / dr.maximum(rho, 1e-9)
        return height, (p[0] * per_rho, p[1] * per_rho, sp)

    def point(self, height_m: mi.Float64, normal: Vec) -> Vec:
        """Return the point at a geodetic height above where the ellipsoid has a unit normal."""
        a2, b2 = self.a_m**2, self.b_m**2
        x, y, z = normal
        scale = inverse_root(a2 * (x * x + y * y) + b2 * z * z)
        return x * dr.fma(a2, scale, height_m), y * dr.fma(a2, scale, height_m), z * dr.fma(b2, scale, height_m)

    def shadow_crossings(self, o: Vec, d: Vec, sun: Vec) -> tuple[mi.Float64, mi.Float64, mi.Bool]:
        """Return ``(t1, t2, crosses)``: where a line enters and leaves the umbra of a Sun at infinity.

        In the stretched space the umbra is the half cylinder of radius ``a`` behind the planet:
        ``|p' - (p'.s') s'| < a`` and ``p'.s' < 0``. Crossings on the sunward half are returned as such and must be
        rejected with :meth:`in_umbra` at points beside them.
        """
        o1, d1, s1 = self.stretch(o), self.stretch(d), self._unit(self.stretch(sun))
        os, ds = dot(o1, s1), dot(d1, s1)
        q2 = dot(d1, d1) - ds * ds
        q1 = dot(o1, d1) - os * ds
        q0 = dot(o1, o1) - os * os - self.a_m**2
        disc = q1 * q1 - q2 * q0
        crosses = (disc > 0.0) & (q2 > 1e-12)
        root = dr.sqrt(dr.maximum(disc, 0.0))
        q2 = dr.maximum(q2, 1e-12)
        return (-q1 - root) / q2, (-q1 + root) / q2, crosses

    def in_umbra(self, p: Vec, sun: Vec) -> mi.Bool:
        """Return whether the Sun's centre is hidden by the ellipsoid from ``p`` (no refraction)."""
        p1, s1 = self.stretch(p), self._unit(self.stretch(sun))
        ps = dot(p1, s1)
        return (dot(p1, p1) - ps * ps < self.a_m**2) & (ps < 0.0)

    @staticmethod
    def _unit(v: Vec) -> Vec:
        s = inverse_root(dot(v, v))
        return v[0] * s, v[1] * s, v[2] * s
