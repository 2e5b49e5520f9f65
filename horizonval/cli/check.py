"""What is wrong with a scene, suite or study, before anything is rendered."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from horizonval.cli.options import Json
from horizonval.cli.printing import print_json

if TYPE_CHECKING:
    from horizonval.spec.load import Suite
    from horizonval.studies.trade.design import Study


def check(
    target: Annotated[
        str, typer.Argument(metavar="SCENE|SUITE|STUDY", help="A file, or the name of a shipped scene, suite or study.")
    ],
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Frames of a suite or study, in place of the file's number.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Say what would go wrong, before rendering: exposure, arc in view, Sun, determinability, time, memory and disk.

    Exit status 1 if there is a warning or an error, 0 if there are notes at most.
    """
    from horizonval.api.check import check as check_target

    report = check_target(target, frames=frames)
    if as_json:
        print_json(report.to_dict())
    else:
        print(report)
    return 0 if report.ok else 1


def print_warnings(target: Suite | Study) -> None:
    """Print errors and warnings about a sample of the frames before a run, to standard error."""
    from horizonval.precheck import check_before_run

    report = check_before_run(target)
    for line in [] if report is None else report.summary_lines():
        print(f"horizonval: {line}", file=sys.stderr)
