"""Files of a run: records of cases, the plans of figures, and the command that repeats it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.code import code_version
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit
from horizonval.frame import FrameTruth
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import Row
from horizonval.spec.files import Kind, shipped_names, shipped_path
from horizonval.spec.load import Case, Suite
from horizonval.spec.suite import FigureSpec
from horizonval.store.index import Filter
from horizonval.suites.plan import CasePlan

CASE_SCHEMA = 1
MAX_POINTS = 2000

Record = dict[str, Any]


def record_of(
    name: str,
    truth: FrameTruth,
    rows: Sequence[Row],
    details: Mapping[str, Any],
    addresses: Mapping[str, str],
) -> Record:
    """Return the record of a case with results.

    ``addresses``: images by band, the frame under ``""``; empty if nothing was archived.
    """
    images = {band: address for band, address in addresses.items() if band}
    placed = [
        replace(row, frame_address=addresses.get(""), image_address=images.get(row.band)).to_dict() for row in rows
    ]
    return {
        "schema": CASE_SCHEMA,
        "case": name,
        "scene_id": truth.scene_id,
        "version": code_version(),
        "truth_frame": addresses.get(""),
        "image": next(iter(images.values()), None),
        "images": images,
        "rows": placed,
        "details": dict(details),
        "error": None,
    }


def failed_record(name: str, case: Case, estimators: Sequence[str], plan: CasePlan, error: str) -> Record:
    """Return the record of a failed case."""
    truth = _truth_or_none(case)
    reason = " ".join(error.split())
    rows = []
    for band in case.camera.band:
        for estimator in estimators:
            expected = Outcome.BAD_INPUT
            if truth is not None:
                expected = expected_outcome(truth, band.name, needs=plan.estimator(estimator).needs).outcome
            row = Row(
                case=name,
                camera=camera_name(case),
                band=band.name,
                estimator=estimator,
                expected=str(expected),
                status=str(Outcome.BAD_INPUT),
                reason=reason,
            )
            rows.append(row.to_dict())
    return {
        "schema": CASE_SCHEMA,
        "case": name,
        "scene_id": truth.scene_id if truth else None,
        "version": code_version(),
        "truth_frame": None,
        "image": None,
        "images": {},
        "rows": rows,
        "details": {},
        "error": reason,
    }


def camera_name(case: Case) -> str:
    return case.camera.camera.name or case.scene.camera.file.rsplit("/", 1)[-1].removesuffix(".toml")


def details_of(result: Fit | Refusal) -> dict[str, Any]:
    """Return data for the report's overlay: thinned limb points and the fitted limb; of a crash its last output."""
    points = np.asarray(result.points, dtype=np.float64).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) > MAX_POINTS:
        points = points[np.linspace(0, len(points) - 1, MAX_POINTS).round().astype(int)]
    fit = None
    if isinstance(result, Fit):
        fit = {
            "nadir_cam": [float(x) for x in result.nadir_cam],
            "angular_radius_rad": None if result.angular_radius_rad is None else float(result.angular_radius_rad),
        }
    details = {"points": points.round(3).tolist(), "fit": fit}
    return details | {"output": result.output} if isinstance(result, Refusal) and result.output else details


def _truth_or_none(case: Case) -> FrameTruth | None:
    from horizonval.truth.frame_truth import truth_of

    try:
        return truth_of(case.scene, case.camera, infrared=False)
    except Exception:  # Whatever broke the case may break its truth as well; the error is reported already.
        return None


HERE = ["--out", "."]


def command_of_suite(suite: Suite, root: Path) -> list[str]:
    """Return the words of the ``run`` or ``study`` command for the folder ``root``."""
    kind: Kind = "study" if suite.study else "suite"
    return ["horizonval", "study" if suite.study else "run", target_of(kind, suite.source, root), *suite.options, *HERE]


def command_of_rescoring(
    archive: Path, root: Path, estimators: Sequence[str], wanted: Filter | None, time_limit_s: float
) -> list[str]:
    """Return the words of the ``archive rescore`` command for the folder ``root``."""
    words = ["horizonval", "archive", "rescore", relative(archive, root)]
    words += [word for name in estimators for word in ("--estimator", name)]
    for field in fields(wanted or Filter()):
        value = getattr(wanted, field.name, None)
        if field.name != "kind" and value is not None:
            words += [f"--{field.name}", value]
    return [*words, "--time-limit", f"{time_limit_s:g}", *HERE]


def target_of(kind: Kind, source: str, root: Path) -> str:
    """Return a shipped file's name, or the relative path of a user's file."""
    path = Path(source).resolve()
    if path.stem in shipped_names(kind) and path == shipped_path(kind, path.stem).resolve():
        return path.stem
    return relative(path, root)


def relative(path: Path, root: Path) -> str:
    """Return a path relative to a folder, or the absolute one (another drive)."""
    try:
        text = Path(os.path.relpath(path.resolve(), root.resolve())).as_posix()
    except ValueError:
        return str(path.resolve())
    return f"./{text}" if text.startswith("-") else text


def figure_plans(suite: Suite) -> list[JsonObject]:
    """Return the plan of every figure of a suite: one for each value of its key ``by``.

    A plan has ``kind``, ``title``, ``x`` and ``y`` (the keys, or None), and ``cases``: the values ``[x, y]`` by case;
    for methods of all heads by scene. Raises ``UserError``: a figure's key is not a number in one of its cases.
    """
    plans = []
    for number, figure in enumerate(suite.figures, start=1):
        where = f"{suite.source}: figure[{number}]"
        chosen = [case for case in suite.cases if figure.cases in (None, case.table)]
        for value, cases in _groups(chosen, figure, where).items():
            title = figure.title or figure.cases or suite.title or suite.name
            plans.append(
                {
                    "kind": figure.kind,
                    "title": title if value is None else f"{title}, {figure.by} {value}",
                    "x": figure.x,
                    "y": figure.y,
                    "cases": {
                        name: values
                        for case in cases
                        for values in (_values(case, figure, where),)
                        for name in (case.name, case.scene_name)
                    },
                }
            )
    return plans


def value_at(case: Case, key: str) -> Any:
    """Return the value of a dotted key in the scene, or of ``camera.<table>.<key>`` in the camera file.

    Raises ``KeyError``: no such key.
    """
    parts = key.split(".")
    tree: Any = case.scene.model_dump(mode="json")
    if parts[0] == "camera" and len(parts) > 2:
        tree, parts = case.camera.model_dump(mode="json"), parts[1:]
    for part in parts:
        if isinstance(tree, list):
            # Bands and heads are known by their names.
            tree = {item.get("name"): item for item in tree if isinstance(item, dict)}
        if not isinstance(tree, dict) or part not in tree:
            raise KeyError(key)
        tree = tree[part]
    return tree


def _groups(cases: Sequence[Case], figure: FigureSpec, where: str) -> dict[Any, list[Case]]:
    if figure.by is None:
        return {None: list(cases)}
    groups: dict[Any, list[Case]] = {}
    for case in cases:
        value = _found(case, figure.by, f"{where}.by")
        groups.setdefault(f"{value:g}" if isinstance(value, float) else str(value), []).append(case)
    return groups


def _values(case: Case, figure: FigureSpec, where: str) -> list[float]:
    values = []
    for axis, key in (("x", figure.x), ("y", figure.y)):
        if key is None:
            continue
        value = _found(case, key, f"{where}.{axis}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UserError(f"{key} of {case.name} is {value!r}", where=f"{where}.{axis}", expected="a number")
        values.append(float(value))
    return values


def _found(case: Case, key: str, where: str) -> Any:
    try:
        return value_at(case, key)
    except KeyError:
        raise UserError(
            f"{case.name} has no {key!r}", where=where, expected="a key of the scene, or camera.<table>.<key>"
        ) from None
