"""All commands in the order of ``--help``, and the exit of a command."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from typing import Annotated

import typer

from horizonval.cli.archive import archive_app
from horizonval.cli.bench import bench_app, dataset
from horizonval.cli.images import calibrate, camera, estimate, observe, oracle, sheet
from horizonval.cli.info import doctor, list_names, schema, templates
from horizonval.cli.locating import locate
from horizonval.cli.nightly import baseline_app, regress, reproduce
from horizonval.cli.rendering import gallery, mitsuba, radiance, render
from horizonval.cli.run import budget, check, report, run, study
from horizonval.cli.serving import serve, view
from horizonval.core.environment import settle_libraries
from horizonval.core.errors import UserError, printable
from horizonval.core.files import begin_command
from horizonval.jobs.pool import hush, sign_of_life

COMPLETION = "_HORIZONVAL_COMPLETE"
"""Environment variable with which shells request completions."""

app = typer.Typer(
    name="horizonval",
    help="Physically based rendering validation of Earth horizon sensors.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
COMMANDS: tuple[Callable[..., int | None], ...] = (
    run, check, render, mitsuba, observe, serve, sheet, estimate, oracle, calibrate, camera, radiance, report, view,
    study, budget, dataset, reproduce, locate, regress, gallery, templates, schema, doctor,
)  # fmt: skip
for _command in COMMANDS:
    app.command()(_command)
app.command("list")(list_names)
app.add_typer(archive_app, name="archive")
app.add_typer(baseline_app, name="baseline")
app.add_typer(bench_app, name="bench")


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from horizonval import __version__

        print(f"horizonval {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line; each of a user's mistakes is one line on standard error; exit status 2."""
    # One thread for linear algebra, before numpy loads: the last bit of a result must not depend on the machine.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    settle_libraries()
    # Unencodable names must not stop a command on a terminal or pipe.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    arguments = sys.argv[1:]
    # Shell completion allows no other output.
    life = sign_of_life(f"horizonval: {_command_name(arguments)} is getting ready")
    with nullcontext() if COMPLETION in os.environ else life:
        status = run_command_line(arguments)
    sys.exit(status)


def _command_name(arguments: list[str]) -> str:
    """Return the words that name the command, as far as known before parsing."""
    words = [word for word in arguments[:2] if not word.startswith("-")]
    return " ".join(words if words[:1] in (["archive"], ["baseline"], ["bench"]) else words[:1]) or "it"


def run_command_line(arguments: list[str]) -> int:
    """Run one command line and return its exit status."""
    begin_command()
    try:
        status = app(arguments or ["--help"], prog_name="horizonval", standalone_mode=False)
        sys.stdout.flush()
    except UserError as e:
        return _fail(*e.lines())
    except BrokenPipeError:
        # The reader has gone (``| head``): no error, and no further output.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except OSError as e:
        parts = (e.filename and os.fsdecode(e.filename), e.strerror or e)
        more = "; raise the limit (ulimit -n)" if e.errno in (errno.EMFILE, errno.ENFILE) else ""
        return _fail(printable(": ".join(str(part) for part in parts if part)) + more)
    except Exception as e:
        # The parser's own errors (unknown option, missing argument) have this method; anything else is a defect.
        if hasattr(e, "format_message"):
            return _fail(printable(" ".join(e.format_message().split())) + " (see --help)")
        raise
    if status == 130:
        print("horizonval: interrupted", file=sys.stderr)
    return int(status or 0)


def _fail(*lines: str) -> int:
    hush()
    for line in lines:
        print(f"horizonval: error: {line}", file=sys.stderr)
    return 2
