"""Suites with their orbits flown."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import get_args

from pydantic import ValidationError

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.geometry.pose import ellipsoid_from_spec
from horizonval.spec import load
from horizonval.spec.earth import Earth
from horizonval.spec.load import Suite
from horizonval.spec.orbit import OrbitSpec
from horizonval.spec.suite import Keep
from horizonval.suites.flight import fly


def load_suite(path_or_name: str | Path, frames: int | None = None, seed: int | None = None) -> Suite:
    """Read a suite file as :func:`horizonval.spec.load.load_suite` does; ``[cases.orbit]`` becomes scenes.

    ``frames`` and ``seed`` replace the suite's. Raises ``UserError``: a mistake, with file and key.
    """
    return load.load_suite(path_or_name, fly=fly_scene, frames=frames, seed=seed)


def with_options(suite: Suite, time_limit_s: float | None, keep: str | None) -> Suite:
    """Return a suite with the values of the command line. Raises ``UserError``: an invalid value."""
    if time_limit_s is not None:
        if not 0.0 < time_limit_s < math.inf:
            raise UserError(f"found {time_limit_s:g}", where="--time-limit", expected="a number of seconds above 0")
        words = ("--time-limit", f"{time_limit_s:g}")
        suite = replace(suite, time_limit_s=time_limit_s, options=(*suite.options, *words))
    if keep is None:
        return suite
    for word in get_args(Keep):
        if keep == word:
            return replace(suite, keep=word, options=(*suite.options, "--keep", keep))
    raise UserError(f"found {keep!r}", where="--keep", expected=" or ".join(get_args(Keep)))


def fly_scene(spec: OrbitSpec, scene: JsonObject, seed: int, name: str, where: str) -> tuple[list[JsonObject], str]:
    """Return the samples of an orbit over a scene's Earth, and a warning or nothing; ``where``: file and key.

    Raises ``UserError``: as :func:`horizonval.suites.flight.fly`.
    """
    try:
        earth = Earth.model_validate(scene.get("earth", {}), strict=True)
    except ValidationError:
        # The complete scene is validated later, with better messages.
        earth = Earth()
    try:
        return fly(spec, ellipsoid_from_spec(earth), seed, name, Path(where.partition(": ")[0]).parent)
    except UserError as e:
        # The place is a key of the orbit, or in a file that it names.
        is_key = e.where.partition(":")[0].partition(".")[0] in OrbitSpec.model_fields
        inner = f".{e.where}" if is_key else f": {e.where}" if e.where else ""
        raise e.at(f"{where}.orbit{inner}") from e
