"""The units of a suite as work for the engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from horizonval.jobs.engine import Done, Work, keep, kept
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.frame_cost import shared_view
from horizonval.scoring.row import Row
from horizonval.store.folder import RunFolder, intact_json
from horizonval.store.store import Store
from horizonval.suites.identity import unit_identity
from horizonval.suites.plan import CasePlan, Unit
from horizonval.suites.record import Record
from horizonval.suites.units.case import failed_records, point_to, records_of, rendered


@dataclass(frozen=True)
class Brief:
    """Part of a record that stays in memory: its rows, or the error."""

    rows: list[Row]
    error: str | None

    @classmethod
    def of(cls, record: Record) -> Brief:
        return cls([Row.from_dict(row) for row in record["rows"]], record["error"])


Briefs = dict[str, Brief]
"""By the names of a unit's results."""


class UnitWork(Work[Unit, Briefs]):
    """Units of a suite, in the folder of its run."""

    def __init__(self, plan: CasePlan, folder: RunFolder) -> None:
        self.plan, self.run = plan, folder
        self.folder: Path | None = folder.root

    def name(self, item: Unit) -> str:
        return item.name

    def group(self, item: Unit) -> str:
        """Return the key of units that share view tables; the heads of a unit differ in direction only."""
        return shared_view(item.cases[0].scene, item.cases[0].camera)

    def limit_s(self, item: Unit) -> float:
        return self.plan.frame_limit_s * len(item.cases)

    def parts(self, item: Unit, done: Done[Briefs] | None) -> Mapping[str, str | None]:
        """Count frames only, not a scene's common result."""
        briefs = (None if done is None else done.result) or {}
        return {case.name: briefs[case.name].error if case.name in briefs else None for case in item.cases}

    def finished(self, item: Unit) -> Briefs | None:
        """Return the records of a finished unit whose archived files are all undamaged."""
        identity, store = unit_identity(item, self.plan), Store(self.run.archive)
        found, frames = {}, {}
        for name in item.names:
            record = kept(self.run.case(name), identity)
            if record is None:
                return None
            addresses = [a for a in (record["truth_frame"], *record["images"].values()) if a is not None]
            if not all(store.is_intact(address) for address in addresses):
                return None
            found[name] = Brief.of(record)
            frames[name] = record["truth_frame"]
        self._mend_pointers(item, frames)
        return found

    def _mend_pointers(self, unit: Unit, frames: Mapping[str, str | None]) -> None:
        """Rewrite missing or damaged addresses of a finished unit's frames."""
        for case in unit.cases:
            address = frames[case.name]
            if self.plan.keep == "all" and address is not None and rendered(case, self.plan, self.run) != address:
                intact_json(self.run.frame_pointer(case.name))
                point_to(case, self.run, address)

    def make(self, item: Unit, watch: Stopwatch) -> Briefs:
        return self._keep(item, records_of(item, self.plan, self.run, watch))

    def lost(self, item: Unit, why: str) -> Done[Briefs]:
        return Done(self._keep(item, failed_records(item, self.plan, dict.fromkeys(item.names, why))), why)

    def _keep(self, unit: Unit, records: Mapping[str, Record]) -> Briefs:
        identity = unit_identity(unit, self.plan)
        for name, record in records.items():
            keep(self.run.case(name), identity, record)
        return {name: Brief.of(record) for name, record in records.items()}
