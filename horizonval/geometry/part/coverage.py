"""Which share of every pixel parts cover, from their outline, exactly.

Edges of the outline are drawn through the lens: halved until the chord between two points lies within a thousandth of a
pixel of the edge's image. The area of the polygon inside each pixel then follows from its edges alone (Green's theorem,
as fonts are drawn): an edge that climbs by ``dy`` inside a pixel covers all pixels to its right by ``dy``, and of its
own what lies to its right. No sampling: the share is exact to a thousandth of a pixel times the edge's length in it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry import brown
from horizonval.geometry.camera import CameraModel, in_image_circle, project
from horizonval.geometry.part.outline import Outline
from horizonval.spec.camera import turning_angle

CHORD_PX = 1e-3
ROUNDING = 1e-12
_FIRST_HALVINGS, _MOST_HALVINGS = 3, 16


def coverage(outline: Outline, camera: CameraModel) -> FloatArray:
    """Return the covered share of every pixel, shape (H, W), float64 from 0 to 1; 0 where the lens gives no light."""
    start, end = _image_edges(*outline.edges(), replace(camera, image_circle_rad=None))
    share = polygon_coverage(start + 0.5, end + 0.5, camera.width, camera.height)
    if camera.image_circle_rad is not None:
        share = np.where(in_image_circle(camera), share, 0.0)
    return share


def polygon_coverage(start: FloatArray, end: FloatArray, width: int, height: int) -> FloatArray:
    """Return the covered share of unit squares, shape (height, width).

    Parameters
    ----------
    start, end : ndarray, shape (n, 2)
        Edges (x, y) of closed polygons that do not overlap, holes running against their outlines; square (column, row)
        covers [column, column + 1] x [row, row + 1].
    """
    sign = np.sign(np.sum(start[:, 0] * end[:, 1] - end[:, 0] * start[:, 1])) or 1.0
    edges = np.stack([start, end], axis=1)
    edges = edges[(edges[:, :, 1].min(axis=1) < height) & (edges[:, :, 1].max(axis=1) > 0.0)]
    edges = _cut_at_whole_numbers(_limited(edges, 1, height), 1)
    row = np.floor(edges[:, :, 1].mean(axis=1)).astype(int)
    inside = (row >= 0) & (row < height)
    edges, row = edges[inside], row[inside]
    # left of the image an edge covers whole rows, and how it leans there does not matter
    pieces = _cut_at_whole_numbers(_limited(edges, 0, width), 0)
    row = np.clip(np.floor(pieces[:, :, 1].mean(axis=1)).astype(int), 0, height - 1)
    pieces[:, :, 0] = np.maximum(pieces[:, :, 0], 0.0)
    middle = pieces[:, :, 0].mean(axis=1)
    column = np.floor(middle).astype(int)
    kept = column < width
    row, column, middle = row[kept], column[kept], middle[kept]
    climb = (pieces[:, 1, 1] - pieces[:, 0, 1])[kept]
    share = np.zeros((height, width + 1))
    own = climb * (column + 1.0 - middle)
    np.add.at(share, (row, column), own)
    np.add.at(share, (row, column + 1), climb - own)
    # what an edge covers to its right runs on to the end of the row
    share = np.cumsum(share, axis=1)[:, :width]
    share = -sign * share
    # sums of what cancels leave some 1e-16 where nothing is
    return np.where(share < ROUNDING, 0.0, np.where(share > 1.0 - ROUNDING, 1.0, share))


def _image_edges(start: FloatArray, end: FloatArray, camera: CameraModel) -> tuple[FloatArray, FloatArray]:
    """Return the images of edges, shape (m, 2) each, in as many chords as they need."""
    straight = camera.projection == "pinhole" and not any(camera.distortion)
    if straight or not len(start):
        return _image(camera, start), _image(camera, end)
    starts, ends = [], []
    for halving in range(_MOST_HALVINGS + 1):
        middle = 0.5 * (start + end)
        u, v, m = (_image(camera, d) for d in (start, end, middle))
        done = np.linalg.norm(m - 0.5 * (u + v), axis=-1) <= CHORD_PX
        done &= halving >= _FIRST_HALVINGS
        if halving == _MOST_HALVINGS:
            done[:] = True
        starts.append(u[done])
        ends.append(v[done])
        start, middle, end = start[~done], middle[~done], end[~done]
        start, end = np.concatenate([start, middle]), np.concatenate([middle, end])
        if not len(start):
            break
    return np.concatenate(starts), np.concatenate(ends)


def _image(camera: CameraModel, d: FloatArray) -> FloatArray:
    """Return the images of directions; those beyond what the lens can image move towards the boresight until it can."""
    if camera.projection == "fisheye":
        widest = turning_angle(camera.distortion[:4]) * (1.0 - 1e-6)
        across = np.hypot(d[:, 0], d[:, 1])
        off = np.minimum(np.arctan2(across, d[:, 2]), widest)
        scale = np.sin(off) / np.maximum(across, 1e-300)
        d = np.column_stack([d[:, 0] * scale, d[:, 1] * scale, np.cos(off)])
    elif camera.projection == "pinhole":
        x, y = d[:, 0] / d[:, 2], d[:, 1] / d[:, 2]
        scale = np.minimum(
            1.0, brown.invertible_radius(camera.distortion) * (1.0 - 1e-6) / np.maximum(np.hypot(x, y), 1e-300)
        )
        d = np.column_stack([x * scale, y * scale, np.ones(len(d))])
    return project(camera, d)[0]


def _limited(edges: FloatArray, axis: int, most: int) -> FloatArray:
    """Cut edges where they enter and leave [0, most] along an axis, so that no far corner makes a million pieces."""
    for bound in (0.0, float(most)):
        a, b = edges[:, 0, axis], edges[:, 1, axis]
        crossing = (a < bound) != (b < bound)
        share = np.divide(bound - a, b - a, out=np.zeros_like(a), where=crossing)
        middle = edges[:, 0] + share[:, None] * (edges[:, 1] - edges[:, 0])
        middle[:, axis] = bound
        first, second = edges.copy(), edges[crossing].copy()
        first[crossing, 1] = middle[crossing]
        second[:, 0] = middle[crossing]
        edges = np.concatenate([first, second])
    return edges


def _cut_at_whole_numbers(edges: FloatArray, axis: int) -> FloatArray:
    """Return pieces of edges, shape (m, 2, 2), none of which passes a whole number along an axis.

    Edges that lie outside of the image along the axis have been cut at its border, and stay whole.
    """
    a, b = edges[:, 0, axis], edges[:, 1, axis]
    low, high = np.minimum(a, b), np.maximum(a, b)
    first = np.floor(low)
    count = np.maximum(np.ceil(high) - first, 1.0).astype(int)
    count[(high <= 0.0)] = 1
    owner = np.repeat(np.arange(len(edges)), count)
    number = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    lower = np.maximum(first[owner] + number, low[owner])
    upper = np.where(count[owner] == 1, high[owner], np.minimum(first[owner] + number + 1.0, high[owner]))
    length = b - a
    rising = length[owner] >= 0.0
    starts, stops = np.where(rising, lower, upper), np.where(rising, upper, lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = ((x - a[owner]) / length[owner] for x in (starts, stops))
    level = length[owner] == 0.0
    s, t = np.where(level, 0.0, s), np.where(level, 1.0, t)
    p, d = edges[owner, 0], edges[owner, 1] - edges[owner, 0]
    return np.stack([p + s[:, None] * d, p + t[:, None] * d], axis=1)
