"""State of this machine, and lists of names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.options import Json, kinds_of_files, lists, shipped
from horizonval.cli.output import check_target, print_result, watched, written
from horizonval.core.errors import UserError


def doctor(as_json: Json = False) -> int:
    """Report what works on this machine, and how to fix what does not. Exit status 1 if rendering is impossible."""
    from horizonval.api.info import examine

    examination = examine()
    lines = [f"{label:24} {text}" for label, text in examination["facts"]]
    for problem, fix in examination["problems"]:
        lines += [f"problem: {problem}", f"    to mend it: {fix}"]
    verdict = "ready" if examination["can_render"] else "rendering is impossible here"
    print_result(examination, as_json, [*lines, verdict])
    return 0 if examination["can_render"] else 1


def list_names(
    what: Annotated[
        str,
        typer.Argument(
            help="cameras, suites, studies, scenes, estimators, atmospheres or detectors.", autocompletion=lists
        ),
    ],
    as_json: Json = False,
) -> None:
    """List the names that other commands take, with descriptions.

    The first word of a line is the name; with --json an object of names and descriptions.
    """
    from horizonval.api.info import LISTS
    from horizonval.core.errors import one_of

    if what not in LISTS:
        raise UserError(f"nothing is called {what!r}", where="list", expected=one_of(what, LISTS))
    names = LISTS[what]()
    width = max(map(len, names), default=0)
    print_result(names, as_json, (f"{name:{width}}  {line}".rstrip() for name, line in names.items()))


def schema(
    kind: Annotated[str, typer.Argument(help="scene, camera, suite, study or prior.", autocompletion=kinds_of_files)],
) -> None:
    """Print the JSON Schema (draft 2020-12) of a kind of file, for editors and other programs."""
    from horizonval.core.errors import one_of
    from horizonval.spec.schema import MODELS, schema_text

    known = next((name for name in MODELS if name == kind), None)
    if known is None:
        expected = one_of(kind, MODELS)
        raise UserError(f"there is no schema of {kind!r}", where="schema", expected=expected)
    print(schema_text(known), end="")


def templates(
    target: Annotated[
        str,
        typer.Argument(
            metavar="SUITE|SCENE",
            help="A file, or the name of a shipped suite or scene.",
            autocompletion=shipped("suite", "scene"),
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The table: NAME.npz, or NAME.h for C.")],
    band: Annotated[str | None, typer.Option(help="Name of the band, where the cameras have several.")] = None,
    error: Annotated[
        float, typer.Option(help="Most that the table may be off by, as a share of a profile's largest value.")
    ] = 0.005,
    air: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE",
            help="An air that is known, the same everywhere, in place of the shipped tables' climate and weather: see "
            "`horizonval list atmospheres`, or a profile file.",
        ),
    ] = None,
    clear: Annotated[bool, typer.Option("--clear", help="With --air: no clouds either.")] = False,
    as_json: Json = False,
) -> None:
    """Write the limb profiles that a fit needs for the frames of a suite: one table for a flight computer.

    The table is a part of the shipped tables: latitudes, and months or Sun angles, of the limbs in view, with only as
    many heights and modes as the error requires. Prints the size in memory and the error. The key `climate` of a prior
    accepts the `.npz` file.
    """
    from horizonval.api.estimate import mission_table
    from horizonval.tables.mission import write_table

    check_target(output)
    with watched("marching the air" if air else "cutting") as progress:
        made = mission_table(target, band, error, air, clear, progress)
    with written(output) as path:
        write_table(made, path)
    a, b, k, h = made.cut.table.modes.shape
    facts = {
        "band": made.band.name,
        "bytes": made.cut.bytes,
        "frames": made.frames,
        "places": [a, b],
        "modes": k,
        "heights": h,
        "error": made.cut.error,
        "rms_error": made.cut.rms,
    }
    print_result(facts, as_json, [f"{output}: {made.band.name}, {made.frames} frames; {made.text}"])
