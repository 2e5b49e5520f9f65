"""Images for others: the benchmark (frames, submissions, ranking) and training data sets."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.options import Dask, Json, Shard, Workers, estimators, files, shipped
from horizonval.cli.output import print_json, print_result, resumable
from horizonval.core.errors import UserError, excerpt, printable

bench_app = typer.Typer(help="The benchmark of horizon sensing: make, run, score.", rich_markup_mode=None)

Folder = Annotated[Path, typer.Argument(metavar="FOLDER", help="Of `bench make`.")]


@bench_app.command("make")
def bench_make(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the benchmark; created if missing.")],
    passphrase_file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sealed frames, drawn by the passphrase in this file.")
    ] = None,
    frames_per_cell: Annotated[int, typer.Option(help="The first so many of the 50 of each cell.")] = 50,
    workers: Workers = None,
    as_json: Json = False,
) -> None:
    """Render the frames: the public ones, or sealed ones of a passphrase. The same command resumes."""
    from horizonval.core.files import read_bytes
    from horizonval.studies.bench.frames import sealed_seed
    from horizonval.studies.bench.submissions import LONGEST_PASSPHRASE, make_frames

    seed = None
    if passphrase_file is not None:
        try:
            text = read_bytes(passphrase_file, largest=LONGEST_PASSPHRASE, expected="a passphrase").decode()
        except UnicodeDecodeError:
            raise UserError("is no text", where=str(passphrase_file), expected="a passphrase in UTF-8") from None
        seed = sealed_seed(text)
    with resumable("bench", "frames") as progress:
        head = make_frames(out, seed, frames_per_cell, workers, progress, passphrase_file)
    made = (f"{out / g}: {head[g]['images']} images, digest {head[g]['images_sha256']}" for g in ("frames", "heads"))
    print_result(head, as_json, [*made, f"commitment {head['commitment']}"])


@bench_app.command("run")
def bench_run(
    folder: Folder,
    estimator: Annotated[
        list[str] | None, typer.Option(help="A method or an installed plug-in; repeatable.", autocompletion=estimators)
    ] = None,
    program: Annotated[
        list[str] | None, typer.Option(metavar="NAME=COMMAND", help="A program as an estimator; repeatable.")
    ] = None,
    time_limit: Annotated[float, typer.Option(min=0.1, metavar="S", help="Processor time of one image.")] = 60.0,
    memory_limit: Annotated[int, typer.Option(min=64, metavar="MB", help="Of one submission.")] = 4096,
    contain: Annotated[
        bool,
        typer.Option(help="Plug-ins and programs see no frames and no network, and write nowhere; Linux can."),
    ] = True,
    workers: Workers = None,
) -> int:
    """Run submissions on the frames, each in a separate process. The same command resumes."""
    from pydantic import ValidationError

    from horizonval.jobs.pool import available_cpus
    from horizonval.plugins.supervisor import Limits, can_hide
    from horizonval.spec.suite import ProgramSpec
    from horizonval.studies.bench.submissions import run_submissions

    programs = []
    for text in program or ():
        name, _, command = text.partition("=")
        try:
            programs.append(ProgramSpec(name=name, command=command))
        except ValidationError:
            raise UserError(
                f'found "{excerpt(text)}"',
                where="--program",
                expected="NAME=COMMAND, the name of at most 50 letters, digits, dots, dashes and underscores",
            ) from None
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
    print_result(scores, as_json, page(scores).splitlines())


def dataset(
    suite: Annotated[
        str | None,
        typer.Argument(help="A suite file, or the name of a shipped suite.", autocompletion=shipped("suite")),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the data set; created if missing.")] = ...,  # type: ignore[assignment]
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Number of frames; by default what the suite's scenes make.")
    ] = None,
    format_name: Annotated[
        str | None, typer.Option("--format", metavar="FORMAT", help="webdataset (by default), hdf5 or zarr.")
    ] = None,
    shard_size: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Frames of a file; 1000 by default.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="In place of suite.seed: everything else is drawn.")] = None,
    seeds: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="SEEDS",
            help="Make a data set again from its seeds.json alone: the same bytes.",
            autocompletion=files(".json"),
        ),
    ] = None,
    workers: Workers = None,
    shard: Shard = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Training images with exact truth: split by scene into training, validation and test, in files of N frames.

    The small `seeds.json` in the folder reproduces all of them. The same command resumes after an interruption.
    """
    from horizonval.api.run import execution_of
    from horizonval.studies.dataset.make import make_dataset
    from horizonval.studies.dataset.scenes import list_of, read_list

    if seeds is not None:
        given = {
            "SUITE": suite,
            "--frames": frames,
            "--format": format_name,
            "--shard-size": shard_size,
            "--seed": seed,
        }
        if second := [name for name, value in given.items() if value is not None]:
            raise UserError(f"used with {second[0]}", where="--from", expected="the list alone, which says it all")
        made = read_list(seeds)
        if not made.is_of_this_code:
            print(
                "horizonval: note: the list was made by other code of this version; bytes may differ", file=sys.stderr
            )
    elif suite is None:
        raise UserError("of which suite?", where="dataset", expected="a suite, or --from SEEDS")
    else:
        made, _ = list_of(suite, frames, seed, shard_size or 1000, format_name or "webdataset")
    with resumable("dataset", "frames", kept="shards") as progress:
        index = make_dataset(made, out, execution_of(workers, shard, dask), progress)
    if as_json:
        print_json(index)
    elif shard is not None:
        print(f"{out}: {index['frames']} frames of shard {shard}; the command without --shard makes the rest")
    else:
        parts = ", ".join(
            f"{name} {part['frames']} frames of {part['scenes']} scenes" for name, part in index["splits"].items()
        )
        print(f"{out}: {parts}; {index['bytes'] / 1e6:.0f} MB, digest {index['sha256']}")
