"""Findings, facts and costs in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from horizonval.precheck.cost import Cost
from horizonval.precheck.findings import Finding, Kind, Level
from horizonval.precheck.limb import LimbView
from horizonval.precheck.rules import gravity, median, percent

_NAMES = 3
_SUBJECTS: dict[Kind, str] = {"scene": "bands", "suite": "cameras", "study": "designs"}


def merged_lines(findings: Sequence[Finding], kind: Kind) -> list[str]:
    """Return a line for every level and code: of several cameras, designs or bands the worst one's text."""
    merged: dict[tuple[str, str], list[Finding]] = {}
    for finding in findings:
        merged.setdefault((finding.level, finding.code), []).append(finding)
    return [line for group in merged.values() for line in _merged(group, kind)]


def _merged(group: Sequence[Finding], kind: Kind) -> list[str]:
    if len(group) == 1 or group[0].level is Level.ERROR:
        return [finding.line() for finding in group]
    worst = max(group, key=lambda finding: gravity(finding.value, finding.limit))
    several = len(group) > _NAMES
    subject = f"{len(group)} {_SUBJECTS[kind]}" if several else ", ".join(finding.subject for finding in group)
    if kind == "scene":
        # Bands or heads of one frame.
        return [replace(worst, subject=subject).line()]
    frames, of, total = (sum(getattr(finding, key) for finding in group) for key in ("frames", "of", "total"))
    which = f"; the worst is {worst.subject}" if len({finding.text for finding in group}) > 1 else ""
    return [replace(worst, subject=subject, frames=frames, of=of, total=total).line() + which]


def joined(*parts: str) -> str:
    """Return the parts that are not empty, with commas."""
    return ", ".join(part for part in parts if part)


def view_line(view: LimbView) -> str:
    """Return what is in view of one frame, and how bright it will be."""
    parts = [
        f"{view.arc_deg:.0f} deg of horizon in view ({view.arc_px:.0f} px)" if view.arc_px else "no horizon in view"
    ]
    warmth = "" if view.plateau_k is None else f"{view.plateau_k:.0f} K"
    level = "" if view.level is None else f"{percent(view.level)} of full scale"
    if view.highest is not None and view.level is not None and view.highest > 1.05 * view.level:
        level += f" (at most {percent(view.highest)})"
    if warmth or level:
        parts.append(f"limb at {joined(warmth, level)}")
    if view.snr is not None:
        parts.append(f"SNR {view.snr:.3g}" if view.snr < 1e6 else "no noise")
    parts.append(f"expected: {view.outcome}" + (" (borderline)" if view.borderline else ""))
    return ", ".join(parts)


def group_line(views: Sequence[LimbView], frames: int) -> str:
    """Return the same of the frames of a group: medians, and how many of each outcome."""
    counts = Counter(str(view.outcome) for view in views)
    found = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
    looked = f"{frames} frames" if len(views) == frames else f"{len(views)} of {frames} frames"
    parts = [f"{looked} ({found})"]
    arc, level, snr = (median(getattr(view, key) for view in views) for key in ("arc_deg", "level", "snr"))
    if arc:
        parts.append(f"{arc:.0f} deg of horizon")
    if level is not None:
        parts.append(f"limb at {percent(level)} of full scale")
    if snr is not None and snr < 1e6:
        parts.append(f"SNR {snr:.3g}")
    return ", ".join(parts) + (" (medians)" if len(parts) > 1 and len(views) > 1 else "")


def cost_lines(cost: Cost, processors: int) -> list[str]:
    """Return what a run takes, a line or two; ``processors`` share the work."""
    frames = f"{cost.frames} frame{'s' if cost.frames != 1 else ''}"
    lines = [
        f"cost: {frames}, about {seconds(cost.processor_s / processors)} on {processors} processors "
        f"(to a factor of three), "
        f"{size(cost.memory_mb)} a process, {size(cost.disk_mb)} on disk"
    ]
    if cost.tables:
        time = seconds(cost.tables_s / processors)
        lines.append(
            f"      and up to {time} for {cost.tables} tables of multiple scattering that no earlier run has left in "
            "the cache"
        )
    return lines


def seconds(value: float) -> str:
    """Return a long time as text, to two digits."""
    if value < 90:
        return f"{float(f'{value:.2g}'):g} s"
    return f"{float(f'{value / 60:.2g}'):g} min" if value < 5400 else f"{float(f'{value / 3600:.2g}'):g} h"


def size(megabytes: float) -> str:
    """Return a size as text, to two digits."""
    return f"{float(f'{megabytes:.2g}'):g} MB" if megabytes < 950 else f"{float(f'{megabytes / 1000:.2g}'):g} GB"


def counted(findings: Sequence[Finding]) -> str:
    """Return how many findings there are of each level."""
    counts = Counter(finding.level for finding in findings)
    return ", ".join(f"{count} {level}{'s' if count > 1 else ''}" for level, count in counts.items())
