"""Check the frames of a scene, a suite or a study, all or an even sample, and add up their cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from horizonval.api.check.cost import RECORD_BYTES, Cost, FrameCost, column_key, frame_cost, json_of_bands
from horizonval.api.check.findings import Finding, Kind, Level, Report, cannot_run
from horizonval.api.check.limb import LimbView, Needs, group_line, limb_views
from horizonval.api.check.rules import findings_of
from horizonval.core.errors import UserError
from horizonval.earth.optical import node_counts, optical_model
from horizonval.jobs.engine import ExpectedTime
from horizonval.renderer.frame_cost import refuse_too_large, shared_view
from horizonval.scoring import limits
from horizonval.sensor.motion import check_scene_turn
from horizonval.sensor.observe import check_camera
from horizonval.spec.camera import ALL_HEADS, CameraSpec
from horizonval.spec.load import Case, Suite
from horizonval.spec.scene import SceneSpec
from horizonval.spec.suite import Keep
from horizonval.studies.regression.unseen import unseen
from horizonval.studies.trade.design import Study
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import CasePlan, of_heads, plan_of
from horizonval.suites.record import camera_name
from horizonval.truth.frame_truth import truth_of

MOST_FRAMES = 400
"""Frames that a check examines; about 0.05 s each."""
FEW_FRAMES = 32
"""Frames that are examined before a run, in about two seconds."""
FEW_LINEAR = 2
"""Frames of each linear array before a run; about 0.2 s each."""
FRAMES_FOR_COST = 3
"""Frames of every camera from which the time of a run is predicted."""
PER_PLACE_OR_FILE = ("view_tables_s", "frame_bytes", "image_bytes")

Spectral: TypeAlias = dict[tuple[str, ...], dict[str, int]]
"""Spectral nodes of every band, by air, ground and bands as text."""


@dataclass(frozen=True)
class Group:
    """Frames with a common verdict: of a camera of a suite, or of a design of a study."""

    subject: str
    cases: tuple[Case, ...]
    estimators: int = 1
    needs: Needs = "image"


@dataclass
class Look:
    """Result of a group: by band a view of every examined frame, the costs, and errors of frames."""

    views: dict[str, list[LimbView]] = field(default_factory=dict)
    costs: list[FrameCost] = field(default_factory=list)
    errors: list[Finding] = field(default_factory=list)
    examined: int = 0


def check_scene(scene: SceneSpec, camera: CameraSpec) -> Report:
    """Return the report of a scene; with several heads and no choice it covers every head.

    Facts are one line for every band: arc in view, level and signal-to-noise ratio of the limb. Takes one second for a
    solar camera, and up to two more for every thermal band.
    """
    findings: list[Finding] = []
    facts: dict[str, str] = {}
    try:
        refuse_too_large(scene, camera)
        if camera.detector is not None:
            check_camera(camera)
            check_scene_turn(scene, camera)
    except UserError as e:
        findings.append(cannot_run(e))
    groups = _groups_of_heads(scene, camera)
    spectral: Spectral = {}
    looks = [look_at(group, 1, spectral, infrared=True) for group in groups]
    for group, look in zip(groups, looks, strict=True):
        head = [group.subject] if len(groups) > 1 else []
        findings += look.errors
        for band, views in look.views.items():
            facts[", ".join([*head, band])] = views[0].line()
            subject = ", ".join([*head, band] if len(look.views) > 1 else head)
            findings += findings_of(views, subject, single=True)
    cost, count = total_cost(groups, looks, "all"), len(groups)
    return Report("scene", scene.scene.name, tuple(findings), facts, count, count, cost)


def _groups_of_heads(scene: SceneSpec, camera: CameraSpec) -> list[Group]:
    """Return a group of one frame for every chosen head, named after it."""
    if not camera.head or scene.camera.head not in (None, ALL_HEADS):
        return [Group(scene.scene.name, (Case(scene, camera),))]
    groups = []
    for head in camera.head:
        chosen = scene.camera.model_copy(update={"head": head.name})
        case = Case(scene.model_copy(update={"camera": chosen}), camera, head.name)
        groups.append(Group(head.name, (case,), needs="heads" if len(camera.head) > 1 else "image"))
    return groups


def check_suite(target: Suite | Study, *, most: int = MOST_FRAMES, infrared: bool = True) -> Report:
    """Return the report of a suite or a study; errors of the run are findings.

    Designs of a study that differ in the estimator alone share their frames and are one group. Of more than ``most``
    frames an even sample is examined; the report states its size. ``infrared``: whether to compute the level of thermal
    limbs, for one frame of every camera: up to 2 s for each band.
    """
    suite = _suite_of(target)
    try:
        refuse_mistakes(suite, plan_of(suite))
    except UserError as e:
        return Report(_kind_of(target), suite.name, tuple(map(cannot_run, e.mistakes)), {}, 0, len(suite.cases))
    return _check_groups(target, most, infrared=infrared)


def check_before_run(target: Suite | Study) -> Report | None:
    """Return a report of an even sample of the frames, without thermal levels and cost.

    None if the run itself will report a mistake in the file.
    """
    try:
        report = _check_groups(target, FEW_FRAMES, infrared=False, before_run=True)
    except UserError:
        return None
    return None if any(finding.code == "cannot-run" for finding in report.findings) else report


def _check_groups(target: Suite | Study, most: int, *, infrared: bool, before_run: bool = False) -> Report:
    suite, groups = _suite_of(target), groups_of(target)
    findings: list[Finding] = []
    facts: dict[str, str] = {}
    spectral: Spectral = {}
    looks = []
    counts = [min(len(g.cases), FEW_LINEAR) if before_run and _is_linear(g) else len(g.cases) for g in groups]
    for group, count in zip(groups, sample_sizes(counts, most), strict=True):
        look = look_at(group, count, None if before_run else spectral, infrared=infrared)
        looks.append(look)
        findings += look.errors[:1] + _doubts(group)
        for band, views in look.views.items():
            subject = f"{group.subject}, {band}" if len(look.views) > 1 else group.subject
            findings += findings_of(views, subject, total=len(group.cases))
            facts[subject] = group_line(views, len(group.cases))
    if not before_run:
        facts |= unseen(suite)
    examined = sum(look.examined for look in looks)
    cost = None if before_run else total_cost(groups, looks, suite.keep, suite.draws)
    name, frames = suite.name, len(suite.cases)
    return Report(_kind_of(target), name, tuple(findings), facts, examined, frames, cost, suite.source)


def _doubts(group: Group) -> list[Finding]:
    """Return a warning for every doubtful orbit of a group."""
    counts = Counter(case.doubt for case in group.cases if case.doubt)
    total = len(group.cases)
    return [
        Finding(
            level=Level.WARNING,
            code="doubtful-orbit",
            text=text,
            subject=group.subject,
            frames=count,
            of=total,
            total=total,
        )
        for text, count in counts.items()
    ]


def expected_of(target: Suite | Study) -> dict[str, ExpectedTime]:
    """Return the expected time of each frame by case, from a few frames of every camera.

    Empty if the run itself will report a mistake in the file.
    """
    suite = _suite_of(target)
    spectral: Spectral = {}
    expected = {}
    try:
        for group in groups_of(suite):
            bands: dict[str, list[Case]] = {}
            for case in group.cases:
                bands.setdefault(json_of_bands(case.camera), []).append(case)
            for cases in bands.values():
                same = replace(group, cases=tuple(cases))
                costs = look_at(same, FRAMES_FOR_COST, spectral, infrared=False).costs
                if not costs:
                    return {}
                seconds = sum(c.render_s + (c.observe_s + c.estimate_s) * suite.draws for c in costs) / len(costs)
                once_s, place_s = costs[0].tables_s, sum(c.view_tables_s for c in costs) / len(costs)
                for case in cases:
                    once = {str(column_key(case.scene, case.camera)): once_s} if once_s else {}
                    once |= {shared_view(case.scene, case.camera): place_s} if place_s else {}
                    expected[case.name] = ExpectedTime(seconds, once)
    except UserError:
        return {}
    return expected


def groups_of(target: Suite | Study) -> list[Group]:
    """Return the frames of a suite by camera, those of a study by entry of ``[design]``, and by their estimators."""
    plan = plan_of(_suite_of(target))
    members: dict[tuple[str, int, Needs], list[Case]] = {}
    for case in _suite_of(target).cases:
        name = target.frames[case.name][0] if isinstance(target, Study) else camera_name(case)
        try:
            key = (name, *_what_runs(case, plan))
        except UserError:
            # The check for mistakes reports unknown estimators.
            key = (name, 0, "image")
        members.setdefault(key, []).append(case)
    return [Group(name, tuple(cases), count, needs) for (name, count, needs), cases in members.items()]


def _what_runs(case: Case, plan: CasePlan) -> tuple[int, Needs]:
    """Return the number of estimators per image of a case, and whether all of them need all heads."""
    alone, together = plan.alone(case), plan.together(case) if of_heads(case) else ()
    return len(alone) + len(together), "heads" if together and not alone else "image"


def _suite_of(target: Suite | Study) -> Suite:
    return target.suite if isinstance(target, Study) else target


def _kind_of(target: Suite | Study) -> Kind:
    return "study" if isinstance(target, Study) else "suite"


def _is_linear(group: Group) -> bool:
    geometry = group.cases[0].camera.camera
    return min(geometry.width, geometry.height) <= limits.LINEAR_PX


def sample_sizes(counts: Sequence[int], most: int) -> list[int]:
    """Return the sample size of every group: all frames, or an even share of ``most``, at least one.

    What a small group leaves of its share goes to the others. With more groups than ``most`` the rest get none.
    """
    sizes = [0] * len(counts)
    left = most
    order = sorted(range(len(counts)), key=lambda i: counts[i])
    for position, i in enumerate(order):
        sizes[i] = min(counts[i], max(left // (len(order) - position), 1 if left > 0 else 0))
        left -= sizes[i]
    return sizes


def look_at(group: Group, count: int, spectral: Spectral | None, *, infrared: bool) -> Look:
    """Examine an even sample of ``count`` frames of a group, including the first.

    ``spectral``: cache of spectral nodes by air, ground and bands; None skips costs and unknown air or bands.
    ``infrared``: whether to compute the first frame's infrared horizon, hence the level of its thermal limbs.
    """
    seen = Look()
    places = np.floor(np.arange(count) * len(group.cases) / max(count, 1)).astype(int)
    cases = group.cases if count >= len(group.cases) else [group.cases[int(i)] for i in places]
    for number, case in enumerate(cases):
        seen.examined += 1
        try:
            nodes = None if spectral is None else _spectral_nodes(case, spectral)
            truth = truth_of(case.scene, case.camera, infrared=infrared and number == 0)
        except UserError as e:
            seen.errors.append(cannot_run(e, group.subject))
            continue
        for view in limb_views(truth, case.camera, group.needs):
            seen.views.setdefault(view.band.name, []).append(view)
        if nodes is not None:
            seen.costs.append(frame_cost(truth, case.scene, case.camera, nodes, group.estimators))
    return seen


def _spectral_nodes(case: Case, known: Spectral) -> dict[str, int]:
    """Return the spectral nodes of the bands of a frame, cached by air, ground and bands."""
    scene = case.scene
    air, surface = scene.atmosphere.model_dump_json(), scene.surface.model_dump_json()
    key = (air, surface, json_of_bands(case.camera), str(scene.render.band_error))
    if key not in known:
        known[key] = node_counts(optical_model(scene, case.camera))
    return known[key]


def total_cost(groups: Sequence[Group], looks: Sequence[Look], keep: Keep, draws: int = 1) -> Cost | None:
    """Return the cost of all frames of groups; None if no frame can be made.

    Unexamined frames cost the mean of their group, or of all frames if none of the group was examined.
    """
    known = [cost for look in looks for cost in look.costs]
    if not known:
        return None
    totals = dict.fromkeys(("cells", "evaluations", "render_s", "observe_s", "estimate_s"), 0.0)
    disk, frames = 0.0, 0
    columns: dict[tuple[object, ...], FrameCost] = {}
    for group, look in zip(groups, looks, strict=True):
        costs, n = look.costs or known, len(group.cases)
        mean = {key: float(np.mean([getattr(c, key) for c in costs])) for key in (*totals, *PER_PLACE_OR_FILE)}
        for key in totals:
            totals[key] += n * mean[key]
        places = {shared_view(case.scene, case.camera) for case in group.cases}
        totals["render_s"] += len(places) * mean["view_tables_s"]
        disk += n * RECORD_BYTES + (0.0 if keep == "none" else n * (mean["frame_bytes"] + mean["image_bytes"]))
        frames += n
        # Columns of a group differ in content, hardly in their number of nodes.
        columns |= {column_key(case.scene, case.camera): costs[0] for case in group.cases if costs[0].tables}
    totals["observe_s"] *= draws
    totals["estimate_s"] *= draws
    return Cost(
        frames=frames,
        **totals,
        tables=sum(cost.tables for cost in columns.values()),
        tables_s=sum(cost.tables_s for cost in columns.values()),
        memory_mb=max(cost.memory_mb for cost in known),
        disk_mb=disk / 1e6,
    )
