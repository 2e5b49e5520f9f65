"""Published systems, reproduced."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.options import DryRun, Json, Workers
from horizonval.cli.options.completion import systems
from horizonval.cli.printing import print_dry_run, print_json
from horizonval.cli.work import resumable


def reproduce(
    systems: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[A|B|C|D|E|F|G|all]...", help="Published systems; all by default.", autocompletion=systems
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the pages; made if need be.")] = ...,  # type: ignore[assignment]
    seed: Annotated[int, typer.Option(min=0, help="Of all noise in the experiments.")] = 0,
    workers: Workers = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> int:
    """Published experiments done again: OUT/<X>.json and a page for each, published figures beside measured ones.

    The same command again, after whatever interrupted it, finishes what is missing. Exit status 1 if a bar is missed.
    """
    from horizonval.systems.pages import printed_rows
    from horizonval.systems.run import WORK, reproduce_systems

    if dry_run:
        from horizonval.commands.dry_run import of_systems

        print_dry_run(of_systems(systems or [], out, seed, out / WORK), as_json)
        return 0

    done = {}
    with resumable("reproduce", unit="items") as progress:
        for content in reproduce_systems(systems or [], out, seed=seed, workers=workers, progress=progress):
            done[content["system"]] = content
            if not as_json:
                print("\n".join(printed_rows(content)), flush=True)
    if as_json:
        print_json(done)
    else:
        print(f"pages: {out / 'README.md'}")
    return int(any(row["holds"] is False for content in done.values() for row in content["rows"]))
