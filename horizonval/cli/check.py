"""What is wrong with a scene, suite or study, before anything is rendered."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from horizonval.cli.options import Json
from horizonval.cli.options.completion import shipped
from horizonval.cli.printing import print_json

if TYPE_CHECKING:
    from horizonval.jobs.engine import ExpectedTime
    from horizonval.studies.trade.design import Study


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
    """Say what would go wrong, before rendering: exposure, arc in view, Sun, determinability, time, memory and disk.

    Exit status 1 if there is a warning or an error, 0 if there are notes at most.
    """
    import horizonval as hv

    report = hv.check(target, frames=frames)
    if as_json:
        print_json(report.to_dict())
    else:
        print(report)
    return 0 if report.ok else 1


@contextmanager
def warnings_printed() -> Iterator[None]:
    """Print what the library warns of before a run, in the form of the command line, to standard error."""
    from horizonval.api.run import SuiteWarning

    with warnings.catch_warnings():
        warnings.simplefilter("always", SuiteWarning)
        otherwise = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
            if issubclass(category, SuiteWarning):
                print(f"horizonval: {message}", file=sys.stderr)
            else:
                otherwise(message, category, *place, **more)

        warnings.showwarning = show
        yield


def print_warnings(target: Study) -> dict[str, ExpectedTime]:
    """Print errors and warnings about a sample of the frames before a run, to standard error.

    Returns what the frames are expected to take.
    """
    from horizonval.precheck import check_before_run, expected_of

    report = check_before_run(target)
    for line in [] if report is None else report.summary_lines():
        print(f"horizonval: {line}", file=sys.stderr)
    return expected_of(target)
