"""What a check finds: typed findings, and the report that holds them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Literal

from horizonval.precheck.cost import Cost

Kind = Literal["scene", "suite", "study"]


class Level(StrEnum):
    """How much a finding matters.

    ``ERROR``: it cannot work, a run would refuse it. ``WARNING``: it runs, and what comes of it is most likely not what
    was wanted. ``NOTE``: worth knowing.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """One thing that a user ought to know before rendering.

    Attributes
    ----------
    level : Level
    code : str
        One word of :data:`horizonval.precheck.rules.CODES`, for machines.
    text : str
        What is found, with its value and limit and their units.
    value, limit : float or None
        What was compared with what, in ``unit``; of several frames the value of the worst, or the median where the text
        says so.
    unit : str
    fix : str
        What to change, where there is something.
    subject : str
        What it is about: a scene's band, a suite's camera, a study's design.
    frames, of : int
        How many of how many frames that were looked at.
    """

    level: Level
    code: str
    text: str
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    fix: str = ""
    subject: str = ""
    frames: int = 1
    of: int = 1

    def line(self) -> str:
        """Return the finding as one line."""
        head = f"{self.level}: {self.subject}: " if self.subject else f"{self.level}: "
        count = "" if self.of == 1 else f"all {self.of} frames: " if self.frames == self.of else self._some()
        return head + count + self.text + (f"; {self.fix}" if self.fix else "")

    def _some(self) -> str:
        return f"{self.frames} of {self.of} frames: "


@dataclass(frozen=True)
class Report:
    """The result of a check; ``print`` shows it.

    Attributes
    ----------
    kind : {"scene", "suite", "study"}
    name : str
    findings : tuple of Finding
        Errors first, then warnings, then notes.
    facts : dict
        What is in view and how bright it will be, by subject; plain data, a line each in the text.
    examined, frames : int
        How many of how many frames were looked at.
    cost : Cost or None
        None where an error leaves nothing to be rendered.
    """

    kind: Kind
    name: str
    findings: tuple[Finding, ...]
    facts: dict[str, str]
    examined: int
    frames: int
    cost: Cost | None = None

    @property
    def ok(self) -> bool:
        """Whether there is neither an error nor a warning."""
        return all(finding.level is Level.NOTE for finding in self.findings)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Errors and warnings."""
        return tuple(finding for finding in self.findings if finding.level is not Level.NOTE)

    def __str__(self) -> str:
        """Return the report as text of a line for every fact and finding."""
        from horizonval.precheck.text import report_text

        return report_text(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "kind": self.kind,
            "name": self.name,
            "ok": self.ok,
            "examined": self.examined,
            "frames": self.frames,
            "findings": [asdict(finding) for finding in self.findings],
            "facts": self.facts,
            "cost": None if self.cost is None else self.cost.to_dict(),
        }

    def to_json(self) -> str:
        """Return :meth:`to_dict` as JSON."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False)


def sorted_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings with the gravest first, otherwise in their order."""
    order = list(Level)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))
