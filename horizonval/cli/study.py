"""Trade studies: run one, or ask a finished one."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.check import print_warnings
from horizonval.cli.options import Dask, DryRun, Json, Shard, Workers
from horizonval.cli.options.completion import shipped
from horizonval.cli.printing import print_dry_run, print_json, print_shard
from horizonval.cli.work import execution_of, resumable
from horizonval.core.errors import UserError, command_line
from horizonval.jobs.execution import Execution


def study(
    study: Annotated[
        str,
        typer.Argument(
            help="A study file, the name of a shipped study, or a study's folder.", autocompletion=shipped("study")
        ),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the study; made if need be.")] = None,
    workers: Workers = None,
    shard: Shard = None,
    merge: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Take over the frames of another folder; repeatable.")
    ] = None,
    dask: Dask = None,
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Frames of a design, in place of the study's number.")
    ] = None,
    compare: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="A B", help="Two designs, by name or number, frame by frame; with a study's folder."),
    ] = None,
    error_deg: Annotated[
        float | None, typer.Option(min=1e-6, help="Ask for another error than the study's; with its folder.")
    ] = None,
    availability: Annotated[
        float | None, typer.Option(min=1e-6, max=0.999999, help="The same for the availability, such as 0.95.")
    ] = None,
    cheapest_by: Annotated[
        str | None,
        typer.Option(metavar="EXPR", help="Another cost than the study's, such as pixels or mass_g + 20 * power_w."),
    ] = None,
    by_information: Annotated[
        bool,
        typer.Option(
            "--by-information", help="What the limb of the frames allows any method: the bound, no estimator run."
        ),
    ] = False,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> int:
    """Trade study: designs compared on the same frames; accuracy, availability, cost, and the cheapest that will do.

    With a file and --out it runs, or goes on, or adds what is new in the file: finished frames are kept. With the
    folder of a finished study it tells the cheapest design for an --error-deg, --availability and --cheapest-by, or
    compares two.
    Exit status 1 if a frame failed.
    """
    if out is None:
        running = {
            "--dry-run": dry_run,
            "--workers": workers,
            "--shard": shard,
            "--merge": merge,
            "--dask": dask,
            "--frames": frames,
            "--by-information": by_information,
        }
        used = [name for name, value in running.items() if value]
        if used or not Path(study).is_dir():
            raise UserError(
                "missing", where="--out", expected="the folder of the study, or a folder in place of the file"
            )
        return _ask_study(Path(study), compare, error_deg, availability, cheapest_by, as_json)
    asked = {"--compare": compare, "--error-deg": error_deg, "--availability": availability}
    for name, value in {**asked, "--cheapest-by": cheapest_by}.items():
        if value is not None:
            words = value if isinstance(value, tuple) else (value,)
            then = command_line("study", out, name, *words)
            raise UserError(f"used with --out {out}", where=name, fix=f"run the study, then {then}")
    if by_information:
        if dry_run:
            raise UserError("used with --by-information", where="--dry-run", fix="leave one of them out")
        return _by_information(study, out, execution_of(workers, shard, dask, merge), frames, as_json)
    from horizonval.studies.trade.run import run_study

    execution = execution_of(workers, shard, dask, merge)
    if dry_run:
        from horizonval.commands.dry_run import of_suite
        from horizonval.precheck import check_study
        from horizonval.studies.trade.run import study_in

        planned = study_in(study, out, frames)
        print_dry_run(of_suite(planned.suite, out, execution, check_study(planned, infrared=False)), as_json)
        return 0
    with resumable("study", kept="frames") as progress:
        done = run_study(study, out, execution=execution, progress=progress, frames=frames, on_start=print_warnings)
    if as_json:
        print_json(done.result)
    elif done.page is None:
        print_shard(shard, done.missing)
    else:
        from horizonval.studies.trade.formatting import design_lines

        print("\n".join(design_lines(done.result, done.costs)))
        _print_answer((done.costs if done.result["prices"] is None else done.result)["query"])
        print(f"report: {done.page}")
    if done.failed:
        print(f"horizonval: {len(done.failed)} frames failed: {', '.join(done.failed)}", file=sys.stderr)
    return 1 if done.failed else 0


def _by_information(study: str, out: Path, execution: Execution, frames: int | None, as_json: bool) -> int:
    from horizonval.studies.information.study import information_lines, run_information

    with resumable("study", kept="frames") as progress:
        result = run_information(study, out, execution=execution, progress=progress, frames=frames)
    if as_json:
        print_json(result)
    else:
        print("\n".join(information_lines(result)))
    for name, error in result["failed"].items():
        print(f"horizonval: {name}: {error}", file=sys.stderr)
    return 1 if result["failed"] else 0


def _ask_study(
    folder: Path,
    compare: tuple[str, str] | None,
    error_deg: float | None,
    availability: float | None,
    cheapest_by: str | None,
    as_json: bool,
) -> int:
    from horizonval.spec.explain import with_option
    from horizonval.studies.trade.formatting import comparison_lines
    from horizonval.studies.trade.run import ask, conclude_again, open_study

    data = open_study(folder)
    requirement = data.plan.requirement
    if error_deg is not None:
        requirement = with_option(requirement, "error_deg", error_deg, "--error-deg")
    if availability is not None:
        requirement = with_option(requirement, "availability", availability, "--availability")
    if compare is not None:
        comparison = data.compare(*compare, requirement.error_deg)
        if as_json:
            print_json(comparison)
        else:
            print("\n".join(comparison_lines(comparison)))
        return 0
    answer = ask(data, conclude_again(folder), requirement, cheapest_by)
    if as_json:
        print_json(answer)
    else:
        _print_answer(answer)
    return 0


def _print_answer(answer: dict[str, Any]) -> None:
    """Print the answer in words, and where no design meets what is asked for, why frames were missed."""
    from horizonval.studies.trade.formatting import miss_lines

    print(answer["text"])
    if answer["cheapest"] is None and any(answer["misses"].values()):
        print("\n".join(miss_lines(answer["misses"])))
