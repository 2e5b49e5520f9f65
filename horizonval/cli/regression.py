"""The nightly verdict, and the baseline it is measured against."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.options import DryRun, Json, Workers
from horizonval.cli.options.completion import shipped
from horizonval.cli.printing import print_dry_run, print_json
from horizonval.cli.work import resumable
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress

baseline_app = typer.Typer(help="The accepted baseline of the nightly regression.", rich_markup_mode=None)

BASELINES = Path("results/baseline")
PAGES = Path("results/published")
BaselineFile = Annotated[
    Path | None, typer.Option("--baseline", metavar="FILE", help="By default results/baseline/SUITE.json.")
]


def regress(
    suite: Annotated[
        str,
        typer.Argument(
            help="A suite with a [regression] table: a file or a shipped name.", autocompletion=shipped("suite")
        ),
    ] = "nightly",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the nights; made if need be.")] = Path("regress"),
    baseline: BaselineFile = None,
    lane: Annotated[
        list[str] | None, typer.Option(help="replay, rerender, fresh or published; repeatable. All by default.")
    ] = None,
    night: Annotated[str | None, typer.Option(metavar="DATE", help="Label and seed; today (UTC) by default.")] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Another version's folder of this night: pairs for fresh scenes.")
    ] = None,
    workers: Workers = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> int:
    """Nightly verdict: is anything worse than the accepted baseline or the last release?

    Writes verdict.json, junit.xml and index.html. `--lane replay` alone is quick enough for every change. Exit status
    0 pass (or improved), 1 regression, 2 incomplete (no baseline, failed frames, wrong use), 3 inconclusive.
    """
    from datetime import UTC, datetime
    from functools import partial

    from horizonval.studies.regression.night import LANES, Wanted, run_night

    lanes = tuple(name for name in LANES if lane is None or name in lane)
    for name in lane or ():
        if name not in LANES:
            raise UserError(f"found {name!r}", where="--lane", expected=" or ".join(LANES))
    label = night or datetime.now(UTC).date().isoformat()
    file = baseline or BASELINES / f"{Path(suite).stem}.json"
    wanted = Wanted(suite, out, file, label, lanes, workers, reference)
    if dry_run:
        from horizonval.commands.dry_run import of_night

        print_dry_run(of_night(wanted), as_json)
        return 0
    with resumable(f"night {label}", "units", kept="units") as progress:
        verdict = run_night(wanted, progress, partial(_published, workers))
    if as_json:
        print_json(verdict)
    else:
        _print_verdict(verdict)
        print(f"report: {out / 'index.html'}")
    return int(verdict["exit_status"])


@baseline_app.command("accept")
def baseline_accept(
    run: Annotated[Path, typer.Argument(help="Folder of a night, as `regress` writes it.")],
    reason: Annotated[str, typer.Option(help="Why the results are right, for whoever reviews the change.")],
    baseline: BaselineFile = None,
    release: Annotated[bool, typer.Option("--release", help="Also as the last release's.")] = False,
) -> None:
    """Make a night the accepted baseline, and write the table of what differs from the one before."""
    from horizonval.store.folder import read_json
    from horizonval.studies.regression.accept import accept

    name = (read_json(run / "night.json") or {}).get("suite", "nightly")
    for path in accept(run, baseline or BASELINES / f"{name}.json", reason, release=release):
        print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


def _published(workers: int | None, folder: Path, progress: Progress) -> list[JsonObject]:
    from horizonval.jobs.execution import available_cpus
    from horizonval.systems.key_figures import key_figures
    from horizonval.systems.task_cache import TaskCache

    return key_figures(TaskCache(folder, workers=workers or available_cpus(), progress=progress), PAGES)


def _print_verdict(verdict: dict[str, Any]) -> None:
    from horizonval.studies.regression.gates import gate_sentence
    from horizonval.studies.regression.page import published_sentence

    for gate in verdict["gates"]:
        print(f"{gate['verdict']:12} {gate['name']} ({gate['against']}): {gate_sentence(gate)}")
    if verdict["published"]:
        same = sum(one["verdict"] == "PASS" for one in verdict["published"])
        print(
            f"{'PASS' if same == len(verdict['published']) else 'FAIL':12} published systems: {same} of "
            f"{len(verdict['published'])} figures as accepted"
        )
    for one in verdict["published"]:
        if one["verdict"] != "PASS":
            print(f"{one['verdict']:12} system {one['system']}, {one['name']}: {published_sentence(one)}")
    for problem in verdict["problems"]:
        print(f"problem: {problem}")
    for step in verdict["trend"]:
        print(
            f"step: {step['figure']} from {step['before']:.4g} to {step['after']:.4g} {step['unit']} on {step['night']}"
        )
    print(f"night {verdict['night']}: {verdict['verdict']}{'' if verdict['complete'] else ', incomplete'}")
