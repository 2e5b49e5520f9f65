"""Rooms of the package import only rooms below them, and no module imports in a circle."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import horizonval

PACKAGE = Path(horizonval.__file__).parent
TESTS = Path(__file__).parents[1]

ROOMS = [
    "__main__", "cli", "bridges", "serve", "api", "systems", "studies", "suites", "tables", "report",
    "jobs", "scoring", "store", "sensor", "renderer", "plugins", "estimation", "truth", "frame", "earth", "formats",
    "geometry", "spec", "wire", "core",
]  # fmt: skip
"""From top to bottom. A room may import any room that comes later in this list."""

STRANGERS = {
    ("renderer", "sensor"), ("sensor", "renderer"), ("estimation", "frame"), ("estimation", "truth"),
    ("plugins", "frame"), ("plugins", "truth"),
}  # fmt: skip
"""Pairs that must not know each other although the order would allow it."""

HEAVY = {"mitsuba", "drjit"}
LIGHT_ROOMS = {
    "core", "wire", "formats", "geometry", "earth", "spec", "truth", "frame", "estimation", "plugins", "sensor",
    "scoring", "store",
}  # fmt: skip
"""Rooms that must work without the renderer."""

Imports = dict[str, set[str]]


def _imported(path: Path) -> set[str]:
    """Every name a file imports, also inside functions; a name imported from a module as ``module.name``."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def _dotted(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {_dotted(path): path for path in PACKAGE.rglob("*.py")}


def _module(name: str) -> str | None:
    """Return the module of the package that an imported name is, or lies in."""
    return name if name in MODULES else (parent if (parent := name.rpartition(".")[0]) in MODULES else None)


def _room(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


@pytest.fixture(scope="module")
def names() -> Imports:
    """Names that every module imports."""
    return {module: _imported(path) for module, path in MODULES.items()}


@pytest.fixture(scope="module")
def inside(names: Imports) -> Imports:
    """Modules of the package that every module imports."""
    return {module: {m for name in found if (m := _module(name))} - {module} for module, found in names.items()}


def test_imports_point_downwards(inside: Imports):
    assert {_room(module) for module in MODULES} <= {"", *ROOMS}
    pairs = [(a, b) for a, found in inside.items() for b in found if _room(a) and _room(b) and _room(a) != _room(b)]
    assert len(pairs) > 500
    upwards = [pair for pair in pairs if ROOMS.index(_room(pair[0])) > ROOMS.index(_room(pair[1]))]
    assert not upwards
    assert not [pair for pair in pairs if (_room(pair[0]), _room(pair[1])) in STRANGERS]


def test_what_judges_shares_no_code_with_what_is_judged(inside: Imports):
    """Scoring knows what an estimator returns, not how it comes to it."""
    known = {m for module, found in inside.items() if _room(module) == "scoring" for m in found}
    assert {m for m in known if _room(m) in ("estimation", "plugins")} <= {
        "horizonval.estimation",
        "horizonval.estimation.observation",
    }


def test_only_the_renderer_and_its_callers_import_it(names: Imports):
    heavy = {module for module, found in names.items() if {name.split(".")[0] for name in found} & HEAVY}
    assert not {module for module in heavy if _room(module) in LIGHT_ROOMS}


def test_no_circles(inside: Imports):
    # A package's own modules load the package first; that is no circle.
    left = {module: {m for m in found if not module.startswith(m + ".")} for module, found in inside.items()}
    while True:
        imported = set().union(*left.values())
        ends = {module for module, found in left.items() if not found or module not in imported}
        if not ends:
            break
        left = {module: found - ends for module, found in left.items() if module not in ends}
    assert not left, f"circles: { {module: sorted(found) for module, found in sorted(left.items())} }"


def test_every_import_of_the_package_names_a_module():
    """Imports inside functions too: nothing else finds a renamed module before the function is called."""
    gone = []
    for path in [*MODULES.values(), *TESTS.rglob("*.py")]:
        for name in _imported(path):
            if name.startswith("horizonval.") and _module(name) is None:
                gone.append(f"{path}: {name}")
    assert not gone
