"""Triangles of a mesh file: PLY, OBJ or glTF, read by trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError

KINDS = (".ply", ".obj", ".gltf", ".glb")
MOST_TRIANGLES = 200_000
EXPECTED = "a mesh: PLY, OBJ or glTF"


def mesh_triangles(file: str, where: str) -> FloatArray:
    """Return the triangles of a mesh in the file's own axes and unit, shape (n, 3, 3).

    Nodes of a glTF scene are where the file puts them. Faces of more than three corners are cut into triangles.

    Parameters
    ----------
    file : str
    where : str
        The part, for error messages.

    Raises
    ------
    UserError
        No such file, none that can be read, or without a surface: no triangles, places that are not finite, no area.
    """
    path = Path(file)
    place = f"{where}: {path}"
    if path.suffix.lower() not in KINDS:
        raise UserError(f"no mesh can be read from {path.suffix!r} files", where=place, expected=EXPECTED)
    try:
        files.ensure_file(path, expected=EXPECTED)
    except UserError as error:
        raise error.inside(where) from None
    # Loaded here: scenes without meshes have no use for it.
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        triangles = np.asarray(mesh.triangles, dtype=np.float64).reshape(-1, 3, 3)
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UserError(f"the mesh cannot be read: {reason}", where=place, expected=EXPECTED) from None
    if not len(triangles):
        raise UserError("the mesh has no triangles", where=place, expected="at least one")
    if len(triangles) > MOST_TRIANGLES:
        raise UserError(
            f"the mesh has {len(triangles)} triangles",
            where=place,
            expected=f"{MOST_TRIANGLES} at most",
            fix="simplify it",
        )
    if not np.isfinite(triangles).all():
        raise UserError("the mesh has corners that are not finite", where=place)
    area = 0.5 * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=-1)
    size = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    solid = area > 1e-14 * size**2
    if not solid.any():
        raise UserError("the mesh is degenerate: its triangles have no area", where=place, expected="a surface")
    return triangles[solid]
