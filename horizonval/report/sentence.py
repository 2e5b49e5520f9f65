"""The first sentences of a report: what each estimator does, how badly it is off and where it fails, in degrees."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.report.angle_unit import DEG
from horizonval.report.formatting import count, percent
from horizonval.report.load import ReportRun
from horizonval.scoring.row import Row

MOST_NAMED = 2
"""Estimators with a sentence each; of more the best and the worst."""


@dataclass(frozen=True)
class Record:
    """What one estimator did with all cameras; errors in arc seconds."""

    name: str
    due: int
    right: int
    errors: tuple[float, ...]
    false: tuple[tuple[str, int], ...]
    silent: tuple[tuple[str, int], ...]

    @property
    def rank(self) -> tuple[float, float, str]:
        """Best first: the larger share of right answers, then the smaller worst error."""
        return (-self.right / self.due if self.due else 1.0, max(self.errors, default=0.0), self.name)

    @property
    def text(self) -> str:
        if self.due:
            parts = [f"{self.name} is right in {percent(self.right / self.due)} of {count(self.due, 'answer')} due"]
        else:
            parts = [f"{self.name} has no answer due"]
        if self.errors:
            middle, most = (DEG.text(float(value)) for value in np.percentile(self.errors, [50.0, 95.0]))
            parts.append(
                f": half of its claims are within {middle} of the true nadir, 95 % within {most}, "
                f"the worst {DEG.text(max(self.errors))} off"
            )
        for words, places in (("false or crashed", self.false), ("without answer", self.silent)):
            if places:
                parts.append(f"; {words} mostly " + " and ".join(f"{place} ({n})" for place, n in places[:2]))
        return "".join(parts) + "."


def sentences(run: ReportRun, groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a sentence for each judged estimator, or for the best and the worst of many, which are named.

    Parameters
    ----------
    run : ReportRun
    groups : sequence of mapping
        Of :func:`horizonval.scoring.summary.summarise`: an estimator with a camera each.
    """
    rows = run.judged_rows
    if not any(row.is_due or row.is_claim for row in rows):
        return ["No frame is due an answer."]
    return opening([_record(name, rows, groups) for name in run.judged_estimators])


def opening(records: Sequence[Record]) -> list[str]:
    """Return the records' sentences, the best first; of many those of the best and the worst."""
    ranked = sorted(records, key=lambda one: one.rank)
    if len(ranked) <= MOST_NAMED:
        return [record.text for record in ranked]
    return [f"Of {len(ranked)} estimators the best: {ranked[0].text}", f"The worst: {ranked[-1].text}"]


def _record(name: str, rows: Sequence[Row], groups: Sequence[Mapping[str, Any]]) -> Record:
    own = [row for row in rows if row.estimator == name]
    due = [row for row in own if row.is_due]
    return Record(
        name=name,
        due=len(due),
        right=sum(row.is_claim and not row.false_valid for row in due),
        errors=tuple(row.nadir_error_arcsec for row in own if row.is_claim and row.nadir_error_arcsec is not None),
        false=_places(name, groups, ("crashed", "false")),
        silent=_places(name, groups, ("silent",)),
    )


def _places(name: str, groups: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> tuple[tuple[str, int], ...]:
    """Return where an estimator failed so, with all cameras, and how often; the most first."""
    found: Counter[str] = Counter()
    for group in groups:
        if group["estimator"] == name and not group["given_pose"]:
            for key in keys:
                for place, n, _ in group["headline"][key]:
                    found[place] += n
    return tuple(sorted(found.items(), key=lambda item: (-item[1], item[0])))
