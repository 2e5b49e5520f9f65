"""Which mutants there are: rooms, operators, and what is out of scope. cosmic-ray finds and makes them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path, is_number
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator
from cosmic_ray.work_item import MutationSpec

ROOMS = {
    "scoring": ("scoring",),
    "limb": ("estimation/limb",),
    "estimators": ("estimation/methods", "estimation/guard", "plugins"),
    "archive": ("store",),
    "jobs": ("jobs", "suites"),
    "regression": ("studies/regression",),
}
"""Name of a room and its folders in the package."""

DRAWINGS = ("studies/regression/page.py",)
"""Sizes and colours of figures, and what a page says, are looked at, not computed with."""

BINARY = (
    "Add_Sub",
    "Sub_Add",
    "Mul_Div",
    "Div_Mul",
    "FloorDiv_Mul",
    "Mod_Mul",
    "Pow_Mul",
    "BitOr_BitAnd",
    "BitAnd_BitOr",
)
COMPARISON = ("Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is")
ORDER = ("Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt")
UNARY = ("Delete_Not", "Delete_Invert", "USub_UAdd")
OPERATORS = (
    *(f"core/ReplaceBinaryOperator_{name}" for name in BINARY),
    *(f"core/ReplaceComparisonOperator_{name}" for name in (*COMPARISON, *ORDER)),
    *(f"core/ReplaceUnaryOperator_{name}" for name in UNARY),
    *(f"core/{name}" for name in ("ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot")),
    *(f"core/{name}" for name in ("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "NumberReplacer")),
    *(f"core/{name}" for name in ("ReplaceBreakWithContinue", "ReplaceContinueWithBreak")),
    *(f"core/{name}" for name in ("ZeroIterationForLoop", "ExceptionReplacer")),
)
"""Of each kind the replacements that still make a program: ``a ^ b`` for floats only shows that a line is executed."""


LARGEST_NUMBER = 20
"""Numbers above are sizes that one more or less does not spoil; no test states them to so many digits."""


@dataclass(frozen=True)
class Mutant:
    """One mutation: where, what was there, and what stands there now."""

    room: str
    file: str
    line: int
    operator: str
    before: str
    after: str
    spec: MutationSpec

    @property
    def title(self) -> str:
        """The file, the line and the change on one line."""
        return f"{self.file}:{self.line}  {self.before}  ->  {self.after}"


@dataclass(frozen=True)
class Place:
    """Where an operator has something to replace."""

    room: str
    file: str
    spec: MutationSpec


def all_places(tree: Path, rooms: list[str]) -> list[Place]:
    """Return the places of the mutants in some rooms of a copy of the source, in a fixed order."""
    places = []
    for room in rooms:
        for folder in ROOMS[room]:
            for path in sorted((tree / "horizonval" / folder).rglob("*.py")):
                if not path.as_posix().endswith(DRAWINGS):
                    places += [Place(room, path.relative_to(tree).as_posix(), spec) for spec in _of_file(path)]
    return places


def mutant_at(place: Place) -> Mutant | None:
    """Return the mutant; None where the operator cannot make it, such as for exceptions with a dot in their name."""
    source = place.spec.module_path.read_text(encoding="utf-8")
    try:
        mutated = mutate_code(source, get_operator(place.spec.operator_name)(), place.spec.occurrence)
    except AttributeError:
        return None
    if mutated is None or mutated == source:
        return None
    before, after = source.split("\n"), mutated.split("\n")
    k = next(i for i, lines in enumerate(zip(before, after, strict=False)) if lines[0] != lines[1])
    name = place.spec.operator_name.removeprefix("core/")
    return Mutant(place.room, place.file, k + 1, name, before[k].strip(), " ".join(after[k].split()), place.spec)


def _of_file(path: Path) -> Iterator[MutationSpec]:
    outside = _out_of_scope(ast.parse(path.read_text(encoding="utf-8")))
    nodes = list(ast_nodes(get_ast_from_path(path)))
    settings = {("core/NumberReplacer", node.start_pos) for node in nodes if is_number(node) and _large(node.value)}
    for name in OPERATORS:
        operator = get_operator(name)()
        places = [place for node in nodes for place in operator.mutation_positions(node)]
        for occurrence, (start, end) in enumerate(places):
            if (name, start) in settings or any(first <= start and end <= last for first, last in outside):
                continue
            yield MutationSpec(path, name, occurrence, start, end)


def _names(statement: ast.Assign) -> list[ast.Name]:
    return [leaf for target in statement.targets for leaf in ast.walk(target) if isinstance(leaf, ast.Name)]


def _large(number: str) -> bool:
    """Whether one more or less is a change of a few per cent: of a resolution, a limit of iterations, a size."""
    return abs(complex(ast.literal_eval(number))) > LARGEST_NUMBER


Span = tuple[tuple[int, int], tuple[int, int]]


def _out_of_scope(tree: ast.Module) -> list[Span]:
    """Return where nothing is mutated: types, the wording of errors, the values of named settings.

    A setting is a constant in capitals at the top of a module. What it does is tested where it is used; a test of its
    value would only repeat it.
    """
    nodes: list[ast.AST | None] = []
    for node in tree.body:
        if isinstance(node, ast.Assign) and all(name.id.isupper() for name in _names(node)):
            nodes.append(node)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            nodes.append(node.annotation)
        elif isinstance(node, ast.FunctionDef):
            nodes.append(node.returns)
        elif isinstance(node, ast.Raise | ast.JoinedStr) or (
            isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
        ):
            nodes.append(node)
    return [
        ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
        for node in nodes
        if isinstance(node, ast.expr | ast.stmt) and node.end_lineno is not None and node.end_col_offset is not None
    ]
