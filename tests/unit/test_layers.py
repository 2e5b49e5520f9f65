"""The rooms of the package import only rooms below them, nothing imports in circles, and a class name is used once."""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

import pytest

import horizonval

PACKAGE = Path(horizonval.__file__).parent

ROOMS = [
    "__main__", "cli", "bridges", "serve", "api", "systems", "studies", "suites", "tables", "report",
    "jobs", "scoring", "store", "sensor", "renderer", "plugins", "estimation", "truth", "frame", "earth", "formats",
    "geometry", "spec", "wire", "core",
]  # fmt: skip
"""From top to bottom. A room may import any room that stands later in this list."""

STRANGERS = {
    ("renderer", "sensor"), ("sensor", "renderer"), ("estimation", "frame"), ("estimation", "truth"),
    ("plugins", "frame"), ("plugins", "truth"),
}  # fmt: skip
"""Pairs that must not know each other although the order would allow it."""

HEAVY = {"mitsuba", "drjit"}
LIGHT_ROOMS = (
    "core",
    "wire",
    "formats",
    "geometry",
    "earth",
    "spec",
    "truth",
    "frame",
    "estimation",
    "plugins",
    "sensor",
    "scoring",
    "store",
)


def _modules() -> dict[str, Path]:
    names = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def _imports(name: str, path: Path) -> set[str]:
    """Every module a file imports, also inside functions; names imported from a package count as its modules."""
    found = set()
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, base]) if base else ".".join(above)
            found.add(base)
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return found


MODULES = _modules()
INSIDE = {name: {i for i in _imports(name, path) if i in MODULES} - {name} for name, path in MODULES.items()}


def _room(module: str) -> str | None:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else None


MOST_MODULES = 15
"""Of one folder, ``__init__`` not counted."""


def test_every_room_has_its_place():
    rooms = {_room(name) for name in MODULES} - {None}
    assert rooms <= set(ROOMS)
    assert len(MODULES) > 50


@pytest.mark.parametrize("module", sorted(MODULES))
def test_imports_point_downwards(module):
    room = _room(module)
    if room is None:
        return
    for imported in INSIDE[module]:
        other = _room(imported)
        if other is None or other == room:
            continue
        assert ROOMS.index(other) > ROOMS.index(room), f"{module} imports {imported}, which stands above it"
        assert (room, other) not in STRANGERS, f"{module} must not know {imported}"


@pytest.mark.parametrize("module", sorted(m for m in MODULES if _room(m) == "scoring"))
def test_what_judges_shares_no_code_with_what_is_judged(module):
    """Scoring knows what an estimator returns, not how it comes to it."""
    allowed = {"horizonval.estimation", "horizonval.estimation.observation"}
    assert {imported for imported in INSIDE[module] if _room(imported) == "estimation"} <= allowed


def test_no_circles():
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module in done:
            return
        for imported in sorted(INSIDE[module]):
            # A package's own modules always load the package first; that is no circle.
            if not module.startswith(imported + "."):
                visit(imported, (*path, module))
        done.add(module)

    sys.setrecursionlimit(max(sys.getrecursionlimit(), 10_000))
    for module in sorted(MODULES):
        visit(module, ())


def _files() -> list[Path]:
    return [*MODULES.values(), *sorted(Path(__file__).parents[1].rglob("*.py"))]


def test_every_import_of_the_package_names_a_module():
    """What is imported inside functions too: nobody else finds a module that was renamed before it is called."""
    gone = []
    for path in _files():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            gone += [f"{path}: {name}" for name in names if name.startswith("horizonval.") and name not in MODULES]
    assert not gone


@pytest.mark.parametrize("module", sorted(m for m in MODULES if _room(m) in LIGHT_ROOMS))
def test_only_render_knows_the_renderer(module):
    roots = {name.split(".")[0] for name in _imports(module, MODULES[module])}
    assert not roots & HEAVY


def test_no_folder_holds_too_much():
    folders = Counter(path.parent for path in MODULES.values() if path.name != "__init__.py")
    crowded = {str(folder.relative_to(PACKAGE)): n for folder, n in folders.items() if n > MOST_MODULES}
    assert not crowded, f"more than {MOST_MODULES} modules: {crowded}"


def test_no_class_name_is_defined_twice():
    names = Counter(
        node.name
        for path in MODULES.values()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert not [name for name, count in names.items() if count > 1], "one class name, one meaning"
    assert len(names) > 200


def _folder(module: str) -> tuple[str, ...]:
    return MODULES[module].parent.relative_to(PACKAGE).parts


def test_folders_of_a_room_do_not_import_in_circles():
    """Modules that lie in a folder itself tie its sub-folders together, and may be used by them."""
    below: dict[tuple[str, ...], set[tuple[str, ...]]] = {}
    for module, imported in INSIDE.items():
        for other in imported:
            a, b = _folder(module), _folder(other)
            nested = a == b[: len(a)] or b == a[: len(b)]
            if a and b and not nested and a[0] == b[0]:
                below.setdefault(a, set()).add(b)

    def visit(folder: tuple[str, ...], path: tuple[tuple[str, ...], ...]) -> None:
        assert folder not in path, " -> ".join("/".join(f) for f in [*path[path.index(folder) :], folder])
        for other in sorted(below.get(folder, ())):
            visit(other, (*path, folder))

    assert len(below) > 5
    for folder in sorted(below):
        visit(folder, ())
