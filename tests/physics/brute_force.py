"""Single scattering along one ray by brute force: numpy, spherical shells, no tables, no code of the renderer.

Both optical depths are trapezoidal sums on grids that are dense at the lowest point (substitution ``t = sinh``-like
cubic); the optical depth towards the Sun is summed anew for every point of the view ray.
"""

from __future__ import annotations

import numpy as np


def _cubic(lo: float, hi: float, centre: float, n: int) -> np.ndarray:
    """Return ``n`` parameters from lo to hi, dense at ``centre``."""
    c = float(np.clip(centre, lo, hi))
    x = np.linspace(-1.0, 1.0, n)
    w = 0.05 * x + 0.95 * x**3
    t = np.where(x < 0, c + (c - lo) * w, c + (hi - c) * w)
    return np.unique(t)


def single_scatter(
    altitude_m: np.ndarray,
    extinction: np.ndarray,
    radius_m: float,
    albedo: float,
    observer: np.ndarray,
    direction: np.ndarray,
    sun: np.ndarray,
    n_view: int = 4001,
    n_sun: int = 1201,
) -> float:
    """Return radiance per unit solar irradiance [1/sr] of a conservative Rayleigh atmosphere over a Lambert sphere."""
    top = radius_m + altitude_m[-1]

    def k(p: np.ndarray) -> np.ndarray:
        h = np.linalg.norm(p, axis=-1) - radius_m
        return np.interp(h, altitude_m, extinction, left=extinction[0], right=0.0)

    def exit_distance(p: np.ndarray) -> float:
        b = p @ sun
        return float(-b + np.sqrt(b * b - p @ p + top * top))

    def sun_transmittance(p: np.ndarray) -> float:
        b = float(p @ sun)
        if b < 0 and p @ p - b * b < radius_m**2:
            return 0.0
        t = _cubic(0.0, exit_distance(p), -b, n_sun)
        return float(np.exp(-np.trapezoid(k(p + t[:, None] * sun), t)))

    direction, sun = direction / np.linalg.norm(direction), sun / np.linalg.norm(sun)
    b = float(observer @ direction)
    miss2 = float(observer @ observer) - b * b
    half = np.sqrt(top**2 - miss2)
    hits = miss2 < radius_m**2
    end = -b - np.sqrt(radius_m**2 - miss2) if hits else -b + half
    t = _cubic(-b - half, end, end if hits else -b, n_view)
    # put grid points on the edges of the shadow, where the integrand jumps
    od, dd = float(observer @ sun), float(direction @ sun)
    q = np.array([1 - dd * dd, 2 * (b - od * dd), observer @ observer - od * od - radius_m**2])
    roots = np.roots(q)
    edges = [r.real + s for r in roots if abs(r.imag) < 1e-6 for s in (-1e-3, 1e-3) if t[0] < r.real < t[-1]]
    t = np.sort(np.concatenate([t, edges]))
    p = observer + t[:, None] * direction
    kv = k(p)
    tau = np.concatenate([[0.0], np.cumsum(0.5 * (kv[1:] + kv[:-1]) * np.diff(t))])
    phase = 3.0 / (16.0 * np.pi) * (1.0 + float(direction @ sun) ** 2)
    t_sun = np.array([sun_transmittance(q) for q in p])
    radiance = np.trapezoid(kv * phase * t_sun * np.exp(-tau), t)
    if hits:
        ground = p[-1] / np.linalg.norm(p[-1])
        mu = float(ground @ sun)
        if mu > 0:
            just_above = ground * radius_m * (1 + 1e-12)
            radiance += albedo / np.pi * mu * sun_transmittance(just_above) * np.exp(-tau[-1])
    return float(radiance)
