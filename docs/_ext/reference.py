"""Sphinx extension: the pages of the reference that follow from the code, written before the pages are read."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from sphinx.application import Sphinx

import horizonval
from horizonval.cli.app import app as command_line
from horizonval.cli.app import run_command_line
from horizonval.scoring.row import COLUMNS
from horizonval.spec.pose import TABLE_OF, PoseKeys
from horizonval.spec.schema import MODELS, FileKind, Key, KeyTable, tables, tables_of

DOCS = Path(__file__).parents[1]
GENERATED, RESULTS = DOCS / "reference" / "generated", DOCS / "results"
"""Folders of generated pages; not kept in the repository."""
RESULT_PAGES = {
    "bench": "bench/README.md",
    "failures": "failures/README.md",
    "in-the-loop": "in-the-loop/README.md",
    "infrared-horizon": "infrared-horizon-stability/README.md",
    "published": "published/README.md",
    **{f"published-{letter}": f"published/{letter}.md" for letter in "ABCDEFG"},
    "studies": "studies/README.md",
}
"""Pages of `results/` that the documentation includes, by their names in it."""
HELP_COLUMNS = 96

INTRODUCTIONS: dict[FileKind, str] = {
    "scene": "A scene is one frame: one camera, one pose, one planet, one instant. `horizonval render` takes it.",
    "camera": "A camera file describes a sensor as its data sheet does. What is left out is off.",
    "suite": "A suite makes many scenes and names the estimators that are scored on them. `horizonval run` takes it.",
    "study": "A study compares designs on the same frames. `horizonval study` takes it.",
    "prior": "A prior says what is known before an image is looked at. `horizonval estimate --prior` takes it. The "
    "same table `[prior]` stands in scenes, suites and studies.",
}
SCENE_TABLES = (
    "`defaults`, `base` and the entries of `list` are partial scenes: any key of a [scene file](scene-keys.md). "
    "Inside `[camera]` they also change the [camera file](camera-keys.md), as `camera.detector.exposure_s`."
)


def pages() -> dict[str, str]:
    """Return the Markdown of every generated page by its name."""
    made = {f"{kind}-keys": _keys_page(kind) for kind in MODELS}
    made["pose-keys"] = _pose_page()
    made["command-line"] = _command_page()
    made["api"] = _api_page()
    made["results"] = _results_page()
    return made


def result_pages() -> dict[str, str]:
    """Return the Markdown of every page that includes one of `results/`, by its name."""
    made = {}
    for name, path in RESULT_PAGES.items():
        lines = [f"```{{include}} ../../results/{path}", ":relative-images:"]
        if name.startswith("published-"):
            lines.append(f":relative-docs: {Path(path).stem}.json")
        made[name] = "\n".join([*lines, "```", ""])
    letters = sorted(name for name in RESULT_PAGES if name.startswith("published-"))
    text = (DOCS.parent / "results" / RESULT_PAGES["published"]).read_text(encoding="utf-8")
    for name in letters:
        text = text.replace(f"]({name[-1]}.md)", f"]({name}.md)")
    made["published"] = text + "\n```{toctree}\n:hidden:\n\n" + "\n".join(letters) + "\n```\n"
    return made


def _keys_page(kind: FileKind) -> str:
    lines = [f"# {kind.capitalize()} files", "", INTRODUCTIONS[kind]]
    if kind in ("suite", "study"):
        lines.append(SCENE_TABLES)
    lines += [
        f"`horizonval schema {kind}` prints the same as JSON Schema.",
        "A dash is a key that can be left out, which then means what the text says.",
        "The unit 1 is that of pure numbers.",
    ]
    for table in tables(kind):
        if table.header:
            variant = f", {table.variant}" if table.variant else ""
            lines += ["", f"## `{table.header}`{variant}"]
        lines += ["", _meaning(table.meaning)]
        if table.keys:
            lines += ["", *_keys_table(table)]
    return "\n".join(lines) + "\n"


def _pose_page() -> str:
    lines = [
        "# Keys of a pose",
        "",
        "Where a camera is, when, and how it is turned has the same keys everywhere: in scene files, as keywords of",
        "`hv.Scene`, `hv.Session` and `hv.Client.image`, and in requests to `horizonval serve`.",
        "Files do not hold vectors and quaternions; in Python and in requests these take the place of angles.",
        "",
        "| key | meaning | value | unit | in a scene file |",
        "|---|---|---|---|---|",
    ]
    for key in tables_of(PoseKeys)[0].keys:
        place = f"`[{TABLE_OF[key.name]}]`" if key.name in TABLE_OF else "–"
        cells = (f"`{key.name}`", key.meaning, _values(key), key.unit or "", place)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _keys_table(table: KeyTable) -> Iterator[str]:
    yield "| key | meaning | value | unit | default |"
    yield "|---|---|---|---|---|"
    for key in table.keys:
        cells = (f"`{key.name}`", key.meaning, _values(key), key.unit or "", _default(key))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _values(key: Key) -> str:
    return key.values.replace("_", "\\_").replace("*", "\\*")


def _default(key: Key) -> str:
    match key.default:
        case None:
            return "*required*"
        case "":
            return "–"
        case "a table":
            return "empty"
        case text:
            return f"`{text}`"


def _meaning(text: str) -> str:
    return text.replace("  ", "\n\n")


def _command_page() -> str:
    lines = [
        "# Command line",
        "",
        "Text for people by default, `--json` for programs.",
        "Exit status 0 is success, 1 a check that failed, and 2 wrong use or bad input, told in one line.",
        "Long commands show their progress, can be interrupted, and go on from there.",
    ]
    for path in _commands(typer.main.get_command(command_line), ()):
        lines += ["", f"## `{' '.join(('horizonval', *path))}`", "", "```text", _help(path), "```"]
    return "\n".join(lines) + "\n"


def _commands(command: Any, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    if path:
        yield path
    for name, inner in getattr(command, "commands", {}).items():
        yield from _commands(inner, (*path, name))


def _help(path: tuple[str, ...]) -> str:
    """Return what ``--help`` prints."""
    text = io.StringIO()
    os.environ["COLUMNS"] = str(HELP_COLUMNS)
    with contextlib.redirect_stdout(text):
        run_command_line([*path, "--help"])
    return text.getvalue().rstrip()


def _api_page() -> str:
    lines = [
        "# Python",
        "",
        "Everything here is a name of the package itself: `import horizonval as hv`.",
        "The renderer is loaded when it is first needed.",
    ]
    for name in getattr(horizonval, "__all__", ()):
        thing = getattr(horizonval, name)
        kind = "class" if inspect.isclass(thing) else "function" if callable(thing) else "data"
        if inspect.isclass(thing) and issubclass(thing, BaseException):
            kind = "exception"
        lines += ["", f"## `{name}`", "", "```{eval-rst}", f".. auto{kind}:: horizonval.{name}"]
        lines += ["   :members:"] if kind == "class" else []
        lines.append("```")
    return "\n".join(lines) + "\n"


def _results_page() -> str:
    lines = [
        "# Table of results",
        "",
        "`results.parquet` of a run has one row for every image and estimator.",
        "Columns marked optional are empty where they do not apply.",
        "",
        "| column | meaning | unit | type |",
        "|---|---|---|---|",
    ]
    for column in COLUMNS:
        kind = column.sql_type + (", optional" if column.optional else "")
        lines.append(f"| `{column.name}` | {column.meaning} | {column.unit} | {kind} |")
    return "\n".join(lines) + "\n"


def _write(_app: Sphinx) -> None:
    for folder, made in ((GENERATED, pages()), (RESULTS, result_pages())):
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob("*.md"):
            if old.stem not in made:
                old.unlink()
        for name, text in made.items():
            path = folder / f"{name}.md"
            # An unchanged page keeps its time, so that a second build is quick.
            if not path.is_file() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
