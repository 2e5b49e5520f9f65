"""The outline of parts as the camera sees them: polygons on faces of a cube round the camera, where edges are straight.

Seen from the camera an edge of a triangle is an arc of a great circle, and on a plane across any axis (gnomonic
projection) a straight line. There the triangles are cut to the field of view and united, in float64, by GEOS. What is
kept are the corners of the union, less those that move it by no more than a thousandth of a pixel. It is plain data:
with a camera it says which share of every pixel is covered, without the parts' files.

A camera that looks no farther than 70 deg from its boresight needs one face, the plane across its boresight, as large
as its image. Others have the five faces of a cube that do not lie behind it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, unproject

ONE_FACE_RAD = math.radians(70.0)
WIDEST_RAD = math.radians(125.0)
"""Directions farther off may lie behind all five faces."""
WIDEST_EQUAL_ANGLE_RAD = math.radians(85.0)
"""At 90 deg of elevation its image is a line."""
SIMPLER_PX = 1e-3
GRID = 1e-9
"""To which corners on faces are rounded: a millionth of a pixel."""
_MARGIN = 1.02

_FACES: dict[str, FloatArray] = {
    "+z": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "+x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "+y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}
"""Rows: two directions in a face and the one across it, right-handed, so that no face turns an outline round."""

Rings = list[FloatArray]


@dataclass(frozen=True)
class Outline:
    """What parts cover: closed rings of corners (n, 2) on each face, outer ones and holes running opposite ways.

    ``rings``: by the face's name. ``reach``: half the faces' width and height.
    """

    rings: dict[str, Rings]
    reach: tuple[float, float]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        rings = {face: [ring.tolist() for ring in rings] for face, rings in self.rings.items() if rings}
        return {"reach": list(self.reach), "rings": rings}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Outline:
        """Rebuild from :meth:`to_dict`."""
        rings = {face: [np.array(ring, dtype=np.float64) for ring in rings] for face, rings in data["rings"].items()}
        return cls(rings, (float(data["reach"][0]), float(data["reach"][1])))

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Return both ends of all edges as directions in camera axes, shape (n, 3) each."""
        starts, ends = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for face, rings in self.rings.items():
            for ring in rings:
                corner = np.column_stack([ring, np.ones(len(ring))]) @ _FACES[face]
                starts.append(corner)
                ends.append(np.roll(corner, -1, axis=0))
        return np.concatenate(starts), np.concatenate(ends)

    def covers(self, d_cam: FloatArray) -> NDArray[np.bool_]:
        """Return which directions, shape (n, 3), lie behind a part; right in the field of view of the camera."""
        covered = np.zeros(len(d_cam), dtype=bool)
        for face, rings in self.rings.items():
            x, y, z = _FACES[face] @ d_cam.T
            index = np.flatnonzero((z > 0.0) & (np.abs(x) <= self.reach[0] * z) & (np.abs(y) <= self.reach[1] * z))
            x, y = x[index] / z[index], y[index] / z[index]
            inside = np.zeros(len(index), dtype=bool)
            for ring in rings:
                inside ^= _inside_ring(ring, x, y)
            covered[index] |= inside
        return covered


def outline_of(triangles: Sequence[FloatArray], camera: CameraModel) -> Outline:
    """Return the outline of all parts together in a camera's field of view.

    Parameters
    ----------
    triangles : sequence of ndarray, shape (n, 3, 3)
        Of each part, in camera axes.
    camera : CameraModel

    Raises
    ------
    UserError
        A lens that sees farther back than :data:`WIDEST_RAD`.
    """
    faces, reach = _faces_of(camera)
    everything = np.concatenate([np.zeros((0, 3, 3)), *triangles])
    tolerance = SIMPLER_PX / max(camera.fx, camera.fy)
    return Outline({face: _united(everything @ _FACES[face].T, reach, tolerance) for face in faces}, reach)


def _faces_of(camera: CameraModel) -> tuple[list[str], tuple[float, float]]:
    u, v = np.linspace(-0.5, camera.width - 0.5, 65), np.linspace(-0.5, camera.height - 0.5, 65)
    image = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    d = unproject(replace(camera, image_circle_rad=None), image)
    d = d[np.isfinite(d).all(axis=-1)]
    off = np.arctan2(np.hypot(d[:, 0], d[:, 1]), d[:, 2])
    seen = off if camera.image_circle_rad is None else off[off <= camera.image_circle_rad]
    widest = float(seen.max(initial=0.0))
    if camera.image_circle_rad is not None:
        widest = min(camera.image_circle_rad, widest * _MARGIN + 0.01)
    limit = WIDEST_EQUAL_ANGLE_RAD if camera.projection == "equal_angle" else WIDEST_RAD
    if widest > limit:
        raise UserError(
            f"the lens sees {math.degrees(widest):.4g} deg off its boresight",
            where="part",
            expected=f"{math.degrees(limit):g} deg at most in scenes with parts",
        )
    if widest <= ONE_FACE_RAD:
        near = d[off <= widest + 1e-9]
        x, y = (float(np.abs(near[:, k] / near[:, 2]).max(initial=0.0)) for k in (0, 1))
        if camera.image_circle_rad is not None:
            x = y = math.tan(widest)
        return ["+z"], (x * _MARGIN, y * _MARGIN)
    return list(_FACES), (1.0, 1.0)


def _united(triangles: FloatArray, reach: tuple[float, float], tolerance: float) -> Rings:
    """Return the rings of the union of triangles, in axes of a face, inside the face."""
    # Loaded here: scenes without parts have no use for it.
    import shapely

    planes = np.array([[1.0, 0.0, reach[0]], [-1.0, 0.0, reach[0]], [0.0, 1.0, reach[1]], [0.0, -1.0, reach[1]]])
    side = triangles @ planes.T
    out = (side <= 0.0).all(axis=1).any(axis=1)
    whole = (side >= 0.0).all(axis=(1, 2)) & ~out
    rings = list(triangles[whole][..., :2] / triangles[whole][..., 2:])
    for triangle in triangles[~whole & ~out]:
        corners = _clipped(triangle, planes)
        if len(corners) >= 3:
            rings.append(corners[:, :2] / corners[:, 2:])
    solid = [ring for ring in rings if abs(_area(ring)) > 1e-16]
    if not solid:
        return []
    # On a grid GEOS rounds safely; in plain float64 it loses slivers (2.2: 0.2 % of a tube's area).
    union = shapely.union_all([shapely.Polygon(ring) for ring in solid], grid_size=GRID)
    union = union.simplify(tolerance, preserve_topology=True)
    found: Rings = []
    for polygon in shapely.get_parts(union):
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            continue
        for k, ring in enumerate((polygon.exterior, *polygon.interiors)):
            corners = np.asarray(ring.coords)[:-1, :2]
            found.append(corners if (_area(corners) > 0.0) == (k == 0) else corners[::-1].copy())
    return found


def _clipped(polygon: FloatArray, planes: FloatArray) -> FloatArray:
    """Return a convex polygon, shape (n, 3), cut by planes through the origin (Sutherland and Hodgman 1974)."""
    for plane in planes:
        if not len(polygon):
            break
        side = polygon @ plane
        ahead, side_ahead = np.roll(polygon, -1, axis=0), np.roll(side, -1)
        kept: list[FloatArray] = []
        for p, q, s, t in zip(polygon, ahead, side, side_ahead, strict=True):
            if s >= 0.0:
                kept.append(p)
            if (s >= 0.0) != (t >= 0.0):
                kept.append(p + (q - p) * (s / (s - t)))
        polygon = np.array(kept).reshape(-1, 3)
    return polygon[polygon[:, 2] > 0.0] if len(polygon) else polygon


def _area(ring: FloatArray) -> float:
    x, y = ring[:, 0] - ring[0, 0], ring[:, 1] - ring[0, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _inside_ring(ring: FloatArray, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Return which points lie inside a ring: an odd number of its edges to their right."""
    inside = np.zeros(len(x), dtype=bool)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        across = (y0 > y) != (y1 > y)
        if across.any():
            inside[across] ^= x[across] < x0 + (y[across] - y0) * ((x1 - x0) / (y1 - y0))
    return inside
