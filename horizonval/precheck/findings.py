"""What a check finds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

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
    frames, of, total : int
        How many of how many frames that were looked at, of how many that there are.
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
    total: int = 1

    def line(self) -> str:
        """Return the finding as one line."""
        head = f"{self.level}: {self.subject}: " if self.subject else f"{self.level}: "
        return head + self._count() + self.text + (f"; {self.fix}" if self.fix else "")

    def _count(self) -> str:
        if self.total == 1:
            return ""
        looked_at = " looked at" if self.of < self.total else ""
        which = f"all {self.of}" if self.frames == self.of > 1 else f"{self.frames} of {self.of}"
        return f"{which} frame{'s' if self.of > 1 else ''}{looked_at}: "


def sorted_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings with the gravest first, otherwise in their order."""
    order = list(Level)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.level)))
