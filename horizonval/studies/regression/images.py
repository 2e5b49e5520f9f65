"""Comparison of two images of one scene on the limb, on the disc, and in space.

Only images with different digests are compared by region; the truth maps define the regions. Each region gives the bias
of the mean. On the limb the difference is also split, in blocks along it, into a gain and a displacement along the
gradient:

    L_now - L_base = a L_base - s |grad L_base|

by least squares for ``a`` and ``s``, so that a brighter limb is not mistaken for a moved one. This is first order in
``s``: half a pixel is found to a fifth of it, several pixels only as "far off".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.studies.regression.baseline import FrozenFrame

ELSEWHERE, SPACE, LIMB, DISC = range(4)
LIMB_PX = 3.0
"""Half width of the limb region: blur covers two pixels, and an edge that moves by one must stay inside."""
LEAST_LIMB_M = 60e3
"""The same in height: visible air ends below 60 km."""
BLOCK_PX = 16
FEWEST_PX = 12
PERCENT = 100.0


def regions_of(hit: NDArray[np.floating], tangent_height_m: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return the region of every pixel, shape (H, W); Sun, Moon and clouds beyond the limb belong to none."""
    height = np.asarray(tangent_height_m, dtype=np.float64)
    finite = np.isfinite(height)
    filled = np.where(finite, height, 0.0)
    rows, columns = slopes(filled)
    near = finite & (np.abs(filled) < 500e3)
    per_px = float(np.median(np.hypot(rows, columns)[near])) if near.any() else 0.0
    width = max(LEAST_LIMB_M, LIMB_PX * per_px)
    found = np.full(height.shape, ELSEWHERE, dtype=np.uint8)
    found[finite & (height > width) & (hit == 0)] = SPACE
    found[finite & (np.abs(height) <= width) & np.isin(hit, (0, 1, 2))] = LIMB
    found[finite & (height < -width) & np.isin(hit, (1, 5))] = DISC
    return found


def slopes(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the slope per pixel down and across, shape (H, W); zero across a linear array."""
    down, across = (
        np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values) for axis in (0, 1)
    )
    return down, across


def bias(base: FloatArray, now: FloatArray, region: NDArray[np.bool_]) -> float | None:
    """Return (mean now / mean base) - 1 over a region; None if the base is dark."""
    if region.sum() < FEWEST_PX:
        return None
    before = float(np.mean(base[region], dtype=np.float64))
    if before <= 1e-6 * float(np.max(np.abs(base), initial=0.0)) or before == 0.0:
        return None
    return float(np.mean(now[region], dtype=np.float64)) / before - 1.0


def displacement_px(base: FloatArray, now: FloatArray, limb: NDArray[np.bool_]) -> float | None:
    """Return the rms displacement of the limb over blocks along it; None if it cannot be measured."""
    rows, columns = slopes(base)
    slope = np.hypot(rows, columns)
    steep = limb & (slope > 0.02 * float(slope[limb].max(initial=0.0)))
    found, weights = [], []
    for top in range(0, base.shape[0], BLOCK_PX):
        for left in range(0, base.shape[1], BLOCK_PX):
            part = (slice(top, top + BLOCK_PX), slice(left, left + BLOCK_PX))
            inside = steep[part]
            if inside.sum() < FEWEST_PX:
                continue
            matrix = np.stack([base[part][inside], -slope[part][inside]], axis=1)
            answer, _, rank, _ = np.linalg.lstsq(matrix, (now - base)[part][inside], rcond=None)
            if rank == 2:
                found.append(float(answer[1]))
                weights.append(float(np.sum(slope[part][inside] ** 2)))
    if not found:
        return None
    return float(np.sqrt(np.average(np.square(found), weights=weights)))


def noise_in_space(
    dn: NDArray[np.integer], noise_free: NDArray[np.integer], regions: NDArray[np.uint8]
) -> float | None:
    """Return the standard deviation [DN] of a detector image about the noise-free one, in space."""
    space = regions == SPACE
    if space.sum() < 100:
        return None
    residual = dn[space].astype(np.float64) - noise_free[space].astype(np.float64)
    return float(np.std(residual))


def compare_images(
    table: str,
    now: Mapping[str, Any],
    base: Mapping[str, Any],
    radiance: NDArray[np.floating] | None,
    frozen: FrozenFrame | None,
) -> dict[str, Any]:
    """Return the comparison of a re-rendered scene and band with the base.

    ``now``, ``base``: the bands' records: ``radiance_sha256``, ``images``, ``noise_dn``. ``radiance`` (shape (H, W)):
    of now; needed if the digests differ. ``frozen``: of the base, 12 bits. The result has ``table``, ``same_radiance``,
    ``same_images`` (of ``n_images``), ``limb_radiance`` and ``disc_radiance`` [%], ``limb_displacement`` [px],
    ``noise`` [%]; None where a metric does not apply.
    """
    same = now["radiance_sha256"] == base["radiance_sha256"]
    found: dict[str, Any] = {
        "table": table,
        "same_radiance": same,
        "same_images": sum(a == b for a, b in zip(now["images"], base["images"], strict=False)),
        "n_images": len(now["images"]),
        "limb_radiance": 0.0,
        "disc_radiance": 0.0,
        "limb_displacement": 0.0,
        "noise": _noise(now["noise_dn"], base["noise_dn"]),
    }
    if frozen is None or (not same and radiance is None):
        return found | {"limb_radiance": None, "disc_radiance": None, "limb_displacement": None}
    old = frozen.radiance
    # With equal digests the metric of an existing region is 0.
    new = old if same or radiance is None else np.asarray(radiance, dtype=np.float64)
    limb, disc = frozen.regions == LIMB, frozen.regions == DISC
    at_limb, on_disc, moved = bias(old, new, limb), bias(old, new, disc), displacement_px(old, new, limb)
    return found | {
        "limb_radiance": None if at_limb is None else PERCENT * at_limb,
        "disc_radiance": None if on_disc is None else PERCENT * on_disc,
        "limb_displacement": moved,
    }


def _noise(now: float | None, base: float | None) -> float | None:
    if now is None or base is None:
        return None
    if base == 0.0:
        return 0.0 if now == 0.0 else PERCENT
    return PERCENT * (now / base - 1.0)
