"""What a case depends on, as one digest: equal digests mean equal results.

A case is a pure function of its scene, its camera, the atmosphere or profile file it may use, and the code. The code
enters with its own digest and not only with the version number, so that a result made by older code is never mistaken
for one of this code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from functools import cache
from importlib.resources import files
from pathlib import Path

import horizonval
from horizonval.core.errors import UserError
from horizonval.spec.files import find
from horizonval.spec.load import Case, Suite
from horizonval.stability.case import StabilityCase
from horizonval.suites.plan import CasePlan, Unit, plan_of

_STABILITY_ROOMS = ("stability", "renderer", "earth", "geometry", "spec")
_FRAME_ROOMS = ("renderer", "frame.py", "truth.py", "infrared_horizon", "earth", "geometry", "spec", "archive")


def code_version() -> str:
    """Return the version and a digest of everything in the package that can change a result."""
    return f"{horizonval.__version__}+{_code_digest(('',))[:12]}"


def frame_identity(case: Case) -> str:
    """Return the digest of what a frame depends on; detectors, estimators and scores do not change a frame."""
    return _digest(_scene_content(case), _code_digest(_FRAME_ROOMS))


def case_identity(case: Case, estimators: tuple[str, ...]) -> str:
    """Return the digest of what a case's results depend on."""
    return _digest(_scene_content(case), json.dumps(estimators), code_version())


def unit_identity(unit: Unit, plan: CasePlan) -> str:
    """Return the digest of what the results of a unit depend on: all its cases, their estimators, what is kept."""
    content = plan.content(plan.of(unit.cases[0]))
    return _digest(*(_scene_content(case) for case in unit.cases), content, code_version())


def suite_identity(suite: Suite) -> str:
    """Return the digest of a suite's frames, estimators and study, whatever code runs them."""
    more = [] if suite.stability is None else [suite.stability.model_dump_json()]
    if suite.programs or suite.keep != "all" or suite.draws != 1:
        more.append(plan_of(suite).content())
    if any(case.estimators is not None for case in suite.cases):
        more.append(json.dumps([case.estimators for case in suite.cases]))
    return _digest(suite.name, json.dumps(suite.estimators), *(_scene_content(case) for case in suite.cases), *more)


def stability_identity(case: StabilityCase) -> str:
    """Return the digest of what the profiles of a study's case depend on."""
    return _digest(case.spec.model_dump_json(), case.name, _code_digest(_STABILITY_ROOMS))


def rescored_identity(addresses: Iterable[str], estimators: Iterable[str]) -> str:
    """Return the digest of what the results of archived images depend on: their bytes, the estimators, the code."""
    return _digest(json.dumps([*addresses]), json.dumps([*estimators]), code_version())


def _scene_content(case: Case) -> str:
    content = {"scene": case.scene.model_dump(mode="json"), "camera": case.camera.model_dump(mode="json")}
    for key, path in _atmosphere_files(case).items():
        try:
            content[f"atmosphere {key}"] = {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        except OSError as e:
            raise UserError(e.strerror or "cannot be read", where=str(path), expected="an atmosphere file") from e
        # The content counts, not where it lies: a folder can be moved.
        content["scene"]["atmosphere"][key] = path.name
    return json.dumps(content, sort_keys=True)


def _atmosphere_files(case: Case) -> dict[str, Path]:
    """Return the files that a case's atmosphere is read from, by the key that names them."""
    atmosphere = case.scene.atmosphere
    found = {}
    if atmosphere.file is not None:
        found["file"] = find("atmosphere", atmosphere.file)
    if atmosphere.profile_file is not None:
        found["profile_file"] = Path(atmosphere.profile_file)
    return found


@cache
def _code_digest(rooms: tuple[str, ...]) -> str:
    """Digest of the package's Python files and data tables below ``rooms`` (paths relative to the package)."""
    package = Path(str(files("horizonval")))
    digest = hashlib.sha256()
    chosen = (
        p
        for room in rooms
        for p in ([package / room] if (package / room).is_file() else (package / room).rglob("*"))
        if p.is_file() and p.suffix in (".py", ".npz", ".csv", ".json")
    )
    for path in sorted(chosen):
        digest.update(f"{path.relative_to(package).as_posix()}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _digest(*parts: str) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()
