"""Where scan lines meet clouds: the relief of the renderer's own clouds, searched along each ray in numpy.

A ray is looked at in even steps from where it comes below the highest tops to where it meets the ground or leaves them
again; the crossing between the last step above the relief and the first below is taken as linear. A step is 5 km on
rays that graze the ground, and far less on all others: the largest structures of clouds there are. Steps that fall
between two narrow tops are missed.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.earth_pattern import BASE_M
from horizonval.earth.clouds.relief import CloudField, top_m
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geodetic_height, line_intersections, surface_normal

STEPS = 96


def distance_to_clouds(
    field: CloudField, observer_m: FloatArray, direction: FloatArray, ellipsoid: Ellipsoid = WGS84
) -> FloatArray:
    """Return how far [m] the first cloud is along rays (n, 3) from one observer (3,); nan where there is none."""
    first, last = line_intersections(observer_m, direction, ellipsoid.raised(field.top_m))
    ground, _ = line_intersections(observer_m, direction, ellipsoid)
    last = np.where(np.isfinite(ground), ground, last)
    out = np.full(len(direction), np.nan)
    low = np.flatnonzero(first > 0.0)
    share = np.linspace(0.0, 1.0, STEPS)
    t = first[low, None] + (last - first)[low, None] * share
    place = observer_m + t[..., None] * direction[low, None, :]
    normal = surface_normal(place, ellipsoid)
    top = top_m(field, normal.reshape(-1, 3)).reshape(t.shape)
    above = geodetic_height(place, ellipsoid) - np.where(top > BASE_M, top, -1e9)
    inside = above < 0.0
    met = np.flatnonzero(inside.any(axis=1))
    k = np.maximum(np.argmax(inside[met], axis=1), 1)
    before, after = above[met, k - 1], above[met, k]
    # Between clear sky and a cloud there is no slope: the cloud's wall stands at the step that is inside it.
    part = np.where(before < 1e8, before / np.where(before > after, before - after, 1.0), 1.0)
    out[low[met]] = t[met, k - 1] + np.clip(part, 0.0, 1.0) * (t[met, k] - t[met, k - 1])
    return out
