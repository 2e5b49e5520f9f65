"""From a study file to its designs and to the suite of their frames.

A *design* is an entry of ``[design]`` with one estimator. Designs that differ only in the estimator share their frames.
A *condition* is a scene of ``[frames]``. A frame is named ``<design without estimator>__<condition>``, and its random
numbers are drawn under the condition's name. Names follow from the values of the axes, so a frame keeps its name and
result when values are added. An estimator added later recomputes the results of all frames, without rendering those
that `keep` stores.

``study-plan.json`` lets a folder compute its results without the study file.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError, nearest
from horizonval.core.files import LONGEST_FRAME_NAME, LONGEST_GENERATED_NAME, shortened
from horizonval.core.json_types import JsonObject
from horizonval.spec.base import deep_merge
from horizonval.spec.expand import variants
from horizonval.spec.explain import show, with_option
from horizonval.spec.files import find
from horizonval.spec.load import Case, Suite, read_toml, suite_of, validate
from horizonval.spec.requirement import Requirement
from horizonval.spec.suite import CasesSpec, StudyHead, StudySpec, SuiteHead, SuiteSpec
from horizonval.store.folder import read_json, write_json
from horizonval.studies.trade import cost
from horizonval.suites.record import value_at
from horizonval.suites.suite import fly_scene

ESTIMATOR_AXIS = "estimator"
MOST_DESIGNS = 10_000
_TABLE = "frames"
PLAN_FILE = "study-plan.json"
PLAN_SCHEMA = 2


@dataclass(frozen=True)
class DesignEntry:
    """An entry of ``[design]``: its name, its values on the axes, what it changes, its estimators and costs."""

    name: str
    settings: dict[str, Any]
    scene: JsonObject
    orbit: JsonObject
    estimators: tuple[str, ...]
    costs: dict[str, float]


@dataclass(frozen=True)
class Design:
    """A design as the study's results know it.

    ``frames``: name of its entry, the beginning of its frames' names. ``settings``: values on the axes, including the
    estimator if there are several. ``width``, ``height``, ``heads``: pixels of an image, and images of an estimate.
    ``costs``: numbers of the file, summed over its options.
    """

    name: str
    frames: str
    estimator: str
    settings: dict[str, Any]
    camera: str
    width: int
    height: int
    heads: int
    costs: dict[str, float] = field(default_factory=dict)


def limit_of(requirements: Sequence[Requirement]) -> Requirement:
    """Return the first requirement with an error; :class:`StudySpec` makes sure that there is one."""
    return next(one for one in requirements if one.error_deg is not None)


@dataclass(frozen=True)
class StudyPlan:
    """Designs, conditions and frames of a study.

    ``conditions``: cluster of every condition: samples of one flight are one cluster if there are several flights.
    ``frames``: entry and condition of every frame, by case.
    """

    head: StudyHead
    requirements: tuple[Requirement, ...]
    designs: tuple[Design, ...]
    conditions: dict[str, str]
    frames: dict[str, tuple[str, str]]

    @property
    def limit(self) -> Requirement:
        """The requirement whose error is the limit of the page's tables."""
        return limit_of(self.requirements)

    @property
    def limit_deg(self) -> float:
        return self.limit.error_deg or math.inf

    def design(self, name: str, where: str) -> Design:
        """Return the design of a name, or of a number from 1. Raises ``UserError``: no such design."""
        for number, design in enumerate(self.designs, start=1):
            if name in (design.name, str(number)):
                return design
        known = ", ".join(nearest(name, [design.name for design in self.designs])[:8])
        raise UserError(f"no design {name!r}", where=where, expected=f"a number up to {len(self.designs)}, or {known}")


@dataclass(frozen=True)
class Study(StudyPlan):
    """An expanded study, with the suite of its frames."""

    suite: Suite


def read_study(path_or_name: str | Path, frames: int | None = None) -> tuple[StudySpec, Path]:
    """Read a study file; ``frames`` replaces the number of Sobol points, or else of the orbit's samples.

    Raises ``UserError``: a mistake, with file and key.
    """
    path = find("study", path_or_name)
    spec = validate(StudySpec, read_toml(path), str(path))
    if frames is None:
        return spec, path
    if spec.frames.sobol is not None:
        change: JsonObject = {"sobol": with_option(spec.frames.sobol, "n", frames, "--frames")}
    elif spec.frames.orbit is not None:
        change = {"orbit": spec.frames.orbit | {"n": frames}}
    else:
        raise UserError("the study draws no frames", where="--frames", expected="a study with frames.sobol or .orbit")
    return spec.model_copy(update={"frames": spec.frames.model_copy(update=change)}), path


def expand(spec: StudySpec, path: Path) -> Study:
    """Return a study with its designs and the suite of their frames; other files are relative to ``path``.

    Raises ``UserError``: a mistake in the file.
    """
    entries = list(_entries(spec, path))
    _check_keys(spec, entries, path)
    cost.read_price(spec.study.cheapest_by, entries[0].costs, f"{path}: study.cheapest_by")
    designs: list[Design] = []
    cases: list[Case] = []
    frames: dict[str, tuple[str, str]] = {}
    clusters: dict[str, str] = {}
    used: dict[str, None] = {}
    for entry in entries:
        entry_cases = _cases(spec, path, entry)
        used |= dict.fromkeys(entry.estimators)
        for condition, case in entry_cases:
            frame = _frame_of(case, entry, condition)
            cases.append(frame)
            cluster = _cluster(spec, case, condition)
            # Each head is a frame; a method of all heads has one under the scene's name.
            frames[frame.scene_name] = (entry.name, condition)
            clusters.setdefault(condition, cluster)
            if frame.head is not None:
                frames[frame.name] = (entry.name, f"{condition}.{frame.head}")
                clusters.setdefault(f"{condition}.{frame.head}", cluster)
        designs += [_design(entry, estimator, entry_cases[0][1], spec) for estimator in entry.estimators]
    if len({design.name for design in designs}) < len(designs):
        raise UserError("two designs have the same name", where=f"{path}: design", fix="rename one in design.list")
    head = spec.study
    suite = Suite(
        head.name,
        head.title,
        tuple(used),
        tuple(cases),
        str(path),
        programs=tuple(program for program in spec.estimator if program.name in used),
        keep=head.keep,
        time_limit_s=head.time_limit_s,
        memory_limit_mb=head.memory_limit_mb,
        study=True,
    )
    if len(set(clusters.values())) == 1:
        # A single flight gives no variation between flights: results hold for it alone.
        clusters = {condition: condition for condition in clusters}
    return Study(head, tuple(spec.requirement), tuple(designs), clusters, frames, suite)


def leaves(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[str]:
    """Yield the dotted keys of nested tables; a range ``{from, to}`` is a value."""
    for key, value in tree.items():
        if isinstance(value, Mapping) and not ("from" in value or "to" in value):
            yield from leaves(value, (*path, key))
        else:
            yield ".".join((*path, key))


def _entries(spec: StudySpec, path: Path) -> Iterator[DesignEntry]:
    where = f"{path}: design"
    grid = dict(spec.design.grid or {})
    listed = [_together(spec, items) for items in itertools.product(*spec.design.lists.values())]
    # The estimator is always the last axis.
    axis = grid.pop(ESTIMATOR_AXIS, None)
    if axis is not None:
        raise UserError(
            "the estimator is an axis by itself", where=f"{where}.grid.estimator", fix="name them in study.estimators"
        )
    keys = list(leaves(grid))
    table = CasesSpec(
        name="d",
        list=[scene for scene, *_ in listed],
        grid=grid or None,
    )
    entry_variants = list(variants(table, spec.study.seed, where))
    if len(entry_variants) > MOST_DESIGNS:
        raise UserError(f"{len(entry_variants)} entries", where=where, expected=f"at most {MOST_DESIGNS}")
    per_item = len(entry_variants) // len(listed)
    for i, variant in enumerate(entry_variants):
        _, names, estimators, costs = listed[i // per_item]
        scene = dict(variant.scene)
        scene.pop("scene", None)
        orbit = scene.pop("orbit", {})
        if not isinstance(orbit, Mapping):
            raise UserError(f"found {show(orbit)}", where=f"{where}: orbit", expected="keys of the orbit")
        settings = dict(zip(spec.design.lists, names, strict=True))
        settings |= {key: _plain(_value(variant.scene, key)) for key in keys}
        name = shortened("_".join(filter(None, [variant.item, *variant.parts])), LONGEST_GENERATED_NAME)
        yield DesignEntry(name or "all", settings, scene, dict(orbit), _estimators(estimators, where), costs)


def _together(spec: StudySpec, items: Sequence[JsonObject]) -> tuple[JsonObject, list[str], Any, dict[str, float]]:
    """Return merged entries of the lists as a scene, their names, estimators and costs."""
    costs: Counter[str] = Counter()
    for table in (spec.design.cost, *(item.get("cost", {}) for item in items)):
        for key, value in table.items():
            costs[key] += value
    scene: JsonObject = {}
    estimators: Any = spec.study.estimators
    names = [str(item["name"]) for item in items]
    for item in items:
        scene = deep_merge(
            scene, {key: value for key, value in item.items() if key not in ("name", "estimators", "cost")}
        )
        estimators = item.get("estimators", estimators)
    # One name of all of them, with valid characters.
    word = re.sub(r"[^A-Za-z0-9._-]+", "-", "_".join(names)) if names else ""
    return (
        (deep_merge(scene, {"scene": {"name": word}}) if word else scene),
        names,
        estimators,
        {key: float(value) for key, value in costs.items()},
    )


def _estimators(chosen: Any, where: str) -> tuple[str, ...]:
    if not isinstance(chosen, list) or not chosen or not all(isinstance(name, str) for name in chosen):
        raise UserError(f"found {show(chosen)}", where=f"{where}: estimators", expected="a list of names")
    return tuple(dict.fromkeys(chosen))


def _check_keys(spec: StudySpec, entries: Sequence[DesignEntry], path: Path) -> None:
    """Conditions must not vary what a design fixes: it would override them."""
    frames = spec.frames
    varied = set(leaves(frames.grid or {})) | set(leaves(frames.sobol.ranges if frames.sobol else {}))
    for item in frames.list or []:
        varied |= set(leaves(item))
    for entry in entries:
        fixed = set(leaves(entry.scene)) | {f"orbit.{key}" for key in leaves(entry.orbit)}
        if both := sorted(fixed & varied):
            raise UserError(
                f"{both[0]} is varied by [frames] too", where=f"{path}: design", fix="take it out of one of them"
            )
        if entry.orbit and frames.orbit is None:
            raise UserError(
                "a design changes the orbit, but there is none",
                where=f"{path}: design",
                expected="a table frames.orbit",
            )


def _cases(spec: StudySpec, path: Path, entry: DesignEntry) -> list[tuple[str, Case]]:
    """Return the entry's frames with the names of their conditions."""
    frames = spec.frames
    listed = frames.list
    if listed is None and frames.grid is None and frames.sobol is None and frames.orbit is None:
        listed = [{}]
    table = CasesSpec(
        name=_TABLE,
        base=deep_merge(frames.base, entry.scene),
        list=listed,
        grid=frames.grid,
        sobol=frames.sobol,
        orbit=None if frames.orbit is None else deep_merge(frames.orbit, entry.orbit),
    )
    head = SuiteHead(name=spec.study.name, seed=spec.study.seed, estimators=list(entry.estimators))
    suite = SuiteSpec(suite=head, defaults=spec.defaults, cases=[table])
    cases = suite_of(suite, path, fly_scene, places=(f"design {entry.name}, frames",)).cases
    return [("_".join(filter(None, [case.variant, case.sample])), case) for case in cases]


def _cluster(spec: StudySpec, case: Case, condition: str) -> str:
    """Return the flight of a condition; a condition without one is a separate cluster."""
    orbit = spec.frames.orbit
    return condition if orbit is None or orbit.get("n") == 1 else case.variant or "one flight"


def _frame_of(case: Case, entry: DesignEntry, condition: str) -> Case:
    """Return a condition's case as the frame of an entry."""
    name = shortened(f"{entry.name}__{condition}", LONGEST_FRAME_NAME)
    identity = case.scene.scene.model_copy(update={"name": name, "draw": condition})
    return replace(case, scene=case.scene.model_copy(update={"scene": identity}), estimators=entry.estimators)


def _design(entry: DesignEntry, estimator: str, case: Case, spec: StudySpec) -> Design:
    items = [item for listed in spec.design.lists.values() for item in listed]
    several = len(spec.study.estimators) > 1 or any("estimators" in item for item in items)
    settings = entry.settings | ({ESTIMATOR_AXIS: estimator} if several else {})
    camera = case.camera
    together = case.head is not None and _needs_heads(estimator, spec)
    return Design(
        f"{entry.name}_{estimator}" if several else entry.name,
        entry.name,
        estimator,
        settings,
        camera.camera.name or str(value_at(case, "camera.file")),
        camera.camera.width,
        camera.camera.height,
        len(camera.head) if together else 1,
        entry.costs,
    )


def _needs_heads(estimator: str, spec: StudySpec) -> bool:
    from horizonval.plugins import registry, supervisor

    if any(program.name == estimator for program in spec.estimator):
        return False
    try:
        return supervisor.get(estimator).needs == "heads"
    except UserError as e:
        known = ", ".join(nearest(estimator, registry.names()))
        raise UserError(f"no estimator {estimator!r}", where="study.estimators", expected=f"one of {known}") from e


def _value(tree: Any, key: str) -> Any:
    for part in key.split("."):
        tree = tree[part]
    return tree


def _plain(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime) else value


def write_plan(plan: StudyPlan, folder: Path) -> None:
    """Write a plan into a study's folder."""
    content = {
        "schema": PLAN_SCHEMA,
        "study": plan.head.model_dump(mode="json"),
        "requirements": [one.model_dump(mode="json") for one in plan.requirements],
        "designs": [asdict(design) for design in plan.designs],
        "conditions": plan.conditions,
        "frames": plan.frames,
    }
    write_json(folder / PLAN_FILE, content)


def read_plan(folder: Path) -> StudyPlan | None:
    """Return the plan of a folder, or None. Raises ``UserError``: the file is invalid."""
    path = folder / PLAN_FILE
    if not path.exists():
        return None
    data: Any = read_json(path)
    try:
        if data["schema"] != PLAN_SCHEMA:
            raise ValueError
        return StudyPlan(
            StudyHead.model_validate(data["study"]),
            tuple(Requirement.model_validate(one) for one in data["requirements"]),
            tuple(Design(**design) for design in data["designs"]),
            dict(data["conditions"]),
            {name: (entry, condition) for name, (entry, condition) in data["frames"].items()},
        )
    except (KeyError, TypeError, ValueError) as e:
        raise UserError(
            "not a study's plan", where=str(path), fix="delete it and run the study again; finished frames are kept"
        ) from e
