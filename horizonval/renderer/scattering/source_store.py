"""Diffuse fields on disk: solved once for every column of air, found again by its content.

The key is a hash of everything the solution depends on: the planet's radius, the columns, the phase functions, the
quality and the version of the method. Albedo, Sun, camera and scene are not in it. Files are written aside and moved
into place, so that runs side by side cannot harm each other; a damaged file is solved again.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.cache import cached_arrays, keep_arrays, log_damage
from horizonval.core.environment import cache_folder
from horizonval.core.errors import DamagedFileError
from horizonval.core.progress import Progress, made_once
from horizonval.earth.column import SpectralNode
from horizonval.renderer.scattering.diffuse_field import DiffuseField, MultipleScattering
from horizonval.renderer.scattering.multiple_scattering import solve
from horizonval.renderer.scattering.quality import Quality, degree_of
from horizonval.renderer.scattering.shell_column import SOLVED_TOGETHER, field_heights, layer_bands
from horizonval.renderer.tables import SunTable

METHOD = 3
"""To be raised with every change of the method that changes its numbers."""

_KEPT = 64
_memory: OrderedDict[str, MultipleScattering] = OrderedDict()


def content_key(node: SpectralNode, altitude_m: FloatArray, planet_m: float, quality: Quality) -> str:
    """Return the name under which a solution is kept."""
    digest = hashlib.sha256()
    digest.update(repr((METHOD, planet_m, node.molecular_cos2, astuple(quality))).encode())
    for column in (altitude_m, node.extinction_per_m, node.molecular_per_m, node.particle_per_m, node.asymmetry):
        digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
    if len(node.layer_per_m):
        digest.update(np.ascontiguousarray(node.layer_per_m, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(node.forward_per_m, dtype="<f8").tobytes())
        heights = field_heights(float(altitude_m[-1]), quality.n_height, layer_bands(node, altitude_m))
        digest.update(np.ascontiguousarray(heights, dtype="<f8").tobytes())
    return digest.hexdigest()[:32]


def multiple_scattering(
    nodes: Sequence[SpectralNode],
    altitude_m: FloatArray,
    planet_m: float,
    quality: Quality,
    sun_table: Callable[[Sequence[SpectralNode]], SunTable],
    progress: Progress | None = None,
) -> list[MultipleScattering]:
    """Return solutions from memory, from disk, or solved now.

    ``sun_table`` is asked only then, for tables ``SOLVED_TOGETHER`` wide.
    """
    keys = [content_key(node, altitude_m, planet_m, quality) for node in nodes]
    solutions: dict[str, MultipleScattering] = {}
    missing: dict[int, dict[str, SpectralNode]] = {}
    for key, node in zip(keys, nodes, strict=True):
        degree = degree_of(node, quality)
        top_m, bands = float(altitude_m[-1]), layer_bands(node, altitude_m)
        heights = field_heights(top_m, quality.n_height, bands) if bands else None
        solution = _memory.get(key) or _read(_path(key), key, top_m, planet_m, degree, heights)
        if solution is None:
            missing.setdefault(degree, {})[key] = node
        else:
            solutions[key] = solution
    for columns in missing.values():
        for first in range(0, len(columns), SOLVED_TOGETHER):
            together = dict(list(columns.items())[first : first + SOLVED_TOGETHER])
            some = list(together.values())
            with made_once("tables"):
                solved = solve(some, altitude_m, planet_m, sun_table(some), quality, progress)
            for key, solution in zip(together, solved, strict=True):
                _write(_path(key), key, solution)
                solutions[key] = solution
    for key, solution in solutions.items():
        _memory[key] = solution
        _memory.move_to_end(key)
    while len(_memory) > _KEPT:
        _memory.popitem(last=False)
    return [solutions[key] for key in keys]


def _path(key: str) -> Path:
    return cache_folder() / "scattering" / f"{key}.npz"


def _write(path: Path, key: str, solution: MultipleScattering) -> None:
    """Keep a solution."""
    arrays = {
        "key": np.asarray(key),
        "air": solution.air.moments,
        "air_irradiance": solution.air.irradiance,
        "bounce": solution.bounce.moments,
        "bounce_irradiance": solution.bounce.irradiance,
        "spherical_albedo": np.asarray(solution.spherical_albedo),
    }
    keep_arrays(path, arrays)


def _read(
    path: Path, key: str, top_m: float, planet_m: float, degree: int, heights: FloatArray | None
) -> MultipleScattering | None:
    data = cached_arrays(path)
    if data is None:
        return None
    if str(data.get("key")) != key:
        log_damage(DamagedFileError("holds the solution of another column of air", where=str(path)))
        return None
    fields = [
        DiffuseField(top_m, planet_m, degree, data[name], data[f"{name}_irradiance"], heights)
        for name in ("air", "bounce")
    ]
    return MultipleScattering(fields[0], fields[1], float(data["spherical_albedo"]))
