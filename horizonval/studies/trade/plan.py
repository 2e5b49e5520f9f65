"""What a study's folder must know to work out its results without the study file: ``study-plan.json``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.spec.suite import Requirement, StudyHead
from horizonval.store.folder import read_json, write_json
from horizonval.studies.trade.design import Design, Study

FILE = "study-plan.json"
PLAN_SCHEMA = 1


@dataclass(frozen=True)
class StudyPlan:
    """Designs, conditions and frames of a study; see :class:`horizonval.studies.trade.design.Study`."""

    head: StudyHead
    designs: tuple[Design, ...]
    conditions: dict[str, str]
    frames: dict[str, tuple[str, str]]
    batches: dict[str, list[list[str]]]

    @property
    def requirement(self) -> Requirement:
        return self.head.requirement

    def design(self, name: str, where: str) -> Design:
        """Return the design of a name, or of a number from 1.

        Raises
        ------
        UserError
            There is none.
        """
        for number, design in enumerate(self.designs, start=1):
            if name in (design.name, str(number)):
                return design
        from horizonval.core.errors import nearest

        known = ", ".join(nearest(name, [design.name for design in self.designs])[:8])
        raise UserError(f"no design {name!r}", where=where, expected=f"a number up to {len(self.designs)}, or {known}")


def plan_of_study(study: Study) -> StudyPlan:
    """Return the plan of an expanded study."""
    return StudyPlan(study.spec.study, study.designs, study.conditions, study.frames, study.batches)


def write_plan(plan: StudyPlan, folder: Path) -> None:
    """Write a plan into a study's folder."""
    content = {
        "schema": PLAN_SCHEMA,
        "study": plan.head.model_dump(mode="json"),
        "designs": [asdict(design) for design in plan.designs],
        "conditions": plan.conditions,
        "frames": plan.frames,
        "batches": plan.batches,
    }
    write_json(folder / FILE, content)


def read_plan(folder: Path) -> StudyPlan | None:
    """Return the plan of a folder, ``None`` where there is none.

    Raises
    ------
    UserError
        The file is not what a study writes.
    """
    path = folder / FILE
    if not path.exists():
        return None
    data: Any = read_json(path)
    try:
        if data["schema"] != PLAN_SCHEMA:
            raise ValueError
        return StudyPlan(
            StudyHead.model_validate(data["study"]),
            tuple(Design(**design) for design in data["designs"]),
            dict(data["conditions"]),
            {name: (entry, condition) for name, (entry, condition) in data["frames"].items()},
            {entry: [list(batch) for batch in batches] for entry, batches in data["batches"].items()},
        )
    except (KeyError, TypeError, ValueError) as e:
        raise UserError(
            "not a study's plan", where=str(path), fix="delete it and run the study again; finished frames are kept"
        ) from e
