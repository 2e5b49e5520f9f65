"""Which tests execute which line, how long each takes, and hence which of them are run for a mutant."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from functools import cache, cached_property
from pathlib import Path

import coverage

_TIME = re.compile(r"^([\d.]+)s (?:setup|call|teardown) +(\S.*)$")
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - .*)?$")
OF_DEFINITIONS = "tests/unit/test_values.py"
"""Tests of what modules define, which is executed before any test."""
CONTROL = "\n_NOTHING_CHANGED = None\n"
"""Added to every file while the tests are recorded: a test that fails now would fail with any mutant."""


def environment(tree: Path) -> dict[str, str]:
    """Return the environment in which the copy is tested, not what is installed."""
    return os.environ | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tree.parent / "cache")}


def record(tree: Path, tests: list[str], data: Path, files: list[Path]) -> None:
    """Run tests of the copy, and keep which lines each executes and how long it takes; more is added to what is kept.

    Parameters
    ----------
    tree : Path
        The copy of the source.
    tests : list of str
        Paths in it.
    data : Path
        The recording; its log lies beside it.
    files : list of Path
        Of the copy; those that mutants are made of.
    """
    settings = data.with_suffix(".ini")
    settings.write_text(f"[run]\nsource = horizonval\nrelative_files = true\ndata_file = {data}\n")
    command = [sys.executable, "-m", "pytest", "-q", "-vv", "--durations=0", "-p", "no:cacheprovider", *tests]
    command += ["--cov=horizonval", f"--cov-config={settings}", "--cov-context=test", "--cov-report=", "--cov-append"]
    before = {path: path.read_bytes() for path in files}
    try:
        for path, content in before.items():
            path.write_bytes(content + CONTROL.encode())
        with data.with_suffix(".log").open("a") as log:
            subprocess.run(command, cwd=tree, env=environment(tree), stdout=log, stderr=subprocess.STDOUT, check=False)
    finally:
        for path, content in before.items():
            path.write_bytes(content)


class Recording:
    """What was recorded, and the choice of tests by it."""

    def __init__(self, data: Path, tree: Path) -> None:
        self._data = coverage.CoverageData(str(data))
        self._data.read()
        self._tree = tree
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        for line in data.with_suffix(".log").read_text(errors="replace").splitlines():
            if time := _TIME.match(line):
                self.seconds[time[2]] = self.seconds.get(time[2], 0.0) + float(time[1])
            elif failure := _FAILED.match(line):
                self.failed.add(failure[1])

    def tests(self, file: str, line: int, longest_s: float) -> list[str]:
        """Return the tests of a line, as many as take ``longest_s`` together: those written for its module first, of
        which three times as many are taken, and of each kind the shortest first.

        A line that is executed while its module is imported has the tests of what it is about: of the function whose
        argument's default it is, of the functions that use the names it defines, else of the whole module.
        """
        tests = self._of_lines(file, {line})
        function = self._function(file, line)
        if not tests and function is not None:
            tests = self._of_lines(file, set(range(function.body[0].lineno, (function.end_lineno or 0) + 1)))
        if not tests and function is None:
            names = self._defined(file, line)
            tests = set().union(*(self._of_lines(*use) for use in self._uses(names))) if names else set()
            tests = tests or self._of_lines(file, set(self._contexts(file)))
            tests |= {test for test in self.seconds if test.startswith(OF_DEFINITIONS)}
        chosen, total = [], 0.0
        for test in sorted(tests - self.failed, key=lambda test: (not self._is_near(test, file), self._s(test), test)):
            total += self._s(test)
            if total > longest_s and not (self._is_near(test, file) and total < 3 * longest_s):
                break
            chosen.append(test)
        return chosen

    def _s(self, test: str) -> float:
        return self.seconds.get(test, 0.0)

    @cache  # noqa: B019
    def _is_near(self, test: str, file: str) -> bool:
        """Whether a test's file names the module: it was written for it, or for what all modules define."""
        if test.startswith(OF_DEFINITIONS):
            return True
        path = self._tree / test.partition("::")[0]
        module = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        return path.is_file() and re.search(rf"\b{re.escape(module)}\b", path.read_text(encoding="utf-8")) is not None

    @cache  # noqa: B019  (one object for a run)
    def _contexts(self, file: str) -> dict[int, list[str]]:
        return self._data.contexts_by_lineno(file)

    def _of_lines(self, file: str, lines: set[int]) -> set[str]:
        by_line = self._contexts(file)
        return {c.rpartition("|")[0] for line in lines for c in by_line.get(line, ()) if "::" in c}

    @cache  # noqa: B019
    def _syntax(self, file: str) -> ast.Module:
        return ast.parse((self._tree / file).read_text(encoding="utf-8"))

    def _function(self, file: str, line: int) -> ast.FunctionDef | None:
        holding = [
            node
            for node in ast.walk(self._syntax(file))
            if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0)
        ]
        return max(holding, key=lambda node: node.lineno, default=None)

    def _defined(self, file: str, line: int) -> set[str]:
        """Return the names that a statement at a module's or a class's top defines."""
        names: set[str] = set()
        for node in ast.walk(self._syntax(file)):
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= line <= (node.end_lineno or 0):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names |= {leaf.id for t in targets for leaf in ast.walk(t) if isinstance(leaf, ast.Name)}
        return names

    @cached_property
    def _package(self) -> dict[str, list[tuple[set[int], set[str]]]]:
        """Lines of every function of the package with the names that occur in it."""
        package: dict[str, list[tuple[set[int], set[str]]]] = {}
        for path in sorted((self._tree / "horizonval").rglob("*.py")):
            file = path.relative_to(self._tree).as_posix()
            for node in ast.walk(self._syntax(file)):
                if isinstance(node, ast.FunctionDef):
                    names = {leaf.id for leaf in ast.walk(node) if isinstance(leaf, ast.Name)}
                    names |= {leaf.attr for leaf in ast.walk(node) if isinstance(leaf, ast.Attribute)}
                    lines = set(range(node.body[0].lineno, (node.end_lineno or 0) + 1))
                    package.setdefault(file, []).append((lines, names))
        return package

    def _uses(self, names: set[str]) -> list[tuple[str, set[int]]]:
        return [(f, lines) for f, functions in self._package.items() for lines, used in functions if used & names]
