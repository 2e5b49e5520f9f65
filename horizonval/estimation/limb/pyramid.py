"""A picture at several sizes, and where the limb of a cone runs in it.

A limb tens of pixels deep at one size is an edge at another. Each level has half of the pixels a side of the one
before, each the mean of its neighbours with the weights (1, 4, 6, 4, 1) / 16 both ways (Burt and Adelson, IEEE Trans.
Communications 31, 532, 1983). A position ``uv`` of level ``k`` is ``2^k uv`` of the picture.

Pixels without a measurement are excluded at all levels: rows, columns and rectangles that a link lost and filled with
one value, and what a lens does not fill.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import NOISE_FLOOR, Picture, median, noise_sigma, percentile, pixel_directions
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import tangent_basis

COARSEST_PX = 24
"""No level's shorter side is shorter: a window across a limb has 17 pixels."""
LARGEST_FINE_PX = 320
"""Longer side of the largest level searched as a whole; larger ones are searched near a limb of a smaller one. A disc
of four pixels in a megapixel is still two wide."""


@dataclass(frozen=True)
class PyramidLevel:
    """One size of a picture.

    ``grey``, ``known``: shape (h, w), the latter marks measured pixels (None: all); ``scale``: picture pixels per
    pixel; ``floor``: smallest credible noise.
    """

    grey: NDArray[np.float32]
    known: NDArray[np.bool_] | None
    scale: float
    floor: float

    @cached_property
    def noise(self) -> float:
        """Standard deviation of a pixel's noise, by what neighbours show."""
        return max(noise_sigma(self.grey), self.floor)

    def at(self, uv: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the levels at places (..., 2) of this level, interpolated linearly, and which are known.

        Beyond the rim it is the level of the rim.
        """
        height, width = self.grey.shape
        u, v = uv[..., 0], uv[..., 1]
        inside = (u >= 0.0) & (v >= 0.0) & (u <= width - 1.0) & (v <= height - 1.0)
        u, v = np.clip(u, 0.0, width - 1.0), np.clip(v, 0.0, height - 1.0)
        column, row = np.minimum(u.astype(np.intp), width - 2), np.minimum(v.astype(np.intp), height - 2)
        first = row * width + column
        flat = self.grey.ravel()
        right, down = (u - column).astype(np.float32), (v - row).astype(np.float32)
        upper = flat[first] + right * (flat[first + 1] - flat[first])
        first += width
        lower = flat[first] + right * (flat[first + 1] - flat[first])
        if self.known is not None:
            inside &= self.known[np.rint(v).astype(np.intp), np.rint(u).astype(np.intp)]
        return np.asarray(upper + down * (lower - upper), dtype=np.float64), inside


def levels_of(picture: Picture, camera: CameraModel) -> list[PyramidLevel]:
    """Return the levels of a picture, the picture itself first."""
    known = known_pixels(picture, camera)
    grey = picture.single
    if known is not None:
        grey = _filled(grey, known)
    greys, scales = [grey], [1.0]
    while min(greys[-1].shape) >= 2 * COARSEST_PX:
        greys.append(np.asarray(cv2.pyrDown(greys[-1]), dtype=np.float32))
        scales.append(2.0 * scales[-1])
    low, high = (percentile(greys[-1], q) for q in (1.0, 99.0))
    # A picture of one level but for some pixels has a range of its own.
    floor = NOISE_FLOOR * ((high - low) or float(np.ptp(picture.grey)))
    shares = [None if known is None else known.astype(np.float32)]
    while len(shares) < len(greys):
        shares.append(None if shares[-1] is None else np.asarray(cv2.pyrDown(shares[-1]), dtype=np.float32))
    # A lost line is filled from both sides, a wide gap is not.
    knowns = [None if share is None else share > 0.7 for share in shares]
    return [PyramidLevel(*one, floor) for one in zip(greys, knowns, scales, strict=True)]


def known_pixels(picture: Picture, camera: CameraModel) -> NDArray[np.bool_] | None:
    """Return which pixels hold a measurement, shape (H, W); None if all do."""
    unknown = _lost_lines(picture.single)
    _mark_blocks(picture.single, unknown)
    if camera.image_circle_rad is not None:
        unknown |= ~np.isfinite(pixel_directions(camera)[:, :, 0])
    return ~unknown if unknown.any() else None


def _lost_lines(grey: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the pixels of rows and columns of one value between others that are not."""
    lost = np.zeros(grey.shape, dtype=bool)
    for image, out in ((grey, lost), (grey.T, lost.T)):
        # Two pixels of a line tell most lines that vary.
        flat = image[:, 0] == image[:, image.shape[1] // 2]
        some = np.flatnonzero(flat)
        flat[some] = (image[some] == image[some, :1]).all(axis=1)
        varied = np.flatnonzero(~flat)
        if flat.any() and len(varied):
            inner = flat.copy()
            inner[: varied[0]] = inner[varied[-1] :] = False
            out[inner] = True
    return lost


def _mark_blocks(grey: NDArray[np.float32], unknown: NDArray[np.bool_]) -> None:
    """Mark the rectangles of seven pixels a side and more that have the darkest value and no pixel of it next to them.

    Noise leaves none, and a horizon bends.
    """
    darkest = (grey == grey.min()).view(np.uint8)
    opened = cv2.morphologyEx(darkest, cv2.MORPH_OPEN, np.ones((7, 7), np.uint8))
    if not opened.any():
        return
    for left, top, wide, high, area in cv2.connectedComponentsWithStats(opened, connectivity=4)[2][1:]:
        around = darkest[max(top - 1, 0) : top + high + 1, max(left - 1, 0) : left + wide + 1]
        if area == wide * high == np.count_nonzero(around):
            unknown[top : top + high, left : left + wide] = True


def _filled(grey: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the picture with unknown pixels at the mean of known ones near by: they make no edges of their own."""
    filled = grey.copy()
    missing = ~known
    size = 5
    while missing.any() and size < 4 * max(grey.shape):
        weight = cv2.blur((~missing).astype(np.float32), (size, size))
        mean = cv2.blur(np.where(missing, np.float32(0.0), filled), (size, size))
        there = missing & (weight > 0.0)
        filled[there] = mean[there] / weight[there]
        missing &= ~there
        size *= 3
    return filled


STEP_RAD = 1e-5
"""Step of differences across the limb: far above rounding, far below a pixel."""


@dataclass(frozen=True)
class Trace:
    """n positions along a cone's limb, by azimuth.

    ``uv``: shape (n, 2) [px]; ``inwards``: shape (n, 2), unit vector across the limb towards the axis; ``px_rad``:
    shape (n,), angle of a pixel across the limb; ``azimuth``: shape (n,); ``spacing``: pixels between positions.
    """

    uv: FloatArray
    inwards: FloatArray
    px_rad: FloatArray
    azimuth: FloatArray
    spacing: float

    @cached_property
    def middle_px_rad(self) -> float:
        """Median angle of a pixel across the limb."""
        return median(self.px_rad)


def trace_limb(
    camera: CameraModel, axis_cam: FloatArray, rho_rad: float, spacing_px: float, most: int | None = None
) -> Trace:
    """Return evenly spaced positions of a cone's limb in the image.

    ``spacing_px``: smallest spacing; ``most``: largest number of positions.
    """
    frame = cone_frame(axis_cam)
    middle = _middle(camera) @ frame
    # First azimuths are dense towards the middle of the image, since a telescope sees a degree.
    share = np.linspace(-1.0, 1.0, 256)
    azimuth = (np.arctan2(middle[1], middle[0]) if np.isfinite(middle).all() else 0.0) + np.pi * share * np.abs(share)
    with np.errstate(invalid="ignore"):
        uv, _ = project(camera, on_cone(frame, rho_rad, azimuth))
        seen = _inside(camera, uv, 0.5)
        across, down = (uv[1:] - uv[:-1]).T
        step = np.where(seen[1:] | seen[:-1], np.sqrt(across * across + down * down), 0.0)
        along = np.concatenate([[0.0], np.cumsum(np.where(np.isfinite(step), step, 0.0))])
        length = float(along[-1])
        if length < 1.0:
            return Trace(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0), spacing_px)
        count = max(int(length / spacing_px), 2)
        count = count if most is None else min(count, most)
        azimuth = np.interp((np.arange(count) + 0.5) * (length / count), along, azimuth)
        # The place itself, one step further in, and one step further along.
        inwards, along = STEP_RAD * np.array([[[0.0], [-1.0], [0.0]], [[0.0], [0.0], [1.0]]])
        here, inner, after = project(camera, on_cone(frame, rho_rad + inwards, azimuth + along))[0]
        seen = _inside(camera, here, 0.0) & np.isfinite(inner[:, 0] + after[:, 0])
    here, azimuth = here[seen], azimuth[seen]
    radial, tangent = inner[seen] - here, after[seen] - here
    # Across the limb in the image, which is not where the axis lies: at right angles to the limb itself.
    turned = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    length_2 = np.maximum((turned * turned).sum(axis=1), 1e-300)
    across = (turned * radial).sum(axis=1) / np.sqrt(length_2)
    normal = turned * (np.where(across < 0.0, -1.0, 1.0) / np.sqrt(length_2))[:, None]
    return Trace(here, normal, STEP_RAD / np.maximum(np.abs(across), 1e-300), azimuth, length / count)


@lru_cache(maxsize=2)
def _middle(camera: CameraModel) -> FloatArray:
    """Return the line of sight of the image's middle, shape (3,)."""
    return unproject(camera, np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0]))


def _inside(camera: CameraModel, uv: FloatArray, margin: float) -> NDArray[np.bool_]:
    """Return which places (n, 2) lie in the image, or no further than a margin [px] beyond its outermost pixels."""
    u, v = uv.T
    columns = (u >= -margin) & (u <= camera.width - 1.0 + margin)
    return np.asarray(columns & (v >= -margin) & (v <= camera.height - 1.0 + margin))


def cone_frame(axis: FloatArray) -> FloatArray:
    """Return the tangent basis of a cone's axis and the axis as columns, shape (3, 3)."""
    return np.column_stack([tangent_basis(axis), axis])


def on_cone(frame: FloatArray, rho: float | FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return lines of sight on cones, shape (..., 3), of half-angles ``rho`` at azimuths (...) in a cone's frame."""
    sine = np.sin(rho)
    parts = np.empty((*np.broadcast_shapes(np.shape(rho), azimuth.shape), 3))
    parts[..., 0], parts[..., 1], parts[..., 2] = sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(rho)
    return np.asarray(parts @ frame.T)
