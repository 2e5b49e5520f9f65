"""Bent rays and single scattering along them by brute force: numpy, the ray equation in three dimensions, no tables.

``d(n d)/ds = grad n`` by Runge and Kutta's fourth-order rule in steps of constant ``ds``. Where the Sun's light comes
from is found by shooting, how much it spreads by shooting from three neighbouring points. Nothing of the renderer is
used, and nothing of the change of height it rests on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Air:
    """Exponential air over a sphere: refractivity and extinction, both zero above the top."""

    radius_m: float = 6_371_000.0
    top_m: float = 100_000.0
    refractivity: float = 2.8e-4
    scale_m: float = 8000.0
    extinction_per_m: float = 1.2e-5

    def share(self, height_m: np.ndarray) -> np.ndarray:
        """Return density as a share of that at the ground."""
        return np.where(height_m <= self.top_m, np.exp(-np.maximum(height_m, -5e3) / self.scale_m), 0.0)


@dataclass(frozen=True)
class Shot:
    """Where rays end, their direction there, the optical depth passed and the lowest height."""

    position: np.ndarray
    direction: np.ndarray
    tau: np.ndarray
    lowest_m: np.ndarray


def _slope(air: Air, p: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return derivatives of position, of ``n d`` and of optical depth over the path."""
    r = np.linalg.norm(p, axis=-1)
    share = air.share(r - air.radius_m)
    n = 1.0 + air.refractivity * share
    pull = -air.refractivity / air.scale_m * share / r
    return v / n[:, None], pull[:, None] * p, air.extinction_per_m * share


def shoot(air: Air, p: np.ndarray, d: np.ndarray, length_m: float, steps: int) -> tuple[Shot, list[np.ndarray]]:
    """Follow rays from points (n, 3) in unit directions (n, 3); also return positions and ``n d`` after every step."""
    r = np.linalg.norm(p, axis=-1)
    v = d * (1.0 + air.refractivity * air.share(r - air.radius_m))[:, None]
    tau, lowest, h = np.zeros(len(p)), r - air.radius_m, length_m / steps
    track = [np.concatenate([p, v, tau[:, None]], axis=1)]
    for _ in range(steps):
        p1, v1, t1 = _slope(air, p, v)
        p2, v2, t2 = _slope(air, p + h / 2 * p1, v + h / 2 * v1)
        p3, v3, t3 = _slope(air, p + h / 2 * p2, v + h / 2 * v2)
        p4, v4, t4 = _slope(air, p + h * p3, v + h * v3)
        p = p + h / 6 * (p1 + 2 * p2 + 2 * p3 + p4)
        v = v + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
        tau = tau + h / 6 * (t1 + 2 * t2 + 2 * t3 + t4)
        lowest = np.minimum(lowest, np.linalg.norm(p, axis=-1) - air.radius_m)
        track.append(np.concatenate([p, v, tau[:, None]], axis=1))
    return Shot(p, v / np.linalg.norm(v, axis=-1)[:, None], tau, lowest), track


def _aim(air: Air, p: np.ndarray, sun: np.ndarray, steps: int = 600) -> tuple[Shot, np.ndarray, np.ndarray]:
    """Return rays that leave points towards the Sun, their local directions, and whether the ground is in the way."""
    r = np.linalg.norm(p, axis=-1)
    up = p / r[:, None]
    zenith = np.arccos(np.clip(up @ sun, -1.0, 1.0))
    side = sun - (up @ sun)[:, None] * up
    side /= np.linalg.norm(side, axis=-1)[:, None]
    n = 1.0 + air.refractivity * air.share(r - air.radius_m)
    grazing = np.pi - np.arcsin(np.minimum((1.0 + air.refractivity) * air.radius_m / (n * r), 1.0))
    length = 2.0 * np.sqrt((air.radius_m + air.top_m) ** 2 - air.radius_m**2)

    def fire(angle: np.ndarray) -> tuple[Shot, np.ndarray, np.ndarray]:
        local = np.cos(angle)[:, None] * up + np.sin(angle)[:, None] * side
        shot, _ = shoot(air, p, local, length, steps)
        leaves = np.arctan2(np.sum(shot.direction * side, axis=-1), np.sum(shot.direction * up, axis=-1))
        return shot, leaves - zenith, local

    low, high = np.maximum(zenith - 0.05, 0.0), np.minimum(zenith + 1e-6, grazing)
    f_low, f_high = fire(low)[1], fire(high)[1]
    dark = (zenith > grazing) & (f_high < 0.0)
    for _ in range(14):
        # regula falsi, with the Illinois halving
        angle = np.where(dark, high, low - f_low * (high - low) / np.where(f_high == f_low, 1.0, f_high - f_low))
        f = fire(angle)[1]
        above = f > 0
        f_low = np.where(above, 0.5 * f_low, f)
        low = np.where(above, low, angle)
        f_high = np.where(above, f, 0.5 * f_high)
        high = np.where(above, angle, high)
        if np.all(dark | (np.abs(f) < 1e-10)):
            break
    shot, _, local = fire(angle)
    return shot, local, dark


def sunlight(air: Air, p: np.ndarray, sun: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Sun's irradiance across its rays at points (n, 3), 1 outside, without n^2, and local directions."""
    shot, local, dark = _aim(air, p, sun)
    step = 30.0
    one = np.cross(local, sun + np.array([0.3, 0.5, 0.1]))
    one /= np.linalg.norm(one, axis=-1)[:, None]
    two = np.cross(local, one)
    moved = []
    for across in (one, two):
        ends = [_aim(air, p + s * step * across, sun)[0].position for s in (-1.0, 1.0)]
        moved.append((ends[1] - ends[0]) / (2.0 * step))
    area = np.abs(np.cross(moved[0], moved[1]) @ sun)
    n = 1.0 + air.refractivity * air.share(np.linalg.norm(p, axis=-1) - air.radius_m)
    return np.where(dark, 0.0, area / n**2 * np.exp(-shot.tau)), local


def limb_radiance(air: Air, observer: np.ndarray, direction: np.ndarray, sun: np.ndarray, n_view: int = 300) -> float:
    """Return the single scattered radiance [1/sr] of conservative Rayleigh air along a ray that misses the ground."""
    sun = sun / np.linalg.norm(sun)
    b = float(observer @ direction)
    half = np.sqrt((air.radius_m + air.top_m) ** 2 - (observer @ observer - b * b))
    entry = observer + (-b - half) * direction
    length = 2.4 * half
    steps = n_view * 8
    _, track = shoot(air, entry[None], direction[None], length, steps)
    state = np.array(track)[::8, 0]
    p, v, tau = state[:, :3], state[:, 3:6], state[:, 6]
    k = air.extinction_per_m * air.share(np.linalg.norm(p, axis=-1) - air.radius_m)
    light, local = sunlight(air, p, sun)
    cosine = np.sum(local * v, axis=-1) / np.linalg.norm(v, axis=-1)
    phase = 3.0 / (16.0 * np.pi) * (1.0 + cosine**2)
    return float(np.trapezoid(k * phase * light * np.exp(-tau), dx=length / n_view))
