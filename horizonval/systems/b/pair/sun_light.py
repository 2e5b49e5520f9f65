"""A frame without the Sun's own light in the lens: the other half of every pair of observations.

What the Sun lights (ground, air, clouds) stays as it is. What goes is what comes straight from its disc: its image,
hence that image's ghosts, scatter and spread, and what lens and baffle let in of a Sun outside the frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from horizonval.frame import FrameTruth, RadianceFrame
from horizonval.geometry.camera import pixel_grid, unproject

EDGE_PX = 1.5
"""Beyond the disc's edge: half a diagonal of a pixel, and as much again for refraction."""


def without_sunlight(frame: RadianceFrame) -> RadianceFrame:
    """Return the frame with the Sun's disc taken out of the image, and without a Sun for stray light.

    Pixels that the disc may touch take the radiance of their row to the left and to the right of it, on a straight
    line between the two: space, or the thin upper air.
    """
    touched = sun_pixels(frame.truth)
    radiance = {}
    for band, values in frame.radiance.items():
        filled = np.array(values)
        for row in np.flatnonzero(touched.any(axis=1)):
            gone = touched[row]
            if not gone.all():
                columns = np.arange(len(gone))
                filled[row, gone] = np.interp(columns[gone], columns[~gone], filled[row, ~gone])
        radiance[band] = filled
    return replace(frame, radiance=radiance, truth=replace(frame.truth, sun_visible_fraction=0.0))


def sun_pixels(truth: FrameTruth) -> NDArray[np.bool_]:
    """Return which pixels the Sun's disc may touch, shape (H, W)."""
    camera = truth.camera_model
    los = unproject(camera, pixel_grid(camera))
    apart = np.linalg.norm(los - np.array(truth.sun_cam), axis=-1)
    reach = truth.sun_angular_radius_rad + EDGE_PX / min(camera.fx, camera.fy)
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * apart, 1.0)) < reach) & (truth.sun_visible_fraction > 0.0)
