"""The renderer's folders stand in layers: none is imported by one that it imports itself."""

from __future__ import annotations

import ast
from pathlib import Path

import horizonval

ROOM = Path(horizonval.__file__).parent / "renderer"
LAYERS = [
    "reference",
    "rays",
    "scene",
    "parts",
    "plugin",
    "view_table",
    "local_light",
    "thermal",
    "kernel",
    "scattering",
]
LAYERS += ["refraction", "ground", ""]
"""From top to bottom; the last are the modules of the room itself."""


def _imported(path: Path) -> set[str]:
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    modules = [node.module or "" for node in tree if isinstance(node, ast.ImportFrom)]
    parts = [name.split(".")[2:] for name in modules if name.startswith("horizonval.renderer.")]
    return {names[0] if (ROOM / names[0]).is_dir() else "" for names in parts}


def test_every_folder_has_its_layer() -> None:
    folders = {path.parent.name for path in ROOM.glob("*/__init__.py")}
    assert folders == set(LAYERS) - {""}


def test_folders_import_only_lower_folders() -> None:
    wrong = [
        f"{path.relative_to(ROOM)} imports {folder}"
        for path in ROOM.rglob("*.py")
        # the package names the library that the back-end finds before Dr.Jit is imported
        if path != ROOM / "__init__.py"
        for folder in _imported(path)
        if LAYERS.index(folder) < LAYERS.index("" if path.parent == ROOM else path.parent.name)
    ]
    assert not wrong
