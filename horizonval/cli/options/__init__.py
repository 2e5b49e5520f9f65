"""Options that several families of commands share."""

from __future__ import annotations

from typing import Annotated

import typer

from horizonval.jobs.pool import MOST_WORKERS

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Workers = Annotated[
    int | None, typer.Option(min=1, max=MOST_WORKERS, help="Processes; by default as many as processors.")
]
Shard = Annotated[
    str | None, typer.Option(metavar="I/N", help="Only every N-th frame from the I-th on; then run without it.")
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say what would be made and what it takes; render and write nothing.")
]
Dask = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler in place of own processes, or local:N.")
]
