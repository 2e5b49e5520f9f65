"""Pictures of a sphere's limb made without the package: the sky on a grid four times finer, blurred and summed.

Nothing here is shared with what is tested: no profile in closed form, no distance from the limb, no derivative but by
differences of whole pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

FINE = 4
"""Samples per pixel and axis. The fine pixels hold their share of the Earth, to a few per cent of a fine pixel at the
edge; after a blur of 2.8 of them nothing of that is left."""
RADIUS_M = 6371008.8


@dataclass(frozen=True)
class Sphere:
    """What a picture is made of: nadir by two angles about a middle, altitude, levels, blur."""

    width: int
    height: int
    focal_px: float
    nadir_cam: tuple[float, float, float]
    altitude_m: float
    scale_height_m: float = 0.0
    blur_px: float = 0.7
    earth: float = 200.0
    space: float = 20.0
    tilt: tuple[float, float] = (0.0, 0.0)
    bow_m: float = 0.0
    """By how much a soft limb is higher a right angle of azimuth from the plane of nadir and boresight than in it, as
    the square of the azimuth's sine."""

    @property
    def nadir(self) -> np.ndarray:
        n = np.array(self.nadir_cam) / np.linalg.norm(self.nadir_cam)
        first, second = self.across
        turned = n + self.tilt[0] * first + self.tilt[1] * second
        return turned / np.linalg.norm(turned)

    @property
    def across(self) -> tuple[np.ndarray, np.ndarray]:
        """Two unit vectors across the middle: along the plane of nadir and boresight, and along the limb."""
        n = np.array(self.nadir_cam) / np.linalg.norm(self.nadir_cam)
        second = np.cross([0.0, 0.0, 1.0], n) if np.hypot(n[0], n[1]) > 1e-6 else np.array([1.0, 0.0, 0.0])
        second /= np.linalg.norm(second)
        return np.cross(second, n), second


def _sky(sphere: Sphere, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Brightness from 0 to 1 at the middles of fine pixels: hard limbs by the share that lies inside."""
    x = (u - (sphere.width - 1) / 2) / sphere.focal_px
    y = (v - (sphere.height - 1) / 2) / sphere.focal_px
    n = sphere.nadir
    cosine = (x * n[0] + y * n[1] + n[2]) / np.sqrt(1.0 + x * x + y * y)
    distance = RADIUS_M + sphere.altitude_m
    if sphere.scale_height_m > 0.0:
        sine = np.sqrt(np.clip(1.0 - cosine**2, 0.0, 1.0))
        along = (np.stack([x, y, np.ones_like(x)], axis=-1) @ sphere.across[1]) / np.sqrt(1.0 + x * x + y * y)
        bow = sphere.bow_m * (along / np.maximum(sine, 1e-9)) ** 2
        lowest = np.where(cosine > 0.0, distance * sine, np.inf) - RADIUS_M - bow
        return np.exp(-np.maximum(lowest, 0.0) / sphere.scale_height_m)
    level = cosine - np.sqrt(1.0 - (RADIUS_M / distance) ** 2)
    by_v, by_u = np.gradient(level)
    return np.clip(level / np.maximum(np.hypot(by_u, by_v), 1e-300) + 0.5, 0.0, 1.0)


def picture(sphere: Sphere, tile: int = 64) -> np.ndarray:
    """Return the picture without noise, shape (height, width), made in tiles; those without limb are of one level."""
    margin = int(np.ceil(6.0 * sphere.blur_px)) + 1
    out = np.empty((sphere.height, sphere.width))
    for top in range(0, sphere.height, tile):
        for left in range(0, sphere.width, tile):
            rows, columns = min(tile, sphere.height - top), min(tile, sphere.width - left)
            coarse_u, coarse_v = np.meshgrid(
                np.linspace(left - margin, left + columns + margin, 9),
                np.linspace(top - margin, top + rows + margin, 9),
            )
            rough = _sky(sphere, coarse_u, coarse_v)
            if rough.min() == rough.max() and sphere.scale_height_m == 0.0:
                out[top : top + rows, left : left + columns] = rough[0, 0]
                continue
            u = left - margin - 0.5 + (np.arange((columns + 2 * margin) * FINE) + 0.5) / FINE
            v = top - margin - 0.5 + (np.arange((rows + 2 * margin) * FINE) + 0.5) / FINE
            fine = _sky(sphere, *np.meshgrid(u, v))
            blurred = gaussian_filter(fine, sphere.blur_px * FINE, truncate=6.0)
            summed = blurred.reshape(rows + 2 * margin, FINE, columns + 2 * margin, FINE).mean(axis=(1, 3))
            out[top : top + rows, left : left + columns] = summed[margin:-margin, margin:-margin]
    return sphere.space + (sphere.earth - sphere.space) * out


def noisy(clean: np.ndarray, rng: np.random.Generator, sigma: float = 2.55) -> np.ndarray:
    """Return eight bits of a picture with noise of one per cent of full scale."""
    return np.clip(np.rint(clean + rng.normal(0.0, sigma, clean.shape)), 0, 255)


def bound_rad(sphere: Sphere, *, altitude_known: bool, sigma: float = 2.55) -> np.ndarray:
    """Return the Cramer-Rao bound of the nadir's two tilts [rad^2], shape (2, 2), by differences of whole pictures.

    Not known besides: altitude if it is free, brightness of Earth and space, and the blur. Rounding to whole levels
    adds 1/12 to the noise's variance.
    """
    pixel = 1.0 / sphere.focal_px
    rho = np.arcsin(RADIUS_M / (RADIUS_M + sphere.altitude_m))
    per_metre = 0.1 * pixel * (RADIUS_M + sphere.altitude_m) / np.tan(rho)
    changes: list[tuple[str, float]] = [("tilt0", 0.1 * pixel), ("tilt1", 0.1 * pixel)]
    if not altitude_known:
        changes.append(("altitude_m", per_metre))
    changes += [("earth", 1.0), ("space", 1.0), ("blur_px", 0.05)]

    def changed(name: str, by: float) -> Sphere:
        if name.startswith("tilt"):
            tilt = list(sphere.tilt)
            tilt[int(name[4])] += by
            return replace(sphere, tilt=(tilt[0], tilt[1]))
        return replace(sphere, **{name: getattr(sphere, name) + by})

    rows = [(picture(changed(n, h)) - picture(changed(n, -h))).ravel() / (2.0 * h) for n, h in changes]
    jacobian = np.array(rows)
    information = jacobian @ jacobian.T / (sigma**2 + 1.0 / 12.0)
    size = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)
    return np.asarray(covariance[:2, :2])
