"""A suite from frames to report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.check import warnings_printed
from horizonval.cli.options import Dask, DryRun, Json, Shard, Workers
from horizonval.cli.options.completion import shipped
from horizonval.cli.printing import print_dry_run, print_json, print_shard, print_summary
from horizonval.cli.work import execution_of, interruptible
from horizonval.core.errors import UserError


def run(
    suite: Annotated[
        str, typer.Argument(help="A suite file, or the name of a shipped suite.", autocompletion=shipped("suite"))
    ] = "quick",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the run; made if need be.")] = ...,  # type: ignore[assignment]
    workers: Workers = None,
    shard: Shard = None,
    merge: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Take over the results of another folder's run; repeatable."),
    ] = None,
    dask: Dask = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.1, metavar="S", help="Of one estimate; in place of the suite's time_limit_s.")
    ] = None,
    keep: Annotated[
        str | None, typer.Option(metavar="WHAT", help="Frames in the archive: all, failures or none; see suite.keep.")
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="In place of suite.frames, of a suite that draws shares of it."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="In place of suite.seed: other Sobol points, other draws of the noise.")
    ] = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> int:
    """Main job: render, observe, estimate, score, report; and the study of the infrared horizon a suite asks for.

    The same command again, after whatever interrupted it, finishes what is missing. Shards (`--shard 2/8`) may share a
    folder, at the same time or not; the command without --shard then makes what is missing and the report. Another
    --frames goes on in the same folder. Exit status 1 if a frame failed.
    """
    import horizonval as hv

    if dry_run:
        from horizonval.commands.dry_run import of_suite
        from horizonval.precheck import check_suite
        from horizonval.suites.suite import load_suite, with_options

        loaded = with_options(load_suite(suite, frames, seed), time_limit, keep)
        execution = execution_of(workers, shard, dask, merge)
        print_dry_run(of_suite(loaded, out, execution, check_suite(loaded, infrared=False)), as_json)
        return 0
    with interruptible(kept="frames"), warnings_printed():
        result = hv.run(
            suite,
            out,
            workers=workers,
            shard=shard,
            seed=seed,
            frames=frames,
            keep=keep,
            time_limit_s=time_limit,
            dask=dask,
            merge=merge or (),
        )
    if as_json:
        print_json(result.summary)
    elif not result.summary:
        print_shard(shard, result.missing)
    else:
        print_summary(result.summary)
        if result.summary.get("stability"):
            _print_study(result.summary["stability"])
        print(f"report: {result.report}")
    if result.failed:
        from horizonval.suites.suite import load_suite

        names, loaded = ", ".join(result.failed), load_suite(suite, frames, seed)
        study = loaded.stability
        total = len(loaded.cases) + (len(study.months) if study else 0)
        what = "frames and months" if study else "frames"
        print(f"horizonval: {len(result.failed)} of {total} {what} failed: {names}", file=sys.stderr)
    # A run that ends without its summary has not done what was asked, whatever stopped it.
    return 1 if result.failed or (shard is None and not result.summary) else 0


def report(run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]) -> None:
    """Make the report of a run again."""
    from horizonval.report import build_report

    if not run_folder.is_dir():
        raise UserError("no such folder", where=str(run_folder), expected="the folder of a run")
    print(f"report: {build_report(run_folder)}")
    if (run_folder / "study.json").is_file():
        from horizonval.report.pages.study_page import write_page
        from horizonval.store.manifest import amend_manifest

        page = write_page(run_folder)
        amend_manifest(run_folder, [page])
        print(f"designs: {page}")


def _print_study(digest: dict[str, Any]) -> None:
    for band in digest["bands"]:
        half, errors = band["half_km"], [f"{s['name']} {s['max_pitch_deg']:.3f}" for s in band["sensors"]]
        print(
            f"infrared horizon, {band['name']}: half plateau {half['min']:.1f} to {half['max']:.1f} km; "
            f"largest pitch error [deg]: {', '.join(errors)}"
        )
