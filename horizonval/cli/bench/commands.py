"""The benchmark: its frames made, submissions run on them, all of them ranked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.options import Json, Workers
from horizonval.cli.options.completion import estimators
from horizonval.cli.printing import print_json
from horizonval.cli.work import resumable
from horizonval.core.errors import UserError, printable

bench_app = typer.Typer(help="The benchmark of horizon sensing: make, run, score.", rich_markup_mode=None)

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Of `bench make`.")]


@bench_app.command("make")
def bench_make(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the benchmark; made if need be.")],
    passphrase_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sealed frames, drawn by the passphrase in this file.")
    ] = None,
    frames_per_cell: Annotated[int, typer.Option(help="The first so many of the 50 of each cell.")] = 50,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Render the frames: the public ones, or sealed ones of a passphrase. The same command again finishes them."""
    from horizonval.core import files
    from horizonval.studies.bench.frames import sealed_seed
    from horizonval.studies.bench.submissions import make_frames

    seed = None
    if passphrase_file is not None:
        try:
            text = files.read_bytes(passphrase_file, largest=4096, expected="a passphrase").decode()
        except UnicodeDecodeError:
            raise UserError("is no text", where=str(passphrase_file), expected="a passphrase in UTF-8") from None
        seed = sealed_seed(text)
    with resumable("bench", "frames") as progress:
        head = make_frames(out, seed, frames_per_cell, workers, progress)
    if as_json:
        print_json(head)
    else:
        for group in ("frames", "heads"):
            print(f"{out / group}: {head[group]['images']} images, digest {head[group]['images_sha256']}")
        print(f"commitment {head['commitment']}")


@bench_app.command("run")
def bench_run(
    folder: Folder,
    estimator: Annotated[
        list[str] | None, typer.Option(help="A method or an installed plug-in; repeatable.", autocompletion=estimators)
    ] = None,
    program: Annotated[
        list[str] | None, typer.Option(metavar="NAME=COMMAND", help="A program as an estimator; repeatable.")
    ] = None,
    time_limit: Annotated[float, typer.Option(min=0.1, metavar="S", help="Of one image.")] = 60.0,
    memory_limit: Annotated[int, typer.Option(min=64, metavar="MB", help="Of one submission.")] = 4096,
    contain: Annotated[
        bool,
        typer.Option(help="Hide the folder from plug-ins and programs, and cut their network; Linux can."),
    ] = True,
    workers: Workers = None,
) -> int:
    """Run submissions on the frames, each in a process of its own. The same command again finishes them."""
    from horizonval.estimation.process.containment import can_hide
    from horizonval.estimation.process.limits import Limits
    from horizonval.jobs.pool import available_cpus
    from horizonval.spec.suite import ProgramSpec
    from horizonval.studies.bench.submissions import run_submissions

    programs = []
    for text in program or ():
        name, _, command = text.partition("=")
        if not name or not command:
            raise UserError(f"found {text!r}", where="--program", expected="NAME=COMMAND")
        programs.append(ProgramSpec(name=name, command=command))
    names = [*(estimator or ()), *(spec.name for spec in programs)]
    if not names:
        raise UserError("which submission?", where="bench run", expected="--estimator, --program or several")
    if contain and not can_hide():
        raise UserError(
            "this system hides no folder from a process",
            where="bench run",
            expected="Linux with namespaces of users and mounts",
            fix="run it in a container, or trust the submissions with --no-contain",
        )
    limits = Limits(time_limit, memory_limit, tuple(programs), Path.cwd())
    with resumable("bench", "images") as progress:
        failed = run_submissions(folder, names, limits, workers or available_cpus(), progress, contained=contain)
    for name, reasons in failed.items():
        for frame, why in reasons.items():
            print(printable(f"{name}: {frame}: {why}"))
    return 1 if any(failed.values()) else 0


@bench_app.command("score")
def bench_score(folder: Folder, as_json: Json = False) -> None:
    """Score and rank all submissions: scores.json and README.md in the folder."""
    from horizonval.studies.bench.submissions import page, score_submissions

    scores = score_submissions(folder)
    if as_json:
        print_json(scores)
    else:
        print("\n".join(printable(line) for line in page(scores).splitlines()))
