"""The report of a check: for people as text, for machines as plain data."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from horizonval.core.errors import command_line
from horizonval.jobs.pool import available_cpus
from horizonval.precheck.cost import Cost
from horizonval.precheck.findings import Finding, Kind, Level
from horizonval.precheck.text import cost_lines, counted, merged_lines

SUMMARY_LINES = 4
"""Lines before a run: what does not fit is counted in the last one."""


@dataclass(frozen=True, repr=False)
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
    source : str
        The file, for commands that name it; empty where there is none.
    """

    kind: Kind
    name: str
    findings: tuple[Finding, ...]
    facts: dict[str, str]
    examined: int
    frames: int
    cost: Cost | None = None
    source: str = ""

    @property
    def ok(self) -> bool:
        """Whether there is neither an error nor a warning."""
        return all(finding.level is Level.NOTE for finding in self.findings)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Errors and warnings."""
        return tuple(finding for finding in self.findings if finding.level is not Level.NOTE)

    def __repr__(self) -> str:
        """Return one short line."""
        return f"<Report of {self.kind} {self.name}: {counted(self.findings) or 'nothing wrong'}>"

    def __str__(self) -> str:
        """Return facts, findings, cost and verdict, a line each."""
        lines = [f"{self.kind} {self.name}"]
        lines += [f"  {subject}: {fact}" for subject, fact in self.facts.items()]
        if 0 < self.examined < self.frames:
            lines.append(f"  looked at {self.examined} of {self.frames} frames, evenly chosen")
        lines += merged_lines(self.findings, self.kind)
        if self.cost is not None:
            lines += cost_lines(self.cost, available_cpus())
        count = counted(self.findings)
        verdict = count if not self.ok else f"nothing wrong, {count}" if count else "nothing wrong"
        return "\n".join([*lines, verdict])

    def summary_lines(self) -> list[str]:
        """Return errors and warnings in few lines, for what goes on after them."""
        lines = merged_lines(self.warnings, self.kind)
        check = command_line("check", self.source or self.name)
        if len(lines) > SUMMARY_LINES:
            left = len(lines) - SUMMARY_LINES + 1
            lines = [*lines[: SUMMARY_LINES - 1], f"and {left} more warnings: see {check}"]
        if lines and self.examined < self.frames:
            lines.append(f"looked at {self.examined} of {self.frames} frames; {check} looks at more")
        return lines

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
