"""Parts of the spacecraft as the camera sees them: triangles, their outline, and the share of pixels they cover.

**Shapes.** A circle is a polygon of 512 corners and of the circle's area: with ``theta = pi / 512`` its corners lie
``theta^2 / 3`` of the radius outside (1.3e-5) and the middles of its sides half as far inside. A circle 1000 pixels
across is right to a hundredth of a pixel. Meshes are read by
:mod:`horizonval.geometry.mesh`.

**Outline.** Seen from the camera an edge of a triangle is an arc of a great circle, and on a plane across any axis
(gnomonic projection) a straight line. There the triangles are cut to the field of view and united, in float64, by GEOS.
The outline consists of the corners of the union, less those that move it by no more than a thousandth of a pixel. It is
plain data: with a camera it gives the covered share of every pixel without the parts' files. A camera that sees no
farther than 70 deg from its boresight needs one plane across its boresight, others the five faces of a cube that do not
lie behind it.

**Coverage.** Edges of the outline are drawn through the lens: halved until the chord between two points lies within a
thousandth of a pixel of the edge's image. The area of the polygon inside each pixel then follows from its edges alone
(Green's theorem, as fonts are drawn): an edge that climbs by ``dy`` inside a pixel covers all pixels to its right by
``dy``, and of its own what lies to its right. Without sampling the share is exact to a thousandth of a pixel times the
edge's length in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import brown
from horizonval.geometry.camera import CameraModel, in_image_circle, project, unproject, widest_angle
from horizonval.geometry.frames import from_yaw_pitch_roll, inverse, rotate
from horizonval.geometry.mesh import mesh_triangles
from horizonval.geometry.rotation import tangent_basis
from horizonval.spec.scene import SpacecraftPart

CORNERS = 512


def panel(width_m: float, height_m: float) -> FloatArray:
    """Return a rectangle across z, shape (2, 3, 3)."""
    x, y = 0.5 * width_m, 0.5 * height_m
    corner = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return corner[[[0, 1, 2], [0, 2, 3]]]


def disc(radius_m: float) -> FloatArray:
    """Return a circle across z, shape (n, 3, 3)."""
    return _fan(_circle(radius_m))


def tube(radius_m: float, end_radius_m: float, length_m: float) -> FloatArray:
    """Return an open tube or cone round z from z = 0, shape (n, 3, 3)."""
    near, far = _circle(radius_m), _circle(end_radius_m)
    far[:, 2] = length_m
    next_near, next_far = np.roll(near, -1, axis=0), np.roll(far, -1, axis=0)
    lower, upper = np.stack([near, next_near, next_far], axis=1), np.stack([near, next_far, far], axis=1)
    return np.concatenate([lower, upper])


def boom(radius_m: float, from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """Return a closed cylinder between two points, shape (n, 3, 3)."""
    axis = to_m - from_m
    length = float(np.linalg.norm(axis))
    axis = axis / length
    ends = _circle(radius_m)
    upright = np.concatenate(
        [tube(radius_m, radius_m, length), _fan(ends)[:, ::-1], _fan(ends + np.array([0.0, 0.0, length]))]
    )
    turned = upright @ np.column_stack([tangent_basis(axis), axis]).T
    return np.asarray(turned + from_m)


def shape_triangles(part: SpacecraftPart) -> FloatArray:
    """Return the triangles of a part that is no mesh, in its own axes [m], shape (n, 3, 3)."""
    if part.shape == "panel":
        assert part.width_m is not None
        assert part.height_m is not None
        return panel(part.width_m, part.height_m)
    assert part.radius_m is not None
    if part.shape == "disc":
        return disc(part.radius_m)
    if part.shape == "baffle":
        assert part.length_m is not None
        return tube(part.radius_m, part.end_radius_m or part.radius_m, part.length_m)
    assert part.from_m is not None
    assert part.to_m is not None
    return boom(part.radius_m, np.array(part.from_m), np.array(part.to_m))


def _circle(radius_m: float) -> FloatArray:
    """Return the corners of a circle's polygon across z, shape (n, 3)."""
    step = math.tau / CORNERS
    angle = np.arange(CORNERS) * step
    radius = radius_m * math.sqrt(step / math.sin(step))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(CORNERS)])


def _fan(ring: FloatArray) -> FloatArray:
    centre = np.broadcast_to(ring.mean(axis=0), ring.shape)
    return np.stack([centre, ring, np.roll(ring, -1, axis=0)], axis=1)


FARTHEST_M = 1e6
"""Distance of a part's corners from the camera."""
NEAREST_M = 1e-3
"""A surface nearer than this is taken to lie on the lens: the camera is a point."""


def triangles_cam(part: SpacecraftPart, q_cam_from_body: ArrayLike, where: str) -> FloatArray:
    """Return the triangles of a part in camera axes [m], seen from the camera, shape (n, 3, 3).

    UserError, at ``where``: a mesh that cannot be used, or a part that encloses or touches the camera.
    """
    if part.shape == "mesh":
        assert part.file is not None
        triangles = mesh_triangles(part.file, f"{where}.file") * (part.scale or 1.0)
    else:
        triangles = shape_triangles(part)
    turn = [math.radians(angle) for angle in (part.yaw_deg, part.pitch_deg, part.roll_deg)]
    triangles = rotate(inverse(from_yaw_pitch_roll(*turn)), triangles) + np.array(part.position_m)
    if part.frame == "body":
        triangles = rotate(q_cam_from_body, triangles)
    if not (np.abs(triangles) <= FARTHEST_M).all():
        raise UserError("lies too far from the camera", where=where, expected=f"corners within {FARTHEST_M:g} m")
    _refuse_around_camera(triangles, where)
    return triangles


def all_triangles_cam(parts: Sequence[SpacecraftPart], q_cam_from_body: ArrayLike) -> list[FloatArray]:
    """Return the triangles of every part, errors as :func:`triangles_cam`."""
    return [triangles_cam(part, q_cam_from_body, f"part[{i}] ({part.name})") for i, part in enumerate(parts, start=1)]


def blocked(triangles: FloatArray, directions: FloatArray) -> FloatArray:
    """Return which rays (n, 3) from the camera meet a triangle (m, 3, 3), shape (n,) (Möller and Trumbore 1997)."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal, towards = np.cross(u, v), np.cross(a, u)
    hit = np.zeros(len(directions), dtype=bool)
    for i, d in enumerate(directions):
        across = np.cross(d, v)
        det = np.einsum("ij,ij->i", u, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = np.einsum("ij,ij->i", -a, across) / det
            q = -(towards @ d) / det
            t = np.einsum("ij,ij->i", a, normal) / (normal @ d)
            hit[i] = bool(np.any((p >= 0.0) & (q >= 0.0) & (p + q <= 1.0) & (t > 0.0)))
    return hit


def _refuse_around_camera(triangles: FloatArray, where: str) -> None:
    nearest = float(_distance(triangles).min())
    if nearest < NEAREST_M:
        raise UserError(
            f"the part is {nearest * 1e3:.3g} mm from the camera's pupil",
            where=where,
            expected=f"{NEAREST_M * 1e3:g} mm or more",
            fix="move it with position_m",
        )
    if abs(_solid_angle(triangles)) > 0.999 * 4.0 * math.pi:
        raise UserError(
            "the part encloses the camera",
            where=where,
            expected="a camera outside of it",
            fix="move it with position_m",
        )


def _solid_angle(triangles: FloatArray) -> float:
    """Return the signed solid angle of a surface: 4 pi times its winding number (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles / np.linalg.norm(triangles, axis=-1, keepdims=True), 1, 0)
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    cosines = [np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a))]
    return float(2.0 * np.arctan2(triple, 1.0 + sum(cosines)).sum())


_TINY = float(np.finfo(np.float64).tiny)


def _distance(triangles: FloatArray) -> FloatArray:
    """Return how far triangles are from the origin, shape (n,): their plane where its foot is inside, else an edge."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    square = np.einsum("ij,ij->i", normal, normal)
    along = np.einsum("ij,ij->i", a, normal)
    # Without an area it is its edges.
    flat = square < _TINY
    square = np.maximum(square, _TINY)
    foot = normal * (along / square)[:, None] - a
    p = np.einsum("ij,ij->i", np.cross(foot, v), normal) / square
    q = np.einsum("ij,ij->i", np.cross(u, foot), normal) / square
    inside = ~flat & (p >= 0.0) & (q >= 0.0) & (p + q <= 1.0)
    start, edge = triangles, np.roll(triangles, -1, axis=1) - triangles
    share = np.clip(
        -np.einsum("ijk,ijk->ij", start, edge) / np.maximum(np.einsum("ijk,ijk->ij", edge, edge), _TINY), 0.0, 1.0
    )
    to_edge = np.linalg.norm(start + share[..., None] * edge, axis=-1).min(axis=1)
    return np.where(inside, np.abs(along) / np.sqrt(square), to_edge)


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
    """Return the outline of all parts, triangles in camera axes, in a camera's field of view.

    UserError: a lens that sees farther back than :data:`WIDEST_RAD`.
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

    Edges (n, 2) are those of closed polygons that do not overlap, with holes in the opposite sense; square (column,
    row) covers [column, column + 1] x [row, row + 1].
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
    if camera.wide:
        widest = widest_angle(camera) * (1.0 - 1e-6)
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
