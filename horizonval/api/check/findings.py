"""Findings of a check, and its report as text and plain data."""

from __future__ import annotations

import json
import math
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any, Literal

from horizonval.api.check.cost import Cost, cost_lines
from horizonval.core.errors import UserError, command_line

Kind = Literal["scene", "suite", "study"]

SUMMARY_LINES = 4
"""Maximum number of lines before a run; the last one counts further warnings."""
MOST_NAMES = 3
"""Maximum number of named cameras, designs or bands in a line."""
SUBJECTS: dict[Kind, str] = {"scene": "bands", "suite": "cameras", "study": "designs"}


class Level(StrEnum):
    """Severity of a finding.

    ``ERROR``: a run would refuse it. ``WARNING``: it runs, but most likely not as intended. ``NOTE``: worth knowing.
    """

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True)
class Finding:
    """One problem or remark.

    ``code``: one of :data:`horizonval.api.check.rules.CODES`. ``text``: the problem with value, limit and units.
    ``value``, ``limit``: in ``unit``, of the worst frame, or the median where the text says so. ``fix``: what to
    change, or empty. ``subject``: a scene's band, a suite's camera, or a study's design. ``frames``, ``of``, ``total``:
    frames with the problem, examined frames, and all frames.
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


@dataclass(frozen=True, repr=False)
class Report:
    """The result of a check; ``print`` shows it.

    ``findings``: errors first, then warnings, then notes. ``facts``: view and brightness as text, by subject.
    ``examined``, ``frames``: examined and all frames. ``cost``: None if an error prevents all frames. ``source``: the
    file, or empty.
    """

    kind: Kind
    name: str
    findings: tuple[Finding, ...]
    facts: dict[str, str]
    examined: int
    frames: int
    cost: Cost | None = None
    source: str = ""

    def __post_init__(self) -> None:
        order = list(Level)
        findings = tuple(sorted(self.findings, key=lambda finding: order.index(finding.level)))
        object.__setattr__(self, "findings", findings)

    @property
    def ok(self) -> bool:
        """Whether there is neither an error nor a warning."""
        return not self.warnings

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Errors and warnings."""
        return tuple(finding for finding in self.findings if finding.level is not Level.NOTE)

    def __repr__(self) -> str:
        """Return one short line."""
        return f"<Report of {self.kind} {self.name}: {self._counted() or 'nothing wrong'}>"

    def __str__(self) -> str:
        """Return facts, findings, cost and verdict, a line each."""
        lines = [f"{self.kind} {self.name}"]
        lines += [f"  {subject}: {fact}" for subject, fact in self.facts.items()]
        if 0 < self.examined < self.frames:
            lines.append(f"  looked at {self.examined} of {self.frames} frames, evenly chosen")
        lines += _merged_lines(self.findings, self.kind)
        if self.cost is not None:
            lines += cost_lines(self.cost)
        count = self._counted()
        verdict = count if not self.ok else f"nothing wrong, {count}" if count else "nothing wrong"
        return "\n".join([*lines, verdict])

    def summary_lines(self) -> list[str]:
        """Return errors and warnings in few lines, as shown before a run."""
        lines = _merged_lines(self.warnings, self.kind)
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

    def _counted(self) -> str:
        counts = Counter(finding.level for finding in self.findings)
        return ", ".join(f"{count} {level}{'s' if count > 1 else ''}" for level, count in counts.items())


def cannot_run(error: UserError, subject: str = "") -> Finding:
    """Return a mistake of the user as a finding."""
    what = f"{error.where}: {error.what}" if error.where else error.what
    fix = "; ".join(part for part in (f"expected {error.expected}" if error.expected else "", error.fix) if part)
    return Finding(Level.ERROR, "cannot-run", what, fix=fix, subject=subject)


def _merged_lines(findings: Sequence[Finding], kind: Kind) -> list[str]:
    """Return a line for every level and code, with the text of the worst subject."""
    merged: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        merged.setdefault((finding.level, finding.code), []).append(finding)
    return [line for group in merged.values() for line in _merged(group, kind)]


def _merged(group: Sequence[Finding], kind: Kind) -> list[str]:
    if len(group) == 1 or group[0].level is Level.ERROR:
        return [finding.line() for finding in group]
    worst = max(group, key=lambda finding: gravity(finding.value, finding.limit))
    several = len(group) > MOST_NAMES
    subject = f"{len(group)} {SUBJECTS[kind]}" if several else ", ".join(finding.subject for finding in group)
    if kind == "scene":
        # Bands or heads of one frame.
        return [replace(worst, subject=subject).line()]
    frames, of, total = (sum(getattr(finding, key) for finding in group) for key in ("frames", "of", "total"))
    which = f"; the worst is {worst.subject}" if len({finding.text for finding in group}) > 1 else ""
    return [replace(worst, subject=subject, frames=frames, of=of, total=total).line() + which]


def gravity(value: float | None, limit: float | None) -> float:
    """Return the distance of a value from its limit; a missing value is the worst."""
    if limit is None:
        return 0.0
    return math.inf if value is None else abs(value - limit)


def percent(share: float) -> str:
    """Return a share as text: whole per cent, small ones to two digits."""
    return f"{100.0 * share:.2g} %" if 0.0 < share < 0.1 else f"{100.0 * share:.0f} %"


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of the known values."""
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None
