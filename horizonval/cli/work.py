"""Long work: where it is done, how far it is, and what is left of it when it is interrupted."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from horizonval.jobs.pool import Execution
    from horizonval.jobs.progress import Terminal


def execution_of(workers: int | None, shard: str | None, dask: str | None, merge: list[Path] | None) -> Execution:
    """Return where the frames of a suite or study are made, as the options of these names say."""
    from horizonval.jobs.pool import Execution, parse_shard

    return Execution(workers, None if shard is None else parse_shard(shard), dask, tuple(merge or ()))


@contextmanager
def resumable(what: str, unit: str = "frames", *, kept: str | None = None) -> Iterator[Terminal]:
    """Show the progress of work that the same command takes up again; an interruption says so and ends with 130.

    Parameters
    ----------
    what, unit : str
        What is done, and what is counted of it.
    kept : str, optional
        What an interruption does not lose, where that is worth saying.
    """
    from horizonval.jobs.progress import Terminal

    with interruptible(kept), Terminal(what, unit) as progress:
        yield progress


@contextmanager
def interruptible(kept: str | None = None) -> Iterator[None]:
    """Let an interruption say that the same command goes on, and end with 130; ``kept`` as for :func:`resumable`.

    Nothing else that ends the work early is a success: not a plug-in's ``sys.exit(0)``, nor a reader who is gone.
    """
    try:
        yield
    except KeyboardInterrupt:
        finished = f"finished {kept} are kept, " if kept else ""
        print(f"horizonval: interrupted; {finished}the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    except SystemExit as end:
        # Work that comes to its end leaves the block: whoever ends the process inside it has not finished it.
        if end.code not in (None, 0):
            raise
        print("horizonval: error: foreign code ended the process before the work was done", file=sys.stderr)
        raise SystemExit(1) from None
    except BrokenPipeError:
        raise SystemExit(1) from None


def watched(what: str, unit: str = "files") -> Terminal:
    """Show on a terminal how far work has come that needs no log."""
    from horizonval.jobs.progress import Terminal

    return Terminal(what, unit, log=False)
