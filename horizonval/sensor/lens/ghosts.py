"""Ghosts: faint images of the scene by two reflections between lens surfaces or the detector's window.

A ghost is the image scaled about the principal point c, seldom in focus::

    ghost(p) = ratio / scale^2 * image(c + (p - c) / scale),   then blurred

Every pixel of the image is taken as evenly lit, and its light is shared among the pixels that its scaled square covers:
the ghost of all that stays in the image holds ``ratio`` times its light, exactly, and nothing is below 0. The light is
added: what reflections take from the image is in the lens's measured transmission.

Neglected: change of the ratio over the field and of the shape (a pupil's image, mostly); ghosts of what is outside the
image.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel
from horizonval.spec.optics import Ghost

_CUT_SIGMA = 5.0


def ghost_image(image: FloatArray, camera: CameraModel, ghost: Ghost) -> FloatArray:
    """Return what the ghost adds to the image, shape (H, W)."""
    rows = _axis_map(camera.height, camera.cy, ghost.scale)
    columns = _axis_map(camera.width, camera.cx, ghost.scale)
    out = np.asarray((columns @ (rows @ image).T).T) * ghost.ratio
    if ghost.blur_px > 0:
        out = gaussian_filter(out, ghost.blur_px, mode="constant", truncate=_CUT_SIGMA)
    return out


def _axis_map(size: int, centre: float, scale: float) -> csr_array:
    """Return the matrix that takes light along one axis to its places in the ghost; columns sum to 1 or less."""
    source = np.arange(size)
    ends = centre + (np.stack([source - 0.5, source + 0.5]) - centre) * scale
    low, high = ends.min(axis=0), ends.max(axis=0)
    first = np.floor(low + 0.5).astype(np.intp)
    entries = []
    for step in range(int(np.ceil(abs(scale))) + 1):
        target = first + step
        overlap = np.minimum(high, target + 0.5) - np.maximum(low, target - 0.5)
        good = (overlap > 0) & (target >= 0) & (target < size)
        entries.append((overlap[good] / abs(scale), target[good], source[good]))
    values, to, origin = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return csr_array((values, (to, origin)), shape=(size, size))
