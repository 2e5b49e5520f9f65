"""Rescore the detector images of an archive with the current estimators.

The output has the layout of a run's folder without an archive, so that the report can read it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.core.errors import UserError, command_line
from horizonval.core.progress import Progress, Silent
from horizonval.estimation.observation import Estimator
from horizonval.jobs.engine import Recorded, do
from horizonval.jobs.pool import Execution
from horizonval.jobs.progress import Stopwatch
from horizonval.plugins import supervisor
from horizonval.plugins.supervisor import Limits
from horizonval.scoring.row import Row
from horizonval.store.folder import RunFolder, intact_json, read_json, write_json
from horizonval.store.index import Filter
from horizonval.store.named import run_folder_of
from horizonval.store.store import Store
from horizonval.store.verify import files_of_run, withdraw_manifest, write_manifest
from horizonval.suites.identity import rescored_identity
from horizonval.suites.plan import CasePlan
from horizonval.suites.record import Record, command_of_rescoring
from horizonval.suites.run import conclude
from horizonval.suites.units.archived import Item, archived_record, cases_of_heads, climates_of, items_of

RESCORE_SCHEMA = 1


@dataclass(frozen=True)
class Rescored:
    """Content of ``summary.json``, failed images with reasons, the report's first page, and seconds by stage."""

    summary: dict[str, Any]
    failed: dict[str, str]
    report: Path
    seconds: dict[str, Mapping[str, float]]


class RescoreWork(Recorded[Item]):
    """Images of an archive, into a folder that is laid out like a run's."""

    renders = False

    def __init__(self, plan: CasePlan, archive: Path, folder: RunFolder) -> None:
        self.plan, self.archive, self.run = plan, archive, folder

    def name(self, item: Item) -> str:
        return item.name

    def path(self, item: Item) -> Path:
        return self.run.case(item.name)

    def identity(self, item: Item) -> str:
        """Return the digest of images, frames, climate files of the priors, estimators and code."""
        names = item.estimators(self.plan)
        return rescored_identity(item.addresses, names, self.plan, climates_of(item, Store(self.archive)))

    def record(self, item: Item, watch: Stopwatch) -> Record:
        return archived_record(item, self.plan, Store(self.archive), watch)


def rescore(
    store: Store,
    out: Path,
    estimators: Sequence[str] = (),
    wanted: Filter | None = None,
    workers: int = 1,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Rescored:
    """Rescore the images of an archive into ``out``, or resume.

    ``estimators``: by default those of the archive's run. ``wanted``: selects images. ``workers``: parallel estimates;
    results do not depend on it. ``limits``: of one estimate. Raises ``UserError``: unknown estimators, no images, or a
    folder with other content.
    """
    run = run_folder_of(store.root)
    head = (read_json(run.suite) if run else None) or {}
    limits = limits or Limits()
    chosen = [supervisor.get(name, limits) for name in estimators or head.get("estimators", ())]
    if not chosen:
        raise UserError("which estimators?", where="--estimator", fix="see `horizonval list estimators`")
    entries = [entry for entry in store.index.select() if entry.kind == "frame"]
    entries += [entry for entry in store.index.select(wanted) if entry.kind == "image"]
    items = items_of(entries, chosen)
    # In the suite's order, as far as known.
    place = {name: number for number, name in enumerate(head.get("cases", ()))}
    items.sort(key=lambda item: place.get(item.name, len(place)))
    if not items:
        raise UserError(
            "no detector image to score", where=str(store.root), fix=f"see {command_line('archive', 'ls', store.root)}"
        )
    folder = RunFolder(out)
    command = command_of_rescoring(store.root, out, estimators, wanted, limits.time_s)
    _claim(folder, store, head, chosen, items, command)
    plan = CasePlan(tuple(estimator.name for estimator in chosen), limits)
    with folder.locked():
        folder.remove_temporary_files()
        done = do(RescoreWork(plan, store.root, folder), items, Execution(workers), progress or Silent())
        rows = [Row.from_dict(row) for one in done.values() if one.result is not None for row in one.result["rows"]]
        rows.sort(key=lambda row: row.sort_key)
        failed = {name: one.error for name, one in done.items() if one.error is not None}
        summary, pages = conclude(folder, head.get("suite"), rows, failed)
        records = [folder.case(item.name) for item in items]
        write_manifest(folder.root, [*files_of_run(folder), *records, *pages])
    seconds = {name: one.seconds for name, one in done.items() if one.seconds}
    return Rescored(summary, failed, pages[0], seconds)


def _claim(
    folder: RunFolder,
    store: Store,
    head: dict[str, Any],
    chosen: Sequence[Estimator],
    items: Sequence[Item],
    command: Sequence[str],
) -> None:
    before = intact_json(folder.suite)
    if (before is not None and "rescored" not in before) or folder.archive.exists():
        raise UserError("holds a run", where=str(folder.root), fix="choose another --out")
    folder.refuse_files_of_others()
    folder.refuse_links()
    for path in (folder.root, folder.cases):
        atomic.make_folder(path)
    names = [item.name for item in items]
    withdraw_manifest(folder.root)
    for path in folder.cases.glob("*.json"):
        if path.stem not in names:
            path.unlink()
    write_json(
        folder.suite,
        {
            "schema": RESCORE_SCHEMA,
            "rescored": True,
            "suite": head.get("suite") or store.root.name,
            "title": " ".join(filter(None, [str(head.get("title") or ""), "(scored again)"])),
            "version": code_version(),
            "command": list(command),
            "estimators": [estimator.name for estimator in chosen],
            "given_pose": [estimator.name for estimator in chosen if estimator.needs == "pose"],
            "likelihood": [estimator.name for estimator in chosen if estimator.claim == "likelihood"],
            "cases": names,
            "orbit": [name for name in head.get("orbit") or () if name in names],
            "heads": cases_of_heads(items),
            "archive": Path(os.path.relpath(store.root, folder.root)).as_posix(),
        },
    )
