"""Which frames a suite's figures are made of, and where each stands on the axes.

The report is made of a run's folder alone, so this is worked out when the run is claimed and kept in ``run.json``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.spec.load import Case, Suite
from horizonval.spec.suite import FigureSpec


def figure_plans(suite: Suite) -> list[JsonObject]:
    """Return the plan of every figure of a suite: one for each value of its key ``by``.

    Raises ``UserError``: a figure's key is no number in one of its cases.

    Returns
    -------
    list of dict
        ``kind``, ``title``, ``x`` and ``y`` (the keys, or None), and ``cases``: by the name of the case its values
        ``[x, y]``, those without an axis left out. All heads of a scene together, which some estimators want, go by
        the scene's name.
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
    """Return what a case has under a dotted key: of its scene, or ``camera.<table>.<key>`` of its camera file.

    Raises ``KeyError``: there is nothing of that name.
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
