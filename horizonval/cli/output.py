"""Shared output of commands: checked targets, progress, interruptions, tables."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from horizonval.core import atomic
from horizonval.core.errors import UserError, printable
from horizonval.core.files import check_parent, is_input, is_same, kind_at

if TYPE_CHECKING:
    from horizonval.api.run import DryRun
    from horizonval.jobs.progress import Terminal


def check_target(out: Path, *inputs: str | Path | None) -> None:
    """Refuse an unwritable file before the work, and one that the command has read, or will (``inputs``)."""
    if not out.name:
        what = "is a folder, or an empty name"
        raise UserError(what, where=f"-o {out}", expected="the path of a file")
    check_parent(out)
    kind = kind_at(out, links=True)
    if kind in ("a folder", "a socket", "no file"):
        raise UserError(f"is {kind}", where=str(out), expected="the path of a file")
    if is_input(out) or any(is_same(out, one) for one in inputs if one is not None):
        raise UserError("is read by this command, which would replace it", where=str(out), fix="name another file")


@contextmanager
def written(out: Path) -> Iterator[Path]:
    """Give the path to write an output to, the only way in which commands write the file that ``-o`` names.

    A file is replaced when it is complete, at the end of the link if ``out`` is one, and never where the command has
    read it. A device or a pipe stays: the complete output goes into it as a stream.
    """
    check_target(out)
    if kind_at(out, links=True) in ("", "a file"):
        yield Path(os.path.realpath(out)) if out.is_symlink() else out
        return
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder, out.name)
        try:
            yield whole
        except UserError as error:
            raise error.at(error.where.replace(str(whole), str(out))) from None
        atomic.pour(whole, out)


@contextmanager
def resumable(what: str, unit: str = "frames", *, kept: str | None = None) -> Iterator[Terminal]:
    """Show the progress of resumable work, counted in ``unit``; an interruption prints a line and gives status 130.

    ``kept``: what an interruption preserves, for that line.
    """
    from horizonval.jobs.progress import Terminal

    with interruptible(kept), Terminal(what, unit) as progress:
        yield progress


@contextmanager
def interruptible(kept: str | None = None) -> Iterator[None]:
    """End with status 130 and one line after an interruption; ``kept`` as for :func:`resumable`.

    Other early ends, such as a plug-in's ``sys.exit(0)`` or a closed pipe, do not count as success.
    """
    try:
        yield
    except KeyboardInterrupt:
        finished = f"finished {kept} are saved, " if kept else ""
        print(f"horizonval: interrupted; {finished}the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    except SystemExit as end:
        # Finished work leaves the block: ending the process inside it means failure.
        if end.code not in (None, 0):
            raise
        print("horizonval: error: foreign code ended the process before the work was done", file=sys.stderr)
        raise SystemExit(1) from None
    except BrokenPipeError:
        raise SystemExit(1) from None


def watched(what: str, unit: str = "files") -> Terminal:
    """Show progress on a terminal, without log lines."""
    from horizonval.jobs.progress import Terminal

    return Terminal(what, unit, log=False)


def print_json(data: object) -> None:
    """Print one JSON object."""
    print(json.dumps(data, indent=1, allow_nan=False))


def print_result(data: object, as_json: bool, lines: Iterable[str]) -> None:
    """Print plain data as JSON, or else lines of text; generators of lines are only consumed for text."""
    if as_json:
        print_json(data)
    else:
        for line in lines:
            print(printable(line))


def print_dry_run(counted: DryRun, as_json: bool) -> None:
    """Print what a command would make."""
    print_result(counted.to_dict(), as_json, str(counted).splitlines())


def print_summary(summary: dict[str, Any]) -> None:
    """Print the table of a run, one line for every camera and estimator, and its summary in words.

    Estimators that receive the true pose come last: they test the scoring, and are excluded from other lines.
    """
    from horizonval.report.words import by_camera, headline, prior_words, unit_of

    groups = by_camera(summary["groups"])
    judged = [group for group in groups if not group["given_pose"]]
    unit = unit_of(group["nadir_error_arcsec"]["max"] for group in judged)
    unit = replace(unit, sign=f" {unit.name}")
    several_draws = any(group["nees_noise"]["n"] for group in groups)
    head = ("camera", "estimator", "frames", "right", f"rms [{unit.name}]", "median", "95 %", "worst", "false claims")
    rows = [(*head, "noise NEES / 2") if several_draws else head]
    for group in groups:
        error, right, false = group["nadir_error_arcsec"], group["headline"]["due"], group["false_valid"]
        rows.append(
            (
                group["camera"],
                group["estimator"] + (" (given the pose)" if group["given_pose"] else ""),
                str(group["n"]),
                f"{right['n']} of {right['of']} usable",
                *("-" if error[key] is None else unit.number(error[key]) for key in ("rms", "median", "p95", "max")),
                f"{false['n']} of {false['of']}",
                *([_noise_nees(group["nees_noise"])] if several_draws else []),
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    if summary.get("prior"):
        print(f"Prior of the methods that use one: {prior_words(summary['prior'])}.")
    for group in judged:
        print(f"{group['camera']}, {group['estimator']}: {headline(group, unit)}")


def print_shard(shard: str | None, missing: int) -> None:
    """Print that a shard is finished, and what the whole lacks."""
    print(f"shard {shard} is done, {missing} results of others are missing; run without --shard to conclude")


def _noise_nees(nees: dict[str, Any]) -> str:
    """Return the mean per degree of freedom with its standard error, 1 if the claimed noise is honest."""
    if not nees["n"]:
        return "-"
    error = nees["standard_error"]
    spread = "" if error is None else f" +- {error / nees['expected']:.2f}"
    return f"{nees['mean'] / nees['expected']:.2f}{spread} ({nees['n']} frames)"
