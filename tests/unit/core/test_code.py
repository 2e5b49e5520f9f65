"""Which code a result depends on: what flows through it, and of that only what it says."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import horizonval
from horizonval.core import code
from horizonval.studies.stability.part import CODE as STABILITY_CODE
from horizonval.suites.identity import FRAME_CODE, RESCORED_CODE, ROW_CODE, code_of

PACKAGE = Path(horizonval.__file__).parent
KINDS = {
    "frame": FRAME_CODE,
    "row": (*ROW_CODE, *code_of(["guarded-altitude-free"])),
    "ideal row": (*ROW_CODE, *code_of(["ideal"])),
    "rescored": RESCORED_CODE,
    "stability": STABILITY_CODE,
}

Changed = Callable[[str, Callable[[str], str]], set[str]]


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package, to change."""
    root = tmp_path_factory.mktemp("package") / "horizonval"
    shutil.copytree(PACKAGE, root, ignore=shutil.ignore_patterns("__pycache__", "scenes"))
    return root


@pytest.fixture
def changed(copy: Path) -> Changed:
    """Return the kinds of results that the change of a file makes again."""

    def digests() -> dict[str, str]:
        return {kind: code.digest_below({"horizonval": copy}, *modules) for kind, modules in KINDS.items()}

    def change(name: str, edit: Callable[[str], str]) -> set[str]:
        path = copy / name
        text = path.read_text()
        assert edit(text) != text, "the change changes nothing"
        before = digests()
        try:
            path.write_text(edit(text))
            after = digests()
        finally:
            path.write_text(text)
        return {kind for kind in KINDS if before[kind] != after[kind]}

    return change


def _with_words(text: str) -> str:
    """Put a word into the docstrings, and a comment above everything."""
    return "# better said\n" + text.replace('"""', '"""Better said: ', 1)


def _added(text: str) -> str:
    return text + "\nADDED = 1.5\n"


@pytest.mark.parametrize(
    "name",
    [
        "geometry/horizon.py",
        "renderer/scene/frame.py",
        "sensor/observe.py",
        "suites/units/case.py",
        "scoring/errors.py",
    ],
)
def test_words_make_nothing_again(changed: Changed, name: str) -> None:
    assert changed(name, _with_words) == set()


def test_layout_makes_nothing_again(changed: Changed) -> None:
    assert changed("geometry/horizon.py", lambda text: ast.unparse(ast.parse(text))) == set()


@pytest.mark.parametrize("name", ["cli/campaign.py", "report/formatting.py", "systems/pages.py", "jobs/engine.py"])
def test_what_no_result_flows_through_makes_nothing_again(changed: Changed, name: str) -> None:
    assert changed(name, _added) == set()


def test_the_help_of_a_command_makes_nothing_again(changed: Changed) -> None:
    assert changed("cli/campaign.py", lambda text: text.replace('help="', 'help="Indeed: ', 1)) == set()


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("renderer/kernel/march.py", {"frame", "row", "ideal row", "stability"}),
        ("earth/column.py", {"frame", "row", "ideal row", "rescored", "stability"}),
        ("truth/frame_truth.py", {"frame", "row", "ideal row", "rescored"}),
        ("store/seal.py", {"frame", "row", "ideal row", "rescored"}),
        ("sensor/observe.py", {"row", "ideal row"}),
        ("scoring/errors.py", {"row", "ideal row", "rescored"}),
        ("estimation/process/sandbox.py", {"row", "ideal row", "rescored"}),
        ("estimation/methods/guarded.py", {"row"}),
    ],
)
def test_a_constant_makes_again_what_flows_through_it(changed: Changed, name: str, kinds: set[str]) -> None:
    assert changed(name, _added) == kinds


def test_a_table_makes_again_what_reads_it(changed: Changed, copy: Path) -> None:
    table = sorted(path for path in (copy / "earth" / "data").iterdir() if path.suffix in (".csv", ".json"))[0]
    kinds = changed(str(table.relative_to(copy)), lambda text: text + "\n")
    assert {"frame", "row"} <= kinds


def test_a_number_in_a_function_counts() -> None:
    def spelled(text: str) -> list[str]:
        words: list[str] = []
        code._spell(ast.parse(text), words)
        return words

    text = 'def f(x: int) -> int:\n    """Say."""\n    return x + 1\n'
    assert spelled(text) == spelled(text.replace("Say.", "Tell.").replace("    return", "\n    # why\n    return"))
    assert spelled(text) == spelled(text.replace('    """Say."""\n', ""))
    for other in (
        text.replace("1", "1.0"),
        text.replace("+", "-"),
        text.replace("int", "float"),
        text.replace("x", "y"),
    ):
        assert spelled(text) != spelled(other)


@pytest.fixture
def package(tmp_path: Path) -> dict[str, Path]:
    """A small package: who imports whom, in every way there is."""
    root = tmp_path / "small"
    (root / "inner").mkdir(parents=True)
    (root / "__init__.py").write_text("from small import far\n")
    (root / "first.py").write_text(
        "from typing import TYPE_CHECKING\nimport small.plain\nif TYPE_CHECKING:\n    from small import annotated\n"
        "def f():\n    from small.inner import lazy, NAME\n"
    )
    (root / "inner" / "__init__.py").write_text("NAME = 1\nfrom . import beside\n")
    (root / "inner" / "lazy.py").write_text("from ..relative import thing\n")
    for name in ("plain", "annotated", "far", "relative", "inner/beside", "inner/alone"):
        (root / f"{name}.py").write_text("thing = 1\n")
    return {"small": root}


def test_imports_are_followed_wherever_they_stand(package: dict[str, Path]) -> None:
    names = {name.removeprefix("small.") for name in code.modules_of(package, "small.first")}
    assert names == {"first", "plain", "inner", "inner.lazy", "inner.beside", "relative"}


def test_a_module_that_is_not_there_is_an_error(package: dict[str, Path]) -> None:
    with pytest.raises(ModuleNotFoundError):
        code.modules_of(package, "small.gone")


@pytest.mark.parametrize("text", ["this is no python", "x = '\\ud800'\0", "(" * 500 + ")" * 500])
def test_a_module_that_cannot_be_read_is_its_bytes(package: dict[str, Path], text: str) -> None:
    digests = set()
    for number in range(2):
        (package["small"] / "plain.py").write_text(text + "#" * number)
        digests.add(code.digest_below(package, "small.first"))
    assert len(digests) == 2


def test_nothing_is_imported_to_find_a_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not for its digest, and not to see whether it is there, compiled or not."""
    root = tmp_path / "imported_by_mistake"
    root.mkdir()
    (root / "__init__.py").write_text("raise SystemExit(0)")
    (root / "fast.cpython-311-x86_64-linux-gnu.so").write_bytes(b"machine")
    monkeypatch.syspath_prepend(tmp_path)
    assert code.is_there("imported_by_mistake.fast")
    assert not code.is_there("imported_by_mistake.slow")
    assert not code.is_there("no_such_package.at_all")
    first = code.code_digest("imported_by_mistake.fast")
    (root / "fast.cpython-311-x86_64-linux-gnu.so").write_bytes(b"other")
    code.code_digest.cache_clear()
    assert code.code_digest("imported_by_mistake.fast") != first


def test_the_digest_is_quick_and_the_same_in_every_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "from horizonval.core.code import code_digest as d; print(d('horizonval.suites.units.case'))"
    made = [subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True) for _ in range(2)]
    assert made[0].stdout == made[1].stdout
    assert made[0].stdout.strip() == code.code_digest("horizonval.suites.units.case")
    # Without what earlier processes left; and what they left does not change it.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    spent = []
    for _ in range(2):
        monkeypatch.setattr(code, "_known", None)
        code.code_digest.cache_clear()
        start = time.process_time()
        assert code.code_digest("horizonval.suites.units.case") == made[0].stdout.strip()
        spent.append(time.process_time() - start)
    # What the first one kept saves reading all imports again: it takes a fifteenth of the time.
    assert spent[1] < 0.5 * spent[0]


def test_the_version_names_the_release_and_the_code() -> None:
    release, _, digest = code.code_version().partition("+")
    assert release == horizonval.__version__
    assert len(digest) == 12
    assert code.code_version("horizonval.core.errors") != code.code_version()


def test_modules_of_other_packages_count_also_compiled_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_method.py").write_text("import math\nLIMIT = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    first = code.code_digest("own_method")
    (tmp_path / "own_method.py").write_text("import math\nLIMIT = 2\n")
    code.code_digest.cache_clear()
    assert code.code_digest("own_method") != first
    assert len({code.code_digest(name) for name in ("_bisect", "horizonval.core.errors")}) == 2
    with pytest.raises(ModuleNotFoundError):
        code.code_digest("no_such_package.method")
