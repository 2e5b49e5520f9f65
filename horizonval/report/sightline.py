"""Where a pixel looks, and how far above the true horizon, as few numbers as a page's code needs for every pixel.

Directions are interpolated between Chebyshev nodes over the image, which for lenses as smooth as these is exact to
about a thousandth of a degree or much better. The horizon is the tangent cone ``Q`` of the exact ellipsoid in camera
axes: in the vertical plane of a direction, at the angle ``theta`` from the nadir ``n`` towards ``e``, the horizon is
the root of ``n.Qn + 2 n.Qe tan(theta) + e.Qe tan(theta)^2 = 0``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from horizonval.frame import FrameTruth
from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import tangent_cone

NODES = 15
"""Along each side of the image."""
_SMALLEST_Z = 0.1


def sightline_of(truth: FrameTruth) -> dict[str, Any] | None:
    """Return ``{flat, directions, nadir, cone}``; ``None`` where some place in the image has no direction.

    ``directions`` has those of the nodes, row by row: ``x/z, y/z`` if ``flat``, else unit vectors. ``nadir``, the
    geocentric one, and the upper triangle of ``cone`` are in camera axes; light that is bent raises the cone.
    """
    camera = replace(truth.camera_model, image_circle_rad=None)
    node = np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    u = (camera.width - 1 + camera.width * node) / 2
    v = (camera.height - 1 + camera.height * node) / 2
    d = unproject(camera, np.stack(np.meshgrid(u, v), axis=-1)).reshape(-1, 3)
    if not np.isfinite(d).all():
        return None
    flat = bool((d[:, 2] > _SMALLEST_Z).all())
    values = d[:, :2] / d[:, 2:] if flat else d
    axes = rotate(truth.q_cam_from_itrs, np.eye(3))
    cone = axes.T @ tangent_cone(truth.r_itrs, truth.apparent_ellipsoid) @ axes
    cone /= np.abs(cone).max()
    return {
        "flat": flat,
        "directions": [round(float(value), 7) for value in values.ravel()],
        "nadir": [round(float(value), 9) for value in truth.nadir_geocentric_cam],
        "cone": [round(float(value), 10) for value in cone[np.triu_indices(3)]],
    }
