"""The nightly verdict, its baseline, and the reproduction of published systems."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.options import DryRun, Json, Workers, shipped
from horizonval.cli.options import systems as letters
from horizonval.cli.output import interruptible, print_dry_run, print_json
from horizonval.core.errors import UserError

baseline_app = typer.Typer(help="The accepted baseline of the nightly regression.", rich_markup_mode=None)

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
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the nights; created if missing.")] = Path(
        "regress"
    ),
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
    0 pass (or improved), 1 regression, 2 incomplete (no baseline, something of it missing, failed frames, wrong use), 3
    inconclusive (`--lane fresh` alone).
    """
    from horizonval.api.run import DryRun as Counted
    from horizonval.api.run import regress as run_night

    try:
        with interruptible(kept="units"):
            verdict = run_night(
                suite,
                out,
                baseline=baseline,
                lanes=lane,
                night=night,
                reference=reference,
                workers=workers,
                dry_run=dry_run,
            )
    except (UserError, OSError):
        raise
    except Exception:
        # Exit status 1 means that something became worse; a defect of the program is something else.
        traceback.print_exc()
        return 2
    if isinstance(verdict, Counted):
        print_dry_run(verdict, as_json)
        return 0
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
    yes: Annotated[
        bool, typer.Option("--yes", help="Also with methods that claim falsely or crash in nearly every image.")
    ] = False,
) -> None:
    """Make a night the accepted baseline, and write the table of changes and of what the acceptance covers."""
    from horizonval.api.run import baseline_of
    from horizonval.studies.regression.accept import accept
    from horizonval.studies.regression.night import read_night

    file = baseline or baseline_of(read_night(run)["suite"])
    for path in accept(run, file, reason, release=release, yes=yes):
        print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


def _print_verdict(verdict: dict[str, Any]) -> None:
    from horizonval.studies.regression.page import published_sentence
    from horizonval.studies.regression.statistics import Verdict
    from horizonval.studies.regression.words import by_subject, subject, subject_sentence

    subjects = by_subject(verdict["gates"])
    for word in (Verdict.FAIL, Verdict.IMPROVED):
        for first, one, deciding in subjects:
            if one is word:
                print(f"{one:12} {subject_sentence(first, deciding)}")
    undecided = [subject(first) for first, one, _ in subjects if one is Verdict.INCONCLUSIVE]
    if undecided:
        more = f" and {len(undecided) - 1} more" if len(undecided) > 1 else ""
        print(f"{Verdict.INCONCLUSIVE:12} other scenes: too few for {undecided[0]}{more}")
    for lane in ("replay", "rerender", "fresh"):
        same = [one for first, one, _ in subjects if first["lane"] == lane]
        if same:
            held = sum(one is Verdict.PASS for one in same)
            what = "methods hold on other scenes" if lane == "fresh" else "methods and image sets within their margins"
            print(f"{lane}: {held} of {len(same)} {what}")
    if verdict["published"]:
        same = [one for one in verdict["published"] if one["verdict"] == "PASS"]
        print(f"published systems: {len(same)} of {len(verdict['published'])} figures as accepted")
    for one in verdict["published"]:
        if one["verdict"] != "PASS":
            print(f"{one['verdict']:12} system {one['system']}, {one['name']}: {published_sentence(one)}")
    for note in verdict["notes"]:
        print(f"note: {note}")
    for problem in verdict["problems"]:
        print(f"problem: {problem}")
    for step in verdict["trend"]:
        print(
            f"step: {step['figure']} from {step['before']:.4g} to {step['after']:.4g} {step['unit']} on {step['night']}"
        )
    also = ", incomplete" if verdict["verdict"] == Verdict.FAIL and not verdict["complete"] else ""
    print(f"night {verdict['night']}: {verdict['verdict']}{also}")


def reproduce(
    systems: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[A|B|C|D|E|F|G|all]...", help="Published systems; all by default.", autocompletion=letters
        ),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the pages; created if missing.")] = ...,  # type: ignore[assignment]
    seed: Annotated[int, typer.Option(min=0, help="Of all noise in the experiments.")] = 0,
    workers: Workers = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Key figures at reduced size, compared with results/published/quick.json.")
    ] = False,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> int:
    """Repeat published experiments: OUT/<X>.json and a page for each, with published and measured figures.

    The same command resumes after an interruption. Exit status 1 if a bar is missed, or with --quick if a figure
    differs from the committed one.
    """
    if quick and dry_run:
        raise UserError("used with --quick", where="--dry-run", fix="leave one of them out")
    if quick:
        return _quick(systems or [], out, workers, as_json)
    from horizonval.api.run import DryRun as Counted
    from horizonval.api.run import reproduce as reproduced
    from horizonval.systems.page import printed_rows

    done = {}
    with interruptible():
        for content in reproduced(systems or [], out, seed=seed, workers=workers, dry_run=dry_run):
            if isinstance(content, Counted):
                print_dry_run(content, as_json)
                return 0
            done[content["system"]] = content
            if not as_json:
                print("\n".join(printed_rows(content)), flush=True)
    if as_json:
        print_json(done)
    else:
        print(f"pages: {out / 'README.md'}")
    return int(any(row["holds"] is False for content in done.values() for row in content["rows"]))


def _quick(systems: list[str], out: Path, workers: int | None, as_json: bool) -> int:
    from horizonval.api.run import PAGES, shown
    from horizonval.systems.run import reproduce_quick

    with interruptible(), shown(True, "reproduce", "items") as listener:
        rows = reproduce_quick(systems, out, PAGES, workers=workers, progress=listener)
    if as_json:
        print_json(rows)
    else:
        for row in rows:
            print(f"{row['verdict']} {row['system']} {row['name']}: {row['measured']:.6g} {row['unit']}".rstrip())
    return int(any(row["verdict"] == "FAIL" for row in rows))
