"""Digest of everything that a case depends on: equal digests mean equal results.

A case is a pure function of its scene, its camera, its atmosphere or profile file, and the code. The digest of the code
(:mod:`horizonval.core.code`) enters, not only the version number. It covers only the packages that affect the result:
estimators do not change frames, and report pages change nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from horizonval.core import files
from horizonval.core.code import FRAME_ROOMS, code_digest
from horizonval.plugins import registry
from horizonval.spec.files import find
from horizonval.spec.load import Case, Suite
from horizonval.spec.prior import is_climate_file
from horizonval.suites.plan import CasePlan, Unit, plan_of


def code_of(estimators: Iterable[str]) -> tuple[str, ...]:
    """Return the modules of estimators; programs are files, see :class:`CasePlan`."""
    return tuple(sorted({module for name in estimators if (module := registry.module_of(name)) is not None}))


def frame_identity(case: Case) -> str:
    """Return the digest of a frame's inputs; detectors, estimators and scores do not affect it."""
    return _digest(_scene_content(case), code_digest(rooms=FRAME_ROOMS))


def unit_identity(unit: Unit, plan: CasePlan) -> str:
    """Return the digest of a unit's inputs: its cases, their estimators, what the archive keeps."""
    estimators = plan.of(unit.cases[0])
    code = code_digest(*code_of(estimators))
    return _digest(*(_scene_content(case) for case in unit.cases), plan.content(estimators), code)


def suite_identity(suite: Suite) -> str:
    """Return the digest of a suite's frames, estimators and study, without the code."""
    more = [] if suite.stability is None else [suite.stability.model_dump_json()]
    if suite.programs or suite.keep != "all" or suite.draws != 1:
        more.append(plan_of(suite).content())
    if any(case.estimators is not None for case in suite.cases):
        more.append(json.dumps([case.estimators for case in suite.cases]))
    return _digest(suite.name, json.dumps(suite.estimators), *(_scene_content(case) for case in suite.cases), *more)


def rescored_identity(
    addresses: Iterable[str], estimators: Sequence[str], plan: CasePlan, climates: Iterable[Path] = ()
) -> str:
    """Return the digest of the inputs of rescored images: bytes, estimators, the files of programs, code.

    Climate files of the priors count too: an image holds only their paths.
    """
    names = [*estimators]
    air = [files.sha256_of(path, expected="a climate's file") if path.exists() else "" for path in sorted(climates)]
    return _digest(json.dumps([*addresses]), plan.content(names), json.dumps(air), code_digest(*code_of(names)))


def _scene_content(case: Case) -> str:
    content = {"scene": case.scene.model_dump(mode="json"), "camera": case.camera.model_dump(mode="json")}
    for key, path in _atmosphere_files(case).items():
        content[f"atmosphere {key}"] = {"sha256": files.sha256_of(path, expected="an atmosphere file")}
        # The content counts, not the path: a folder can be moved.
        content["scene"]["atmosphere"][key] = path.name
    climate = None if case.scene.prior is None else case.scene.prior.climate
    if climate is not None and is_climate_file(climate):
        content["prior climate"] = {"sha256": files.sha256_of(Path(climate), expected="a climate's file")}
        content["scene"]["prior"]["climate"] = Path(climate).name
    return json.dumps(content, sort_keys=True)


def _atmosphere_files(case: Case) -> dict[str, Path]:
    """Return the files of a case's atmosphere, by key."""
    atmosphere = case.scene.atmosphere
    found = {}
    if atmosphere.file is not None:
        found["file"] = find("atmosphere", atmosphere.file)
    if atmosphere.profile_file is not None:
        found["profile_file"] = Path(atmosphere.profile_file)
    return found


def _digest(*parts: str) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part.encode()).digest())
    return digest.hexdigest()
