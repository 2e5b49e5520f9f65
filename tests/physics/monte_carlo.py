"""Radiance along one ray by backward Monte Carlo: float64, straight rays, no tables, no code of the package.

The planet is a sphere or an ellipsoid of revolution under air whose coefficients depend on the height above it alone
(geodetic height over the ellipsoid), linear between nodes; molecules scatter by Rayleigh's phase function, with
depolarisation or none, or isotropically, and any number of species of particles by Henyey and Greenstein's; the ground
is Lambert's, of an albedo that is any function of latitude and longitude (:class:`Ground`). The Sun is a point of
irradiance 1, so radiances are in 1/sr. :func:`make_air` builds all that, :func:`radiance` answers for one ray.

How light is followed backwards:

- The first event lies on the line of sight. Where, is drawn from a density that two pilot runs have learnt: in each of
  48 pieces of the line of sight the root mean square of what a path brings (the best there is), mixed with the plain
  density and one uniform in length, so that nothing is left out. The ground is one more piece.
- At every event the Sun is asked for directly (exact phase function, shadow of the planet, optical depth summed from
  shell to shell). The first event's answer is ``single``, all later ones together are ``multiple``.
- New directions come from the phase function, for a low Sun six of ten from two Henyey-Greenstein lobes: g 0.7 around
  the Sun, g 0.95 around the point of the horizon over it. New distances are exponential, for a low Sun half of them
  uniform in length; paths that would leave the air are made to scatter in it. Weights take the sum of the densities, so
  the answer does not depend on the choice; plain analog paths would give a few huge weights, and standard errors that
  are not to be trusted.
- Paths end by Russian roulette from the sixth event on, by day also when their weight has become small.

The single scattered part is also integrated without chance (:attr:`Answer.single_exact`), which takes its noise out of
the total: ``total = single_exact + multiple``.

Numbers are drawn from a stream of each ray's own, seeded by everything that describes the ray.

How far to trust it: standard errors come from 64 batches. With the Sun more than 10 deg below the horizon a few paths
carry much of the light, the more so with particles of g above 0.8: there the standard error itself is a sample, and two
seeds must agree before it is believed. Polarisation and refraction are left out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit

N_BINS = 48
"""Pieces of the line of sight whose importance the pilot runs learn."""

N_BATCHES = 64
"""Independent groups of paths, from whose scatter the standard error comes (9 % uncertain itself)."""

_FINE = 0.05
_MAX_STEPS = 4000
_RADIUS = 6371.0
_G1 = 0.5 - 0.5 / np.sqrt(3.0)
_G2 = 0.5 + 0.5 / np.sqrt(3.0)
_SUN_LOBE = 0.7
_HORIZON_LOBE = 0.95


class Ground(NamedTuple):
    """Albedo in cells: belts of latitude of equal height, each cut into a number of equal pieces of longitude.

    ``columns``, ``first``: pieces of each belt from the south, and where its first, at 180 deg W, is in ``albedo``.
    """

    columns: np.ndarray
    first: np.ndarray
    albedo: np.ndarray


class Air(NamedTuple):
    """One wavelength of an atmosphere over a planet; lengths in km, coefficients per km.

    ``particles``, ``g``: scattering coefficient and asymmetry of every species, shape (species, heights). ``cos2``: the
    c of the molecules' phase function ``(1 - c/3 + c cos^2) / (4 pi)``, 0.75 without depolarisation.
    """

    z: np.ndarray
    extinction: np.ndarray
    molecules: np.ndarray
    particles: np.ndarray
    g: np.ndarray
    cos2: float
    ground: Ground
    top: float
    a: float
    b: float
    interval: np.ndarray
    """Interval of ``z`` that holds the lower end of each piece of 50 m."""


class Answer(NamedTuple):
    """Radiances of one ray [1/sr] with standard errors."""

    single: float
    single_se: float
    multiple: float
    multiple_se: float
    single_exact: float
    n_paths: int

    @property
    def total(self) -> float:
        """Every order."""
        return self.single_exact + self.multiple


@dataclass(frozen=True)
class Plan:
    """How paths are drawn; the expected answer does not depend on it."""

    sun_lobe: float = 0.0
    uniform_length: float = 0.0
    weight_roulette: bool = True

    @staticmethod
    def of(sza_deg: float) -> Plan:
        """Return what suits a Sun zenith angle at the ray's lowest point."""
        return Plan(0.6, 0.5, False) if sza_deg > 88.0 else Plan()


def read_air(path: Path | str, band: str, *, axes_km: tuple[float, float] | None = None) -> Air:
    """Read one band of an atmosphere file; ``axes_km`` (equatorial, polar) puts it over an ellipsoid instead."""
    data = json.loads(Path(path).read_text(encoding="utf-8"))
    return air_of(data, next(b for b in data["bands"] if b["name"] == band), axes_km=axes_km)


def air_of(data: dict[str, Any], band: dict[str, Any], *, axes_km: tuple[float, float] | None = None) -> Air:
    """Return one band of an atmosphere file's content."""
    z = np.array(data["altitude_km"], dtype=np.float64)
    scattering = 1e3 * np.array(band["scattering_per_m"], dtype=np.float64)
    absorption = 1e3 * np.array(band["absorption_per_m"], dtype=np.float64)
    molecules, species = scattering, []
    if isinstance(band["phase"], dict):
        molecules, species = np.zeros_like(z), [(scattering, band["phase"]["henyey_greenstein"])]
    elif "particle_scattering_per_m" in band:
        species = [(1e3 * np.array(band["particle_scattering_per_m"]), band["asymmetry"])]
    cos2 = 0.75 if band["phase"] == "rayleigh" else 0.0
    axes = axes_km or (float(data["planet_radius_km"]),) * 2
    return make_air(
        z, molecules, absorption, species, cos2=cos2, ground=uniform(data["surface"]["albedo"]), axes_km=axes
    )


def make_air(
    z_km: np.ndarray,
    molecules: np.ndarray,
    absorption: np.ndarray,
    species: Sequence[tuple[np.ndarray, np.ndarray | float]] = (),
    *,
    cos2: float = 0.75,
    ground: Ground,
    axes_km: tuple[float, float] = (6371.0, 6371.0),
) -> Air:
    """Return air of given coefficients [1/km].

    Parameters
    ----------
    z_km : ndarray, shape (n,)
        Rising strictly from 0. A thin layer has nodes close below and above its edges.
    molecules, absorption : ndarray, shape (n,)
        Scattering of molecules; absorption of everything.
    species : sequence of (ndarray, ndarray or float)
        Scattering and asymmetry of particles.
    cos2 : float
        See :class:`Air`.
    ground : Ground
        From :func:`uniform`, :func:`chequered`, :func:`halves` or :func:`sampled`.
    axes_km : tuple of float
        Equatorial and polar radius.
    """
    z = np.asarray(z_km, dtype=np.float64)
    if np.any(np.diff(z) <= 0.0) or z[0] != 0.0:
        raise ValueError("heights must rise strictly from 0")
    particles, g = np.zeros((len(species), len(z))), np.zeros((len(species), len(z)))
    for k, (scattering, asymmetry) in enumerate(species):
        particles[k], g[k] = scattering, asymmetry
    lower = _FINE * np.arange(int(np.ceil(z[-1] / _FINE)) + 2)
    interval = np.clip(np.searchsorted(z, lower + 1e-9, side="right") - 1, 0, len(z) - 2)
    return Air(
        z=z,
        extinction=np.asarray(molecules + particles.sum(axis=0) + absorption, dtype=np.float64),
        molecules=np.array(molecules, dtype=np.float64),
        particles=particles,
        g=g,
        cos2=float(cos2),
        ground=ground,
        top=float(z[-1]),
        a=float(axes_km[0]),
        b=float(axes_km[1]),
        interval=interval.astype(np.int64),
    )


def uniform(albedo: float) -> Ground:
    """Return a ground of one albedo."""
    return Ground(np.ones(1, dtype=np.int64), np.zeros(1, dtype=np.int64), np.array([float(albedo)]))


def sampled(albedo: Callable[[np.ndarray, np.ndarray], np.ndarray], cell_km: float) -> Ground:
    """Return a ground whose cells have the albedo that a function of latitude and longitude [rad] has in their middles.

    Cells are squares of ``cell_km``, rounded so that belts fill the globe and cells their belt in even number.
    """
    belts = max(1, round(np.pi * _RADIUS / cell_km))
    latitude = (np.arange(belts) + 0.5) / belts * np.pi - 0.5 * np.pi
    columns = 2 * np.maximum(1, np.rint(np.pi * _RADIUS * np.cos(latitude) / cell_km)).astype(np.int64)
    first = np.cumsum(columns) - columns
    places = [
        (np.full(n, p), (np.arange(n) + 0.5) / n * 2.0 * np.pi - np.pi) for p, n in zip(latitude, columns, strict=True)
    ]
    return Ground(columns, first, np.concatenate([albedo(*place) for place in places]).astype(np.float64))


def chequered(square_km: float, albedo: float, albedo_other: float) -> Ground:
    """Return a chequered ground: cells of :func:`sampled`, of two albedos by turns.

    The southernmost belt's first cell, and every other one from there along belts and from belt to belt, has the
    first albedo.
    """
    ground = sampled(lambda latitude, longitude: np.zeros_like(latitude), square_km)
    belt = np.repeat(np.arange(len(ground.columns)), ground.columns)
    number = np.arange(len(belt)) - ground.first[belt]
    return ground._replace(albedo=np.where((belt + number) % 2 == 0, float(albedo), float(albedo_other)))


def halves(albedo_west: float, albedo_east: float) -> Ground:
    """Return a ground of two halves that meet at the meridian 0 and its antimeridian."""
    columns, first = np.full(1, 2, dtype=np.int64), np.zeros(1, dtype=np.int64)
    return Ground(columns, first, np.array([albedo_west, albedo_east], dtype=np.float64))


def seed_of(*identity: object) -> np.random.SeedSequence:
    """Return the seed of a ray from whatever describes it."""
    digest = hashlib.sha256(repr(identity).encode()).digest()
    return np.random.SeedSequence(int.from_bytes(digest, "big"))


# --- geometry ---------------------------------------------------------------------------------------------------------


@njit(cache=True, inline="always")
def _height(air, x, y, z):
    """Return the height over the planet [km]; over the ellipsoid by two of Bowring's steps (exact to 1e-9 km)."""
    if air.a == air.b:
        return np.sqrt(x * x + y * y + z * z) - air.a
    rho = np.sqrt(x * x + y * y)
    e2 = 1.0 - (air.b / air.a) ** 2
    ep2 = (air.a / air.b) ** 2 - 1.0
    sb, cb = z * air.a, rho * air.b
    for _ in range(2):
        n = 1.0 / np.sqrt(sb * sb + cb * cb)
        sb *= n
        cb *= n
        sp = z + ep2 * air.b * sb**3
        cp = rho - e2 * air.a * cb**3
        sb, cb = air.b * sp, air.a * cp
    n = 1.0 / np.sqrt(sp * sp + cp * cp)
    sp *= n
    cp *= n
    return rho * cp + z * sp - air.a * np.sqrt(1.0 - e2 * sp * sp)


@njit(cache=True, inline="always")
def _up(air, p):
    """Return the local vertical."""
    if air.a == air.b:
        return p / np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    h = _height(air, p[0], p[1], p[2])
    # Gradient of the ellipsoid's form at the foot point, found by three steps of p = foot + h up.
    foot = p.copy()
    up = np.empty(3)
    for _ in range(6):
        up[0] = foot[0] / air.a**2
        up[1] = foot[1] / air.a**2
        up[2] = foot[2] / air.b**2
        up /= np.sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2])
        foot = p - h * up
    return up


@njit(cache=True, inline="always")
def _crossings(a, b, p, d):
    """Return (discriminant, first, second) where a ray meets the ellipsoid with axes a and b."""
    ia, ib = 1.0 / (a * a), 1.0 / (b * b)
    qa = (d[0] * d[0] + d[1] * d[1]) * ia + d[2] * d[2] * ib
    qb = (p[0] * d[0] + p[1] * d[1]) * ia + p[2] * d[2] * ib
    # Foot of the perpendicular in stretched space first: p p - 1 would cancel.
    t = -qb / qa
    fx, fy, fz = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    disc = 1.0 - ((fx * fx + fy * fy) * ia + fz * fz * ib)
    root = np.sqrt(max(disc, 0.0) / qa)
    return disc, t - root, t + root


@njit(cache=True, inline="always")
def _albedo(air, up):
    """Return the ground's albedo under a vertical."""
    ground = air.ground
    if len(ground.albedo) == 1:
        return ground.albedo[0]
    belts = len(ground.columns)
    y = (np.arcsin(min(1.0, max(-1.0, up[2]))) / np.pi + 0.5) * belts
    belt = min(max(int(y), 0), belts - 1)
    columns = ground.columns[belt]
    x = (np.arctan2(up[1], up[0]) / (2.0 * np.pi) + 0.5) * columns
    return ground.albedo[ground.first[belt] + min(max(int(x), 0), columns - 1)]


@njit(cache=True, inline="always")
def _place(air, h):
    """Return (lower node, weight of the upper one) of a height; the caller asks for none above the top."""
    h = min(max(h, 0.0), air.top)
    i = air.interval[int(h / _FINE)]
    while h > air.z[i + 1]:
        i += 1
    return i, (h - air.z[i]) / (air.z[i + 1] - air.z[i])


@njit(cache=True, inline="always")
def _between(values, i, w):
    return values[i] + (values[i + 1] - values[i]) * w


@njit(cache=True, inline="always")
def _at(air, values, h):
    if h >= air.top:
        return 0.0
    i, w = _place(air, h)
    return _between(values, i, w)


@njit(cache=True, inline="always")
def _scattering(air, h):
    """Return the scattering coefficient of everything."""
    if h >= air.top:
        return 0.0
    i, w = _place(air, h)
    total = _between(air.molecules, i, w)
    for n in range(len(air.particles)):
        total += _between(air.particles[n], i, w)
    return total


@njit(cache=True, inline="always")
def _tau_between(air, p, d, t0, t1):
    """Return the optical depth of a short piece of a ray, two Gauss points."""
    dt = t1 - t0
    ta, tb = t0 + _G1 * dt, t0 + _G2 * dt
    ka = _at(air, air.extinction, _height(air, p[0] + ta * d[0], p[1] + ta * d[1], p[2] + ta * d[2]))
    kb = _at(air, air.extinction, _height(air, p[0] + tb * d[0], p[1] + tb * d[1], p[2] + tb * d[2]))
    return 0.5 * dt * (ka + kb)


@njit(cache=True, inline="always")
def _piece(k0, k1, dz, ds, r, impact):
    """Return the optical depth of a piece of a ray inside one shell, k linear in r and r quadratic along the piece."""
    if dz == 0.0:
        return 0.5 * ds * (k0 + k1)
    return ds * (0.5 * (k0 + k1) - (k1 - k0) / dz * ds * ds * (impact * impact / (r * r * r)) / 12.0)


@njit(cache=True)
def _trace(air, p, d, store, ts, taus):
    """Follow a ray from a point inside the air to the ground or to space.

    Returns (number of break points, whether the ground is hit, optical depth); with ``store`` the break points'
    distances and optical depths are written to ``ts`` and ``taus``.
    """
    if air.a != air.b:
        return _trace_ellipsoid(air, p, d, store, ts, taus)
    rr = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    r0 = np.sqrt(rr)
    s0 = p[0] * d[0] + p[1] * d[1] + p[2] * d[2]
    px, py, pz = p[0] - s0 * d[0], p[1] - s0 * d[1], p[2] - s0 * d[2]
    pp = px * px + py * py + pz * pz
    impact = np.sqrt(pp)
    big_r, z, k = air.a, air.z, air.extinction
    h0 = min(max(r0 - big_r, 0.0), air.top)
    i = air.interval[int(h0 / _FINE)]
    while h0 > z[i + 1]:
        i += 1
    tau = 0.0
    n = 0
    s, h, kh = s0, h0, _at(air, k, min(h0, air.top * (1 - 1e-15)))
    if store:
        ts[0], taus[0] = 0.0, 0.0
        n = 1
    hits = s0 < 0.0 and impact < big_r
    if s0 < 0.0:
        lowest = impact - big_r
        while h > max(lowest, 0.0):
            zn = z[i]
            if zn <= max(lowest, 0.0):
                zn = max(lowest, 0.0)
            rn = big_r + zn
            sn = -np.sqrt(max((rn - impact) * (rn + impact), 0.0))
            kn = k[i] + (k[i + 1] - k[i]) * (zn - z[i]) / (z[i + 1] - z[i])
            tau += _piece(kh, kn, zn - h, sn - s, big_r + 0.5 * (h + zn), impact)
            s, h, kh = sn, zn, kn
            if store:
                ts[n], taus[n] = s - s0, tau
                n += 1
            if i > 0 and h <= z[i]:
                i -= 1
        if hits:
            return n, True, tau
        while h >= z[i + 1]:
            i += 1
    while i < len(z) - 1:
        zn = z[i + 1]
        rn = big_r + zn
        sn = np.sqrt(max((rn - impact) * (rn + impact), 0.0))
        kn = k[i + 1]
        if zn > h:
            tau += _piece(kh, kn, zn - h, sn - s, big_r + 0.5 * (h + zn), impact)
            s, h, kh = sn, zn, kn
            if store:
                ts[n], taus[n] = s - s0, tau
                n += 1
        i += 1
    return n, False, tau


@njit(cache=True)
def _trace_ellipsoid(air, p, d, store, ts, taus):
    """Follow a ray over the ellipsoid in steps of at most 0.5 km of height (1 km above 40 km, 2 km above 60 km)."""
    disc, near, _ = _crossings(air.a, air.b, p, d)
    hits = disc > 0.0 and near > 1e-9
    end = near
    if not hits:
        _, _, end = _crossings(air.a + air.top, air.b + air.top, p, d)
    tau, t, n = 0.0, 0.0, 0
    if store:
        ts[0], taus[0] = 0.0, 0.0
        n = 1
    x, y, z = p[0], p[1], p[2]
    while t < end:
        h = _height(air, x, y, z)
        # The direction of the vertical is only needed to choose the step.
        ux, uy, uz = x / air.a**2, y / air.a**2, z / air.b**2
        c = (ux * d[0] + uy * d[1] + uz * d[2]) / np.sqrt(ux * ux + uy * uy + uz * uz)
        dh = 0.5 if h < 40.0 else (1.0 if h < 60.0 else 2.0)
        bend = (1.0 - c * c) / air.a
        step = 2.0 * dh / (abs(c) + np.sqrt(c * c + 2.0 * dh * bend))
        tn = min(t + step, end)
        if end - tn < 1e-6:
            tn = end
        tau += _tau_between(air, p, d, t, tn)
        t = tn
        if store:
            ts[n], taus[n] = t, tau
            n += 1
        x, y, z = p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]
    return n, hits, tau


@njit(cache=True, inline="always")
def _sunlight(air, p, sun, ts, taus):
    """Return the transmittance towards the Sun, 0 in the planet's shadow."""
    disc, near, far = _crossings(air.a, air.b, p, sun)
    if disc > 0.0 and far > 1e-6 and near > -1e-6 and (near > 1e-6 or far - near > 1e-3):
        return 0.0
    _, hits, tau = _trace(air, p, sun, False, ts, taus)
    if hits:
        return 0.0
    return np.exp(-tau)


# --- scattering -------------------------------------------------------------------------------------------------------


@njit(cache=True, inline="always")
def _hg(g, c):
    q = 1.0 + g * g - 2.0 * g * c
    return (1.0 - g * g) / (4.0 * np.pi * q * np.sqrt(q))


@njit(cache=True, inline="always")
def _phase(air, h, c):
    """Return the phase function [1/sr] of everything at a height where something scatters."""
    i, w = _place(air, h)
    total = _between(air.molecules, i, w)
    value = total * (1.0 - air.cos2 / 3.0 + air.cos2 * c * c) / (4.0 * np.pi)
    for n in range(len(air.particles)):
        k = _between(air.particles[n], i, w)
        total += k
        value += k * _hg(_between(air.g[n], i, w), c)
    return value / total


@njit(cache=True, inline="always")
def _molecular_cosine(cos2, rng):
    """Return the cosine of an angle of scattering; depolarised light is a mixture of Rayleigh's and isotropic."""
    if 0.75 * rng.random() >= cos2:
        return 2.0 * rng.random() - 1.0
    # the cubic equation of Rayleigh's distribution
    q = 4.0 * rng.random() - 2.0
    root = np.sqrt(q * q + 1.0)
    return min(1.0, max(-1.0, np.cbrt(root + q) - np.cbrt(root - q)))


@njit(cache=True, inline="always")
def _scattered_cosine(air, h, rng):
    """Return the cosine of an angle of scattering at a height."""
    i, w = _place(air, h)
    u = rng.random() * _scattering(air, min(h, air.top * (1.0 - 1e-15))) - _between(air.molecules, i, w)
    if u < 0.0:
        return _molecular_cosine(air.cos2, rng)
    last = len(air.particles) - 1
    for n in range(last):
        u -= _between(air.particles[n], i, w)
        if u < 0.0:
            return _hg_cosine(_between(air.g[n], i, w), rng.random())
    if last < 0:
        return _molecular_cosine(air.cos2, rng)
    return _hg_cosine(_between(air.g[last], i, w), rng.random())


@njit(cache=True, inline="always")
def _hg_cosine(g, u):
    if abs(g) < 1e-4:
        return 2.0 * u - 1.0
    q = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    return min(1.0, max(-1.0, (1.0 + g * g - q * q) / (2.0 * g)))


@njit(cache=True, inline="always")
def _turned(axis, c, azimuth):
    """Return the direction at cosine ``c`` from an axis."""
    if abs(axis[2]) < 0.9:
        ex, ey, ez = -axis[1], axis[0], 0.0
    else:
        ex, ey, ez = 0.0, -axis[2], axis[1]
    n = 1.0 / np.sqrt(ex * ex + ey * ey + ez * ez)
    ex, ey, ez = ex * n, ey * n, ez * n
    fx, fy, fz = axis[1] * ez - axis[2] * ey, axis[2] * ex - axis[0] * ez, axis[0] * ey - axis[1] * ex
    s = np.sqrt(max(0.0, 1.0 - c * c))
    ca, sa = s * np.cos(azimuth), s * np.sin(azimuth)
    d = np.empty(3)
    d[0] = c * axis[0] + ca * ex + sa * fx
    d[1] = c * axis[1] + ca * ey + sa * fy
    d[2] = c * axis[2] + ca * ez + sa * fz
    return d / np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])


@njit(cache=True, inline="always")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, inline="always")
def _towards_light(up, sun):
    """Return the Sun's direction, or the point of the horizon over it when it has set."""
    c = _dot(up, sun)
    if c >= 0.0 or c < -0.99:
        return sun
    level = sun - c * up
    return level / np.sqrt(_dot(level, level))


@njit(cache=True, inline="always")
def _lobes(rng, sun, light):
    """Return a direction out of the two lobes, three of five from the wide one."""
    if rng.random() < 0.6:
        return _turned(sun, _hg_cosine(_SUN_LOBE, rng.random()), 2.0 * np.pi * rng.random())
    return _turned(light, _hg_cosine(_HORIZON_LOBE, rng.random()), 2.0 * np.pi * rng.random())


@njit(cache=True, inline="always")
def _weight(p, new, sun, light, lobe):
    """Return how much a direction is worth that was drawn from the density ``p`` or the lobes."""
    q = 0.6 * _hg(_SUN_LOBE, _dot(new, sun)) + 0.4 * _hg(_HORIZON_LOBE, _dot(new, light))
    return p / ((1.0 - lobe) * p + lobe * q)


@njit(cache=True)
def _scatter(air, rng, d, up, h, sun, lobe):
    """Return (new direction, weight) of light scattered at a height."""
    light = _towards_light(up, sun)
    if lobe > 0.0 and rng.random() < lobe:
        new = _lobes(rng, sun, light)
    else:
        c = _scattered_cosine(air, h, rng)
        new = _turned(d, c, 2.0 * np.pi * rng.random())
    if lobe == 0.0:
        return new, 1.0
    return new, _weight(_phase(air, h, _dot(d, new)), new, sun, light, lobe)


@njit(cache=True)
def _reflect(rng, up, sun, lobe):
    """Return (new direction, weight but for the albedo); weight 0 into the ground."""
    light = _towards_light(up, sun)
    if lobe > 0.0 and rng.random() < lobe:
        new = _lobes(rng, sun, light)
    else:
        new = _turned(up, np.sqrt(rng.random()), 2.0 * np.pi * rng.random())
    c = _dot(new, up)
    if c <= 1e-9:
        return new, 0.0
    return new, _weight(c / np.pi, new, sun, light, lobe)


@njit(cache=True)
def _path(air, rng, p, d, weight, sun, lobe, uniform, by_weight, ts, taus):
    """Return what a path brings that leaves an event at ``p`` into ``d``: sunlight at all its later events."""
    total = 0.0
    start = weight
    event = 1
    while True:
        event += 1
        n, hits, tau_end = _trace(air, p, d, True, ts, taus)
        through = np.exp(-tau_end)
        if hits and rng.random() < through:
            p = p + ts[n - 1] * d
            up = _up(air, p)
            # Onto the ground, and a millimetre above it.
            p = p - (_height(air, p[0], p[1], p[2]) - 1e-6) * up
            weight *= _albedo(air, up)
            if weight == 0.0:
                return total
            c = _dot(up, sun)
            if c > 0.0:
                total += weight * c / np.pi * _sunlight(air, p, sun, ts, taus)
            d, w = _reflect(rng, up, sun, lobe)
            weight *= w
        else:
            length = ts[n - 1]
            absorbed = -np.expm1(-tau_end)
            if absorbed <= 0.0 or length <= 0.0:
                return total
            if uniform > 0.0 and rng.random() < uniform:
                t = length * rng.random()
                j = min(max(np.searchsorted(ts[:n], t, side="right") - 1, 0), n - 2)
            else:
                target = -np.log1p(-rng.random() * absorbed)
                j = min(max(np.searchsorted(taus[:n], target, side="right") - 1, 0), n - 2)
                dtau = taus[j + 1] - taus[j]
                t = ts[j] if dtau <= 0.0 else ts[j] + (target - taus[j]) / dtau * (ts[j + 1] - ts[j])
            dt = ts[j + 1] - ts[j]
            mean_k = (taus[j + 1] - taus[j]) / dt
            density = mean_k * np.exp(-taus[j] - mean_k * (t - ts[j])) / absorbed
            density = (1.0 - uniform) * density + uniform / length
            tau = taus[j] + _tau_between(air, p, d, ts[j], t)
            p = p + t * d
            h = _height(air, p[0], p[1], p[2])
            k = _scattering(air, h)
            if k <= 0.0 or density <= 0.0:
                return total
            weight *= k * np.exp(-tau) / density
            if hits:
                weight /= absorbed
            total += weight * _phase(air, h, _dot(d, sun)) * _sunlight(air, p, sun, ts, taus)
            d, w = _scatter(air, rng, d, p / np.sqrt(_dot(p, p)), h, sun, lobe)
            weight *= w
        if weight <= 0.0:
            return total
        if event >= 6:
            if rng.random() > 0.6:
                return total
            weight /= 0.6
        if by_weight and weight < 0.05 * start:
            survival = max(weight / (0.05 * start), 0.05)
            if rng.random() > survival:
                return total
            weight /= survival


# --- the line of sight ------------------------------------------------------------------------------------------------


@njit(cache=True)
def _sight(air, p, d, split, ts, taus):
    """Return the line of sight from where it enters the air, in fine pieces: distances, optical depths, ground hit."""
    n, hits, _ = _trace(air, p, d, True, ts, taus)
    t = np.empty((n - 1) * split + 1)
    tau = np.empty((n - 1) * split + 1)
    t[0], tau[0] = 0.0, 0.0
    m = 0
    for i in range(n - 1):
        for j in range(split):
            t[m + 1] = ts[i] + (ts[i + 1] - ts[i]) * (j + 1) / split
            tau[m + 1] = tau[m] + _tau_between(air, p, d, t[m], t[m + 1])
            m += 1
    return t, tau, hits


@njit(cache=True)
def _lit(air, p, sun):
    disc, near, _ = _crossings(air.a, air.b, p, sun)
    return not (disc > 0.0 and near > 0.0)


@njit(cache=True)
def _single_exact(air, p, d, sun, t, tau, hits, ts, taus):
    """Return the radiance of first order, three Gauss points per piece, pieces cut where the planet's shadow begins."""
    gauss_x = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)])
    gauss_w = np.array([5.0, 8.0, 5.0]) / 18.0
    c = _dot(d, sun)
    total = 0.0
    for i in range(len(t) - 1):
        lo, hi = t[i], t[i + 1]
        edges = np.array([lo, hi, hi])
        lit_lo, lit_hi = _lit(air, p + lo * d, sun), _lit(air, p + hi * d, sun)
        if not lit_lo and not lit_hi:
            continue
        if lit_lo != lit_hi:
            x, y = lo, hi
            for _ in range(60):
                m = 0.5 * (x + y)
                if _lit(air, p + m * d, sun) == lit_lo:
                    x = m
                else:
                    y = m
            edges[1] = 0.5 * (x + y)
        for e in range(2):
            width = edges[e + 1] - edges[e]
            if width <= 0.0:
                continue
            for q in range(3):
                s = edges[e] + gauss_x[q] * width
                x = p + s * d
                h = _height(air, x[0], x[1], x[2])
                k = _scattering(air, h)
                if k <= 0.0:
                    continue
                tau_s = tau[i] + _tau_between(air, p, d, lo, s)
                source = k * _phase(air, h, c) * _sunlight(air, x, sun, ts, taus)
                total += gauss_w[q] * width * source * np.exp(-tau_s)
    if hits:
        x = p + t[-1] * d
        up = _up(air, x)
        x = x - (_height(air, x[0], x[1], x[2]) - 1e-6) * up
        c = _dot(up, sun)
        if c > 0.0:
            total += _albedo(air, up) / np.pi * c * _sunlight(air, x, sun, ts, taus) * np.exp(-tau[-1])
    return total


@njit(cache=True)
def _run(air, rng, p, d, sun, t, tau, hits, cdf, bin_of, n_batches, per_batch, lobe, uniform, by_weight, ts, taus):
    """Return (single, multiple) of each batch and (paths, sums of squares) of each bin; the ground is the last."""
    single, multiple = np.zeros(n_batches), np.zeros(n_batches)
    counts, squares = np.zeros(N_BINS + 1), np.zeros(N_BINS + 1)
    last = len(t) - 1
    for batch in range(n_batches):
        for i in range(per_batch):
            u = (i + rng.random()) / per_batch
            j = min(np.searchsorted(cdf, u, side="right") - 1, len(cdf) - 2)
            chance = cdf[j + 1] - cdf[j]
            if j < last:
                s = t[j] + (t[j + 1] - t[j]) * rng.random()
                x = p + s * d
                h = _height(air, x[0], x[1], x[2])
                k = _scattering(air, h)
                if k <= 0.0:
                    continue
                tau_s = tau[j] + _tau_between(air, p, d, t[j], s)
                weight = k * np.exp(-tau_s) * (t[j + 1] - t[j]) / chance
                first = weight * _phase(air, h, _dot(d, sun)) * _sunlight(air, x, sun, ts, taus)
                new, w = _scatter(air, rng, d, x / np.sqrt(_dot(x, x)), h, sun, lobe)
                where = bin_of[j]
            else:
                x = p + t[last] * d
                up = _up(air, x)
                x = x - (_height(air, x[0], x[1], x[2]) - 1e-6) * up
                weight = _albedo(air, up) * np.exp(-tau[last]) / chance
                c = _dot(up, sun)
                first = weight * max(c, 0.0) / np.pi * _sunlight(air, x, sun, ts, taus)
                new, w = _reflect(rng, up, sun, lobe)
                where = N_BINS
            single[batch] += first
            later = 0.0
            if weight * w > 0.0:
                later = _path(air, rng, x, new, weight * w, sun, lobe, uniform, by_weight, ts, taus)
            multiple[batch] += later
            counts[where] += 1.0
            squares[where] += (later * chance) ** 2
    return single / per_batch, multiple / per_batch, counts, squares


def radiance(
    air: Air,
    observer_km: np.ndarray,
    direction: np.ndarray,
    sun: np.ndarray,
    n_paths: int,
    seed: np.random.SeedSequence,
    plan: Plan | None = None,
    *,
    se: float = 0.0,
    max_paths: int = 0,
) -> Answer:
    """Return the radiance along one ray [1/sr].

    Parameters
    ----------
    air : Air
    observer_km, direction, sun : array_like, shape (3,)
        Planet-centred, polar axis z; the observer outside the air.
    n_paths : int
        Paths of the first run; a tenth of it twice for the pilots.
    seed : SeedSequence
        See :func:`seed_of`.
    plan : Plan, optional
        Default by the Sun's height at the ray's lowest point.
    se : float
        Wanted standard error of the total, as a part of it: more runs follow until it is met or ``max_paths`` spent.
    max_paths : int
    """
    direction = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    sun = np.asarray(sun, dtype=np.float64) / np.linalg.norm(sun)
    observer = np.asarray(observer_km, dtype=np.float64)
    disc, enter, _ = _crossings(air.a + air.top, air.b + air.top, observer, direction)
    if disc <= 0.0 or enter < 0.0:
        raise ValueError("the ray must enter the air from outside")
    p = observer + (enter + 1e-9) * direction
    ts, taus = np.empty(_MAX_STEPS), np.empty(_MAX_STEPS)
    t, tau, hits = _sight(air, p, direction, 12, ts, taus)
    lowest = p + t[np.argmin(np.linalg.norm(p + t[:, None] * direction, axis=1))] * direction
    if plan is None:
        plan = Plan.of(float(np.degrees(np.arccos(lowest @ sun / np.linalg.norm(lowest)))))
    exact = _single_exact(air, p, direction, sun, t, tau, hits, ts, taus)

    heights = np.array([_height(air, *x) for x in p + (0.5 * (t[1:] + t[:-1]))[:, None] * direction])
    k = np.interp(heights, air.z, air.molecules + air.particles.sum(axis=0))
    plain = k * np.exp(-0.5 * (tau[1:] + tau[:-1])) * np.diff(t)
    # Half of the pieces' borders by plain weight, half by sqrt-like distance from the lowest point.
    plain /= plain.sum()
    even = np.diff(t) / t[-1]
    spread = 0.5 * plain + 0.5 * even
    bin_of = np.minimum((np.cumsum(spread) - 0.5 * spread) * N_BINS, N_BINS - 1).astype(np.int64)
    ground = 0.0
    if hits:
        foot = p + t[-1] * direction
        ground = float(_albedo(air, _up(air, foot)) * np.exp(-tau[-1]))
    plain_ground = ground / (ground + 1.0 - np.exp(-tau[-1])) if ground > 0.0 else 0.0

    def cdf_of(medium: np.ndarray, on_ground: float) -> np.ndarray:
        parts = np.append(medium / medium.sum() * (1.0 - on_ground), on_ground) if ground > 0.0 else medium
        cdf = np.concatenate([[0.0], np.cumsum(parts)])
        return cdf / cdf[-1]

    streams = iter(np.random.default_rng(s) for s in seed.spawn(64))

    def run(cdf: np.ndarray, per_batch: int) -> tuple[np.ndarray, ...]:
        rng = next(streams)
        lobe, uniform, by_weight = plan.sun_lobe, plan.uniform_length, plan.weight_roulette
        args = (bin_of, N_BATCHES, per_batch, lobe, uniform, by_weight, ts, taus)
        return _run(air, rng, p, direction, sun, t, tau, hits, cdf, *args)

    cdf = cdf_of(0.7 * plain + 0.3 * even, max(plain_ground, 0.1))
    learnt_counts, learnt_squares = np.zeros(N_BINS + 1), np.zeros(N_BINS + 1)
    for _ in range(2):
        chance = np.diff(cdf)
        _, _, counts, squares = run(cdf, max(n_paths // (10 * N_BATCHES), 8))
        # ``squares`` holds what a path brings times the chance of its piece: its size per piece, of the order of
        # plain weight times brightness. Per unit of plain weight it is the brightness to be learnt.
        learnt_counts += counts
        learnt_squares += squares
        mass = np.bincount(bin_of, weights=chance[: len(bin_of)], minlength=N_BINS)
        size = np.bincount(bin_of, minlength=N_BINS)
        rms = np.sqrt(learnt_squares / np.maximum(learnt_counts, 1.0))
        # Root mean square of a bin's own contribution per piece, times its number of pieces.
        wanted = rms[:N_BINS] * size
        per_piece_plain = np.bincount(bin_of, weights=plain, minlength=N_BINS)
        inside = plain / np.maximum(per_piece_plain[bin_of], 1e-300)
        wanted_ground = rms[N_BINS] if ground > 0.0 else 0.0
        scale = wanted.sum() + wanted_ground
        if scale > 0.0 and mass.sum() > 0.0:
            medium = 0.7 * wanted[bin_of] / max(wanted.sum(), 1e-300) * inside + 0.2 * plain + 0.1 * even
            cdf = cdf_of(medium, max(0.9 * wanted_ground / scale, 0.02))

    singles, multiples, weights, done, per_batch = [], [], [], 0, max(n_paths // N_BATCHES, 8)
    while True:
        single, multiple, _, _ = run(cdf, per_batch)
        singles.append(single)
        multiples.append(multiple)
        weights.append(float(per_batch))
        done += per_batch * N_BATCHES
        w = np.array(weights) / sum(weights)
        single_batches, multiple_batches = w @ np.array(singles), w @ np.array(multiples)
        first, first_se = _mean_se(single_batches)
        more, more_se = _mean_se(multiple_batches)
        short = more_se / max((exact + more) * se, 1e-300) if se > 0.0 else 0.0
        if short <= 1.0 or done >= max_paths or len(weights) > 50:
            return Answer(first, first_se, more, more_se, exact, done)
        wish = min(done * min(1.15 * short * short - 1.0, 4.0), max_paths - done)
        per_batch = max(int(wish / N_BATCHES), per_batch // 4, 8)


def _mean_se(batches: np.ndarray) -> tuple[float, float]:
    return float(batches.mean()), float(batches.std(ddof=1) / np.sqrt(len(batches)))
