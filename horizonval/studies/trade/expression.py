"""A user's expression over columns, such as ``mass_g + 20 * power_w``.

Numbers, names, ``+ - * / **``, parentheses, ``min``, ``max``, ``abs`` and ``sqrt``: Python's grammar reads it, and
nothing of it is ever executed. All numbers are floats, so that no power can grow without bound.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from horizonval.core.errors import UserError

LONGEST = 500
"""Characters."""
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
"""By name, with how many arguments it takes; ``None``: one or more."""
GRAMMAR = f"numbers, names, + - * / **, parentheses, {', '.join(_FUNCTIONS)}"


@dataclass(frozen=True)
class Expression:
    """An expression that was read; ``names`` are those it uses."""

    text: str
    names: frozenset[str]
    tree: ast.expr

    def value(self, values: Mapping[str, float]) -> float | None:
        """Return its value; ``None`` where it has none, as of a division by zero."""
        try:
            value = float(_value(self.tree, values))
        except (ArithmeticError, ValueError):
            return None
        return value if math.isfinite(value) else None


def read(text: str, known: Mapping[str, Any], where: str) -> Expression:
    """Return an expression.

    Parameters
    ----------
    text : str
    known : mapping
        The names that it may use are its keys.
    where : str
        File and key, for errors.

    Raises
    ------
    UserError
        It is none, or uses a name that is not known.
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
    """Return the names of an expression; everything that is no arithmetic is refused."""
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
