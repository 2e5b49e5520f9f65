"""Commands that are printed can be typed: those of messages and help in the source, and those in the prose of pages.

What stands in a block of a page is run by other tests. Here every command line between backticks is at least parsed by
the program's own parser; where a message leaves out what it knows (`see the list`) the parser refuses it. In prose a
command may be named without its arguments, but not with an option that does not exist.
"""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
import typer

import horizonval
from horizonval.cli.app import app
from horizonval.core.errors import command_line

ROOT = Path(__file__).parents[2]
PACKAGE = Path(horizonval.__file__).parent
QUOTED = re.compile(r"`(horizonval [^`]*)`")
FILLED = "1"
"""In place of what is known only when it is printed: a word that is a path, a name and a number."""


def _literal(node: ast.AST) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(v.value if isinstance(v, ast.Constant) else FILLED for v in node.values)
    return ""


def _docstrings(tree: ast.AST) -> set[int]:
    """Strings that stand alone: those of modules, classes and functions, and those below a constant."""
    return {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}


def printed() -> Iterator[tuple[str, str]]:
    """Command lines in strings of the source that are not docstrings, and where they are."""
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        ours = re.search(r"core\.errors import [^\n]*command_line", text)
        inside = {id(v) for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for v in ast.walk(n) if v is not n}
        inside |= _docstrings(tree)
        keys = path.is_relative_to(PACKAGE / "spec") or path.name == "cost.py"
        for node in ast.walk(tree):
            where = f"{path.relative_to(PACKAGE)}:{getattr(node, 'lineno', 0)}"
            called = ours and isinstance(node, ast.Call) and getattr(node.func, "id", "") == "command_line"
            if called and not any(isinstance(a, ast.Starred) for a in node.args):
                yield command_line(*(_literal(a) or FILLED for a in node.args)).strip("`"), where
            if id(node) in inside or keys:
                continue
            for line in QUOTED.findall(_literal(node)):
                if not line.startswith(f"horizonval {FILLED}"):
                    yield line, where


def in_prose() -> Iterator[tuple[str, str]]:
    """Command lines between backticks outside of blocks."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    pages += sorted((ROOT / "results").rglob("*.md"))
    for page in pages:
        if "generated" in page.parts:
            continue
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        for line in QUOTED.findall(text):
            yield page.relative_to(ROOT).as_posix(), " ".join(line.split()).split(" > ")[0]


def parse(line: str, *, complete: bool) -> None:
    """Parse a command line without running it; ``complete``: with all that the command asks for."""
    words = shlex.split(line)[1:]
    command: click.Command = typer.main.get_command(app)
    context = click.Context(command, info_name="horizonval")
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"{line}: no command {words[0]!r}"
        command = command.commands[words.pop(0)]
        context = click.Context(command, info_name=command.name, parent=context)
    if not complete and not any(word.startswith("-") for word in words):
        return
    if words == ["--install-completion"]:
        # Parsing it would do it.
        assert words[0] in {option for parameter in command.params for option in parameter.opts}
        return
    try:
        command.make_context(command.name, words, parent=context.parent)
    except Exception as error:
        # The parser's own class of errors may be another copy's than the one imported here.
        kind = type(error).__name__
        if kind == "Exit":
            return
        if not complete and (kind == "MissingParameter" or "requires an argument" in str(error)):
            return
        raise AssertionError(f"{line}: {kind}: {error}") from error


@pytest.fixture(scope="module")
def lines() -> dict[str, str]:
    """Printed command lines, and where the source has them."""
    return dict(printed())


def test_what_is_printed_can_be_typed(lines):
    assert {"horizonval doctor", "horizonval archive ls 1", "horizonval list estimators"} <= set(lines)
    for line in lines:
        parse(line, complete=True)


def test_what_pages_name_exists():
    prose = {line for _, line in in_prose()}
    assert len(prose) > 20
    for line in prose:
        parse(line, complete=False)


def test_a_command_that_cannot_be_typed_is_noticed():
    for line in ("horizonval archive ls", "horizonval lst", "horizonval run --out o --no-such", "horizonval run"):
        with pytest.raises(AssertionError):
            parse(line, complete=True)
    with pytest.raises(AssertionError):
        parse("horizonval archive verfy", complete=False)


def test_words_are_quoted_for_the_shell():
    line = command_line("archive", "ls", "my folder/a'b")
    assert shlex.split(line.strip("`")) == ["horizonval", "archive", "ls", "my folder/a'b"]
