"""Cost of a design by the study's expression; processor time of an estimate.

Seconds are kept apart from reproducible results. They have an uncertainty, which propagates to expressions: designs
with indistinguishable costs are tied.

An expression such as ``mass_g + 20 * power_w`` may hold numbers, names, ``+ - * / **``, parentheses, ``min``, ``max``,
``abs`` and ``sqrt``. Python parses it but never executes it. All numbers are floats, so no power can grow without
bound.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scipy import stats

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.scoring.requirements import CONFIDENCE
from horizonval.store.folder import intact_json
from horizonval.suites.units.scored import PROCESSOR

LONGEST = 500
"""Maximum length of an expression, characters."""
_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[float], float]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
_FUNCTIONS: dict[str, tuple[Callable[..., float], int | None]] = {
    "min": (min, None),
    "max": (max, None),
    "abs": (abs, 1),
    "sqrt": (math.sqrt, 1),
}
"""Number of arguments by function; ``None``: one or more."""
GRAMMAR = f"numbers, names, + - * / **, parentheses, {', '.join(_FUNCTIONS)}"


@dataclass(frozen=True)
class Expression:
    """A parsed expression; ``names`` are those it uses."""

    text: str
    names: frozenset[str]
    tree: ast.expr

    def value(self, values: Mapping[str, float]) -> float | None:
        """Return its value; ``None`` if undefined, as for a division by zero."""
        try:
            value = float(_value(self.tree, values))
        except (ArithmeticError, ValueError):
            return None
        return value if math.isfinite(value) else None


def read_expression(text: str, known: Mapping[str, Any], where: str) -> Expression:
    """Return an expression in the names ``known``; ``where`` is file and key for errors.

    Raises ``UserError``: not an expression, or an unknown name.
    """
    if len(text) > LONGEST:
        raise UserError(f"{len(text)} characters", where=where, expected=f"at most {LONGEST}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        names = frozenset(_names(tree))
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as e:
        why = f": {e}" if isinstance(e, _RefusedError) else ""
        raise UserError(f"{text!r} is no expression{why}", where=where, expected=GRAMMAR) from e
    if unknown := sorted(names - set(known)):
        raise UserError(
            f"{unknown[0]!r} is no column",
            where=where,
            expected=f"one of {', '.join(known)}",
            fix="or give it to every design, in a table `cost` of its option",
        )
    return Expression(text.strip(), names, tree)


class _RefusedError(ValueError):
    """A part of an expression that is not allowed, by its text."""


def _names(node: ast.expr) -> set[str]:
    """Return the names of an expression; refuse everything but arithmetic."""
    match node:
        case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
            if not math.isfinite(float(value)):
                raise _RefusedError("a number is too large")
            return set()
        case ast.Name(id=name):
            return {name}
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            return _names(left) | _names(right)
        case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY:
            return _names(operand)
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in _FUNCTIONS and arguments:
            count = _FUNCTIONS[name][1]
            if count is not None and len(arguments) != count:
                raise _RefusedError(f"{name} takes one value")
            return set().union(*(_names(argument) for argument in arguments))
    raise _RefusedError(f"{ast.unparse(node)!r} is not allowed")


def _value(node: ast.expr, values: Mapping[str, float]) -> float:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return float(values[name])
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](_value(left, values), _value(right, values))
        case ast.UnaryOp(op=op, operand=operand):
            return _UNARY[type(op)](_value(operand, values))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return float(_FUNCTIONS[name][0](*(_value(argument, values) for argument in arguments)))
    raise _RefusedError(ast.unparse(node))


COSTS_FILE = "study-costs.json"
SECONDS = "processor_s"
EXACT = ("pixel_rate", "pixels", "width", "height", "heads")
MEASURES = ("bias_deg", "noise_deg", "rms_deg", "p95_deg", "three_sigma_deg", "exclusion_deg")
SHARES = ("availability", "answered_due", "false_valid", "within")
COLUMNS = (*EXACT, SECONDS, *MEASURES, *SHARES)
"""Columns of every design that an expression may use, in addition to the numbers of its file."""


def read_price(text: str, costs: Mapping[str, float], where: str) -> Expression:
    """Return the price expression of a design; ``where`` is file and key, or the option, for errors.

    ``costs``: numbers of a design in the file; all designs have the same names. Raises ``UserError``: not an
    expression, a name that is not a column, or a number of the file with the name of a column.
    """
    if both := sorted(set(costs) & set(COLUMNS)):
        raise UserError(f"a cost is named {both[0]!r}, as a column is", where=where, fix="rename it")
    return read_expression(text, dict.fromkeys((*costs, *COLUMNS)), where)


def is_timed(price: Expression) -> bool:
    """Whether a price depends on processor time, and so on the machine."""
    return SECONDS in price.names


def columns_of(design: Mapping[str, Any], seconds: JsonObject) -> dict[str, JsonObject]:
    """Return the columns of a design of ``study.json``: ``{value, interval, uncertain}`` by name."""
    exact = {name: design[name] for name in EXACT} | dict(design["costs"])
    measured = {SECONDS: seconds} | {name: design[name] for name in MEASURES}
    shares = {name: {"value": design[name]["rate"], "interval": design[name]["interval"]} for name in SHARES}
    return {name: {"value": value, "interval": None, "uncertain": False} for name, value in exact.items()} | {
        name: {
            "value": column["value"],
            "interval": None if None in (column["interval"] or [None]) else column["interval"],
            "uncertain": True,
        }
        for name, column in (measured | shares).items()
    }


def price_of(expression: Expression, columns: Mapping[str, JsonObject]) -> JsonObject:
    """Return ``{value, interval, known}`` of a design's price; ``known``: whether the uncertainty is known or zero.

    ``columns``: by name ``{value, interval, uncertain}``; ``interval`` is None if nothing is uncertain or it is
    unknown. Intervals of the columns propagate one by one and add in quadrature. Without a value: None, None, True.
    """
    values = {name: columns[name]["value"] for name in expression.names}
    middle = None if None in values.values() else expression.value(values)
    if middle is None:
        return {"value": None, "interval": None, "known": True}
    below = above = 0.0
    known, uncertain = True, False
    for name in sorted(expression.names):
        if not columns[name]["uncertain"]:
            continue
        interval = columns[name]["interval"]
        ends = [None] if interval is None else [expression.value(values | {name: end}) for end in interval]
        if None in ends:
            known = False
            continue
        steps = [end - middle for end in ends if end is not None]
        below += min(0.0, *steps) ** 2
        above += max(0.0, *steps) ** 2
        uncertain = True
    interval = [middle - math.sqrt(below), middle + math.sqrt(above)] if uncertain and known else None
    return {"value": middle, "interval": interval, "known": known}


def is_tie(a: JsonObject, b: JsonObject) -> bool:
    """Whether two costs are equal up to rounding, or no further apart than their uncertainties.

    The half widths facing each other add in quadrature: the interval of the difference of independent costs.
    """
    if a["value"] is None or b["value"] is None:
        return a["value"] is b["value"]
    low, high = sorted((a, b), key=lambda price: price["value"])
    if not (low["known"] and high["known"]):
        return True
    up = low["interval"][1] - low["value"] if low["interval"] else 0.0
    down = high["value"] - high["interval"][0] if high["interval"] else 0.0
    gap = high["value"] - low["value"]
    return bool(gap <= math.hypot(up, down) or math.isclose(low["value"], high["value"], rel_tol=1e-9))


def read_timings(folder: Path) -> dict[str, dict[str, float]]:
    """Return the seconds of every stage by case, summed over the shards."""
    timings: dict[str, dict[str, float]] = {}
    for path in sorted(folder.glob("timings*.json")):
        for case, stages in ((intact_json(path) or {}).get("cases") or {}).items():
            timings[case] = stages
    return timings


def cost_of(
    frames: Iterable[tuple[str, int]], estimator: str, timings: Mapping[str, Mapping[str, float]]
) -> JsonObject:
    """Return the mean processor time of an estimate: ``value`` [s], Student ``interval`` of the mean, ``n`` frames.

    ``frames``: cases, and the number of images the estimator saw in sequence.
    """
    seconds = [
        stages[PROCESSOR + estimator] / bands
        for case, bands in frames
        if PROCESSOR + estimator in (stages := timings.get(case, {}))
    ]
    return mean_of(seconds)


def mean_of(values: Sequence[float]) -> JsonObject:
    """Return a mean with Student's interval."""
    n = len(values)
    if n == 0:
        return {"value": None, "interval": None, "n": 0}
    mean = math.fsum(values) / n
    if n < 3:
        return {"value": mean, "interval": None, "n": n}
    error = math.sqrt(math.fsum((x - mean) ** 2 for x in values) / (n - 1) / n)
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, n - 1)) * error
    return {"value": mean, "interval": [max(mean - half, 0.0), mean + half], "n": n}


def all_stages(timings: Mapping[str, Mapping[str, float]]) -> float:
    """Return the wall-clock seconds of all frames, summed over processes."""
    return math.fsum(
        spent for stages in timings.values() for stage, spent in stages.items() if not stage.startswith(PROCESSOR)
    )
