"""Parts where the camera sees them: triangles in camera axes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.frames import from_yaw_pitch_roll, inverse, rotate
from horizonval.geometry.part.mesh_file import mesh_triangles
from horizonval.geometry.part.shapes import shape_triangles
from horizonval.spec.scene import SpacecraftPart

NEAREST_M = 1e-3
"""A surface nearer than this is taken to lie on the lens: the camera is a point."""


def triangles_cam(part: SpacecraftPart, q_cam_from_body: ArrayLike, where: str) -> FloatArray:
    """Return the triangles of a part in camera axes [m], seen from the camera, shape (n, 3, 3).

    Parameters
    ----------
    part : SpacecraftPart
    q_cam_from_body : array_like, shape (4,)
    where : str
        The part's place in the scene, for error messages.

    Raises
    ------
    UserError
        A mesh that cannot be used, or a part that encloses or touches the camera.
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
    _refuse_around_camera(triangles, where)
    return triangles


def all_triangles_cam(parts: Sequence[SpacecraftPart], q_cam_from_body: ArrayLike) -> list[FloatArray]:
    """Return the triangles of every part, errors as :func:`triangles_cam`."""
    return [triangles_cam(part, q_cam_from_body, f"part[{i}] ({part.name})") for i, part in enumerate(parts, start=1)]


def blocked(triangles: FloatArray, directions: FloatArray) -> FloatArray:
    """Return which rays from the camera meet a triangle, shape (n,), bool (Möller and Trumbore 1997).

    Parameters
    ----------
    triangles : ndarray, shape (m, 3, 3)
    directions : ndarray, shape (n, 3)
    """
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


def _distance(triangles: FloatArray) -> FloatArray:
    """Return how far triangles are from the origin, shape (n,): their plane where its foot is inside, else an edge."""
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    square = np.einsum("ij,ij->i", normal, normal)
    along = np.einsum("ij,ij->i", a, normal)
    foot = normal * (along / square)[:, None] - a
    p = np.einsum("ij,ij->i", np.cross(foot, v), normal) / square
    q = np.einsum("ij,ij->i", np.cross(u, foot), normal) / square
    inside = (p >= 0.0) & (q >= 0.0) & (p + q <= 1.0)
    start, edge = triangles, np.roll(triangles, -1, axis=1) - triangles
    share = np.clip(-np.einsum("ijk,ijk->ij", start, edge) / np.einsum("ijk,ijk->ij", edge, edge), 0.0, 1.0)
    to_edge = np.linalg.norm(start + share[..., None] * edge, axis=-1).min(axis=1)
    return np.where(inside, np.abs(along) / np.sqrt(square), to_edge)
