"""Run the experiments of the chosen systems one after the other and write the pages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.pool import available_cpus
from horizonval.store.folder import RunFolder
from horizonval.systems.page import write_first_page, write_system
from horizonval.systems.quick import chosen, experiment, quick_figures, write_quick
from horizonval.systems.task_cache import TaskCache

WORK = ".work"
"""Folder beside the pages where finished parts of experiments wait for the rest; may be deleted at any time."""


def reproduce_systems(
    names: list[str],
    out: Path,
    *,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield the content of each system's JSON file as it is written; results do not depend on ``workers``.

    ``names``: letters or ``all``, none for all; ``out``: created if missing; ``seed``: of all noise. Raises
    ``UserError``: an unknown system, a folder of something else or in use, or no back-end to render with.
    """
    from horizonval.renderer.backend import probe

    letters = chosen(names)
    files.check_folder(out, ours=(out / WORK).is_dir() or any(out.glob("[A-G].json")))
    if probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    work = out / WORK
    work.mkdir(parents=True, exist_ok=True)
    cache = TaskCache(work, seed, workers or available_cpus(), progress or Silent())
    with RunFolder(work).locked():
        _remove_temporary_files(out)
        for letter in letters:
            content = write_system(letter, experiment(letter).reproduce(cache), out, seed)
            write_quick(letter, cache, out)
            write_first_page(out)
            yield content


def reproduce_quick(
    names: list[str], out: Path, pages: Path, *, workers: int | None = None, progress: Progress | None = None
) -> list[JsonObject]:
    """Return the key figures of the chosen systems and those of committed pages; see :func:`quick_figures`.

    An interrupted call resumes from the folder ``out``.
    """
    work = out / WORK
    work.mkdir(parents=True, exist_ok=True)
    with RunFolder(work).locked():
        return quick_figures(
            TaskCache(work, 0, workers or available_cpus(), progress or Silent()), pages, chosen(names)
        )


def _remove_temporary_files(out: Path) -> None:
    """Delete what a killed run was writing; call with the lock held."""
    for path in (*atomic.leftovers(out, below=False), *atomic.leftovers(out / WORK)):
        path.unlink(missing_ok=True)
