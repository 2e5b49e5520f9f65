"""The directions of a camera's pixels, kept for the next image of the same camera.

A flight of images has one camera, and to undistort a million pixels takes longer than most of what is asked of an
image.
"""

from __future__ import annotations

import threading
from collections import OrderedDict

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject

MOST_BYTES = 64 << 20
"""Of all cameras together: two of a megapixel. A larger camera is not kept."""


class PixelDirections:
    """Unit directions of pixel centres by camera; what was asked for longest ago goes first.

    Every number of a camera counts: two that differ in their distortion alone are two.

    Parameters
    ----------
    most_bytes : int
        Of all that is kept.
    """

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[CameraModel, FloatArray] = OrderedDict()
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """What is kept [bytes]."""
        return sum(directions.nbytes for directions in self._kept.values())

    def of(self, camera: CameraModel) -> FloatArray:
        """Return the unit directions in camera axes, shape (H, W, 3), read only; NaN where a pixel sees nothing."""
        with self._lock:
            directions = self._kept.pop(camera, None)
            if directions is None:
                directions = unproject(camera, pixel_grid(camera))
                directions.flags.writeable = False
            if directions.nbytes <= self._most_bytes:
                self._kept[camera] = directions
            while self.nbytes > self._most_bytes:
                self._kept.popitem(last=False)
        return directions


PIXEL_DIRECTIONS = PixelDirections()
"""Of this process."""
