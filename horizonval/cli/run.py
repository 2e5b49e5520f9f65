"""Suites and studies: check, run, report, and query."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.options import Dask, DryRun, Json, Merge, Shard, SuiteName, Workers, shipped
from horizonval.cli.output import (
    interruptible,
    print_dry_run,
    print_json,
    print_result,
    print_shard,
    print_summary,
    resumable,
)
from horizonval.core.errors import UserError, command_line


def check(
    target: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|SUITE|STUDY",
            help="A file, or the name of a shipped scene, suite or study.",
            autocompletion=shipped("scene", "suite", "study"),
        ),
    ],
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Frames of a suite or study, in place of the file's number.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Predict problems before rendering: exposure, arc in view, Sun, determinability, time, memory and disk.

    Exit status 1 if there is a warning or an error, 0 if there are notes at most.
    """
    import horizonval as hv

    report = hv.check(target, frames=frames)
    print_result(report.to_dict(), as_json, str(report).splitlines())
    return 0 if report.ok else 1


def run(
    suite: SuiteName = "quick",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the run; created if missing.")] = ...,  # type: ignore[assignment]
    workers: Workers = None,
    shard: Shard = None,
    merge: Merge = None,
    dask: Dask = None,
    time_limit: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="S", help="Processor time of an estimate, in place of time_limit_s."),
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
    """Main job: render, observe, estimate, score, report; and the suite's study of the infrared horizon, if any.

    The same command resumes after an interruption. Shards (`--shard 2/8`) may share a folder, at the same time or not;
    the command without --shard then makes what is missing and the report. Another --frames continues in the same
    folder. Exit status 1 if a frame failed.
    """
    import horizonval as hv

    with interruptible(kept="frames"):
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
            dry_run=dry_run,
        )
    if result.dry_run is not None:
        print_dry_run(result.dry_run, as_json)
        return 0
    if as_json:
        print_json(result.summary)
    elif not result.summary:
        print_shard(shard, result.missing)
    else:
        print_summary(result.summary)
        if result.summary.get("stability"):
            _print_study(result.summary["stability"])
        print("\n".join([*_requirement_lines(out), f"report: {result.report}"]))
    if result.failed:
        print(f"horizonval: {len(result.failed)} failed: {', '.join(result.failed)}", file=sys.stderr)
    # A run without its summary has failed, whatever stopped it.
    return 1 if result.failed or (shard is None and not result.summary) else 0


def budget(
    suite: SuiteName,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the budget; created if missing.")],
    window_s: Annotated[
        float | None,
        typer.Option(min=1e-3, help="Window of the knowledge errors [s]; a tenth of the longest flight without it."),
    ] = None,
    draws: Annotated[int, typer.Option(min=2, max=100, help="Draws of the detector's noise in every frame.")] = 4,
    alone: Annotated[
        bool, typer.Option("--alone", help="Also run every frame with one source on, as a check of every row.")
    ] = False,
    workers: Workers = None,
    shard: Shard = None,
    dask: Dask = None,
    as_json: Json = False,
) -> int:
    """Pointing budget of a suite: each error source switched off in turn, on common draws.

    Flights are the values of `calibration.draw`, or the orbits; samples of an orbit are times. Writes budget.csv,
    budget.json and index.html. The same command resumes after an interruption.
    """
    from horizonval.api.run import execution_of
    from horizonval.studies.budget.run import PAGE, run_budget
    from horizonval.suites.suite import load_suite

    loaded = load_suite(suite)
    with resumable("budget", kept="frames") as progress:
        execution = execution_of(workers, shard, dask)
        result = run_budget(
            loaded, out, window_s=window_s, draws=draws, alone=alone, execution=execution, progress=progress
        )
    print_result(result, as_json, [*_budget_lines(result), f"budget: {out / PAGE}"])
    return 0


def _budget_lines(result: dict[str, Any]) -> list[str]:
    lines = []
    for one in result["budgets"]:
        lines.append(f"{one['camera']}, {one['method']}: {one['answered']} of {one['frames']} frames answered")
        for row in [*one["rows"], {"title": "total", **one["whole"]}]:
            sigmas = [row["axes"][axis]["mixed"] or 0.0 for axis in ("roll", "pitch")]
            lines.append(f"  {row['title']:34} roll {sigmas[0]:8.2f}  pitch {sigmas[1]:8.2f} arcsec (1 sigma)")
        for axis, closed in one["closure"].items():
            words = "closes" if closed["closes"] else "does not close"
            lines.append(f"  {axis}: {words}, rows {closed['sigma_rss']:.2f}, total {closed['sigma']:.2f} arcsec")
    return lines


def report(run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]) -> None:
    """Rebuild the report of a run."""
    from horizonval.report import build_report

    if not run_folder.is_dir():
        raise UserError("no such folder", where=str(run_folder), expected="the folder of a run")
    print(f"report: {build_report(run_folder)}")
    if (run_folder / "study.json").is_file():
        from horizonval.report.study import write_page
        from horizonval.store.verify import amend_manifest

        page = write_page(run_folder)
        amend_manifest(run_folder, [page])
        print(f"designs: {page}")


def _requirement_lines(folder: Path) -> list[str]:
    from horizonval.scoring.requirements import FILES, lines_of
    from horizonval.store.folder import read_json

    found = read_json(folder / FILES[0])
    return lines_of(found) if found else []


def _print_study(digest: dict[str, Any]) -> None:
    for band in digest["bands"]:
        half, errors = band["half_km"], [f"{s['name']} {s['max_pitch_deg']:.3f}" for s in band["sensors"]]
        print(
            f"infrared horizon, {band['name']}: half plateau {half['min']:.1f} to {half['max']:.1f} km; "
            f"largest pitch error [deg]: {', '.join(errors)}"
        )


def study(
    study: Annotated[
        str,
        typer.Argument(
            help="A study file, the name of a shipped study, or a study's folder.", autocompletion=shipped("study")
        ),
    ],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the study; created if missing.")] = None,
    workers: Workers = None,
    shard: Shard = None,
    merge: Merge = None,
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
    """Trade study: designs compared on the same frames; accuracy, availability, cost, and the cheapest sufficient one.

    With a file and --out it runs, resumes, or adds new designs of the file; finished frames stay. With the folder of a
    finished study it gives the cheapest design for an --error-deg, --availability and --cheapest-by, or compares two.
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
        from horizonval.api.run import execution_of

        return _by_information(study, out, execution_of(workers, shard, dask, merge or ()), frames, as_json)
    from horizonval.api.run import DryRun as Counted
    from horizonval.api.run import study as run_study

    with interruptible(kept="frames"):
        done = run_study(
            study, out, workers=workers, shard=shard, dask=dask, merge=merge or (), frames=frames, dry_run=dry_run
        )
    if isinstance(done, Counted):
        print_dry_run(done, as_json)
        return 0
    if as_json:
        print_json(done.result)
    elif done.page is None:
        print_shard(shard, done.missing)
    else:
        from horizonval.studies.trade.formatting import design_lines

        query = (done.costs if done.result["prices"] is None else done.result)["query"]
        answers = [*_requirement_lines(out), *_answer_lines(query)]
        print("\n".join([*design_lines(done.result, done.costs), *answers, f"report: {done.page}"]))
    if done.failed:
        print(f"horizonval: {len(done.failed)} frames failed: {', '.join(done.failed)}", file=sys.stderr)
    return 1 if done.failed else 0


def _by_information(study: str, out: Path, execution: Any, frames: int | None, as_json: bool) -> int:
    from horizonval.studies.trade.formatting import information_lines
    from horizonval.studies.trade.information import run_information

    with resumable("study", kept="frames") as progress:
        result = run_information(study, out, execution=execution, progress=progress, frames=frames)
    print_result(result, as_json, information_lines(result))
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
    requirements, limit = data.plan.requirements, data.plan.limit
    if error_deg is not None or availability is not None:
        limit = limit.model_copy(update={"n_sigma": None, "quantile": None, "availability": limit.share})
        if error_deg is not None:
            limit = with_option(limit, "error_deg", error_deg, "--error-deg")
        if availability is not None:
            limit = with_option(limit, "availability", availability, "--availability")
        requirements = (limit,)
    if compare is not None:
        comparison = data.compare(*compare, limit.error_deg or math.inf)
        print_result(comparison, as_json, comparison_lines(comparison))
        return 0
    answer = ask(data, conclude_again(folder), requirements, cheapest_by)
    print_result(answer, as_json, _answer_lines(answer))
    return 0


def _answer_lines(answer: dict[str, Any]) -> list[str]:
    """Return the answer in words; if no design meets the requirement, with the causes of misses."""
    from horizonval.studies.trade.formatting import miss_lines

    missed = answer["cheapest"] is None and any(answer["misses"].values())
    return [answer["text"], *(miss_lines(answer["misses"]) if missed else [])]
