"""Images to learn from, with exact truth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from horizonval.cli.options import Dask, Json, Shard, Workers
from horizonval.cli.options.completion import files, shipped
from horizonval.cli.printing import print_json
from horizonval.cli.work import execution_of, resumable
from horizonval.core.errors import UserError


def dataset(
    suite: Annotated[
        str | None,
        typer.Argument(help="A suite file, or the name of a shipped suite.", autocompletion=shipped("suite")),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the data set; made if need be.")] = ...,  # type: ignore[assignment]
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
    """Images to learn from, with exact truth: split by scene into training, validation and test, in files of N frames.

    `seeds.json` in the folder is all that they are made of, in some kilobytes. The same command again, after whatever
    interrupted it, finishes what is missing.
    """
    from horizonval.studies.dataset.make import make_dataset
    from horizonval.studies.dataset.seeds import list_of, read_list

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
        index = make_dataset(made, out, execution_of(workers, shard, dask, None), progress)
    if as_json:
        print_json(index)
    elif shard is not None:
        print(f"{out}: {index['frames']} frames of shard {shard}; the command without --shard makes the rest")
    else:
        parts = ", ".join(
            f"{name} {part['frames']} frames of {part['scenes']} scenes" for name, part in index["splits"].items()
        )
        print(f"{out}: {parts}; {index['bytes'] / 1e6:.0f} MB, digest {index['sha256']}")
