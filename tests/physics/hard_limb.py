"""Hard-limb pictures of a sphere, made without the package: numpy, each edge pixel sampled on a fine grid."""

from __future__ import annotations

import numpy as np


def hard_limb_image(pixels: int, fov_deg: float, nadir_cam: np.ndarray, rho_rad: float, fine: int = 32) -> np.ndarray:
    """Return a square picture, 0 in space and 200 on the Earth, area-averaged; pixel (0, 0) is a pixel's centre."""
    focal = pixels / 2 / np.tan(np.radians(fov_deg) / 2)
    middle = (pixels - 1) / 2

    def inside(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        d = np.stack([(u - middle) / focal, (v - middle) / focal, np.ones_like(u)], axis=-1)
        return d @ nadir_cam > np.cos(rho_rad) * np.linalg.norm(d, axis=-1)

    corner = np.arange(pixels + 1) - 0.5
    at_corner = inside(*np.meshgrid(corner, corner)).astype(int)
    count = at_corner[:-1, :-1] + at_corner[1:, :-1] + at_corner[:-1, 1:] + at_corner[1:, 1:]
    image = np.where(count == 4, 1.0, 0.0)
    rows, columns = np.nonzero((count > 0) & (count < 4))
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    du, dv = np.meshgrid(offset, offset)
    for first in range(0, len(rows), 2000):
        r, c = rows[first : first + 2000], columns[first : first + 2000]
        image[r, c] = inside(c[:, None, None] + du, r[:, None, None] + dv).mean(axis=(1, 2))
    return 200.0 * image
