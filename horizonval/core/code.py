"""The code that a result depends on, as one digest.

A result may be kept as long as the code that it flows through says the same. That code is the modules which the one
that makes it imports, directly or not, and the data files that lie beside them. What counts of a module is its syntax:
comments, docstrings and layout do not, so that a better word in a docstring makes nothing again.

Neglected: what is imported by a name that is made while the program runs; such modules must be named beside the first.
Packages of others are not followed, their versions not looked at.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib.util
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import horizonval
from horizonval.core.cache import cached_json, keep_json
from horizonval.core.machine.caches import cache_folder

OWN = "horizonval"
MACHINERY = re.compile(r"horizonval\.(jobs(\..*)?|core\.(atomic|cache|code|files|machine(\..*)?|progress|sealed))")
"""Modules that are told about results or keep them, and have no part in what they are."""
_KEPT = 4000
"""Modules whose digests stay in the cache; more are of code that is gone."""
_NO_DATA = {".py", ".pyc", ".pyi", ".pyd", ".so", ".html", ".css", ".js", ".typed"}

Imports = list[tuple[int, str, list[str]]]
"""Of every import statement: how many packages up it starts, the module, the names."""


def code_version(*modules: str) -> str:
    """Return the version of this package with the beginning of a digest: of some modules, or of the whole package."""
    digest = code_digest(*modules) if modules else _package_digest()
    return f"{horizonval.__version__}+{digest[:12]}"


@cache
def code_digest(*modules: str) -> str:
    """Return the digest of everything that some modules are made of; see :func:`modules_of`.

    Parameters
    ----------
    *modules : str
        Dotted names; also of other packages than this one, and of compiled modules, whose files count as they are.

    Raises
    ------
    ModuleNotFoundError
        There is no such module.
    """
    roots = {name.partition(".")[0]: _root_of(name.partition(".")[0]) for name in (OWN, *modules)}
    compiled = [name for name in modules if _file_of(name, roots) is None]
    digest = digest_below(roots, *(name for name in modules if name not in compiled))
    if not compiled:
        return digest
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for name in compiled for path in _compiled(name, roots)]
    return hashlib.sha256(json.dumps([digest, compiled, digests]).encode()).hexdigest()


def is_there(module: str) -> bool:
    """Whether there is a file of a module; nothing of its package is imported to find out."""
    first = module.partition(".")[0]
    try:
        roots = {first: _root_of(first)}
    except (ModuleNotFoundError, ValueError):
        return False
    return _file_of(module, roots) is not None or bool(_compiled(module, roots))


def _compiled(name: str, roots: dict[str, Path]) -> list[Path]:
    """Return the compiled files of a module: to ask the import system for them would import its package."""
    first, *rest = name.split(".")
    root = roots[first]
    if not rest:
        return [root] if root.is_file() else []
    place = root.joinpath(*rest)
    return sorted(
        path for path in place.parent.glob("*") if path.is_file() and path.name.partition(".")[0] == place.name
    )


def digest_below(roots: dict[str, Path], *modules: str) -> str:
    """Return the digest of modules of the packages whose folders are given."""
    files = modules_of(roots, *modules)
    digest = hashlib.sha256()
    with _known_digests() as known:
        for name in sorted(files):
            digest.update(f"{name}\0{_looked_at(files[name], known)[0]}\0".encode())
    for path in _data_beside(files, roots):
        digest.update(f"{path.name}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def modules_of(roots: dict[str, Path], *modules: str) -> dict[str, Path]:
    """Return modules and all that they import of the packages in ``roots``, by name, with their files.

    A package's own module counts where something inside it is imported, but for the first one: it is the front door,
    which opens on everything, and no result flows through it. What is imported for annotations alone does not count,
    nor do the modules of :data:`MACHINERY`.
    """
    found: dict[str, Path] = {}
    for name in modules:
        if _file_of(name, roots) is None:
            raise ModuleNotFoundError(f"no source file of {name}")
    waiting = list(modules)
    with _known_digests() as known:
        while waiting:
            name = waiting.pop()
            path = _file_of(name, roots)
            if path is None or name in found or MACHINERY.fullmatch(name) or (name in roots and name not in modules):
                continue
            found[name] = path
            parents = name.split(".")[:-1]
            waiting += [".".join(parents[: i + 1]) for i in range(len(parents))]
            package = name if path.name == "__init__.py" else ".".join(parents)
            for up, module, names in _looked_at(path, known)[1]:
                base = module
                if up:
                    above = package.split(".")[: len(package.split(".")) - up + 1]
                    base = ".".join([*above, *([module] if module else [])])
                waiting += [base, *(f"{base}.{one}" for one in names)]
    return found


@cache
def _package_digest() -> str:
    root = _root_of(OWN)
    names = [
        ".".join((OWN, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
        for path in root.rglob("*.py")
    ]
    return digest_below({OWN: root}, *names)


def _root_of(package: str) -> Path:
    """Return the folder of a package, or the file of a module that is in none."""
    spec = importlib.util.find_spec(package)
    if spec is None:
        raise ModuleNotFoundError(f"no module {package}")
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations)))
    return Path(str(spec.origin))


def _file_of(name: str, roots: dict[str, Path]) -> Path | None:
    first, *rest = name.split(".")
    root = roots.get(first)
    if root is None:
        return None
    if root.suffix == ".py":
        return root if not rest else None
    place = root.joinpath(*rest)
    for path in (place / "__init__.py", place.with_name(f"{place.name}.py")):
        if path.is_file() and (rest or path.name == "__init__.py"):
            return path
    return None


def _data_beside(files: dict[str, Path], roots: dict[str, Path]) -> Iterator[Path]:
    """Yield what is no code in the folders of modules, and in folders ``data`` there, in the order of paths."""
    tops = set(roots.values())
    folders = {path.parent for path in files.values()} - tops
    inside = [
        path for folder in folders for room in (folder, folder / "data") if room.is_dir() for path in room.iterdir()
    ]
    yield from sorted({p for p in inside if p.is_file() and p.suffix not in _NO_DATA and not p.name.startswith(".")})


def _looked_at(path: Path, known: dict[str, Any]) -> tuple[str, Imports]:
    """Return the digest of a file's syntax, and what it imports."""
    source = path.read_bytes()
    key = hashlib.sha256(source).hexdigest()
    if key not in known:
        try:
            tree = ast.parse(source)
            words: list[str] = []
            _spell(tree, words)
            known[key] = (hashlib.sha256("\0".join(words).encode()).hexdigest(), list(_imports(tree)))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            # A module that cannot be imported, of whatever package, is its bytes.
            return key, []
    digest, imports = known[key]
    return digest, imports


def _spell(node: ast.AST, words: list[str]) -> None:
    """Write a syntax tree down without positions and without texts that stand alone as a statement."""
    words.append(type(node).__name__)
    for name, value in ast.iter_fields(node):
        if isinstance(value, ast.AST):
            words.append(name)
            _spell(value, words)
        elif isinstance(value, list):
            words += (name, "[")
            for one in value:
                if not isinstance(one, ast.AST):
                    words.append(repr(one))
                elif not _is_docstring(one):
                    _spell(one, words)
            words.append("]")
        elif value is not None:
            words += (name, repr(value))
    words.append(")")


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _imports(node: ast.AST) -> Iterator[tuple[int, str, list[str]]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for alias in child.names:
                yield 0, alias.name, []
        elif isinstance(child, ast.ImportFrom):
            yield child.level, child.module or "", [alias.name for alias in child.names]
        elif isinstance(child, ast.If) and getattr(child.test, "id", "") == "TYPE_CHECKING":
            for one in child.orelse:
                yield from _imports(one)
        else:
            yield from _imports(child)


_known: dict[str, Any] | None = None


@contextlib.contextmanager
def _known_digests() -> Iterator[dict[str, Any]]:
    """Give what is known of files by the digest of their bytes; kept between processes, as parsing takes seconds."""
    global _known
    path = cache_folder() / "code.json"
    if _known is None:
        _known = cached_json(path) or {}
    before = len(_known)
    yield _known
    if len(_known) != before:
        while len(_known) > _KEPT:
            _known.pop(next(iter(_known)))
        keep_json(path, _known)
